"""What multilaterate does with a job."""

from __future__ import annotations

import numpy as np

from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.errors import InputError, together
from metrocli.plan import Plan
from metrocli.result import Result
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.tasks.kind import Job, Task
from metrocli.tasks.multilaterate.correction import refuse_lost
from metrocli.tasks.multilaterate.diagnosis import adjusted_job
from metrocli.tasks.multilaterate.distance import distance
from metrocli.tasks.multilaterate.effects import EFFECTS
from metrocli.tasks.multilaterate.layout import Layout, Planned
from metrocli.tasks.multilaterate.plan import planned
from metrocli.tasks.multilaterate.problem import Network, build, network_of
from metrocli.tasks.multilaterate.readings import join
from metrocli.tasks.multilaterate.report import report
from metrocli.tasks.multilaterate.settings import Files, Settings
from metrocli.tasks.multilaterate.simulation import simulated
from metrocli.tasks.multilaterate.solve import solve


def run(job: Job[Settings, Files]) -> Result:
    """Find the points; raises InputError, UndeterminedError or NotConvergedError."""
    network, probing, tolerance = _network(job), job.files.probing, job.settings.tolerance
    if probing is not None:
        refuse_lost(network, probing, tolerance)
    return report(solve(network, job.settings.outliers == "remove"), probing, tolerance)


def _network(job: Job[Settings, Files]) -> Network:
    files = job.files
    network = build(job.settings, files.lengths, files.points, files.tracers, files.distances)
    return network.with_effects(job.effects)


def check(job: Job[Settings, Files]) -> None:
    """Raise InputError with what is wrong with the files together and with the effects, without computing."""
    settings, files = job.settings, job.files
    readings = join(files.lengths, files.points, files.tracers, settings.measures == "absolute")
    places = np.column_stack([np.nan_to_num(readings.said), np.zeros(len(readings.said)), np.ones(len(readings.said))])
    bare = network_of(settings, readings, places, files.lengths, None)
    together(
        lambda: network_of(settings, readings, places, files.lengths, files.distances),
        lambda: bare.with_effects(job.effects),
        lambda: None if files.probing is None else refuse_lost(bare, files.probing, settings.tolerance),
    )


def diagnosed(job: Job[Settings, Files]) -> AdjustedJob:
    """Return the job as diagnosis sees it; raises as `run` does."""
    return adjusted_job(solve(_network(job), remove=False))


def plan(job: Job[Settings, Files]) -> Plan:
    """Return what lengths from every listed tracer to every point will determine; UndeterminedError where they do not.

    Where the job's lengths exist, only what they read is planned.
    """
    files = job.files
    if files.tracers is None:
        raise InputError("plan needs to know where the tracers will stand: `inputs: {tracers: tracers.csv}`")
    measurement = Planned(files.points, files.tracers, files.lengths or None)
    return planned(Layout(job.settings, measurement, files.distances, job.effects), files.candidates)


def simulate(job: Job[Settings, Files], options: SimulationOptions) -> Simulation:
    """Return the lengths of a measurement with the mover and tracers of `simulation:`, and with effects in it.

    Where the job's lengths exist, their times and temperatures are those of the simulation.
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
    result_answers={"distance": lambda result, points: (distance(result, points[0], points[1]),)},
)
