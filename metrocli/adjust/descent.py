"""The steps of an adjustment: Gauss-Newton with damping, and when they end.

Method: docs/algorithms/tiled-elimination.md (normal equations) and docs/algorithms/free-networks.md (datum).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from metrocli.adjust.datum import Datum, Frame, open_frame
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.outcome import Outcome
from metrocli.adjust.schur.layout import Layout
from metrocli.adjust.schur.normals import Normals, assemble, cost_of
from metrocli.adjust.schur.tiles import Tiling
from metrocli.arrays import Array, extents
from metrocli.frozen import dataclass

_ROUNDING = 1e-13
"""A decrease of the sum of squares below this fraction of it is rounding"""
_STILL = 1e-12
"""Values stand where a step changes none by more than this fraction of the largest of its block"""
_LAST_DIGITS = 4 * float(np.finfo(float).eps)
"""Relative rounding error of a predicted reading"""
_NEAR, _FAR_BELOW = 1e3, 1e-2
"""The last step is one shorter than `_NEAR` tolerances after which a step below `_FAR_BELOW` tolerances is expected"""
_RESTORED, _IN_DATUM = 20, 1e-7
"""Rounds that bring values into the datum at most, and how far they may be off it, in the extent of its members"""
_WITHOUT_SCIPY = 500
"""Most unknowns that numpy solves: loading scipy takes as long as a dozen solutions of as many"""
_NOTHING = 1e-10
"""Share of the diagonal of the normal matrix below which its reduction leaves nothing"""
# from a damping that leaves a sound step as it is to one whose step is 1e-8 of the gradient's: both ends are beyond use
_DAMPING_START, _DAMPING_END, _DAMPING_LIMIT = 1e-9, 1e-11, 1e8


@dataclass(frozen=True)
class IteratedSystem:
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
        """Return the normal equations at the values of the blocks."""
        with np.errstate(all="ignore"):
            return assemble(self.tiling, blocks, self.layout)

    def cost(self, blocks: Mapping[str, Block]) -> float:
        """Return the sum of squares of the whitened residuals."""
        with np.errstate(all="ignore"):
            return cost_of(self.tiling, blocks)

    def frame(self, blocks: Mapping[str, Block], matrix: Array, diagonal: Array) -> Frame | None:
        """Return the movements that the reduced normal matrix leaves open, None without a datum."""
        with np.errstate(all="ignore"):
            return open_frame(self.datum, blocks, self.layout, matrix, diagonal) if self.datum else None


class Descent:
    """The iteration: the present values, the normal equations there, and the damping."""

    def __init__(self, problem: IteratedSystem, state: Mapping[str, Block], wanted: bool) -> None:
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
            if self._stands(moved, fall, small):
                return Outcome.CONVERGED
            # `fall` is the square of the step's length in standard deviations, so
            # it is compared with a squared tolerance
            short = fall <= small + _ROUNDING * self.cost
            last = short or self._contracts(fall, small)
            self.normals = None
            normals = self.problem.normals(moved) if self.wanted or not (last or final) else None
            cost = normals.cost if normals else self.problem.cost(moved)
            # a last step may end above by what rounding leaves in the sum: else an adjustment
            # at its solution would be damped for ever
            if cost <= self.cost or (last and cost <= self.cost + small + self._rounding()):
                # a strongly damped step is short however far the end is, so its length does not show that it is near
                done = last and self.damping <= 1e-4
                self.fall = 0.0 if self.damping else fall
                self.state, self.normals, self.cost, self.damping = moved, normals, cost, _relaxed(self.damping)
                return Outcome.CONVERGED if done else Outcome.ITERATION_LIMIT
            # the cost rose by a step below the tolerance: that is rounding, and the values before it stand
            if short:
                return Outcome.CONVERGED
            self._damp()
        return Outcome.DIVERGED

    def restore_datum(self, small: float) -> Outcome:
        """Bring the values at the end of the steps into the datum, where these have left it; return the outcome.

        A damped step leaves no movement open, so nothing holds the values in the datum meanwhile. What is far off it
        is brought back to first order; steps that follow adjust the readings again.
        """
        before = np.inf
        for _ in range(_RESTORED):
            normals = self.here()
            try:
                frame = self.problem.frame(self.state, normals.reduced()[0], normals.diagonal)
            except np.linalg.LinAlgError:  # what is undetermined is named where the covariance is computed
                break
            if frame is None:
                break
            block = self.state[frame.datum.block]
            shifts = frame.steps(self.state, block.values)
            off = float(np.abs(shifts[block.name]).max())
            # what is left is of second order: if it no longer shrinks, it is rounding
            if off <= _IN_DATUM * float(extents(block.values).max()) or off > before / 2:
                break
            before, left = off, self.state
            self._go(left | {name: left[name].moved(shift) for name, shift in shifts.items()})
            if not np.isfinite(self.cost):  # there nothing predicts the readings, as of points behind their camera
                self._go(left)
                return Outcome.DIVERGED
            outcome = Outcome.ITERATION_LIMIT
            for _ in range(_RESTORED):
                outcome = self.step(small, final=False)
                if outcome is not Outcome.ITERATION_LIMIT:
                    break
            if outcome is not Outcome.CONVERGED:
                return outcome
        return Outcome.CONVERGED

    def _go(self, state: dict[str, Block]) -> None:
        """Take other values, from which the steps begin anew."""
        self.state, self.normals, self.damping, self.fall = state, None, 0.0, 0.0
        self.cost = self.here().cost

    def _stands(self, moved: Mapping[str, Block], fall: float, small: float) -> bool:
        """Return whether a step is rounding, in the sum of squares and in the values, as where a solution is the start.

        The normal equations are then those of the solution, and are not made again.
        """
        if self.damping or fall > min(_FAR_BELOW**2 * small, _ROUNDING * self.cost):
            return False
        pairs = [(block.values, moved[name].values) for name, block in self.state.items() if block.free.any()]
        return all(np.abs(new - old).max() <= _STILL * np.abs(old).max() for old, new in pairs)

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


def _solve(problem: IteratedSystem, state: Mapping[str, Block], normals: Normals) -> tuple[Array, float, Frame | None]:
    """Return the step of the reduced unknowns, the decrease `g' H^-1 g` that all predict, and the open movements."""
    matrix, right, alone = normals.reduced()
    frame = problem.frame(state, matrix, normals.diagonal)
    step = np.zeros(problem.layout.width)
    if len(step):
        step[:] = cholesky_solve(held(matrix, frame, normals.diagonal), right)
    return step, alone + float(right @ step), frame


def held(matrix: Array, frame: Frame | None, diagonal: Array) -> Array:
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


def cholesky_solve(matrix: Array, right: Array) -> Array:
    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        raise np.linalg.LinAlgError("the normal equations have entries that are not numbers")
    # unknowns in mm and 1/s have diagonals that differ by many digits: balanced, pivots are compared with 1
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    balanced, scaled = matrix * scale[:, None] * scale, (right.T * scale).T
    # loading scipy takes longer than solving as few unknowns as these (docs/decisions/154-loaded-where-used.md)
    if len(matrix) <= _WITHOUT_SCIPY:
        np.linalg.cholesky(balanced)  # raises LinAlgError unless it is positive definite
        solved: Array = np.asarray(np.linalg.solve(balanced, scaled), dtype=float)
    else:
        from scipy.linalg import cho_factor, cho_solve

        solved = cho_solve(cho_factor(balanced, lower=True), scaled)
    unscaled: Array = (solved.T * scale).T
    return unscaled


def _moved(
    problem: IteratedSystem, state: Mapping[str, Block], step_r: Array, step_e: Array, frame: Frame | None
) -> dict[str, Block]:
    layout = problem.layout
    moved = dict(state)
    # fixed entries have column -1: they read entry 0 and get a step of 0
    steps = {
        name: np.where(columns >= 0, step_r[np.maximum(columns, 0)], 0.0) for name, columns in layout.columns.items()
    }
    if layout.eliminated:
        steps[layout.eliminated] = (
            step_e if state[layout.eliminated].all_free else step_e * state[layout.eliminated].free
        )
    if frame is not None:
        block = state[frame.datum.block]
        # the stiffness of `held` let the open movements take any value: the datum decides them, at the moved values
        shifts = frame.steps(state, block.values + steps.get(block.name, np.zeros_like(block.values)))
        steps |= {name: steps.get(name, 0.0) + shift for name, shift in shifts.items()}
    for name, step in steps.items():
        if state[name].free.any():
            moved[name] = state[name].moved(step)
    return moved
