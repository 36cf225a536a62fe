"""Lay the ideal part into the raw part: even, most or least-motion, each with the minimum overstock everywhere.

Each iteration solves a small convex programme on the exact pose. Method: docs/algorithms/overstock-fit.md.
"""

from __future__ import annotations

import numpy as np

from metrocli.adjust.small_programmes import highest, quadratic, smallest
from metrocli.arrays import Array
from metrocli.errors import NotConvergedError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.tasks.fit_part.stock import LinearStock, Stock

EVEN, MOST, LEAST_MOTION = "even", "most", "least-motion"
_ITERATIONS = 100
_LOWEST = 1000
"""Points with the least overstock among which its largest value is sought"""
_SHARE_OF_GAIN = 0.999
"""Share of the gain of a linear programme that its shortest step keeps"""
_STEP = 1e-9
"""Step [mm] at which the iteration ends"""
_WELL_CONDITIONED = 1e-9
"""Smallest eigenvalue of a Hessian with which a step is computed, relative to the largest"""
_PENALTIES = (0.0, 1.0, 10.0, 100.0, 1000.0)
"""Weights tried for the penalty of `convex`, relative to the largest eigenvalue of the Hessian"""
_ROUNDING = 1e-12
"""Growth of the aim that rounding explains, relative to 1 mm^2 and more"""
_FEASIBLE = 1e-10
"""Violation of the minimum overstock that counts as none [mm]"""
_FIRST_RADIUS = 0.1
"""Trust region of the first linear programme [mm], at least"""
_SMALLEST_RADIUS = 1e-4
"""Trust region [mm] at which the search for the largest least overstock ends: r^2 over the smallest radius of a surface
bounds what is left"""
SLACK = 1e-8
"""What the aim `most` leaves of the largest least overstock for making it even [mm]"""
UNBOUNDED = 2.0
"""A least overstock of more than this many times the size of the point cloud has no limit"""


@dataclass(frozen=True)
class Objective:
    """What an aim makes small, near one pose: value, gradient and second derivative by the step."""

    value: float
    gradient: Array
    hessian: Array
    gauss_newton: Array
    """`J'J/n`, the part of the second derivative that is never negative"""


@dataclass(frozen=True)
class PoseCriterion:
    """What the pose is chosen by."""

    name: str
    minimum: float
    """Least overstock [mm]"""
    before: Array | None = None
    """Points in the part frame before the fit (n, 3), for least-motion"""

    def objective(self, local: LinearStock) -> Objective:
        """Return the aim near a pose: half the mean square of `o - mean o`, or of the moves of the points.

        Of residuals r with derivatives J by the step the gradient is `J'r/n`, the Hessian `J'J/n + sum r_i r_i''/n`.
        """
        n = len(local.points)
        if self.before is not None:
            residuals, by_step = local.points - self.before, local.movement
            gauss_newton = np.einsum("nai,naj->ij", by_step, by_step, optimize=True) / n
            gradient = np.einsum("nai,na->i", by_step, residuals) / n
            second = local.turning(residuals) / n
        else:
            residuals = local.overstock - local.overstock.mean()
            rows = local.rows - local.rows.mean(axis=0)
            gauss_newton, gradient = rows.T @ rows / n, rows.T @ residuals / n
            second = local.curvature(residuals) / n
        return Objective(float((residuals**2).sum() / n / 2), gradient, gauss_newton + second, gauss_newton)


@dataclass(frozen=True)
class PoseFit:
    """A fitted pose and the proof that it is optimal."""

    to_part: Array
    """Pose that brings the measured points into the part frame (6,)"""
    local: LinearStock
    duals: Array
    """Dual value of each point's minimum overstock (n,) [mm]: by how much the aim worsens with the minimum"""
    hessian: Array
    """Second derivative of the Lagrangian by the step (6, 6)"""
    iterations: int
    optimality: float
    """Largest component of `gradient - sum duals rows`, 0 at an optimum, relative to the RMS of the residuals"""


def max_least_overstock(
    stock: Stock, to_part: Array, enough: float = np.inf, limit: float | None = None, radius: float | None = None
) -> tuple[Array, float, Array]:
    """Return the pose with the largest least overstock, that overstock, and the duals of the points (n,).

    Linear programmes in a trust region (Nocedal and Wright 2006, chapter 4): `radius` bounds each component of a step,
    grows where the prediction holds and shrinks where it fails. The search ends as soon as the least overstock is
    `enough`. Where it exceeds `limit` nothing bounds it: it is inf. Unless given, `radius` is a
    fifth of the size of the point cloud, and `limit` twice that size.
    """
    local = stock.at(to_part)
    least = float(local.overstock.min())
    radius = local.lever / 5 if radius is None else radius
    duals = np.zeros(len(stock.measured))
    limit = UNBOUNDED * local.lever if limit is None else limit
    while radius > _SMALLEST_RADIUS:
        if least >= enough:
            break
        if least > limit:
            return to_part, np.inf, duals
        raised, expected = highest(local.rows, local.overstock, radius)
        # duals are kept even if the step is not taken: they are those of the pose that is returned
        predicted, duals = expected - least, raised.duals
        step = _shortest_step(local, least + _SHARE_OF_GAIN * predicted, raised.x)
        tried = local.moved(to_part, step)
        there = stock.at(tried)
        gain = float(there.overstock.min()) - least
        # a step is taken from a tenth of the predicted gain; only one that the region bounds makes it larger
        if gain > 0.1 * predicted:
            to_part, local, least = tried, there, least + gain
            radius = radius * 2 if gain > 0.9 * predicted and np.abs(step).max() > 0.99 * radius else radius
        # a gain below rounding shrinks the region too, so that the search ends at an optimum
        radius = radius if gain > 0.5 * predicted and predicted > _STEP else radius / 4
    return to_part, least, duals


def _shortest_step(local: LinearStock, least: float, other: Array) -> Array:
    """Return the shortest step to a least overstock, where the linear programme has many; `other`, one of them, else.

    What changes no overstock that counts stays as it is: a part does not slide out of a mesh along walls that hold it.
    """
    solved = quadratic(np.eye(6), np.zeros(6), local.rows, least - local.overstock)
    return other if solved is None else solved.x


def max_least_overstock_of_many(
    stock: Stock, to_part: Array, enough: float = np.inf, begun: LinearStock | None = None
) -> tuple[Array, float, Array]:
    """Return what `max_least_overstock` does, by programmes of the lowest points, and of those lower at their optimum.

    The overstock of a point changes by no more than the point moves, so only points that can have come below that
    optimum are looked at there. Where the lowest points have no limit, those follow that hold against their motion.
    Where they cannot have `enough`, all cannot, and what the lowest can have is returned. `begun` is the overstock at
    the pose, if a search has it. The first radius is then twice its range, since far from a mesh the search for the
    nearest triangles is slow.
    """
    radius = None if begun is None else max(2 * float(np.ptp(begun.overstock)), _FIRST_RADIUS)
    begun = stock.at(to_part) if begun is None else begun
    places, overstock = begun.points.copy(), begun.overstock.copy()
    limit = UNBOUNDED * begun.lever
    best, lowest, chosen = to_part, smallest(overstock, _LOWEST), np.zeros(len(overstock), dtype=bool)
    for _ in range(_ITERATIONS):
        chosen[lowest] = True
        rows = np.flatnonzero(chosen)
        best, least, of_rows = max_least_overstock(stock.of(rows), best, enough, limit, radius)
        placed = poses.apply(best, stock.measured)
        if least < enough < np.inf:
            ended = True
        elif np.isfinite(least):
            doubtful = np.flatnonzero(overstock - np.linalg.norm(placed - places, axis=1) < least - _STEP)
            if doubtful.size:
                places[doubtful] = placed[doubtful]
                overstock[doubtful] = stock.of(doubtful).at(best).overstock
            lowest = smallest(overstock, _LOWEST)
            ended = overstock[doubtful].min(initial=np.inf) >= least - _STEP
        else:
            ahead = begun.overstock + np.einsum("nk,nk->n", begun.shape.normal, placed - begun.points)
            lowest, best = smallest(ahead, _LOWEST), to_part
            ended = bool(chosen[lowest].all())
        if ended:
            duals = np.zeros(len(overstock))
            duals[rows] = of_rows
            return best, least, duals
    raise NotConvergedError("the search for the largest least overstock does not end")


def fit(stock: Stock, aim: PoseCriterion, to_part: Array) -> PoseFit:
    """Return the best pose that leaves the minimum everywhere, from a pose that does so or nearly does.

    Sequential quadratic programmes with the second derivative of the Lagrangian. Each step is brought back to the
    minimum, which surfaces that bend away from it miss, and halved until the aim is better met. Raises
    NotConvergedError.
    """
    begun = _restored(stock, aim.minimum, to_part, np.eye(6))
    if begun is None:
        raise NotConvergedError("no small step leaves the minimum overstock everywhere")
    to_part, local = begun
    duals, objective = np.zeros(len(stock.measured)), aim.objective(local)
    for iteration in range(_ITERATIONS):
        hessian, _ = convex(objective, local, duals)
        # a point that is below the minimum by rounding may stay: to bring it back is not a step of the aim
        bounds = np.minimum(aim.minimum - local.overstock, 0.0)
        solved = quadratic(hessian, objective.gradient, local.rows, bounds)
        if solved is None:
            raise NotConvergedError("no small step leaves the minimum overstock everywhere")
        step, duals = solved.x, solved.duals
        while np.abs(step).max() > _STEP:
            reached = _restored(stock, aim.minimum, local.moved(to_part, step), hessian)
            if reached is not None:
                other = aim.objective(reached[1])
                if other.value <= objective.value + _ROUNDING * (1 + objective.value):
                    break
            step = step / 2
        else:
            return _finished(local, to_part, objective, duals, iteration)
        (to_part, local), objective = reached, other
    raise NotConvergedError(
        f"the fit of the ideal part did not converge in {_ITERATIONS} iterations; points beyond edges and corners of a "
        "mesh can cause it: name coded targets in `targets`"
    )


def _restored(stock: Stock, minimum: float, to_part: Array, metric: Array) -> tuple[Array, LinearStock] | None:
    """Return the pose that leaves the minimum, by the smallest steps in a metric M (`x'Mx`), and the overstock there.

    None where the violation does not shrink by half in each step.
    """
    violation = np.inf
    while True:
        local = stock.at(to_part)
        short = minimum - local.overstock
        if short.max() < _FEASIBLE:
            return to_part, local
        step = quadratic(metric, np.zeros(6), local.rows, short) if short.max() < violation / 2 else None
        if step is None:
            return None
        violation, to_part = float(short.max()), local.moved(to_part, step.x)


def convex(objective: Objective, local: LinearStock, duals: Array) -> tuple[Array, float]:
    """Return a second derivative that has a minimum, for the next step, and the penalty p in it.

    It is that of the Lagrangian. Where that bends down across the points that hold the pose, p A'A of their rows A is
    added. It changes no solution that keeps them at the minimum (Nocedal and Wright 2006, chapter 17). Where it bends
    down along them too, their duals are left out.
    """
    lagrangian, active = objective.hessian - local.curvature(duals), local.rows[duals > 0]
    largest = float(np.abs(np.linalg.eigvalsh(lagrangian)).max())
    tried = [(lagrangian + weight * largest * active.T @ active, weight * largest) for weight in _PENALTIES]
    for hessian, penalty in (*tried, (objective.hessian, 0.0), (objective.gauss_newton, 0.0)):
        eigenvalues = np.linalg.eigvalsh(hessian)
        if eigenvalues[0] > _WELL_CONDITIONED * eigenvalues[-1]:
            return hessian, penalty
    # a motion that changes no residual, as the turn of a shaft, has eigenvalue 0 even there
    return objective.gauss_newton + _WELL_CONDITIONED * np.trace(objective.gauss_newton) * np.eye(6), 0.0


def _finished(local: LinearStock, to_part: Array, objective: Objective, duals: Array, iterations: int) -> PoseFit:
    of_constraints = local.rows.T @ duals
    # the value is half the mean square of the residuals
    size = max(float(np.sqrt(2 * objective.value)), 1e-9)
    return PoseFit(
        to_part,
        local,
        duals,
        objective.hessian - local.curvature(duals),
        iterations,
        float(np.abs(objective.gradient - of_constraints).max()) / size,
    )


def criterion_of(stock: Stock, name: str, minimum: float, start: Array) -> PoseCriterion:
    """Return the criterion of a job; `most` is `even` with the largest least overstock as its `minimum`."""
    if name == LEAST_MOTION:
        return PoseCriterion(name, minimum, poses.apply(start, stock.measured))
    return PoseCriterion(name, minimum)
