"""The task selfcal-grid: run, diagnose, compare, simulate and plan a job."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrocli.adjust.clusters.robust import FROM_RESIDUALS, STRUCTURED
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.effects.requested import keys_of
from metrocli.errors import InputError, UndeterminedError
from metrocli.plan import Plan
from metrocli.result import Result
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.table import Table
from metrocli.tasks.job import Job, Task
from metrocli.tasks.selfcal_grid import mountings, readings
from metrocli.tasks.selfcal_grid import plan as planned_views
from metrocli.tasks.selfcal_grid.determination.undetermined import opened
from metrocli.tasks.selfcal_grid.diagnosis import adjusted_job, with_structure
from metrocli.tasks.selfcal_grid.effects import EFFECTS, PLACES
from metrocli.tasks.selfcal_grid.error_map import error_at
from metrocli.tasks.selfcal_grid.problem import GridProblem, build
from metrocli.tasks.selfcal_grid.report import report
from metrocli.tasks.selfcal_grid.sequence import in_sequence
from metrocli.tasks.selfcal_grid.settings import Files, Settings, views_of
from metrocli.tasks.selfcal_grid.simulation import simulated
from metrocli.tasks.selfcal_grid.solve import AdjustedGrid, leave_one_out, solve
from metrocli.tasks.shared.noise import DECLARED, Structured, weighed

_MANY = 20_000
"""Number of readings above which views are left out in turn only if the job asks for it"""


def run(job: Job[Settings, Files]) -> Result:
    """Return the result with both error fields; raises InputError, UndeterminedError or NotConvergedError."""
    settings, files = job.settings, job.files
    solved = _solved(job)
    shared, shown = None, solved
    if settings.noise == STRUCTURED:
        shown, shared = with_structure(solved)
    wanted = settings.leave_one_out == "yes" or (settings.leave_one_out == "auto" and len(files.views) <= _MANY)
    result = report(shown, opened(solved.problem, solved.design), leave_one_out(solved) if wanted else [], files.map)
    if settings.noise in FROM_RESIDUALS:
        noise = solved.problem.noise
        kept = {name: value for name, value in result.statistics.items() if name != "p_value"}
        result = replace(result, statistics={**kept, "noise_estimated": True, "noise": {"mm": noise}})
    return result if shared is None else _with_shared(result, shared)


def _with_shared(result: Result, shared: Structured) -> Result:
    """Return the result with what readings share."""
    return replace(
        result,
        statistics={**result.statistics, **shared.statistics},
        notes=(shared.note, *result.notes),
        details=shared.details([estimate.name for estimate in result.estimates]),
    )


def diagnosed(job: Job[Settings, Files]) -> AdjustedJob:
    """Return the adjusted job for diagnosis, with all its readings.

    Raises the errors of `run`, and UndeterminedError without degrees of freedom.
    """
    solved = solve(_problem(job), remove=False)
    if solved.solution.dof <= 0:
        raise UndeterminedError("there are no more readings than unknowns: no residual can show an error of the model")
    return adjusted_job(solved)


def _solved(job: Job[Settings, Files]) -> AdjustedGrid:
    """Return the adjustment; a noise that is estimated is that of the readings alone, since lengths have their own.

    Raises UndeterminedError without degrees of freedom.
    """
    model = job.settings.noise if isinstance(job.settings.noise, str) else DECLARED

    def adjusted(problem: GridProblem) -> AdjustedGrid:
        solved = solve(problem, job.settings.outliers == "remove")
        if model != DECLARED and solved.solution.dof <= 0:
            raise UndeterminedError("noise: estimated: there are no more readings than unknowns; declare the noise")
        return solved

    return weighed(model, _problem(job), adjusted)[0]


def compare(job: Job[Settings, Files]) -> Table:
    """Return a table of the joint adjustment and of the sequence of the paper, which fits views 1-3 first."""
    return in_sequence(_problem(replace(job, effects=())))


def _problem(job: Job[Settings, Files]) -> GridProblem:
    """Return the problem of the job, with its effects."""
    settings, files = job.settings, job.files
    read = readings.read(views_of(settings), settings.grid.half, files.views)
    warnings = mountings.check(read, settings.grid.pitch)
    used = {view.name for view in read.views}
    warnings += [f"view '{view.name}' has no readings" for view in settings.views if view.name not in used]
    problem = build(read, (settings.grid.half, settings.grid.pitch), settings.declared, files.lengths).warned(warnings)
    return problem.with_effects(job.effects)


def check(job: Job[Settings, Files]) -> None:
    """Raise InputError for what shows before the adjustment."""
    _problem(job)


def simulate(job: Job[Settings, Files], options: SimulationOptions) -> Simulation:
    """Return simulated views with the errors that `simulation:` describes, and with effects.

    If the views of the job exist, the simulation uses their balls, times and temperatures. Calibrated lengths are
    between the same balls as those of the job. Raises InputError without `simulation:` or without declared noise.
    """
    settings, files = job.settings, job.files
    if settings.simulation is None or isinstance(settings.noise, str):
        raise InputError(
            "simulate needs the truth and the noise: write `noise: 5 um` and `simulation: {machine_error: 17 um, "
            "artefact_error: 0.3 mm, shift: 0.2 mm, tilt: 1 mrad}`"
        )
    rng = np.random.default_rng(options.seed)
    return simulated(settings, files.views or None, job.effects, rng, files.lengths)


def plan(job: Job[Settings, Files]) -> Plan:
    """Return what the planned views and lengths will determine, and what other sets of views would."""
    planned = planned_views.plan(job.settings, job.files.lengths)
    if not job.effects:
        return planned
    left_out = f"the plan leaves out {keys_of(job.effects)} of the job: its uncertainties hold without them"
    return replace(planned, warnings=(*planned.warnings, left_out))


TASK = Task(
    Files,
    run,
    check,
    plan=plan,
    simulate=simulate,
    diagnosed=diagnosed,
    effects=EFFECTS,
    places=PLACES,
    answers={"compare": compare},
    result_answers={"at": error_at},
)
