"""Run, diagnose, simulate and plan a calibrate-machine job."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.effects.model import Model
from metrocli.effects.requested import keys_of
from metrocli.errors import Fault, InputError
from metrocli.plan import Plan
from metrocli.result import Result
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.tasks.calibrate_machine.described import raise_if
from metrocli.tasks.calibrate_machine.diagnosis import adjusted_job, covariates, noise_of
from metrocli.tasks.calibrate_machine.effects import EFFECTS, PLACES
from metrocli.tasks.calibrate_machine.files import Files
from metrocli.tasks.calibrate_machine.methods.on_the_fly import measurement, on_the_fly
from metrocli.tasks.calibrate_machine.methods.poses import problem_at
from metrocli.tasks.calibrate_machine.methods.six_dof import six_dof, unmeasured
from metrocli.tasks.calibrate_machine.other_settings import other_settings
from metrocli.tasks.calibrate_machine.plans.planned import plan_of_path
from metrocli.tasks.calibrate_machine.plans.poses import plan_of_poses
from metrocli.tasks.calibrate_machine.plans.stations import plan_of_stations
from metrocli.tasks.calibrate_machine.plans.stops import plan_of_lines, plan_of_points
from metrocli.tasks.calibrate_machine.problem import MachineProblem
from metrocli.tasks.calibrate_machine.report import report
from metrocli.tasks.calibrate_machine.settings import LENGTHS, ON_THE_FLY, SIX_DOF, STANDSTILL, TURNING, Settings
from metrocli.tasks.calibrate_machine.simulation import simulated
from metrocli.tasks.calibrate_machine.solve import AdjustedMachine, solve
from metrocli.tasks.calibrate_machine.sticking import naming, stuck_channels
from metrocli.tasks.job import Job, Task
from metrocli.tasks.shared.noise import weighed

if TYPE_CHECKING:
    from metrocli.tasks.job import Adjustment

_WITHOUT = "the plan leaves out {} of the job: its uncertainties hold for the geometric errors alone"


def run(job: Job[Settings, Files]) -> Result:
    """Estimate the geometric errors; raises InputError, UndeterminedError or NotConvergedError."""
    return with_adjustment(job)[0]


def with_adjustment(job: Job[Settings, Files]) -> tuple[Result, Adjustment]:
    """Return the result of `run`, and what gives its adjustment in the form that diagnosis works on."""
    solved, factor = _solved(job)
    noise = noise_of(solved, job.settings.noise.model, factor)
    return report(solved, job.settings, noise, job.files.paths), partial(adjusted_job, solved)


def diagnosed(job: Job[Settings, Files]) -> AdjustedJob:
    """Adjust the calibration and return it in the form that diagnosis works on."""
    return adjusted_job(_solved(job)[0])


def _solved(job: Job[Settings, Files]) -> tuple[AdjustedMachine, float]:
    """Return the solved calibration, and how many times the declared noise its readings have."""
    settings, files = job.settings, job.files
    model, remove = settings.noise.model, settings.outliers == "remove"
    stuck = stuck_channels(settings, files)
    with naming(stuck):
        if files.path is not None and files.track is not None:
            solved, factor = weighed(model, measurement(settings, files.path, files.track, job.effects), on_the_fly)
            return replace(solved, problem=replace(solved.problem, stuck=stuck)), factor
        problem = problem_of(job).with_effects(job.effects)
        solved, factor = weighed(model, replace(problem, stuck=stuck), lambda problem: solve(problem, remove))
    return solved, factor


def problem_of(job: Job[Settings, Files]) -> MachineProblem:
    """Return the adjustment problem of a job; a track (on-the-fly) needs alignment first."""
    if job.files.lines is not None:
        # here, not in `six_dof`: planned lines have zeros
        raise_if(unmeasured(job.files.lines))
        return six_dof(job.settings, job.files.lines)
    if job.files.poses is None:
        raise InputError(f"method {job.settings.method} has no readings")
    return problem_at(job.settings, job.files.poses, job.files)


def begun(job: Job[Settings, Files]) -> Model:
    """Return the model of a job before its adjustment; raises InputError for a track."""
    return problem_of(job).with_effects(job.effects).model


def check(job: Job[Settings, Files]) -> None:
    """Raise InputError for what shows before the adjustment; a track is aligned with its path by computing."""
    if job.settings.method != ON_THE_FLY:
        problem_of(job).with_effects(job.effects)


def simulate(job: Job[Settings, Files], options: SimulationOptions) -> Simulation:
    """Return a simulated measurement of a machine with the random errors of `simulation:` and the job's effects.

    Raises InputError if a network is to have measured the points.
    """
    _need_no_network("simulate", job.files)
    return simulated(job, options.seed)


def plan(job: Job[Settings, Files]) -> Plan:
    """Return what the job's path, points or lines will determine, and a proposal; effects are left out.

    Raises InputError if a network is to have measured the points.
    """
    settings, files = job.settings, job.files
    _need_no_network("plan", files)
    wanted: dict[str, Callable[[], Plan]] = {
        STANDSTILL: lambda: plan_of_points(settings, files.points),
        SIX_DOF: lambda: plan_of_lines(settings, files.lines),
        LENGTHS: lambda: plan_of_stations(settings, files.lengths, files.listed_stations),
        ON_THE_FLY: lambda: plan_of_path(settings, files.path),
    }
    if settings.machine.turns:
        wanted |= dict.fromkeys(TURNING, partial(plan_of_poses, settings, files))
    planned = wanted[settings.method]()
    left_out = [_WITHOUT.format(keys_of(job.effects))] if job.effects else []
    return replace(planned, warnings=(*planned.warnings, *left_out))


def _need_no_network(command: str, files: Files) -> None:
    if files.network is not None:
        text = f"{command} is about points that nobody measured yet: `inputs: network` has none of them"
        hint = "leave it out, and give the noise of one tracker: `noise: {beam: 10 um, lateral: 20 um}`"
        raise InputError([Fault(text, hint=hint)])


TASK = Task(
    Files,
    run,
    check,
    plan=plan,
    simulate=simulate,
    diagnosed=diagnosed,
    with_adjustment=with_adjustment,
    begun=begun,
    other_settings=other_settings,
    fits_up_to=2**0.5,
    effects=EFFECTS,
    places=PLACES,
    covariates=covariates,
)
