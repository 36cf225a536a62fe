"""Covariance of a pose with the largest least overstock, from fits to points with drawn errors.

Errors of a usual size exchange the points that hold such a pose, which a derivative with the same points cannot know.
Method: docs/algorithms/overstock-fit.md.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from metrocli.adjust.small_programmes import Optimum, highest, quadratic
from metrocli.errors import NotConvergedError
from metrocli.geometry import poses
from metrocli.geometry.surfaces import Array, Index
from metrocli.tasks.fit_part.fit import SLACK, Fit
from metrocli.tasks.fit_part.uncertainty import Sensitivity
from metrocli.uncertainty.predicted import Places

DRAWS = 200
_SEED = 1
_REACH = 0.01
"""Reach of the linear programme of a draw, relative to the size of the point cloud"""
_REGULAR = 1e-9
"""Share of the mean second derivative of the evenness that keeps motions still which no overstock shows"""
_NO_ERROR = 1e-3
"""Share of the largest standard deviation that a place is drawn with if it has no error of its own"""


def sensitivity_of_draws(fit: Fit, places: Places) -> Sensitivity:
    """Return how points with drawn errors move a pose with the largest least overstock.

    Each draw e is solved on the overstock `o + n.e + J x`, linear about the fit. With S the mean derivative of the step
    by the points, and r = x - S e what it leaves, the covariance is `S C S' + mean r r'` about the fitted pose. Raises
    NotConvergedError.
    """
    local, n = fit.local, len(fit.local.points)
    outward = local.shape.normal @ poses.rotation_of(fit.into)
    rows, centred = local.rows, local.rows - local.rows.mean(axis=0)
    hessian = centred.T @ centred / n
    hessian += _REGULAR * np.trace(hessian) * np.eye(6)
    draw, rng = drawing(places), np.random.default_rng(_SEED)
    steps, errors = np.zeros((DRAWS, 6)), np.zeros((DRAWS, n))
    by_even, by_overstock = np.zeros((6, 6)), np.zeros((n, 6))
    for k in range(DRAWS):
        errors[k] = np.einsum("na,na->n", outward, draw(rng))
        overstock = local.overstock + errors[k]
        held, least = highest(rows, overstock, _REACH * local.lever)
        even = quadratic(hessian, centred.T @ overstock / n, rows, least - SLACK - overstock)
        if even is None:
            raise NotConvergedError("a fit to points with drawn errors has no solution")
        steps[k] = even.x
        of_gradient, active, of_bounds = _response(hessian, rows, even)
        by_even -= of_gradient / DRAWS
        by_overstock[active] -= of_bounds.T / DRAWS
        by_overstock += held.duals[:, None] * of_bounds.sum(axis=1) / DRAWS
    by_overstock += centred @ by_even.T / n
    rest = steps - errors @ by_overstock
    by_point = by_overstock[:, :, None] * outward[:, None, :]
    own = np.einsum("nia,nab,njb->ij", by_point, places.own, by_point, optimize=True) + rest.T @ rest / DRAWS
    by_common = np.einsum("nia,nak->ik", by_point, places.common, optimize=True)
    return Sensitivity(by_point, (own + own.T) / 2, by_common, places.core)


def _response(hessian: Array, rows: Array, optimum: Optimum) -> tuple[Array, Index, Array]:
    """Return the derivative of an optimum by minus its gradient (6, 6), its active rows (m,), and that by their bounds.

    `H x - A'd = -g` and `A x = b` with the active rows A.
    """
    active = np.flatnonzero(optimum.duals > 0)
    held = rows[active]
    system = np.block([[hessian, -held.T], [held, np.zeros((len(active), len(active)))]])
    inverse = np.linalg.pinv(system, rcond=1e-13)
    return inverse[:6, :6], active, inverse[:6, 6:]


def drawing(places: Places) -> Callable[[np.random.Generator], Array]:
    """Return the function that draws errors (n, 3) of places with their joint covariance.

    With O = F F', A = F^-1 C = Q R and `R K R' = V diag(l) V'`, the covariance is `F (I + Q V diag(l) V'Q') F'`. A draw
    is `F (z + Q V diag(sqrt(1 + l) - 1) V'Q' z)`. So the shared part may have negative eigenvalues, down to -1.
    """
    n, k = len(places.values), len(places.core)
    eigenvalues, vectors = np.linalg.eigh(places.own)
    whole = np.einsum("nkk->n", places.own) + np.einsum("nak,kl,nal->n", places.common, places.core, places.common)
    # a place without an error of its own gets one so small that it does not count
    size = np.sqrt(np.maximum(eigenvalues, _NO_ERROR**2 * whole.max(initial=0.0)))
    factor = vectors * size[:, None, :]
    alone = np.swapaxes(vectors, 1, 2) @ places.common / np.maximum(size, 1e-300)[:, :, None]
    basis, rest = np.linalg.qr(alone.reshape(3 * n, k))
    shared, turned = np.linalg.eigh(rest @ places.core @ rest.T)
    gain = np.sqrt(np.maximum(1 + shared, 0.0)) - 1
    along = basis @ turned

    def draw(rng: np.random.Generator) -> Array:
        z = rng.normal(size=3 * n)
        mixed = z + along @ (gain * (along.T @ z))
        return np.asarray((factor @ mixed.reshape(n, 3, 1))[:, :, 0])

    return draw
