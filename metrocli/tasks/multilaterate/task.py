"""The functions of multilaterate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from metrocli.diagnosis.adjusted_job import AdjustedJob, misfit_of
from metrocli.errors import InputError, NoSolutionError, all_faults
from metrocli.plan import Plan
from metrocli.result import Result
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.tasks.job import Job, Task
from metrocli.tasks.multilaterate.correction import list_offset, probing_of, refuse_lost
from metrocli.tasks.multilaterate.diagnosis import adjusted_job, covariates, noise_of
from metrocli.tasks.multilaterate.effects import EFFECTS, PLACES
from metrocli.tasks.multilaterate.layout import PlannedNetwork, PlannedPoints, distance
from metrocli.tasks.multilaterate.misnamed import naming_wrong_lengths
from metrocli.tasks.multilaterate.plan import planned
from metrocli.tasks.multilaterate.problem import TracerNetwork, build, network_of
from metrocli.tasks.multilaterate.readings import read
from metrocli.tasks.multilaterate.report import report
from metrocli.tasks.multilaterate.settings import Files, Settings
from metrocli.tasks.multilaterate.simulation import simulated
from metrocli.tasks.multilaterate.solve import AdjustedTracers, solve
from metrocli.tasks.shared.features.requested import requested_features
from metrocli.tasks.shared.noise import weighed
from metrocli.tasks.shared.weather import other_weather


def run(job: Job[Settings, Files]) -> Result:
    """Return the points; raises InputError, UndeterminedError or NotConvergedError."""
    settings = job.settings
    with all_faults() as each:
        with each():
            probing = probing_of(settings, job.files)
        with each():
            features = requested_features(settings.features, job.files.probing)
    remove, model = settings.outliers == "remove", settings.noise.model

    def adjusted(files: Files) -> tuple[AdjustedTracers, float]:
        network = build(settings, files).with_effects(job.effects)
        if probing is not None:
            refuse_lost(network, probing)
        return weighed(model, network, lambda network: solve(network, remove))

    solved, factor = naming_wrong_lengths(settings, job.files, adjusted)
    return report(solved, noise_of(solved, model, factor), probing, features, settings.part)


def check(job: Job[Settings, Files]) -> None:
    """Raise InputError that lists the faults in the combination of files and in the effects, without computing."""
    settings, files = job.settings, job.files
    readings = read(settings, files)
    listed_at = readings.tracers.listed_at
    places = np.column_stack([np.nan_to_num(listed_at), np.zeros(len(listed_at)), np.ones(len(listed_at))])
    bare = network_of(settings, readings, places)
    with all_faults() as each:
        with each():
            network_of(settings, readings, places, files.distances)
        with each():
            bare.with_effects(job.effects)
        with each():
            probing = probing_of(settings, files)
            if probing is not None:
                refuse_lost(bare, probing)
        with each():
            requested_features(settings.features, files.probing)


def diagnosed(job: Job[Settings, Files]) -> AdjustedJob:
    """Return the adjusted job in the form that diagnosis needs, with all lengths; raises as `run` does."""
    return _diagnosed(job, lambda network: solve(network, remove=False))


def cleared(job: Job[Settings, Files]) -> AdjustedJob:
    """Return it without gross lengths; where these cannot be identified, without all outliers, as `run` has it."""
    try:
        without_gross = _diagnosed(job, lambda network: solve(network, remove=True, tested=False))
    except NoSolutionError:
        without_gross = None
    if without_gross is not None and misfit_of(without_gross).worst <= 1:
        return without_gross
    return _diagnosed(job, lambda network: solve(network, remove=True))


def _diagnosed(job: Job[Settings, Files], solves: Callable[[TracerNetwork], AdjustedTracers]) -> AdjustedJob:
    def weighted(files: Files) -> tuple[AdjustedTracers, float]:
        network = build(job.settings, files).with_effects(job.effects)
        kept = partial(solve, remove=True) if job.settings.outliers == "remove" else None
        return weighed(job.settings.noise.model, network, solves, kept)

    solved, _ = naming_wrong_lengths(job.settings, job.files, weighted)
    adjusted = adjusted_job(solved)
    return replace(
        adjusted,
        list_offset=max(adjusted.list_offset, list_offset(solved.network, probing_of(job.settings, job.files))),
    )


def plan(job: Job[Settings, Files]) -> Plan:
    """Return what lengths from every listed tracer to every point will determine.

    If the job's lengths exist, only the pairs of point and tracer in them are planned. Raises InputError without a list
    of tracers, UndeterminedError if the layout does not determine the points.
    """
    files = job.files
    if files.tracers is None:
        raise InputError("plan needs the places where the tracers will stand: `inputs: {tracers: tracers.csv}`")
    measurement = PlannedPoints(files.points, files.tracers, files.lengths or None)
    return planned(PlannedNetwork(job.settings, measurement, files.distances, job.effects), files.candidates)


def simulate(job: Job[Settings, Files], options: SimulationOptions) -> Simulation:
    """Return simulated lengths for the mover and tracers of `simulation:`, with effects.

    If the job's lengths exist, the simulation takes points, tracers, times and temperatures from them.
    """
    settings, files = job.settings, job.files
    if settings.simulation is None or files.tracers is None:
        raise InputError(
            "simulate needs the truth: the tracers' places in `inputs: tracers`, "
            "and `simulation: {mover_error: 5 um, mover_scale: -25 um/m, tracer_error: 5 mm}`"
        )
    measurement = PlannedPoints(files.points, files.tracers, files.lengths or None)
    return simulated(settings, settings.simulation, measurement, job.effects, np.random.default_rng(options.seed))


TASK = Task(
    Files,
    run,
    check,
    plan,
    simulate,
    diagnosed,
    EFFECTS,
    PLACES,
    covariates=covariates,
    other_settings=other_weather,
    cleared=cleared,
    result_answers={"distance": lambda result, points: (distance(result, points[0], points[1]),)},
)
