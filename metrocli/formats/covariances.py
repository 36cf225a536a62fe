"""Covariances that enter with a file: symmetric, positive, and those of the standard uncertainties beside them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli.arrays import Array
from metrocli.result import Result

_CROSS = ("views_lens_covariance",)
"""Covariances between two different sets of quantities, which need not be symmetric"""
_TOLERANCE = 1e-6
"""Largest negative eigenvalue of a correlation matrix, and relative difference of variances, left by rounding"""
_ROUNDING = 1e-12
"""Largest negative variance left by rounding, relative to the largest variance"""


def contradictions(result: Result) -> list[str]:
    """Return a sentence for each covariance of a result that no quantities can have; empty for a sound result.

    With D the diagonal, `D^(-1/2) C D^(-1/2)` must be symmetric with eigenvalues above -1e-6, and D of the estimates
    must be the squares of their standard uncertainties. Rows of undetermined quantities (infinite or nan) are left out.
    """
    return [f"{name} {fault}" for name, fault in _faults(result)]


def _faults(result: Result) -> Iterator[tuple[str, str]]:
    stds = np.array([estimate.std for estimate in result.estimates], dtype=float)
    if (stds < 0).any():
        yield "parameters", "have a negative standard uncertainty"
    if result.covariance.shape != (len(stds), len(stds)):
        yield "covariance", "has another size than the parameters"
    else:
        known = np.isfinite(stds)
        matrix = result.covariance[np.ix_(known, known)]
        if fault := _fault(matrix):
            yield "covariance", fault
        elif not np.allclose(np.sqrt(np.maximum(np.diag(matrix), 0)), stds[known], rtol=_TOLERANCE, atol=1e-300):
            yield "covariance", "contradicts the standard uncertainties of the parameters"
    for name, array in result.arrays.items():
        square = array.ndim >= 2 and array.shape[-1] == array.shape[-2] and array.dtype.kind == "f"
        if name.endswith("covariance") and name not in _CROSS and square and (fault := _fault(array)):
            yield name, fault


def _fault(matrices: Array) -> str:
    """Return what is wrong with one covariance, or any of a stack of them (..., n, n); empty for nothing."""
    variances = np.diagonal(matrices, axis1=-2, axis2=-1)
    known = np.isfinite(variances)
    if (variances[known] < -_ROUNDING * np.abs(variances[known]).max(initial=0.0)).any():
        return "has a negative variance"
    size = np.sqrt(np.where(known & (variances > 0), variances, 1.0))
    both = known[..., :, None] & known[..., None, :]
    # rows of undetermined quantities become those of a unit matrix, which passes
    scaled = np.where(both, matrices / size[..., :, None] / size[..., None, :], np.eye(matrices.shape[-1]))
    if not np.isfinite(scaled).all():
        return "has infinite values"
    if (np.abs(scaled - np.swapaxes(scaled, -1, -2)) > _TOLERANCE).any():
        return "is not symmetric"
    try:
        # shifted by what is allowed: a factor exists exactly where no eigenvalue is
        # below minus that, and costs less than these
        np.linalg.cholesky(scaled + _TOLERANCE * np.eye(matrices.shape[-1]))
    except np.linalg.LinAlgError:
        return "is not positive: no quantities have these correlations"
    return ""
