"""The adjustment: weighted least squares by Gauss-Newton steps.

Method: docs/algorithms/tiled-elimination.md (normal equations), docs/algorithms/free-networks.md (datum) and
docs/algorithms/rank-in-words.md (what is undetermined).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from metrocli.adjust.allowance import take
from metrocli.adjust.datum import Datum, Frame, open_frame
from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.outcome import Combination, Outcome
from metrocli.adjust.rank import open_combinations
from metrocli.adjust.schur.covariance import Covariance, shapes_of
from metrocli.adjust.schur.irregular_normals import FEW
from metrocli.adjust.schur.layout import Layout, arrange
from metrocli.adjust.schur.member_covariance import Gauge, MemberCovariance
from metrocli.adjust.schur.normals import Normals, assemble, cost_of
from metrocli.adjust.schur.tiles import Tiling, tiling_of
from metrocli.adjust.solution import Solution
from metrocli.frozen import dataclass

_ROUNDING = 1e-13
"""A decrease of the sum of squares below this fraction of it is rounding"""
_LAST_DIGITS = 4 * float(np.finfo(float).eps)
"""Relative rounding error of a predicted reading"""
_NEAR, _FAR_BELOW = 1e3, 1e-2
"""The last step is one shorter than `_NEAR` tolerances after which a step below `_FAR_BELOW` tolerances is expected"""
_NOTHING = 1e-10
"""Share of the diagonal of the normal matrix below which its reduction leaves nothing"""
_DAMPING_START, _DAMPING_END, _DAMPING_LIMIT = 1e-9, 1e-11, 1e8


@dataclass(frozen=True)
class Control:
    """When an adjustment stops, and whether it computes a covariance."""

    limit: int = 1000
    """Largest number of steps"""
    tolerance: float = 1e-6
    """The last step is shorter than this, in standard deviations of the unknowns (root mean square)"""
    covariance: bool = True
    """Whether rank and covariance are computed at the end"""


@dataclass(frozen=True)
class _Problem:
    """What stays the same while an adjustment iterates."""

    groups: Sequence[Group]
    layout: Layout
    datum: Datum | None
    tiling: Tiling

    @cached_property
    def size(self) -> float:
        """Length of the vector of whitened readings (each divided by its standard deviation)."""
        whitened = (group.observations.whitened(group.observations.readings) for group in self.groups)
        return float(np.sqrt(sum(np.vdot(values, values) for values in whitened)))

    def normals(self, blocks: Mapping[str, Block]) -> Normals:
        with np.errstate(all="ignore"):
            return assemble(self.tiling, blocks, self.layout)

    def cost(self, blocks: Mapping[str, Block]) -> float:
        with np.errstate(all="ignore"):
            return cost_of(self.tiling, blocks)

    def frame(self, blocks: Mapping[str, Block], matrix: Array, diagonal: Array) -> Frame | None:
        with np.errstate(all="ignore"):
            return open_frame(self.datum, blocks, self.layout, matrix, diagonal) if self.datum else None


def adjust(
    blocks: Iterable[Block], groups: Sequence[Group], datum: Datum | None = None, control: Control | None = None
) -> Solution:
    """Minimise the sum of squares of the whitened residuals over the free entries of the blocks.

    The method is Gauss-Newton; a step that would raise the sum is shortened by damping (Marquardt 1963), so the sum
    never rises. It stops when a step is short compared with the standard deviations, so the units of the unknowns do
    not matter. It also stops when the steps shrink so fast that the next one would be short (contraction of Newton
    steps, Deuflhard: Newton Methods for Nonlinear Problems, 2004). A singular problem ends with an outcome, not with
    an exception. Raises ValueError only if blocks and groups do not fit together.
    """
    control = control or Control()
    take()
    state = {block.name: block for block in blocks}
    layout = arrange(state, groups)
    problem = _Problem(groups, layout, datum, tiling_of(groups, state, layout))
    unknowns = sum(int(block.free.sum()) for block in state.values())
    descent = _Descent(problem, state, control.covariance)
    lost = Solution(Outcome.NO_START, state, tuple(groups), float("inf"), 0, unknowns)
    if not np.isfinite(descent.cost):
        few = lost.observations < unknowns - len(datum.names if datum else ())
        return replace(lost, outcome=Outcome.TOO_FEW) if few else lost
    outcome = Outcome.ITERATION_LIMIT if control.limit else Outcome.CONVERGED
    iterations = 0
    while iterations < control.limit and outcome is Outcome.ITERATION_LIMIT:
        take()
        iterations += 1
        outcome = descent.step(control.tolerance**2 * max(unknowns, 1), iterations == control.limit)
    solution = replace(lost, outcome=outcome, blocks=descent.state, cost=descent.cost, iterations=iterations)
    return _with_covariance(solution, problem, descent.here()) if control.covariance else solution


def covariance_at(blocks: Iterable[Block], groups: Sequence[Group], datum: Datum | None = None) -> Solution:
    """Return the covariance that an adjustment would have at these values, without changing them (for planning)."""
    return adjust(blocks, groups, datum, Control(limit=0))


class _Descent:
    """The iteration: the present values, the normal equations there, and the damping."""

    def __init__(self, problem: _Problem, state: Mapping[str, Block], wanted: bool) -> None:
        """Start at `state`; `wanted` is True if the normal equations are needed after the last step."""
        self.problem, self.state, self.damping, self.wanted = problem, dict(state), 0.0, wanted
        self.fall = 0.0  # decrease that the last step predicted; 0 before the first step and after a damped one
        self.normals: Normals | None = problem.normals(self.state)
        self.cost = self.normals.cost

    def here(self) -> Normals:
        """Return the normal equations at the present values."""
        if self.normals is None:
            self.normals = self.problem.normals(self.state)
        return self.normals

    def step(self, small: float, final: bool) -> Outcome:
        """Take one step that does not raise the cost; CONVERGED after the last step, DIVERGED if no such step is found.

        `final`: no further step is allowed. Normal equations take most of the memory: those of the old values are
        released before those of the new ones are made, and made again if the step is rejected.
        """
        while self.damping <= _DAMPING_LIMIT:
            try:
                moved, fall = self._moved()
            except np.linalg.LinAlgError:
                self._damp()
                continue
            short = fall <= small + _ROUNDING * self.cost
            last = short or self._contracts(fall, small)
            self.normals = None
            found = self.problem.normals(moved) if self.wanted or not (last or final) else None
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
        """Return whether the next step would be far below the tolerance, if the steps go on shrinking as now.

        `fall` is the square of a step's length. The contraction of Gauss-Newton steps, `a + b length`, decreases with
        the length, so the prediction is on the safe side.
        """
        if self.damping or not self.fall:
            return False
        return fall <= _NEAR**2 * small and fall**2 <= _FAR_BELOW**2 * small * self.fall

    def _rounding(self) -> float:
        """Return the possible rounding error of the sum of squares, `2 |residual| |readings| eps` (Cauchy-Schwarz)."""
        return 2 * float(np.sqrt(self.cost)) * _LAST_DIGITS * self.problem.size + _ROUNDING * self.cost

    def _damp(self) -> None:
        self.damping = max(self.damping * 10, _DAMPING_START)

    def _moved(self) -> tuple[dict[str, Block], float]:
        """Return the blocks after the damped step, and the decrease of the sum of squares that it predicts."""
        normals = self.here()
        with np.errstate(all="ignore"):  # an overflow ends as a LinAlgError or as a rejected step
            damped = normals.damped(self.damping) if self.damping else normals
            step, fall, frame = _solve(self.problem, self.state, damped)
            return _moved(self.problem, self.state, step, damped.back(step), frame), fall


def _relaxed(damping: float) -> float:
    return damping / 10 if damping / 10 > _DAMPING_END else 0.0


def _solve(problem: _Problem, state: Mapping[str, Block], normals: Normals) -> tuple[Array, float, Frame | None]:
    """Return the step of the reduced unknowns, the decrease `g' H^-1 g` that all predict, and the open movements."""
    matrix, right, alone = normals.reduced()
    frame = problem.frame(state, matrix, normals.diagonal)
    step = np.zeros(problem.layout.width)
    if len(step):
        step[:] = _cholesky_solve(_held(matrix, frame, normals.diagonal), right)
    return step, alone + float(right @ step), frame


def _held(matrix: Array, frame: Frame | None, diagonal: Array) -> Array:
    """Add stiffness along the open movements of the frame, so that the matrix can be factored.

    The stiffness is scaled so that it counts 1 for every unknown, because the units of the blocks may be as different
    as mm and 1/s. Its size does not affect the result: the datum removes what it adds. Where the reduction leaves
    nothing of the normal matrix, the size is that of its `diagonal` before, not of rounding.
    """
    if frame is None or not len(matrix):
        return matrix
    left = np.diag(matrix)
    size = np.sqrt(np.maximum(np.where(left > _NOTHING * diagonal, left, diagonal), 1e-300))
    unit, _ = np.linalg.qr(frame.reduced * size[:, None])
    stiff = unit * size[:, None]
    held: Array = matrix + stiff @ stiff.T
    return held


def _cholesky_solve(matrix: Array, right: Array) -> Array:
    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        raise np.linalg.LinAlgError("the normal equations have entries that are no numbers")
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    balanced, scaled = matrix * scale[:, None] * scale, (right.T * scale).T
    if len(matrix) <= FEW:
        np.linalg.cholesky(balanced)  # raises LinAlgError unless it is positive definite
        solved: Array = np.asarray(np.linalg.solve(balanced, scaled), dtype=float)
    else:
        from scipy.linalg import cho_factor, cho_solve

        solved = cho_solve(cho_factor(balanced, lower=True), scaled)
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
        frame = problem.frame(blocks, matrix, normals.diagonal)
    except np.linalg.LinAlgError:
        matrix, frame = np.full((layout.width, layout.width), np.nan), None
    conditions = frame.reduced.shape[1] if frame else 0
    counted = replace(solution, conditions=conditions)
    # the datum's movements are held, so that they are not reported as undetermined
    held = _held(matrix, frame, normals.diagonal)
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

    Let n_i be the noise of member i alone, of covariance D_i^-1, and `A = sum H_i W_i`. The movement that restores the
    datum is `h = H e = -A r + sum H_i n_i`, so `r' = r - E h = (I + E A) r - E sum H_i n_i`. The reduced unknowns r and
    the n_i are uncorrelated.
    """
    found = [part.moments(frame.constraint(part.members)) for part in normals.parts]
    e = frame.reduced
    coupled, gram = (np.sum([one[i] for one in found], axis=0) for i in (0, 1))
    transform = np.eye(len(inverse)) + e @ coupled
    return np.asarray(transform @ inverse @ transform.T + e @ gram @ e.T)
