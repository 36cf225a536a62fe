"""Convex programmes of a few unknowns and many inequalities, with their dual values.

Only few inequalities hold a solution, so each programme is solved for a working set that grows by the most violated
ones until none is left. Method: docs/algorithms/overstock-fit.md.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from metrocli.errors import NotConvergedError
from metrocli.frozen import dataclass

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
_ADDED = 40
"""Inequalities that one round adds to the working set, at most"""
_ROUNDS = 200
_STEPS = 1000
"""Exchanges of a basis, at most"""
_PIVOT = 1e-12
"""Numbers up to this are rounding where a basis is exchanged"""
_DEPENDENT = 1e-14
"""Part of a column that the others leave, relative to the largest, up to which it is dependent on them"""
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

    found = _growing(solve, lambda y: turned @ y - raised / scale, raised / scale)
    if found is None:
        return None
    y, duals = found
    return Optimum(factor.T @ (y * scale - centre), duals * scale)


def highest(rows: Array, values: Array, reach: float) -> tuple[Optimum, float]:
    """Return the x within `|x_i| <= reach` for which the least of `values + rows x` is largest, and that least value.

    The duals sum to 1 unless the reach holds the solution: the least value cannot grow, because the rows weighted by
    them add up to zero.

    The dual programme is solved by the simplex method (Dantzig 1951): the least `values'd + reach |rows'd|_1` over
    d >= 0 that sum to 1. Its basis has one column more than x has entries. x and the least value are its multipliers.
    """
    n, k = rows.shape
    # each row, then the limits x_i <= reach and -x_i <= reach
    columns = np.zeros((n + 2 * k, k + 1))
    columns[:n, :k], columns[:n, k] = -rows, 1.0
    columns[n : n + k, :k], columns[n + k :, :k] = np.eye(k), -np.eye(k)
    costs = np.concatenate([values, np.full(2 * k, reach)])
    lowest = int(values.argmin())
    basis = np.append(n + np.arange(k) + k * (rows[lowest] < 0), lowest)
    tolerance, weights = _TOLERANCE * (1 + float(np.abs(values).max())), np.append(np.abs(rows[lowest]), 1.0)
    moved = True
    for _ in range(_STEPS):
        solved = np.linalg.solve(columns[basis], costs[basis])
        left = costs - columns @ solved
        left[basis] = 0.0
        if left.min() >= -tolerance:
            duals = np.zeros(n + 2 * k)
            duals[basis] = weights
            x = solved[:k]
            return Optimum(x, duals[:n]), float((values + rows @ x).min())
        # after a step of no length the first column that helps: then no basis comes back (Bland 1977)
        enters = int(left.argmin()) if moved else int((left < -tolerance).argmax())
        change = np.linalg.solve(columns[basis].T, columns[enters])
        steps = np.where(change > _PIVOT, weights / np.where(change > _PIVOT, change, 1.0), np.inf)
        tied = np.flatnonzero(steps == steps.min())
        leaves = int(tied[basis[tied].argmin()])
        moved = bool(steps[leaves] > 0)
        weights = np.maximum(weights - steps[leaves] * change, 0.0)
        basis[leaves], weights[leaves] = enters, steps[leaves]
    raise NotConvergedError("the linear programme of the largest least overstock has no solution")


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
    tolerance = _TOLERANCE * (1 + float(np.abs(bounds).max(initial=0.0)))
    chosen = np.zeros(len(bounds), dtype=bool)
    chosen[smallest(-bounds, _ADDED) if start is None else start] = True
    for _ in range(_ROUNDS):
        working = np.flatnonzero(chosen)
        solved = solve(working)
        if solved is None:
            return None
        x, duals = solved
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
    size = rows.shape[1]
    if not len(rows) or (bounds <= 0).all():
        return np.zeros(size), np.zeros(len(rows))
    stacked = np.vstack([rows.T, bounds])
    goal = np.append(np.zeros(size), 1.0)
    weights = not_negative(stacked, goal)
    rest = stacked @ weights - goal
    if -rest[-1] < 1e-13:
        return None
    duals = weights / -rest[-1]
    return _polished(rows, bounds, duals)


def not_negative(matrix: Array, goal: Array) -> Array:
    """Return the x >= 0 of least `|matrix x - goal|` (Lawson and Hanson 1974, chapter 23).

    Raises NotConvergedError.
    """
    x, used = np.zeros(matrix.shape[1]), list[int]()
    for _ in range(3 * len(x) + _STEPS):
        helps = matrix.T @ (goal - matrix @ x)
        helps[used] = 0.0
        while True:
            entered = int(helps.argmax())
            if helps[entered] <= 0:
                return x
            wanted = _free(matrix, goal, [*used, entered])
            if wanted[entered] > 0:
                break
            helps[entered] = 0.0  # it helps by rounding only, and would leave at once
        used.append(entered)
        while (falls := np.array([n for n in used if wanted[n] <= 0], dtype=np.intp)).size:
            shares = x[falls] / (x[falls] - wanted[falls])
            x = np.maximum(x + shares.min() * (wanted - x), 0.0)
            x[falls[shares == shares.min()]] = 0.0
            used = [n for n in used if x[n] > 0]
            wanted = _free(matrix, goal, used)
        x = wanted
    raise NotConvergedError("non-negative least squares do not stop exchanging unknowns")


def _free(matrix: Array, goal: Array, used: list[int]) -> Array:
    """Return the x of least `|matrix x - goal|` with zeros but where they are used; all zero if those are dependent."""
    x = np.zeros(matrix.shape[1])
    q, r = np.linalg.qr(matrix[:, used])
    if np.abs(np.diag(r)).min(initial=np.inf) > _DEPENDENT * np.abs(r).max(initial=0.0) and len(used) <= len(matrix):
        x[used] = np.linalg.solve(r, q.T @ goal)
    return x


def _polished(rows: Array, bounds: Array, duals: Array) -> tuple[Array, Array]:
    """Return the solution that meets the active inequalities to rounding: `y = A'd`, `A A' d = b`."""
    active = np.flatnonzero(duals > 0)
    a = rows[active]
    exact = np.zeros_like(duals)
    exact[active] = np.linalg.lstsq(a @ a.T, bounds[active], rcond=None)[0]
    kept = exact if (exact >= 0).all() else duals
    return rows.T @ kept, kept
