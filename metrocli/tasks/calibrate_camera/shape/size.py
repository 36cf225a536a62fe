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
"""Ratios of the variances that are tried first; each step is a quarter of a decade in the standard deviation"""


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
    from scipy.optimize import minimize_scalar

    root = np.linalg.cholesky(kernel + 1e-10 * np.trace(kernel) / len(kernel) * np.eye(len(kernel)))
    values, vectors = np.linalg.eigh(root.T @ evidence.normal @ root)
    values, along = np.maximum(values, 0.0), (vectors.T @ (root.T @ evidence.right)) ** 2

    def scale(ratio: float) -> float:
        if evidence.noise_known:
            return 1.0
        return float(evidence.squares - (along * ratio / (1 + ratio * values)).sum()) / evidence.dof

    def gain(ratio: float) -> float:
        size = float(np.log1p(ratio * values).sum())
        if evidence.noise_known:
            return (float((along * ratio / (1 + ratio * values)).sum()) - size) / 2
        return -(evidence.dof * float(np.log(scale(ratio) * evidence.dof / evidence.squares)) + size) / 2

    best = _RATIOS[int(np.argmax([gain(ratio) for ratio in _RATIOS]))]
    about = np.log(best) + np.array([-0.25, 0.25])
    found = minimize_scalar(lambda x: -gain(float(np.exp(x))), bounds=tuple(about), method="bounded")
    ratio = float(np.exp(found.x))
    return Size(ratio * scale(ratio) * (root @ root.T), gain(ratio))
