"""The adjustment: weighted least squares by Gauss-Newton steps, the only iteration in the program."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from metrocli.adjust.blocks import Array, Block
from metrocli.adjust.covariance import Covariance, Gauge, shapes_of
from metrocli.adjust.datum import Datum, Frame, open_frame
from metrocli.adjust.groups import Group, Linear
from metrocli.adjust.layout import Layout, arrange, considered_covariance
from metrocli.adjust.normals import Normals, assemble
from metrocli.adjust.outcome import Combination, Outcome
from metrocli.adjust.rank import open_combinations
from metrocli.adjust.solution import Solution

_ROUNDING = 1e-13
"""A fall of the sum of squares below this share of it is rounding."""
_DAMPING_START, _DAMPING_END, _DAMPING_LIMIT = 1e-9, 1e-11, 1e8


@dataclass(frozen=True)
class Control:
    """When to stop."""

    limit: int = 1000
    """Steps at most"""
    tolerance: float = 1e-6
    """Stop when a step is shorter than this, in standard deviations of the unknowns (root mean square)"""
    covariance: bool = True
    """Whether covariance and rank are wanted at the end"""


@dataclass(frozen=True)
class _Problem:
    groups: Sequence[Group]
    layout: Layout
    datum: Datum | None

    def linear(self, blocks: Mapping[str, Block]) -> list[Linear]:
        return [group.linear(blocks, self.layout.wanted) for group in self.groups]

    def frame(self, blocks: Mapping[str, Block], matrix: Array) -> Frame | None:
        return open_frame(self.datum, blocks, self.layout, matrix) if self.datum else None


def adjust(
    blocks: Iterable[Block], groups: Sequence[Group], datum: Datum | None = None, control: Control | None = None
) -> Solution:
    """Minimise the sum of squares of the whitened residuals over the free entries of the blocks.

    Gauss-Newton; a step that would raise the sum is shortened by damping (Marquardt 1963), so the sum never rises.
    It stops when a step is short against the standard deviations, whatever the units. Singular problems end with an
    outcome, not with an exception; ValueError only where blocks and groups do not fit together.
    """
    control = control or Control()
    state = {block.name: block for block in blocks}
    problem = _Problem(groups, arrange(state, groups, _kept(state, datum)), datum)
    unknowns = sum(int(block.free.sum()) for block in state.values())
    linears = problem.linear(state)
    if not np.isfinite(sum(linear.cost for linear in linears)):
        lost = Solution(Outcome.NO_START, state, tuple(groups), float("inf"), 0, unknowns)
        return (
            replace(lost, outcome=Outcome.TOO_FEW)
            if lost.observations < unknowns - len(datum.names if datum else ())
            else lost
        )
    damping, iterations, outcome = 0.0, 0, Outcome.ITERATION_LIMIT if control.limit else Outcome.CONVERGED
    while iterations < control.limit:
        normals = assemble(groups, linears, state, problem.layout)
        iterations += 1
        found = _descend(problem, state, normals, damping, control.tolerance**2 * max(unknowns, 1))
        if found is None:
            outcome = Outcome.DIVERGED
            break
        state, linears, damping, last = found
        if last:
            outcome = Outcome.CONVERGED
            break
    solution = Solution(outcome, state, tuple(groups), sum(linear.cost for linear in linears), iterations, unknowns)
    if not control.covariance:
        return solution
    return _with_covariance(solution, problem, assemble(groups, linears, state, problem.layout))


def _kept(blocks: Mapping[str, Block], datum: Datum | None) -> tuple[str, ...]:
    """Return the blocks that must stay in the reduced system: that of the datum where considered blocks act on it."""
    considered = any(block.considered is not None for block in blocks.values())
    return (datum.block,) if datum is not None and considered else ()


def covariance_at(blocks: Iterable[Block], groups: Sequence[Group], datum: Datum | None = None) -> Solution:
    """Return the covariance that an adjustment would have at these values, without moving them: for planning."""
    return adjust(blocks, groups, datum, Control(limit=0))


_Found = tuple[dict[str, Block], list[Linear], float, bool]


def _descend(
    problem: _Problem, state: Mapping[str, Block], normals: Normals, damping: float, small: float
) -> _Found | None:
    """Take one step that does not raise the cost; None where none is found.

    Returns the new blocks, their linearisation, the damping left, and whether the step was the last.
    """
    frame: Frame | None = None
    while damping <= _DAMPING_LIMIT:
        damped = normals.damped(damping) if damping else normals
        try:
            step_r, frame = _solve(problem, state, damped)
            step_e = damped.back(step_r)
        except np.linalg.LinAlgError:
            damping = max(damping * 10, _DAMPING_START)
            continue
        fall = float(normals.right_r @ step_r + np.vdot(normals.right_e, step_e))
        moved = _moved(problem, state, step_r, step_e, frame)
        with np.errstate(all="ignore"):
            linears = problem.linear(moved)
        cost = sum(linear.cost for linear in linears)
        last = fall <= small + _ROUNDING * normals.cost
        if cost <= normals.cost or (last and cost <= normals.cost * (1 + _ROUNDING) + small):
            return moved, linears, _relaxed(damping), last and damping <= 1e-4
        if last:
            return dict(state), problem.linear(state), damping, True
        damping = max(damping * 10, _DAMPING_START)
    return None


def _relaxed(damping: float) -> float:
    return damping / 10 if damping / 10 > _DAMPING_END else 0.0


def _solve(problem: _Problem, state: Mapping[str, Block], normals: Normals) -> tuple[Array, Frame | None]:
    free = problem.layout.free
    matrix, right = normals.reduced()
    frame = problem.frame(state, matrix)
    step = np.zeros(problem.layout.width)
    if free:
        step[:free] = _cholesky_solve(_held(matrix, frame)[:free, :free], right[:free])
    return step, frame


def _held(matrix: Array, frame: Frame | None) -> Array:
    """Add stiffness along the open movements of the frame, so that the matrix can be factored.

    In units in which every unknown has stiffness 1, since those of the blocks may be as far apart as mm and 1/s.
    """
    if frame is None:
        return matrix
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    unit, _ = np.linalg.qr(frame.reduced * size[:, None])
    stiff = unit * size[:, None]
    held: Array = matrix + stiff @ stiff.T
    return held


def _cholesky_solve(matrix: Array, right: Array) -> Array:
    from scipy.linalg import cho_factor, cho_solve

    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        raise np.linalg.LinAlgError("the normal equations have entries that are no numbers")
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    factor = cho_factor(matrix * scale[:, None] * scale, lower=True)
    solved: Array = cho_solve(factor, (right.T * scale).T)
    unscaled: Array = (solved.T * scale).T
    return unscaled


def _moved(
    problem: _Problem, state: Mapping[str, Block], step_r: Array, step_e: Array, frame: Frame | None
) -> dict[str, Block]:
    layout = problem.layout
    moved = dict(state)
    steps = {
        name: np.where(columns >= 0, step_r[np.maximum(columns, 0)], 0.0) for name, columns in layout.columns.items()
    }
    if layout.eliminated:
        steps[layout.eliminated] = np.where(state[layout.eliminated].free, step_e, 0.0)
    if frame is not None and problem.datum is not None:
        block = state[problem.datum.block]
        amounts = frame.step(problem.datum, block.values + steps.get(block.name, np.zeros_like(block.values)))
        for name, moves in frame.moves.items():
            steps[name] = steps.get(name, 0.0) + moves @ amounts
    for name, step in steps.items():
        if state[name].free.any():
            moved[name] = state[name].moved(step)
    return moved


def _with_covariance(solution: Solution, problem: _Problem, normals: Normals) -> Solution:
    blocks, layout = solution.blocks, problem.layout
    try:
        matrix, _ = normals.reduced()
        frame = problem.frame(blocks, matrix)
    except np.linalg.LinAlgError:
        matrix, frame = np.full((layout.width, layout.width), np.nan), None
    conditions = frame.reduced.shape[1] if frame else 0
    counted = replace(solution, conditions=conditions)
    held = _held(matrix, frame)
    combinations: tuple[Combination, ...] = open_combinations(blocks, layout, normals, held)
    if combinations:
        few = counted.dof < 0
        return replace(counted, outcome=Outcome.TOO_FEW if few else Outcome.UNDETERMINED, undetermined=combinations)
    if counted.dof < 0:
        return replace(counted, outcome=Outcome.TOO_FEW)
    free = layout.free
    inverse = _cholesky_solve(held[:free, :free], np.eye(free)) if free else np.zeros((0, 0))
    gauge: Gauge | None = None
    if frame is not None and problem.datum is not None:
        if problem.datum.block == layout.eliminated:
            inverse, gauge = _in_eliminated_datum(frame, problem.datum.block, normals, inverse)
        else:
            transform = frame.transform(layout, problem.datum)[:free, :free]
            inverse = transform @ inverse @ transform.T
    noise_only = np.zeros((layout.width, layout.width))
    noise_only[:free, :free] = (inverse + inverse.T) / 2
    return replace(
        counted,
        cofactor=replace(_cofactor(blocks, layout, normals, noise_only), gauge=gauge),
        covariance=replace(_considered(blocks, layout, normals, held, noise_only), gauge=gauge),
    )


def _in_eliminated_datum(frame: Frame, name: str, normals: Normals, inverse: Array) -> tuple[Array, Gauge]:
    """Return the reduced covariance in a datum of inner constraints on the eliminated block, and what they add to it.

    With `h = H e = -A r + sum H_i n_i`, `A = sum H_i W_i`, n_i the noise of member i of covariance D_i^-1:
    `r' = (I + E A) r - E sum H_i n_i`.
    """
    free = len(inverse)
    h = frame.of_members(normals.d.shape[1])
    share: Array = np.asarray(np.linalg.solve(normals.d, np.swapaxes(h, 1, 2)), dtype=float)
    transform = np.eye(free) + frame.reduced[:free] @ np.einsum("mks,msw->kw", h, normals.weights[:, :, :free])
    noise = frame.reduced[:free] @ np.einsum("mks,msl->kl", h, share) @ frame.reduced[:free].T
    return transform @ inverse @ transform.T + noise, Gauge(frame.moves[name], share, frame.reduced)


def _cofactor(blocks: Mapping[str, Block], layout: Layout, normals: Normals, reduced: Array) -> Covariance:
    inverse, weights = normals.d, normals.weights
    if layout.eliminated:
        free = blocks[layout.eliminated].free
        inverse = np.asarray(np.linalg.inv(normals.d), dtype=float) * free[:, :, None] * free[:, None, :]
        weights = weights * free[:, :, None]
    return Covariance(layout, shapes_of(blocks), reduced, weights, inverse)


def _considered(
    blocks: Mapping[str, Block], layout: Layout, normals: Normals, matrix: Array, noise_only: Array
) -> Covariance:
    """Add what the considered blocks bring: `K = S_ff^-1 S_fc`, `Q_ff + K C K'`, `Q_fc = -K C`."""
    free = layout.free
    if free == layout.width:
        return _cofactor(blocks, layout, normals, noise_only)
    joint = noise_only.copy()
    given = considered_covariance(blocks, layout)
    sensitivity = noise_only[:free, :free] @ matrix[:free, free:]
    joint[:free, :free] += sensitivity @ given @ sensitivity.T
    joint[:free, free:] = -sensitivity @ given
    joint[free:, :free] = joint[:free, free:].T
    joint[free:, free:] = given
    return _cofactor(blocks, layout, normals, joint)
