"""The adjustment: weighted least squares by Gauss-Newton steps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from metrocli.adjust.datum import Datum, Frame, open_frame
from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.outcome import Combination, Outcome
from metrocli.adjust.rank import open_combinations
from metrocli.adjust.schur.covariance import Covariance, shapes_of
from metrocli.adjust.schur.layout import Layout, arrange
from metrocli.adjust.schur.member_covariance import Gauge, MemberCovariance
from metrocli.adjust.schur.normals import Normals, assemble, cost_of
from metrocli.adjust.schur.tiles import Tiling, tiling_of
from metrocli.adjust.solution import Solution

_ROUNDING = 1e-13
"""A fall of the sum of squares below this share of it is rounding."""
_LAST_DIGITS = 4 * float(np.finfo(float).eps)
"""What rounding leaves unsure of a predicted reading, as a share of it"""
_NEAR, _FAR_BELOW = 1e3, 1e-2
"""A step within so many tolerances may be the last if the next is foreseen to be below that share of the tolerance"""
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
    tiling: Tiling

    @cached_property
    def size(self) -> float:
        """Root of the sum of squares of the readings in their standard deviations."""
        whitened = (group.observations.whitened(group.observations.readings) for group in self.groups)
        return float(np.sqrt(sum(np.vdot(values, values) for values in whitened)))

    def normals(self, blocks: Mapping[str, Block]) -> Normals:
        with np.errstate(all="ignore"):
            return assemble(self.groups, self.tiling, blocks, self.layout)

    def cost(self, blocks: Mapping[str, Block]) -> float:
        with np.errstate(all="ignore"):
            return cost_of(self.groups, self.tiling, blocks)

    def frame(self, blocks: Mapping[str, Block], matrix: Array) -> Frame | None:
        with np.errstate(all="ignore"):
            return open_frame(self.datum, blocks, self.layout, matrix) if self.datum else None


def adjust(
    blocks: Iterable[Block], groups: Sequence[Group], datum: Datum | None = None, control: Control | None = None
) -> Solution:
    """Minimise the sum of squares of the whitened residuals over the free entries of the blocks.

    Gauss-Newton; a step that would raise the sum is shortened by damping (Marquardt 1963), so the sum never rises.
    It stops when a step is short against the standard deviations, whatever the units, or when the steps shrink so fast
    that the next would be (the contraction of Deuflhard: Newton Methods for Nonlinear Problems, 2004). Singular
    problems end with an outcome, not with an exception; ValueError only where blocks and groups do not fit together.
    """
    control = control or Control()
    state = {block.name: block for block in blocks}
    layout = arrange(state, groups)
    problem = _Problem(groups, layout, datum, tiling_of(groups, state, layout.eliminated))
    unknowns = sum(int(block.free.sum()) for block in state.values())
    descent = _Descent(problem, state, control.covariance)
    lost = Solution(Outcome.NO_START, state, tuple(groups), float("inf"), 0, unknowns)
    if not np.isfinite(descent.cost):
        few = lost.observations < unknowns - len(datum.names if datum else ())
        return replace(lost, outcome=Outcome.TOO_FEW) if few else lost
    outcome = Outcome.ITERATION_LIMIT if control.limit else Outcome.CONVERGED
    iterations = 0
    while iterations < control.limit and outcome is Outcome.ITERATION_LIMIT:
        iterations += 1
        outcome = descent.step(control.tolerance**2 * max(unknowns, 1))
    solution = replace(lost, outcome=outcome, blocks=descent.state, cost=descent.cost, iterations=iterations)
    return _with_covariance(solution, problem, descent.here()) if control.covariance else solution


def covariance_at(blocks: Iterable[Block], groups: Sequence[Group], datum: Datum | None = None) -> Solution:
    """Return the covariance that an adjustment would have at these values, without moving them: for planning."""
    return adjust(blocks, groups, datum, Control(limit=0))


class _Descent:
    """The way down: where it stands, with the normal equations there."""

    def __init__(self, problem: _Problem, state: Mapping[str, Block], wanted: bool) -> None:
        """Stand at `state`; `wanted` says whether the normal equations of the last place are needed."""
        self.problem, self.state, self.damping, self.wanted = problem, dict(state), 0.0, wanted
        self.fall = 0.0  # that the last step promised, 0 before the first and after a damped one
        self.normals: Normals | None = problem.normals(self.state)
        self.cost = self.normals.cost

    def here(self) -> Normals:
        """Return the normal equations at the present state."""
        if self.normals is None:
            self.normals = self.problem.normals(self.state)
        return self.normals

    def step(self, small: float) -> Outcome:
        """Take one step that does not raise the cost; CONVERGED after the last, DIVERGED where none is found.

        The normal equations of the old place are let go before those of the new one are made: they are most of the
        memory. They are made again where the step is not taken.
        """
        while self.damping <= _DAMPING_LIMIT:
            try:
                moved, fall = self._moved()
            except np.linalg.LinAlgError:
                self._damp()
                continue
            self.normals = None
            short = fall <= small + _ROUNDING * self.cost
            last = short or self._contracts(fall, small)
            found = None if last and not self.wanted else self.problem.normals(moved)
            cost = found.cost if found else self.problem.cost(moved)
            if cost <= self.cost or (last and cost <= self.cost + small + self._rounding()):
                done = last and self.damping <= 1e-4
                self.fall = 0.0 if self.damping else fall
                self.state, self.normals, self.cost, self.damping = moved, found, cost, _relaxed(self.damping)
                return Outcome.CONVERGED if done else Outcome.ITERATION_LIMIT
            if short:
                return Outcome.CONVERGED
            self._damp()
        return Outcome.DIVERGED

    def _contracts(self, fall: float, small: float) -> bool:
        """Return whether the step after this one would be far below the tolerance, shrinking as this one has.

        Falls are squares of lengths. The contraction of Gauss-Newton steps, `a + b length`, itself shrinks with them.
        """
        if self.damping or not self.fall:
            return False
        return fall <= _NEAR**2 * small and fall**2 <= _FAR_BELOW**2 * small * self.fall

    def _rounding(self) -> float:
        """Return how much of a sum of squares may be rounding (Cauchy, Schwarz): `2 |residual| |readings| eps`."""
        return 2 * float(np.sqrt(self.cost)) * _LAST_DIGITS * self.problem.size + _ROUNDING * self.cost

    def _damp(self) -> None:
        self.damping = max(self.damping * 10, _DAMPING_START)

    def _moved(self) -> tuple[dict[str, Block], float]:
        """Return the blocks after the damped step, and the fall of the sum of squares that the model promises."""
        normals = self.here()
        with np.errstate(all="ignore"):  # what is absurd ends as LinAlgError or as a step that is not taken
            damped = normals.damped(self.damping) if self.damping else normals
            step, fall, frame = _solve(self.problem, self.state, damped)
            return _moved(self.problem, self.state, step, damped.back(step), frame), fall


def _relaxed(damping: float) -> float:
    return damping / 10 if damping / 10 > _DAMPING_END else 0.0


def _solve(problem: _Problem, state: Mapping[str, Block], normals: Normals) -> tuple[Array, float, Frame | None]:
    """Return the step of the reduced unknowns, the fall that all promise, `g' H^-1 g`, and the open movements."""
    matrix, right, alone = normals.reduced()
    frame = problem.frame(state, matrix)
    step = np.zeros(problem.layout.width)
    if len(step):
        step[:] = _cholesky_solve(_held(matrix, frame), right)
    return step, alone + float(right @ step), frame


def _held(matrix: Array, frame: Frame | None) -> Array:
    """Add stiffness along the open movements of the frame, so that the matrix can be factored.

    In units in which every unknown has stiffness 1, since those of the blocks may be as far apart as mm and 1/s.
    """
    if frame is None or not len(matrix):
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
        steps[layout.eliminated] = (
            step_e if state[layout.eliminated].all_free else step_e * state[layout.eliminated].free
        )
    if frame is not None:
        block = state[frame.datum.block]
        shifts = frame.steps(state, block.values + steps.get(block.name, np.zeros_like(block.values)))
        steps |= {name: steps.get(name, 0.0) + shift for name, shift in shifts.items()}
    for name, step in steps.items():
        if state[name].free.any():
            moved[name] = state[name].moved(step)
    return moved


def _with_covariance(solution: Solution, problem: _Problem, normals: Normals) -> Solution:
    blocks, layout = solution.blocks, problem.layout
    try:
        matrix = normals.reduced()[0]
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
    inverse = _cholesky_solve(held, np.eye(layout.width)) if layout.width else np.zeros((0, 0))
    gauge = None
    if frame is not None and frame.datum.block == layout.eliminated:
        inverse = _in_eliminated_datum(frame, normals, inverse)
        gauge = Gauge(frame, blocks[frame.datum.block])
    elif frame is not None:
        transform = frame.transform(layout)
        inverse = transform @ inverse @ transform.T
    symmetric = (inverse + inverse.T) / 2
    members = MemberCovariance(normals.shape, normals.parts, problem.tiling.tiles, symmetric, gauge)
    return replace(counted, covariance=Covariance(layout, shapes_of(blocks), symmetric, members))


def _in_eliminated_datum(frame: Frame, normals: Normals, inverse: Array) -> Array:
    """Return the reduced covariance in a datum of inner constraints on the eliminated block.

    With `h = H e = -A r + sum H_i n_i`, `A = sum H_i W_i`, n_i the noise of member i of covariance D_i^-1:
    `r' = (I + E A) r - E sum H_i n_i`.
    """
    found = [part.moments(frame.constraint(part.members)) for part in normals.parts]
    e = frame.reduced
    coupled, gram = (np.sum([one[i] for one in found], axis=0) for i in (0, 1))
    transform = np.eye(len(inverse)) + e @ coupled
    return np.asarray(transform @ inverse @ transform.T + e @ gram @ e.T)
