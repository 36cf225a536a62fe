"""The functions of multilaterate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.errors import InputError, together
from metrocli.plan import Plan
from metrocli.result import Result
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.tasks.job import Job, Task
from metrocli.tasks.multilaterate.correction import astray, probing_of, refuse_lost
from metrocli.tasks.multilaterate.diagnosis import adjusted_job
from metrocli.tasks.multilaterate.distance import distance
from metrocli.tasks.multilaterate.effects import EFFECTS, PLACES
from metrocli.tasks.multilaterate.features.wanted import wanted_features
from metrocli.tasks.multilaterate.layout import Layout, Planned
from metrocli.tasks.multilaterate.plan import planned
from metrocli.tasks.multilaterate.problem import Network, build, network_of
from metrocli.tasks.multilaterate.readings import join
from metrocli.tasks.multilaterate.report import report
from metrocli.tasks.multilaterate.settings import Files, Settings
from metrocli.tasks.multilaterate.simulation import simulated
from metrocli.tasks.multilaterate.solve import Solved, solve
from metrocli.tasks.multilaterate.structure import noise_of
from metrocli.tasks.shared.structured_noise import settled


def run(job: Job[Settings, Files]) -> Result:
    """Return the points; raises InputError, UndeterminedError or NotConvergedError."""
    settings = job.settings
    probing, features = together(
        lambda: probing_of(settings, job.files), lambda: wanted_features(settings.features, job.files.probing)
    )

    def solved(factor: float) -> Solved:
        network = _network(job, factor)
        if probing is not None:
            refuse_lost(network, probing)
        return solve(network, settings.outliers == "remove")

    found, factor = settled(settings.noise, solved, lambda one: [one.residuals])
    noise = noise_of(found, settings.noise.model, factor)
    return report(found, noise, probing, features, settings.part)


def _network(job: Job[Settings, Files], factor: float = 1.0) -> Network:
    files, settings = job.files, replace(job.settings, noise=job.settings.noise.times(factor))
    network = build(settings, files.lengths, files.points, files.tracers, files.distances)
    return network.with_effects(job.effects)


def check(job: Job[Settings, Files]) -> None:
    """Raise InputError that lists the faults in the combination of files and in the effects, without computing."""
    settings, files = job.settings, job.files
    readings = join(files.lengths, files.points, files.tracers, settings.measures == "absolute")
    places = np.column_stack([np.nan_to_num(readings.said), np.zeros(len(readings.said)), np.ones(len(readings.said))])
    bare = network_of(settings, readings, places, files.lengths, None)
    together(
        lambda: network_of(settings, readings, places, files.lengths, files.distances),
        lambda: bare.with_effects(job.effects),
        lambda: _check_probing(bare, job),
        lambda: wanted_features(settings.features, files.probing),
    )


def _check_probing(network: Network, job: Job[Settings, Files]) -> None:
    probing = probing_of(job.settings, job.files)
    if probing is not None:
        refuse_lost(network, probing)


def diagnosed(job: Job[Settings, Files]) -> AdjustedJob:
    """Return the adjusted job in the form that diagnosis needs, with all lengths; raises as `run` does."""
    noise = job.settings.noise
    found, _ = settled(noise, lambda factor: solve(_network(job, factor), remove=False), lambda one: [one.residuals])
    adjusted = adjusted_job(found)
    return replace(adjusted, astray=max(adjusted.astray, astray(found.network, probing_of(job.settings, job.files))))


def plan(job: Job[Settings, Files]) -> Plan:
    """Return what lengths from every listed tracer to every point will determine.

    If the job's lengths exist, only the pairs of point and tracer in them are planned. Raises InputError without a list
    of tracers, UndeterminedError if the layout does not determine the points.
    """
    files = job.files
    if files.tracers is None:
        raise InputError("plan needs the places where the tracers will stand: `inputs: {tracers: tracers.csv}`")
    measurement = Planned(files.points, files.tracers, files.lengths or None)
    return planned(Layout(job.settings, measurement, files.distances, job.effects), files.candidates)


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
    measurement = Planned(files.points, files.tracers, files.lengths or None)
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
    result_answers={"distance": lambda result, points: (distance(result, points[0], points[1]),)},
)
