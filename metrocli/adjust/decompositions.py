"""Singular values of any finite matrix, QR with column pivots, and orthonormal bases of many rows.

`scipy.linalg` has both too, but loading it takes longer than the adjustment of a small job.
"""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array, Index

_EVEN = 0.01
"""Eigenvalue of a Gram matrix, relative to the largest, above which its eigenvectors need no second step"""


def thin_svd(matrix: Array) -> tuple[Array, Array, Array]:
    """Return u (n, k), the singular values (k,) from the largest on, and v' (k, m), with k the smaller of n and m.

    LAPACK's divide and conquer (gesdd) now and then does not converge, although the matrix is an ordinary one. Then
    it is decomposed by QR iteration (gesvd), which is slower. Raises LinAlgError for a matrix with entries that are no
    numbers.
    """
    try:
        u, values, vt = np.linalg.svd(matrix, full_matrices=False)
    except np.linalg.LinAlgError:
        if not np.isfinite(matrix).all():
            raise
        from scipy.linalg import svd

        u, values, vt = svd(matrix, full_matrices=False, lapack_driver="gesvd")
    return np.asarray(u), np.asarray(values), np.asarray(vt)


def pivoted_qr(matrix: Array) -> tuple[Array, Array, Index]:
    """Return Q (m, m), R (m, n) and the order of the columns (n,) with `matrix[:, order] = Q R`.

    The diagonal of R falls, since each step takes the column of which most is left (Businger and Golub 1965). Signs
    are those of LAPACK.
    """
    m, n = matrix.shape
    q, r, order = np.eye(m), np.array(matrix, dtype=float), np.arange(n)
    for k in range(min(m, n)):
        # lengths anew at each step and not updated: updates cancel where columns are nearly dependent
        chosen = k + int((r[k:, k:] ** 2).sum(axis=0).argmax())
        r[:, [k, chosen]], order[[k, chosen]] = r[:, [chosen, k]], order[[chosen, k]]
        mirror = r[k:, k].copy()
        if not mirror[1:].any():  # LAPACK does not mirror such a column
            continue
        # the sign of the entry itself, so that the sum does not cancel
        mirror[0] += np.copysign(np.linalg.norm(mirror), mirror[0])
        mirror *= np.sqrt(2) / np.linalg.norm(mirror)
        r[k:, k:] -= np.outer(mirror, mirror @ r[k:, k:])
        q[:, k:] -= np.outer(q[:, k:] @ mirror, mirror)
    return q, np.triu(r), order


def orthonormalised(columns: Array, least: float, gram: Array | None = None) -> tuple[Array, Array]:
    """Return an orthonormal basis (rows, k) of the span of columns (rows, q), and the turn (q, k) that gives it.

    It uses the eigenvectors of the Gram matrix, `gram` if it is known: far faster than an SVD for many rows. Where
    their sizes differ much, the Cholesky factor of the Gram matrix of what they give is a second step (Cholesky QR).
    Directions of singular values up to `least` are left out.
    """
    values, vectors = np.linalg.eigh(columns.T @ columns if gram is None else gram)
    kept = values > least**2
    turn = vectors[:, kept] / np.sqrt(values[kept])
    columns = columns @ turn
    if kept.any() and values[kept][0] <= _EVEN * values[-1]:
        inverse = np.linalg.inv(np.linalg.cholesky(columns.T @ columns))
        columns, turn = triangular_turn(columns, inverse), turn @ inverse.T
    return columns, turn


def triangular_turn(columns: Array, lower: Array) -> Array:
    """Return `columns lower'` (rows, k) for a lower triangular matrix, computed in the place of the columns."""
    from scipy.linalg.blas import dtrmm

    # half the operations of a product; a new table of many rows would take as long again
    return np.asarray(dtrmm(1.0, lower, columns.T, lower=True, overwrite_b=True).T)


def grams_of(columns: Array) -> Array:
    """Return the Gram matrix of each alternative, (k, q, q), of columns (rows, k, q)."""
    by_alternative = columns.transpose(1, 0, 2)
    return np.asarray(np.matmul(by_alternative.transpose(0, 2, 1), by_alternative))
