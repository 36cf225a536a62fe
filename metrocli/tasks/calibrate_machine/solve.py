"""Solve for the errors of a machine: find what the readings determine, then adjust robustly and remove outliers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Index
from metrocli.adjust.outcome import Outcome
from metrocli.adjust.robust import Fit, Suspects, robust_start, suspects
from metrocli.adjust.solution import Residuals, Solution, residuals_of
from metrocli.errors import NotConvergedError, UndeterminedError
from metrocli.instruments.machine import TOOL
from metrocli.tasks.calibrate_machine.identifiability import Identifiability, identify
from metrocli.tasks.calibrate_machine.problem import Problem

_ROUNDS = 30
_VAGUE = (
    "\nan unknown tool vector cannot be separated from the tracker's place: give `tool_uncertainty` as a few mm, "
    "not more"
)


@dataclass(frozen=True)
class Solved:
    """The adjusted errors of a machine, the tests of the readings, and the readings that were left out."""

    problem: Problem
    """Holds only the readings that were used"""
    identified: Identifiability
    solution: Solution
    residuals: Residuals
    suspects: Suspects
    rejected: tuple[tuple[str, float], ...] = ()
    """Name and |w| of each reading left out"""


def solve(problem: Problem, remove: bool) -> Solved:
    """Adjust the readings; if `remove`, leave out outliers and adjust again until none remains.

    Raises UndeterminedError if the readings do not determine the error in the volume, and NotConvergedError if the
    adjustment does not converge.
    """
    identified = identify(problem)
    state: Mapping[str, Block] = robust_start(identified.blocks.values(), problem.groups, problem.readings.name)
    rejected: list[tuple[str, float]] = []
    for _ in range(_ROUNDS):
        solution, found, doubtful = _adjusted(state, problem)
        worst = _worst(doubtful) if remove else np.zeros(0, dtype=np.intp)
        if not worst.size:
            break
        names = problem.names
        tests = dict(zip(doubtful.rows.tolist(), doubtful.tests.tolist(), strict=True))
        rejected += [(names[i], tests[i]) for i in worst.tolist()]
        problem, state = _without(problem, worst), solution.blocks
        identified = identify(problem)
        state = {name: replace(block, free=identified.blocks[name].free) for name, block in state.items()}
    return Solved(problem, identified, solution, found, doubtful, tuple(rejected))


def solved_again(solved: Solved, problem: Problem) -> Solved:
    """Return the solution of a relinearised problem of the same readings; their identifiability is taken over."""
    solution, found, doubtful = _adjusted(problem.blocks, problem)
    return replace(solved, problem=problem, solution=solution, residuals=found, suspects=doubtful)


def adjusted(blocks: Mapping[str, Block], groups: tuple[Group, ...]) -> Solution:
    """Return the adjustment.

    Raises UndeterminedError if the unknowns are not determined, and NotConvergedError if there is no solution.
    """
    solution = adjust(blocks.values(), groups)
    if solution.outcome in (Outcome.UNDETERMINED, Outcome.TOO_FEW):
        open_ones = "\n".join(f"  {combination}" for combination in solution.undetermined[:8])
        vague = any(part[0] == TOOL for combination in solution.undetermined for part in combination.parts)
        raise UndeterminedError(f"{solution.outcome.value}\n{open_ones}".rstrip() + _VAGUE * vague, solution.misfit)
    if not solution.outcome.good:
        raise NotConvergedError(f"{solution.outcome.value} ({solution.iterations} steps)", solution.misfit)
    return solution


def _adjusted(state: Mapping[str, Block], problem: Problem) -> tuple[Solution, Residuals, Suspects]:
    solution = adjusted(state, problem.groups)
    found = residuals_of(solution, problem.readings)
    return solution, found, suspects(found, Fit(solution.cost, solution.dof, True))


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
