"""Quadratic forms `b' A^+ b` of many small systems at once, and the factor of one large system.

Method: docs/algorithms/what-can-be-seen.md.
"""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Mask
from metrocli.diagnosis.linear.projection import FLAT, VISIBLE

_NOTHING = 1e-150
"""Size below which a column is 0: its square is"""


def roots(gram: Array, scale: Array) -> Array:
    """Return R with `A^+ = R R'` for Gram matrices A (k, q, q); columns of R of directions that are not visible are 0.

    `scale` (k, q) is of size sqrt(diag A) or larger: directions are visible in its unit.
    """
    s = np.where(scale > _NOTHING, scale, 1.0)
    if gram.shape[1] == 1:
        value = gram / (s * s)[:, :, None]
        good = value > VISIBLE**2
        return np.where(good, 1 / np.sqrt(np.where(good, value, 1.0)), 0.0) / s[:, :, None]
    scaled = gram / (s[:, :, None] * s[:, None, :])
    root, rest = triangular(scaled)
    if rest.any():
        values, vectors = np.linalg.eigh(scaled[rest])
        good = values > np.maximum(VISIBLE**2, FLAT * values[:, -1:])
        root[rest] = vectors * np.where(good, 1 / np.sqrt(np.where(good, values, 1.0)), 0.0)[:, None, :]
    return np.asarray(root / s[:, :, None])


def triangular(gram: Array) -> tuple[Array, Mask]:
    """Return R = L^-T of Gram matrices `L L'` (k, q, q), and which have directions that may not be visible (k,).

    It takes half the time of eigenvectors. All directions are visible where `1/tr A^-1`, which no eigenvalue is
    below, exceeds the bounds; `tr A` is at least the largest. A column that is 0 is a direction of its own.
    """
    nothing = np.einsum("kqq->kq", gram) == 0
    try:
        inverse = np.linalg.inv(np.linalg.cholesky(gram + np.eye(gram.shape[1]) * nothing[:, :, None]))
    except np.linalg.LinAlgError:
        return np.zeros(gram.shape), np.ones(len(gram), dtype=bool)
    with np.errstate(over="ignore", invalid="ignore"):
        bound = (inverse**2).sum(axis=(1, 2))
        seen = bound * np.maximum(VISIBLE**2, FLAT * np.einsum("kqq->k", gram)) < 1
    return np.swapaxes(inverse, 1, 2) * ~nothing[:, None, :], ~seen


def ranks_of(root: Array) -> Array:
    """Return the number of visible directions of each root (k, q, q), (k,)."""
    return np.asarray(root.any(axis=1).sum(axis=1))


def quadratic(gram: Array, right: Array, scale: Array) -> tuple[Array, Array]:
    """Return `b' A^+ b` and the rank of A for many small systems (k, q, q), (k, q); scale (k, q) is of size sqrt(A)."""
    root = roots(gram, scale)
    along = np.einsum("kqv,kq->kv", root, right)
    return (along**2).sum(axis=1), ranks_of(root)


def factored(gram: Array, priors: Array | float = 0.0) -> Array:
    """Return the factor of a Gram matrix with priors on its diagonal; a column of those before it is nearly free."""
    from scipy.linalg.lapack import dpotrf

    if not len(gram):
        return gram
    diagonal = np.maximum(np.diag(gram) + priors, 1e-300)
    # columns of two parts can be nearly the same: the least bump with which the factor exists changes the others least
    bump = 1e-13
    while bump < 1e-1:
        factor = gram.copy()
        factor.ravel()[:: len(gram) + 1] = diagonal * (1 + bump)
        upper, failed = dpotrf(factor.T, overwrite_a=True)
        if not failed:
            return np.asarray(upper.T)
        bump *= 100
    raise np.linalg.LinAlgError("products of columns have no factor")


def solved(lower: Array, right: Array) -> Array:
    """Return `lower^-1 right` of a triangular factor (p, p) and right sides (p, ...)."""
    from scipy.linalg.blas import dtrsm

    if not right.size:
        return right
    # without the checks of `solve_triangular`, which take longer than most of these systems, and from the right: the
    # transposed arrays are in the order of BLAS, so that nothing is copied to another order
    solution = dtrsm(1.0, lower.T, right.reshape(len(right), -1).T, side=1).T
    return np.asarray(solution.reshape(right.shape))
