"""Coverage factors of deviations with few degrees of freedom: the probability of k = 2, 95.45 %."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
PROBABILITY = 0.954499736
"""That of two standard deviations of a normal distribution"""
COVERAGE = (2.0, 2.4860, 2.8329)
"""k of one, two and three components of a deviation with infinitely many degrees of freedom (JCGM 102, 6.5.3)"""


def factor(components: npt.NDArray[np.intp] | int, dof: Array | float) -> Array:
    """Return the k of deviations of 0 to 3 components: `k^2 = q F_p(q, dof)`, for q = 1 the t factor (GUM G.6.4).

    With a covariance from `dof` degrees of freedom the square of a deviation, divided by q, has that F distribution.
    """
    q, dof = np.broadcast_arrays(np.asarray(components), np.asarray(dof, dtype=float))
    k = np.array(np.array([COVERAGE[0], *COVERAGE])[q])
    few = np.isfinite(dof) & (q > 0)
    if few.any():
        from scipy.special import fdtri

        k[few] = np.sqrt(q[few] * fdtri(q[few], dof[few], PROBABILITY))
    return np.asarray(k)


def effective(dof: float, part: Array, whole: Array) -> Array:
    """Return the degrees of freedom of variances `whole`, of which `part` has `dof` and the rest infinitely many.

    Welch-Satterthwaite: `dof (whole / part)^2` (GUM G.4.1).
    """
    if math.isinf(dof):
        return np.full(np.shape(whole), math.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(part > 0, dof * (whole / part) ** 2, math.inf))
