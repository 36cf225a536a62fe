"""Solve for the errors of a machine: find what the readings determine, then adjust robustly and remove outliers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.iterated_weights import adjust_with_iterated_weights
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.observations import Index
from metrocli.adjust.outcome import Outcome
from metrocli.adjust.robust import Fit, Suspects, robust_start, suspects
from metrocli.adjust.solution import Residuals, Solution, residuals_of
from metrocli.errors import NotConvergedError, UndeterminedError
from metrocli.frozen import dataclass
from metrocli.instruments.machine import TOOL
from metrocli.tasks.calibrate_machine.identifiability import Identifiability, identify
from metrocli.tasks.calibrate_machine.problem import Problem
from metrocli.tasks.shared.lengths import settled

_ROUNDS = 30
_VAGUE = (
    "\nan unknown tool vector cannot be separated from the tracker's place: give `tool_uncertainty` as a few mm, "
    "not more"
)


@dataclass(frozen=True)
class Solved:
    """The adjusted errors of a machine, the tests of the readings, and the readings that were left out."""

    problem: Problem
    """Holds only the readings that were used; its noise is the final one"""
    identified: Identifiability
    solution: Solution
    rejected: tuple[tuple[str, float], ...] = ()
    """Name and |w| of each reading left out"""

    @cached_property
    def residuals(self) -> Residuals:
        """Residuals of the readings, with their tests."""
        name = self.problem.readings.name
        return residuals_of(self.solution, next(group for group in self.solution.groups if group.name == name))

    @cached_property
    def suspects(self) -> Suspects:
        """The readings that do not fit the others."""
        return suspects(self.residuals, Fit(self.solution.cost, self.solution.dof, True))


def solve(problem: Problem, remove: bool) -> Solved:
    """Adjust the readings; if `remove`, leave out outliers and adjust again until none remains.

    Raises UndeterminedError if the readings do not determine the error in the volume, and NotConvergedError if the
    adjustment does not converge.
    """
    identified = identify(problem)
    state: Mapping[str, Block] = robust_start(identified.blocks.values(), problem.groups, problem.readings.name)
    rejected: tuple[tuple[str, float], ...] = ()
    for _ in range(_ROUNDS):
        solved = Solved(*_adjusted(problem.with_blocks(state), identified), rejected)
        worst = _worst(solved.suspects) if remove else np.zeros(0, dtype=np.intp)
        if not worst.size:
            break
        names = solved.problem.names
        tests = dict(zip(solved.suspects.rows.tolist(), solved.suspects.tests.tolist(), strict=True))
        rejected = (*rejected, *((names[i], tests[i]) for i in worst.tolist()))
        problem, state = _without(solved.problem, worst), solved.solution.blocks
        identified = identify(problem)
        state = {name: replace(block, free=identified.blocks[name].free) for name, block in state.items()}
    return solved


def solved_again(solved: Solved, problem: Problem) -> Solved:
    """Return the solution of a relinearised problem of the same readings; their identifiability is taken over."""
    return Solved(*_adjusted(problem, solved.identified), solved.rejected)


def _adjusted(problem: Problem, identified: Identifiability) -> tuple[Problem, Identifiability, Solution]:
    """Return the adjustment; an unknown repeatability is estimated with it."""
    problem, solution = settled(problem, adjusted, problem.readings.name)
    return problem, identified, solution


def adjusted(problem: Problem) -> Solution:
    """Return the adjustment, with standard deviations and aspects that follow from the solution.

    Raises UndeterminedError if the unknowns are not determined, and NotConvergedError if there is no solution.
    """
    solution = refitted(problem)
    if solution.outcome in (Outcome.UNDETERMINED, Outcome.TOO_FEW):
        open_ones = "\n".join(f"  {combination}" for combination in solution.undetermined[:8])
        vague = any(part[0] == TOOL for combination in solution.undetermined for part in combination.parts)
        raise UndeterminedError(f"{solution.outcome.value}\n{open_ones}".rstrip() + _VAGUE * vague, solution.misfit)
    if not solution.outcome.good:
        raise NotConvergedError(f"{solution.outcome.value} ({solution.iterations} steps)", solution.misfit)
    return solution


def refitted(problem: Problem) -> Solution:
    """Return the adjustment from the present values, whatever its outcome."""
    blocks = problem.blocks.values()
    if problem.noise is None:
        return adjust(blocks, problem.groups)
    aspects = problem.model.aspects if problem.effects else {}
    noise = (problem.readings.name, problem.noise)
    return adjust_with_iterated_weights(blocks, problem.groups, noise, None, aspects)


def _worst(doubtful: Suspects) -> Index:
    """Return the readings to leave out next: those with a test of at least half the largest one.

    A large gross error also raises the tests of good readings, but less; these are tested again without it.
    """
    if not doubtful.rows.size:
        return doubtful.rows
    return np.asarray(doubtful.rows[doubtful.tests >= doubtful.tests.max() / 2])


def _without(problem: Problem, rows: Index) -> Problem:
    keep = np.ones(problem.readings.observations.count, dtype=bool)
    keep[rows] = False
    model = problem.model.with_group(problem.readings.selected(keep))
    return replace(problem, model=model, per_reading=problem.per_reading[keep])
