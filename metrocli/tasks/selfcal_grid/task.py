"""selfcal-grid: errors of a machine and of an artefact from views of a ball grid that nobody calibrated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrocli.diagnosis.adjusted_job import Subject
from metrocli.effects.model import extended
from metrocli.effects.wanted import Wanted
from metrocli.errors import InputError, UndeterminedError
from metrocli.plan import Plan
from metrocli.result import Result
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.table import Table
from metrocli.tasks.selfcal_grid import mountings as grid_mountings
from metrocli.tasks.selfcal_grid import plan as grid_plan
from metrocli.tasks.selfcal_grid import readings as grid_readings
from metrocli.tasks.selfcal_grid.diagnosis import subject
from metrocli.tasks.selfcal_grid.problem import Problem, build
from metrocli.tasks.selfcal_grid.report import KIND, report
from metrocli.tasks.selfcal_grid.sequence import in_sequence
from metrocli.tasks.selfcal_grid.settings import Inputs, Settings, views_of
from metrocli.tasks.selfcal_grid.simulation import simulated
from metrocli.tasks.selfcal_grid.solve import Solved, leave_one_out, solve
from metrocli.tasks.selfcal_grid.undetermined import opened

SIMULATED = ("views",)
SUMMARY = "machine and artefact errors from views of an uncalibrated ball grid"
_MANY = 20_000
"""Readings beyond which views are left out in turn only where the job asks for it"""


def run(
    settings: Settings,
    views: Table,
    lengths: Table | None = None,
    map: Table | None = None,
    effects: Sequence[Wanted] = (),
    **_: object,
) -> Result:
    """Find both fields; raises InputError, UndeterminedError or NotConvergedError."""
    problem = _with(_problem(settings, views, lengths), effects)
    solved = solve(problem, settings.outliers == "remove")
    if settings.noise == "estimated":
        solved = _with_noise_found(solved, settings.outliers == "remove")
    wanted = settings.leave_one_out == "yes" or (settings.leave_one_out == "auto" and len(views) <= _MANY)
    found = report(solved, opened(solved.problem, solved.design), leave_one_out(solved) if wanted else [], map)
    if settings.noise == "estimated":
        noise = solved.problem.noise
        kept = {name: value for name, value in found.statistics.items() if name != "p_value"}
        found = replace(found, statistics={**kept, "noise_estimated": True, "noise": {"mm": noise}})
    return found


def diagnosed(
    settings: Settings, views: Table, lengths: Table | None = None, effects: Sequence[Wanted] = (), **_: object
) -> Subject:
    """Return the job as diagnosis sees it, with all its readings; raises as `run` does."""
    solved = solve(_with(_problem(settings, views, lengths), effects), remove=False)
    if solved.solution.dof <= 0:
        raise UndeterminedError("there are no more readings than unknowns: no residual shows what the model gets wrong")
    return subject(solved)


def _with(problem: Problem, effects: Sequence[Wanted]) -> Problem:
    return problem.with_model(extended(problem.model(), effects)) if effects else problem


def _with_noise_found(solved: Solved, remove: bool) -> Solved:
    """Return the adjustment again with the noise that its residuals show; UndeterminedError without redundancy."""
    if solved.solution.dof <= 0:
        raise UndeterminedError("noise: estimated: there are no more readings than unknowns; declare the noise")
    return solve(solved.whole.with_noise(solved.problem.noise * solved.solution.sigma0), remove)


def compare(settings: Settings, views: Table, lengths: Table | None = None, **_: object) -> Table:
    """Return the joint adjustment beside the sequence of the paper, views 1-3 fitted first."""
    return in_sequence(_problem(settings, views, lengths))


def _problem(settings: Settings, views: Table, lengths: Table | None) -> Problem:
    readings = grid_readings.read(views_of(settings), settings.grid.half, views)
    warnings = grid_mountings.check(readings, settings.grid.pitch)
    used = {view.name for view in readings.views}
    warnings += [f"view '{view.name}' has no readings" for view in settings.views if view.name not in used]
    problem = build(readings, (settings.grid.half, settings.grid.pitch), settings.declared, lengths)
    return problem.warned(warnings)


def simulate(
    settings: Settings,
    options: SimulationOptions,
    views: Table | None = None,
    lengths: Table | None = None,
    effects: Sequence[Wanted] = (),
    **_: object,
) -> Simulation:
    """Return views of an artefact and a machine with the errors of `simulation:`, and with effects in them.

    Where the job's views exist, their balls, times and temperatures are those of the simulation; calibrated lengths
    are between the balls of the job's.
    """
    if settings.simulation is None or isinstance(settings.noise, str):
        raise InputError(
            "simulate needs the truth and the noise: write `noise: 5 um` and `simulation: {machine_error: 17 um, "
            "artefact_error: 0.3 mm, shift: 0.2 mm, tilt: 1 mrad}`"
        )
    return simulated(settings, views, effects, np.random.default_rng(options.seed), lengths)


def plan(settings: Settings, lengths: Table | None = None, **_: object) -> Plan:
    """Return what the views and lengths of the job will determine, and what others would."""
    return grid_plan.plan(settings, lengths)


__all__ = ["KIND", "SIMULATED", "SUMMARY", "Inputs", "Settings", "compare", "diagnosed", "plan", "run", "simulate"]
