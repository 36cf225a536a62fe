"""The functions of locate-launch-unit."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.errors import InputError, MetrocliError
from metrocli.plan import Plan
from metrocli.result import Result
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.table import Table
from metrocli.tasks.job import Job, Task
from metrocli.tasks.locate_launch_unit import KIND
from metrocli.tasks.locate_launch_unit.diagnosis import adjusted_job, covariates, noise_of
from metrocli.tasks.locate_launch_unit.effects import EFFECTS, PLACES
from metrocli.tasks.locate_launch_unit.plan import planned_measurement
from metrocli.tasks.locate_launch_unit.readings import read
from metrocli.tasks.locate_launch_unit.report import place_of_unit, report
from metrocli.tasks.locate_launch_unit.settings import METHODS, Files, Settings
from metrocli.tasks.locate_launch_unit.simulation import simulated
from metrocli.tasks.locate_launch_unit.solve import How, Located, locate
from metrocli.tasks.shared.noise import weighed
from metrocli.tasks.shared.weather import other_weather


def run(job: Job[Settings, Files]) -> Result:
    """Return the located unit; raises InputError, UndeterminedError or NotConvergedError."""
    located, factor = _located(job, _how(job))
    return report(located, job.settings.method, noise_of(located, job.settings.noise.model, factor))


def _located(job: Job[Settings, Files], how: How) -> tuple[Located, float]:
    """Return the located unit, and how many times the declared noise its readings have."""
    readings, noise, own = read(job.files.poses, job.settings.environment), job.settings.noise, _how(job)
    kept = None if how.remove == own.remove else partial(locate, readings, how=own)
    return weighed(noise.model, noise, partial(locate, readings, how=how), kept)


def diagnosed(job: Job[Settings, Files]) -> AdjustedJob:
    """Return the adjusted job in the form that diagnosis needs, with all readings; raises as `run` does."""
    return adjusted_job(_located(job, replace(_how(job), remove=False, explain=False))[0])


def _how(job: Job[Settings, Files]) -> How:
    return How(job.settings.method, job.settings.outliers == "remove", job.effects)


def compare(job: Job[Settings, Files]) -> Table:
    """Return the result of each method for the poses, or the reason why it was refused."""
    readings, noise = read(job.files.poses, job.settings.environment), job.settings.noise
    rows: list[tuple[str | float, ...]] = []
    for method in METHODS:
        try:
            located = locate(readings, noise, How(method))
        except MetrocliError as error:
            rows.append((method, *[float("nan")] * 8, str(error).splitlines()[0].removeprefix("error: ")))
        else:
            rows.append((method, *located.values, *np.sqrt(np.diag(located.covariance)), ""))
    lengths = [f"{name} [mm]" for name in ("x", "y", "z", "sx", "sy", "sz")]
    return Table.of_rows(("method", *lengths[:3], "gamma [rad]", *lengths[3:], "sgamma [rad]", "refused"), rows)


def check(job: Job[Settings, Files]) -> None:
    """Raise InputError for what shows in the poses before the unit is located."""
    read(job.files.poses, job.settings.environment)


def simulate(job: Job[Settings, Files], options: SimulationOptions) -> Simulation:
    """Return simulated poses of a unit at the place of `simulation:`, with effects.

    The receiver stands at the listed places, or at those of the poses. Raises InputError if either is missing.
    """
    settings, files = job.settings, job.files
    where = files.places if files.places is not None else files.poses or None
    if settings.simulation is None or where is None:
        raise InputError(
            "simulate needs the truth, `simulation: {place: [0 mm, 1 m, 1.5 m], gamma: 20 deg}`, and the receiver's "
            "positions, from `inputs: {places: places.csv}` or from the poses"
        )
    rng = np.random.default_rng(options.seed)
    return simulated(settings.simulation, settings.noise, where, rng, job.effects, settings.environment)


def plan(job: Job[Settings, Files]) -> Plan:
    """Return the lines to measure from the located unit, with their margins and NC programs.

    Before the poses are measured, the location is the one expected from poses at the listed places, for a unit at the
    place of `simulation:`. Raises InputError without poses or places, UndeterminedError if no line can be measured.
    """
    settings, poses, places = job.settings, job.files.poses, job.files.places
    if poses:
        located = locate(read(poses, settings.environment), settings.noise, _how(job))
        first = f"located from {len(poses)} measured poses"
    elif places is not None and settings.simulation is not None:
        exact = replace(settings.noise, encoder=0.0, distance=0.0)
        expected = simulated(
            settings.simulation, exact, places, np.random.default_rng(0), (), settings.environment
        ).files["poses.csv"]
        located = locate(read(expected, settings.environment), settings.noise, _how(job))
        first = f"expected from {len(places)} poses that are still to be measured"
    else:
        raise InputError(
            "plan needs measured poses, or before they are measured `inputs: {places: places.csv}` and "
            "`simulation: {place: [0 mm, 1 m, 1.5 m]}`, the approximate place of the unit"
        )
    if settings.plan is None:
        return Plan(KIND.name, (first,), place_of_unit(located, located.covariance))
    made = planned_measurement(located, settings.plan, settings.noise)
    return replace(made, notes=(first, *made.notes))


TASK = Task(
    Files,
    run,
    check,
    plan=plan,
    simulate=simulate,
    diagnosed=diagnosed,
    effects=EFFECTS,
    places=PLACES,
    covariates=covariates,
    other_settings=other_weather,
    answers={"compare": compare},
)
