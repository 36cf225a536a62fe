"""Convex programmes of a few unknowns and many inequalities, with their dual values.

Only few inequalities hold a solution, so each programme is solved for a working set that grows by the most violated
ones until none is left. Method: docs/algorithms/overstock-fit.md.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.errors import NotConvergedError
from metrocli.frozen import dataclass

_ADDED = 40
"""Inequalities that one round adds to the working set, at most"""
_ROUNDS = 200
_TOLERANCE = 1e-11
"""Violation of an inequality that counts as none, relative to the largest bound"""


@dataclass(frozen=True)
class Optimum:
    """The solution of a programme with the proof that it is one."""

    x: Array
    """(k,)"""
    duals: Array
    """Dual value of each inequality, zero or positive (m,)"""


def quadratic(hessian: Array, gradient: Array, rows: Array, bounds: Array) -> Optimum | None:
    """Return the minimum of `x'Hx/2 + g'x` subject to `rows x >= bounds`; None if no x meets the inequalities.

    H (k, k) is positive definite. With H = L L', y = L'x + L^-1 g the programme is one of least distance, min |y|
    subject to `G y >= h`, which is a non-negative least-squares problem (Lawson and Hanson 1974, chapter 23).
    """
    factor = np.linalg.inv(np.linalg.cholesky(hessian))
    centre = factor @ gradient
    turned = rows @ factor.T
    raised = bounds + turned @ centre
    scale = max(1.0, float(np.abs(raised).max(initial=0.0)))

    def solve(chosen: Index) -> tuple[Array, Array] | None:
        return _least_distance(turned[chosen], raised[chosen] / scale)

    optimum = _growing(solve, lambda y: turned @ y - raised / scale, raised / scale)
    if optimum is None:
        return None
    y, duals = optimum
    return Optimum(factor.T @ (y * scale - centre), duals * scale)


def highest(rows: Array, values: Array, radius: float) -> tuple[Optimum, float]:
    """Return the x within `|x_i| <= radius` for which the least of `values + rows x` is largest, and that least value.

    The duals sum to 1 unless the radius holds the solution: the least value cannot grow, because the rows weighted by
    them add up to zero.
    """
    from scipy.optimize import linprog

    size = rows.shape[1]
    cost = np.append(np.zeros(size), -1.0)
    limits = [(-radius, radius)] * size + [(None, None)]

    def solve(chosen: Index) -> tuple[Array, Array] | None:
        against = np.column_stack([-rows[chosen], np.ones(len(chosen))])
        solved = linprog(cost, against, values[chosen], bounds=limits, method="highs")
        return (solved.x, -solved.ineqlin.marginals) if solved.status == 0 else None

    # with too few rows at the start the programme is bounded by `radius` alone, and its first x is far off
    start = smallest(values, 2 * _ADDED)
    optimum = _growing(solve, lambda x: values + rows @ x[:-1] - x[-1], values, start)
    if optimum is None:
        raise NotConvergedError("the linear programme of the largest least overstock has no solution")
    x, duals = optimum
    return Optimum(x[:-1], duals), float((values + rows @ x[:-1]).min())


def smallest(values: Array, count: int) -> Index:
    """Return where the smallest values of (n,) are, `count` of them at most, in no order."""
    if len(values) <= count:
        return np.arange(len(values))
    return np.asarray(np.argpartition(values, count)[:count], dtype=np.intp)


def _growing(
    solve: Callable[[Index], tuple[Array, Array] | None],
    slack: Callable[[Array], Array],
    bounds: Array,
    start: Index | None = None,
) -> tuple[Array, Array] | None:
    """Solve with a working set that grows until every inequality is met; None if the working set has no solution."""
    # 1 beside the largest bound: bounds that are all near 0 would leave a tolerance below rounding
    tolerance = _TOLERANCE * (1 + float(np.abs(bounds).max(initial=0.0)))
    chosen = np.zeros(len(bounds), dtype=bool)
    chosen[smallest(-bounds, _ADDED) if start is None else start] = True
    for _ in range(_ROUNDS):
        working = np.flatnonzero(chosen)
        solved = solve(working)
        if solved is None:
            return None
        x, duals = solved
        # those in the working set are met to the solver's own tolerance, and would be added again for ever
        left = np.where(chosen, np.inf, slack(x))
        violated = np.flatnonzero(left < -tolerance)
        if not violated.size:
            whole = np.zeros(len(bounds))
            whole[working] = duals
            return x, whole
        chosen[violated[smallest(left[violated], _ADDED)]] = True
    raise NotConvergedError("the working set of a convex programme does not stop growing")


def _least_distance(rows: Array, bounds: Array) -> tuple[Array, Array] | None:
    """Return the y of least |y| with `rows y >= bounds`, and the duals; None if no y meets the bounds."""
    from scipy.optimize import nnls

    size = rows.shape[1]
    # y = 0 meets them all, and no y is nearer
    if not len(rows) or (bounds <= 0).all():
        return np.zeros(size), np.zeros(len(rows))
    stacked = np.vstack([rows.T, bounds])
    goal = np.append(np.zeros(size), 1.0)
    # nnls gives up after 3 n steps by default; nearly parallel rows enter and leave its set more often
    weights, _ = nnls(stacked, goal, maxiter=30 * stacked.shape[1] + 100)
    rest = stacked @ weights - goal
    # weights w >= 0 with `rows'w = 0` and `bounds'w = 1` prove that no y meets all bounds (Farkas)
    if -rest[-1] < 1e-13:
        return None
    duals = weights / -rest[-1]
    return _polished(rows, bounds, duals)


def _polished(rows: Array, bounds: Array, duals: Array) -> tuple[Array, Array]:
    """Return the solution that meets the active inequalities to rounding: `y = A'd`, `A A' d = b`."""
    active = np.flatnonzero(duals > 0)
    a = rows[active]
    exact = np.zeros_like(duals)
    # lstsq and not solve: active rows can be dependent, as where many points touch one plane
    exact[active] = np.linalg.lstsq(a @ a.T, bounds[active], rcond=None)[0]
    # a negative dual means that the active set is not that of the exact solution: the one of nnls stands
    kept = exact if (exact >= 0).all() else duals
    return rows.T @ kept, kept
