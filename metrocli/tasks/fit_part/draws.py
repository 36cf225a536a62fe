"""The covariance of a fitted pose from random draws of the errors of its points, and the fit of each draw.

A linear covariance does not hold where errors bring other points to the minimum overstock than those of the fit.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from metrocli.adjust.small_programmes import Optimum, highest, quadratic
from metrocli.arrays import Array, Index
from metrocli.errors import NotConvergedError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.tasks.fit_part.fit import MOST, SLACK, PoseCriterion, PoseFit, convex
from metrocli.tasks.fit_part.uncertainty import Sensitivity, gradient_by_point, sensitivity
from metrocli.uncertainty.predicted import PredictedPlaces

DRAWS = 200
_SEED = 1
_NEAR = 5.0
"""Distance from the minimum, in standard deviations, up to which errors can bring a point there"""
_REGULAR = 1e-9
"""Share of the mean second derivative of the evenness that keeps motions still which no overstock shows"""
_NO_ERROR = 1e-3
"""Share of the largest standard deviation that a place is drawn with if it has no error of its own"""


@dataclass(frozen=True)
class _Programme:
    """The quadratic programme of a fit near the fitted pose: `min x'Hx/2 + (g + sum G_i e_i)'x` for errors e."""

    hessian: Array
    gradient: Array
    by_point: Array
    """G (n, 6, 3)"""


def sensitivity_with_exchanges(fit: PoseFit, aim: PoseCriterion, start: Array, places: PredictedPlaces) -> Sensitivity:
    """Return how the points move a fitted pose, from draws where errors can bring points to the minimum or off it.

    `start` (6,) is the pose into the part frame before the fit.
    """
    nearby = sensitivity(fit, aim, start, places)
    rows, outward = fit.local.rows, fit.local.shape.normal @ poses.rotation_of(fit.to_part)
    by_pose = np.einsum("ni,ij,nj->n", rows, nearby.covariance, rows)
    spread = np.sqrt(np.maximum(by_pose, 0.0) + _along(outward, places) ** 2)
    near = (fit.local.overstock - aim.minimum < _NEAR * spread) | (fit.duals > 0)
    return sensitivity_of_draws(fit, aim, start, places) if spread.any() and near.any() else nearby


def _along(outward: Array, places: PredictedPlaces) -> Array:
    """Return the standard deviation of each place along a direction, outward (n, 3) -> (n,)."""
    return np.asarray(np.sqrt(np.einsum("na,nab,nb->n", outward, places.covariance, outward)))


def sensitivity_of_draws(fit: PoseFit, aim: PoseCriterion, start: Array, places: PredictedPlaces) -> Sensitivity:
    """Return how points with drawn errors move a fitted pose.

    Each draw e is solved on the overstock `o + n.e + J x`, linear about the fit. With S the mean derivative of the step
    by the points, and r = x - S e what it leaves, the covariance is `S C S' + mean r r'` about the fitted pose. Raises
    NotConvergedError.
    """
    local, n = fit.local, len(fit.local.points)
    outward, rows = local.shape.normal @ poses.rotation_of(fit.to_part), local.rows
    programme = _programme(fit, aim, start, outward)
    by_error = programme.by_point.transpose(1, 0, 2).reshape(6, 3 * n)
    # a longer turn bends the overstock by more than the errors
    radius = float(np.sqrt(2 * local.lever * _along(outward, places).max()))
    draw, rng = drawing(places), np.random.default_rng(_SEED)
    steps, errors, gradients = np.zeros((DRAWS, 6)), np.zeros((DRAWS, n)), np.zeros((DRAWS, 6))
    by_gradient, by_overstock = np.zeros((6, 6)), np.zeros((n, 6))
    for k in range(DRAWS):
        error = draw(rng)
        errors[k], gradients[k] = np.einsum("na,na->n", outward, error), by_error @ error.ravel()
        best, by_each = _solved(
            programme.hessian, programme.gradient + gradients[k], aim, rows, local.overstock + errors[k], radius
        )
        steps[k] = best.x
        of_gradient, active, of_bounds = _response(programme.hessian, rows, best)
        by_gradient -= of_gradient / DRAWS
        by_overstock[active] -= of_bounds.T / DRAWS
        by_overstock += by_each[:, None] * of_bounds.sum(axis=1) / DRAWS
    # what is not proportional to the errors of any point: in some draws other points hold the part
    rest = steps - errors @ by_overstock - gradients @ by_gradient.T
    by_point = by_gradient @ programme.by_point + by_overstock[:, :, None] * outward[:, None, :]
    own = np.einsum("nia,nab,njb->ij", by_point, places.own, by_point, optimize=True) + rest.T @ rest / DRAWS
    by_common = np.einsum("nia,nak->ik", by_point, places.common, optimize=True)
    return Sensitivity(by_point, (own + own.T) / 2, by_common, places.core, drawn=True)


def _programme(fit: PoseFit, aim: PoseCriterion, start: Array, outward: Array) -> _Programme:
    """Return the programme of the draws; that of `most` makes the overstock even, as linear as its other part is."""
    local, rows, n = fit.local, fit.local.rows, len(fit.local.points)
    if aim.name == MOST:
        centred = rows - rows.mean(axis=0)
        hessian = centred.T @ centred / n
        hessian += _REGULAR * np.trace(hessian) * np.eye(6)
        return _Programme(hessian, centred.T @ local.overstock / n, centred[:, :, None] * outward[:, None, :] / n)
    objective = aim.objective(local)
    hessian, penalty = convex(objective, local, fit.duals)
    held = penalty * rows * (fit.duals > 0)[:, None]
    by_point = gradient_by_point(fit, aim, start) + held[:, :, None] * outward[:, None, :]
    # the penalty is about the minimum, not about the fit: so errors of the points that hold it move its gradient
    return _Programme(hessian, objective.gradient - (aim.minimum - local.overstock) @ held, by_point)


def _solved(
    hessian: Array, gradient: Array, aim: PoseCriterion, rows: Array, overstock: Array, radius: float
) -> tuple[Optimum, Array]:
    """Return the step of a draw, and the derivative of the least overstock that it keeps by that of each point (n,).

    The least overstock that it keeps is the given minimum, with derivative 0. For `most`, and where no step within the
    radius leaves the minimum, it is the largest possible one.
    """
    if aim.name != MOST:
        best = quadratic(hessian, gradient, rows, aim.minimum - overstock)
        if best is not None and np.abs(best.x).max() < radius:
            return best, np.zeros(len(overstock))
    most, largest = highest(rows, overstock, radius)
    best = quadratic(hessian, gradient, rows, largest - SLACK - overstock)
    if best is None:
        raise NotConvergedError("a fit to points with drawn errors has no solution")
    return best, most.duals


def _response(hessian: Array, rows: Array, optimum: Optimum) -> tuple[Array, Index, Array]:
    """Return the derivative of an optimum by minus its gradient (6, 6), its active rows (m,), and that by their bounds.

    `H x - A'd = -g` and `A x = b` with the active rows A.
    """
    active = np.flatnonzero(optimum.duals > 0)
    held = rows[active]
    system = np.block([[hessian, -held.T], [held, np.zeros((len(active), len(active)))]])
    # more points can hold a pose than it has degrees of freedom: then the system is singular
    inverse = np.linalg.pinv(system, rcond=1e-13)
    return inverse[:6, :6], active, inverse[:6, 6:]


def drawing(places: PredictedPlaces) -> Callable[[np.random.Generator], Array]:
    """Return the function that draws errors (n, 3) of places with their joint covariance.

    With O = F F', A = F^-1 C = Q R and `R K R' = V diag(l) V'`, the covariance is `F (I + Q V diag(l) V'Q') F'`. A draw
    is `F (z + Q V diag(sqrt(1 + l) - 1) V'Q' z)`. So the shared part may have negative eigenvalues, down to -1.
    """
    n, k = len(places.values), len(places.core)
    eigenvalues, vectors = np.linalg.eigh(places.own)
    whole = np.einsum("nkk->n", places.covariance)
    # a place without an error of its own gets one so small that it does not count
    size = np.sqrt(np.maximum(eigenvalues, _NO_ERROR**2 * whole.max(initial=0.0)))
    factor = vectors * size[:, None, :]
    alone = np.swapaxes(vectors, 1, 2) @ places.common / np.maximum(size, 1e-300)[:, :, None]
    basis, rest = np.linalg.qr(alone.reshape(3 * n, k))
    shared, turned = np.linalg.eigh(rest @ places.core @ rest.T)
    # an eigenvalue is below -1 by rounding only
    gain = np.sqrt(np.maximum(1 + shared, 0.0)) - 1
    along = basis @ turned

    def draw(rng: np.random.Generator) -> Array:
        z = rng.normal(size=3 * n)
        mixed = z + along @ (gain * (along.T @ z))
        return np.asarray(np.einsum("nij,nj->ni", factor, mixed.reshape(n, 3)))

    return draw
