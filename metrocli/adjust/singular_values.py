"""Singular value decomposition that does not fail on a finite matrix."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array


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
