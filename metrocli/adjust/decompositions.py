"""Singular values of any finite matrix, and QR with column pivots.

`scipy.linalg` has both too, but loading it takes longer than the adjustment of a small job.
"""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array, Index


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
