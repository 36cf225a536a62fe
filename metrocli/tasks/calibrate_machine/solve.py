"""Solve for the errors of a machine: find what the readings determine, then adjust robustly and remove outliers."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.model.groups import Group
from metrocli.adjust.outcome import Outcome
from metrocli.adjust.robust import FitQuality, Suspects, gross, robust_start, suspects
from metrocli.adjust.rounds import adjust_with_iterated_weights, in_rounds, undisturbed, worst_of
from metrocli.adjust.solution import Residuals, Solution, residuals_of
from metrocli.arrays import Array, Index
from metrocli.doubt import MANY_LEFT_OUT, MOST_REJECTED
from metrocli.errors import NoSolutionError, NotConvergedError, UndeterminedError
from metrocli.frozen import dataclass
from metrocli.instruments.machine import AXES, TOOL
from metrocli.tasks.calibrate_machine.problem import MachineProblem
from metrocli.tasks.calibrate_machine.rank.identifiability import Identifiability, identify
from metrocli.tasks.shared.lengths import with_repeatability
from metrocli.tasks.shared.mirror import Mirrored, mirrored, must_be_decided, of_tracers
from metrocli.words import listed

_VAGUE = (
    "\nan unknown tool vector cannot be separated from the tracker's place: give `tool_uncertainty` as a few mm, "
    "not more"
)
_FRAME = (
    "\nthe axis next to the bed is the frame: place along it and turn about it are those of the reflectors. Give each "
    "of these a `sigma_mm` that holds the turn to 1 mrad"
)


@dataclass(frozen=True)
class AdjustedMachine:
    """The adjusted errors of a machine, the tests of the readings, and the readings that were left out."""

    problem: MachineProblem
    """Holds only the readings that were used; its noise is the final one"""
    identified: Identifiability
    solution: Solution
    rejected: tuple[tuple[str, float], ...] = ()
    """Name and |w| of each reading left out"""

    @property
    def group(self) -> Group:
        """The readings that were used, with their final weights."""
        return self.solution.group(self.problem.readings.name)

    @cached_property
    def residuals(self) -> Residuals:
        """Residuals of the readings, with their tests."""
        return residuals_of(self.solution, self.group)

    @property
    def read(self) -> tuple[Residuals, ...]:
        """The residuals of all readings."""
        return (self.residuals,)

    @cached_property
    def second(self) -> list[Mirrored]:
        """Stations with a second place that fits their lengths as well; none for other readings."""
        if self.problem.listed_at is None:
            return []
        return mirrored(of_tracers(self.solution, self.group, self.problem.listed_at), max(1.0, self.solution.misfit))

    @cached_property
    def suspects(self) -> Suspects:
        """The readings that do not fit the others."""
        return suspects(self.residuals, FitQuality(self.solution.cost, self.solution.dof, True))


def solve(problem: MachineProblem, remove: bool) -> AdjustedMachine:
    """Adjust the readings; if `remove`, leave out outliers and adjust again until none remains.

    Raises UndeterminedError if the readings do not determine the error in the volume, and NotConvergedError if the
    adjustment does not converge.
    """
    identified = identify(problem)

    def whole(always: bool = False) -> _KeptReadings:
        start = robust_start(identified.blocks.values(), problem.groups, (problem.readings.name,), always=always)
        return _KeptReadings(problem.with_blocks(start), identified, ())

    def without_wrong(always: bool) -> AdjustedMachine:
        return in_rounds(whole(always).without_gross(), _KeptReadings.solved, fewer)[1]

    def fewer(used: _KeptReadings, solved: AdjustedMachine) -> tuple[_KeptReadings, bool]:
        worst, suspected = worst_of(solved.suspects), solved.suspects
        if not worst.size:
            return used, False
        adjusted = replace(used, problem=solved.problem.with_blocks(solved.solution.blocks))
        return adjusted.without(suspected.rows[worst], suspected.tests[worst]), True

    if remove:
        solved = undisturbed(without_wrong)
    else:
        begun = whole()
        try:
            solved = begun.solved()
        except NoSolutionError as error:
            raise _contradicted(begun, error) from error
    must_be_decided(solved.second, solved.solution.sigma0)
    return solved


def _contradicted(whole: _KeptReadings, error: NoSolutionError) -> NoSolutionError:
    """Return the error of readings that have no solution, with those without which they have one, if there are any."""
    try:
        rest = whole.without_gross().solved()
    except NoSolutionError:
        return error
    gone = sorted(rest.rejected, key=lambda each: -each[1])
    if not 0 < len(gone) < MOST_REJECTED * len(whole.problem.names):
        return error
    key, them = next(iter(whole.problem.readings.observations.keys)), "them" if len(gone) > 1 else "it"
    named = listed([f"{key} {name}" for name, _ in gone])
    # many have one cause: other units, signs and names are tried
    misfit = rest.solution.misfit if len(gone) < MANY_LEFT_OUT else error.misfit
    return NotConvergedError(
        f"the readings contradict each other: without {named} the others have a solution (sigma0 = "
        f"{rest.solution.sigma0:.3g}); correct {them}, or `outliers: remove`",
        misfit,
    )


@dataclass(frozen=True)
class _KeptReadings:
    """A problem without the readings that were rejected, at the values to start from."""

    problem: MachineProblem
    identified: Identifiability
    rejected: tuple[tuple[str, float], ...]

    def without(self, rows: Index, tests: Array) -> _KeptReadings:
        """Return the problem without some readings, whose tests are given; what the others determine is free."""
        if not rows.size:
            return self
        names = self.problem.names
        left = self.problem.selected(np.isin(np.arange(len(names)), rows, invert=True))
        identified = identify(left)
        values = self.problem.blocks.items()
        state = {name: replace(block, free=identified.blocks[name].free) for name, block in values}
        gone = ((names[row], test) for row, test in zip(rows.tolist(), tests.tolist(), strict=True))
        return _KeptReadings(left.with_blocks(state), identified, (*self.rejected, *gone))

    def without_gross(self) -> _KeptReadings:
        """Return the problem without the readings that are far off at its values."""
        unknowns = sum(int(block.free.sum()) for block in self.identified.blocks.values())
        # a robust fit meets as many readings as it has unknowns exactly: their median is not a scale if they are most
        if not len(self.problem.names) > 2 * unknowns:
            return self
        far = gross(self.problem.readings, self.problem.blocks)
        return self.without(np.flatnonzero(far), far[far > 0])

    def solved(self) -> AdjustedMachine:
        problem, solution = with_repeatability(self.problem, adjusted, self.problem.readings.name)
        return AdjustedMachine(problem, self.identified, solution, self.rejected)


def solved_again(solved: AdjustedMachine, problem: MachineProblem) -> AdjustedMachine:
    """Return the solution of a relinearised problem of the same readings; their identifiability is taken over."""
    return _KeptReadings(problem, solved.identified, solved.rejected).solved()


def adjusted(problem: MachineProblem) -> Solution:
    """Return the adjustment, with standard deviations and aspects that follow from the solution.

    Raises UndeterminedError if the unknowns are not determined, and NotConvergedError if there is no solution.
    """
    solution = refitted(problem)
    if solution.outcome in (Outcome.UNDETERMINED, Outcome.TOO_FEW):
        open_ones = "\n".join(f"  {combination}" for combination in solution.undetermined[:8])
        vague = any(part[0] == TOOL for combination in solution.undetermined for part in combination.parts)
        linear = any(axis.letter in AXES for axis in problem.machine.axes)
        tables = {axis.block for axis in problem.machine.axes}
        framed = not any(part[0] in tables for combination in solution.undetermined for part in combination.parts)
        hint = _VAGUE * vague if linear else _FRAME * framed
        raise UndeterminedError(f"{solution.outcome.value}\n{open_ones}".rstrip() + hint, solution.misfit)
    if not solution.outcome.good:
        raise NotConvergedError(f"{solution.outcome.value} ({solution.iterations} steps)", solution.misfit)
    return solution


def refitted(problem: MachineProblem) -> Solution:
    """Return the adjustment from the present values, whatever its outcome."""
    blocks = problem.blocks.values()
    if problem.noise is None:
        return adjust(blocks, problem.groups)
    aspects = problem.model.aspects if problem.effects else {}
    noise = {problem.readings.name: problem.noise}
    return adjust_with_iterated_weights(blocks, problem.groups, noise, None, aspects)
