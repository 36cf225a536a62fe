"""How large and how smooth the shape of a lens is, by restricted likelihood.

Readings y are X b + Z w + e, with w ~ N(0, t2 K) and e ~ N(0, s2 I). P is the projection off X, A = Z' P Z, c = Z' P y.
The restricted likelihood of t2 / s2 follows from the eigenvalues of L' A L, K = L L' (Patterson and Thompson 1971).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass

_RATIOS = np.geomspace(1e-9, 1e9, 181)
"""Ratios of the variances that are tried first; each step is a tenth of a decade"""
_FINE, _ROUNDS = 21, 6
"""Ratios between the neighbours of the best one, and how often these are taken: to a millionth of a step"""


@dataclass(frozen=True)
class Evidence:
    """What readings know of the unknowns w, whitened by the declared noise."""

    normal: Array
    """A (m, m)"""
    right: Array
    """c (m,)"""
    squares: float
    """Weighted squares of the residuals without the shape"""
    dof: int
    """Readings less the other unknowns"""
    noise_known: bool


@dataclass(frozen=True)
class Size:
    """The most likely covariance of the unknowns, absolute."""

    covariance: Array
    gain: float
    """Logarithm of the likelihood over that without a shape"""


def likely(evidence: Evidence, kernels: Sequence[Array]) -> Size:
    """Return the covariance t2 K of the unknowns with the largest restricted likelihood, of kernels K (m, m)."""
    return max((_likely(evidence, kernel) for kernel in kernels), key=lambda size: size.gain)


def _likely(evidence: Evidence, kernel: Array) -> Size:
    # a smooth kernel is singular to rounding: its root needs a little of a diagonal one
    root = np.linalg.cholesky(kernel + 1e-10 * np.trace(kernel) / len(kernel) * np.eye(len(kernel)))
    values, vectors = np.linalg.eigh(root.T @ evidence.normal @ root)
    # in these directions the likelihood of a ratio is a sum, so that 181 ratios cost no decomposition each
    values, along = np.maximum(values, 0.0), (vectors.T @ (root.T @ evidence.right)) ** 2

    ratios, gains, variances = _RATIOS, np.zeros(1), np.ones(1)
    for _ in range(_ROUNDS + 1):
        grown = 1 + ratios[:, None] * values
        explained, log_det = (along * ratios[:, None] / grown).sum(axis=1), np.log(grown).sum(axis=1)
        if evidence.noise_known:
            gains, variances = (explained - log_det) / 2, np.ones(len(ratios))
        else:
            # an unknown noise is estimated beside the shape, from what it leaves
            variances = (evidence.squares - explained) / evidence.dof
            gains = -(evidence.dof * np.log(variances * evidence.dof / evidence.squares) + log_det) / 2
        at, tried = int(np.argmax(gains)), ratios
        ratios = np.geomspace(tried[max(at - 1, 0)], tried[min(at + 1, len(tried) - 1)], _FINE)
    return Size(tried[at] * variances[at] * (root @ root.T), float(gains[at]))
