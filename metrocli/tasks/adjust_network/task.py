"""The functions of adjust-network."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.errors import InputError, all_faults
from metrocli.plan import Plan
from metrocli.result import Result
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.tasks.adjust_network.diagnosis import adjusted_job, covariates, noise_of
from metrocli.tasks.adjust_network.effects import EFFECTS, PLACES
from metrocli.tasks.adjust_network.other_settings import other_settings
from metrocli.tasks.adjust_network.plan import planned
from metrocli.tasks.adjust_network.problem import Network, build
from metrocli.tasks.adjust_network.readings import read
from metrocli.tasks.adjust_network.report import report
from metrocli.tasks.adjust_network.settings import Files, NetworkSimulation, Settings
from metrocli.tasks.adjust_network.simulation import simulated
from metrocli.tasks.adjust_network.solve import AdjustedNetwork, solve
from metrocli.tasks.adjust_network.starts.agreement import NetworkStart
from metrocli.tasks.adjust_network.starts.search import start
from metrocli.tasks.adjust_network.unknowns import seen_points
from metrocli.tasks.job import Job, Task
from metrocli.tasks.shared.noise import weighed

if TYPE_CHECKING:
    from metrocli.tasks.job import Adjustment


def _network(job: Job[Settings, Files]) -> Network:
    readings = read(job.settings, job.files)
    if not seen_points(readings).any():
        raise InputError("no input has a reading: give `readings`, `lengths`, `bars` or `heights`")
    return build(job.settings, readings, start(readings), job.effects)


def _solved(job: Job[Settings, Files], remove: bool) -> tuple[AdjustedNetwork, float]:
    """Return the solved network, without outliers or with all readings, in the noise of those that the job keeps."""
    settings, removes = job.settings, job.settings.outliers == "remove"
    kept = None if remove == removes else partial(solve, settings, remove=removes)
    return weighed(settings.noise, _network(job), partial(solve, settings, remove=remove), kept)


def run(job: Job[Settings, Files]) -> Result:
    """Return points and stations; raises InputError, UndeterminedError or NotConvergedError."""
    return with_adjustment(job)[0]


def with_adjustment(job: Job[Settings, Files]) -> tuple[Result, Adjustment | None]:
    """Return the result of `run`, and what gives its adjustment for a comparison where no reading was removed."""
    removes = job.settings.outliers == "remove"
    solved, factor = _solved(job, removes)
    # what was removed no longer contradicts the files
    adjustment = None if removes else partial(adjusted_job, solved)
    return report(solved, noise_of(solved, job.settings.noise, factor)), adjustment


def check(job: Job[Settings, Files]) -> None:
    """Raise InputError that lists the faults in the combination of files and in the effects, without computing."""
    readings = read(job.settings, job.files)
    # any place will do: no fault of the files depends on it
    points = np.where(np.isfinite(readings.points.listed), readings.points.listed, 1.0)
    rough = NetworkStart(points, np.zeros((len(readings.stations.names), 6)), np.zeros(len(readings.sightings.rounds)))
    with all_faults() as each, each():
        build(job.settings, readings, rough, job.effects)


def diagnosed(job: Job[Settings, Files], remove: bool = False) -> AdjustedJob:
    """Return the adjusted job in the form that diagnosis needs, by default with all readings; raises as `run` does."""
    return adjusted_job(_solved(job, remove)[0])


def plan(job: Job[Settings, Files]) -> Plan:
    """Return what the network of the listed stations and points will determine; raises as `planned` does."""
    return planned(job.settings, job.files, tuple(job.effects))


def simulate(job: Job[Settings, Files], options: SimulationOptions) -> Simulation:
    """Return simulated readings for the points and stations of the files, which are then the truth."""
    truth = job.settings.simulation or NetworkSimulation()
    return simulated(job.settings, job.files, truth, job.effects, np.random.default_rng(options.seed))


TASK = Task(
    Files,
    run,
    check,
    plan,
    simulate,
    diagnosed,
    EFFECTS,
    PLACES,
    covariates,
    with_adjustment=with_adjustment,
    other_settings=other_settings,
    cleared=partial(diagnosed, remove=True),
)
