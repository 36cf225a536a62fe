"""multilaterate: reflector positions from the lengths of four or more tracking interferometers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from metrocli.diagnosis.adjusted_job import Subject
from metrocli.effects.model import extended
from metrocli.effects.wanted import Wanted
from metrocli.errors import InputError, together
from metrocli.plan import Plan
from metrocli.result import Result
from metrocli.settings import Choice, Quantity, Section, TableFile, setting
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.table import TEXT, Column, Columns, Table
from metrocli.tasks.multilaterate.correction import refuse_lost
from metrocli.tasks.multilaterate.design import Planned
from metrocli.tasks.multilaterate.diagnosis import subject
from metrocli.tasks.multilaterate.layout import Layout
from metrocli.tasks.multilaterate.plan import planned
from metrocli.tasks.multilaterate.problem import Network, build, network_of
from metrocli.tasks.multilaterate.readings import join
from metrocli.tasks.multilaterate.report import KIND, report
from metrocli.tasks.multilaterate.simulation import simulated
from metrocli.tasks.multilaterate.solve import solve
from metrocli.tasks.shared.known_places import SIGMAS

SIMULATED, PLANNED = ("lengths",), ("lengths", "probing")
SUMMARY = "reflector positions from length changes of 4+ tracers"
_PLACE = tuple(Column(axis, "length") for axis in "xyz")
LENGTHS = Columns(
    (
        Column("point", TEXT),
        Column("tracer", TEXT),
        Column("length", "length"),
        Column("t", "time", required=False),
        Column("temp", "temperature", required=False),
    ),
    ("point", "tracer"),
    "lengths read by the tracers",
)
POINTS = Columns((Column("point", TEXT), *_PLACE, *SIGMAS), ("point",), "approximate points: the mover's readings")
TRACERS = Columns(
    (Column("tracer", TEXT), *_PLACE, Column("dead_path", "length", required=False, may_be_empty=True), *SIGMAS),
    ("tracer",),
    "approximate places of the tracers",
)
CANDIDATES = Columns(
    (Column("candidate", TEXT), *_PLACE), ("candidate",), "places where one more tracer could stand, for `plan`"
)
PROBING = Columns(
    (Column("feature", TEXT), Column("point", TEXT, may_be_empty=True), *_PLACE),
    (),
    "the mover's readings on the workpiece",
)
DISTANCES = Columns(
    (Column("from", TEXT), Column("to", TEXT), Column("length", "length"), Column("sigma", "length")),
    ("from", "to"),
    "calibrated distances between points",
)


@dataclass(frozen=True)
class Inputs:
    """What the tracers read, and where the mover says the points are."""

    lengths: Path = setting(TableFile(LENGTHS), "lengths read by the tracers")
    points: Path = setting(TableFile(POINTS), "approximate points: the mover's readings")
    tracers: Path | None = setting(TableFile(TRACERS), "approximate places of the tracers", default=None)
    probing: Path | None = setting(TableFile(PROBING), "the mover's readings on the workpiece", default=None)
    distances: Path | None = setting(TableFile(DISTANCES), "calibrated distances between points", default=None)
    candidates: Path | None = setting(
        TableFile(CANDIDATES), "places where one more tracer could stand, for `plan`", default=None
    )


@dataclass(frozen=True)
class LengthNoise:
    """Standard deviation of a length, `sqrt(a^2 + b^2 (l + l0)^2)` (Härtig et al., weights of eq. 2)."""

    constant: float = setting(Quantity("length", positive=True), "a: the part that does not depend on the length")
    proportional: float = setting(Quantity("ratio", minimum=0.0), "b: the part proportional to the path", default=0.0)


@dataclass(frozen=True)
class Scale:
    """What is known of the tracers' scales."""

    uncertainty: float = setting(
        Quantity("ratio", positive=True), "standard uncertainty of each tracer's scale about 1 (eq. 4)"
    )


@dataclass(frozen=True)
class LengthSimulation:
    """The truth that `metrocli simulate` starts from, with the tracers where their list says."""

    mover_error: float = setting(
        Quantity("length", minimum=0.0), "standard deviation of the mover's readings", default=0.0
    )
    mover_scale: float = setting(Quantity("ratio"), "how much too long the mover reads distances", default=0.0)
    tracer_error: float = setting(
        Quantity("length", minimum=0.0), "standard deviation of the places that are written", default=0.0
    )
    interval: float | None = setting(
        Quantity("time", positive=True), "time from point to point; without it no times are written", default=None
    )
    warming: float = setting(
        Quantity("temperature difference"), "how much the air warms up from the first point to the last", default=0.0
    )


@dataclass(frozen=True)
class Settings:
    """Find reflector positions from lengths, with the tracers' places, dead paths and scales (multilateration)."""

    inputs: Inputs = setting(Section(Inputs), "the files of the job")
    noise: LengthNoise = setting(Section(LengthNoise), "standard deviation of a length")
    measures: str = setting(
        Choice("changes", "absolute"), "interferometer (dead paths unknown) or absolute distance", default="changes"
    )
    scale: Scale | None = setting(Section(Scale), "estimate the tracers' scales; fixed at 1 without it", default=None)
    datum: str | None = setting(
        Choice("inner-constraints", "points"), "what fixes the frame; by the points' sigma unless given", default=None
    )
    outliers: str = setting(Choice("report", "remove"), "name outliers, or leave them out", default="report")
    tolerance: float = setting(
        Quantity("length", positive=True), "how near a probing point must be to its replayed point", default=1.0
    )
    simulation: LengthSimulation | None = setting(
        Section(LengthSimulation), "the truth for `metrocli simulate`", default=None
    )


def run(
    settings: Settings,
    lengths: Table,
    points: Table,
    tracers: Table | None = None,
    probing: Table | None = None,
    distances: Table | None = None,
    effects: Sequence[Wanted] = (),
    **_: object,
) -> Result:
    """Find the points; raises InputError, UndeterminedError or NotConvergedError."""
    network = _with(build(settings, lengths, points, tracers, distances), effects)
    if probing is not None:
        refuse_lost(network, probing, settings.tolerance)
    return report(solve(network, settings.outliers == "remove"), probing, settings.tolerance)


def check(
    settings: Settings,
    lengths: Table,
    points: Table,
    tracers: Table | None = None,
    probing: Table | None = None,
    distances: Table | None = None,
    effects: Sequence[Wanted] = (),
    **_: object,
) -> None:
    """Raise InputError with what is wrong with the files together and with the effects, without computing."""
    readings = join(lengths, points, tracers, settings.measures == "absolute")
    places = np.column_stack([np.nan_to_num(readings.said), np.zeros(len(readings.said)), np.ones(len(readings.said))])
    bare = network_of(settings, readings, places, lengths, None)
    together(
        lambda: network_of(settings, readings, places, lengths, distances),
        lambda: _with(bare, effects),
        lambda: None if probing is None else refuse_lost(bare, probing, settings.tolerance),
    )


def diagnosed(
    settings: Settings,
    lengths: Table,
    points: Table,
    tracers: Table | None = None,
    distances: Table | None = None,
    effects: Sequence[Wanted] = (),
    **_: object,
) -> Subject:
    """Return the job as diagnosis sees it; raises as `run` does."""
    network = _with(build(settings, lengths, points, tracers, distances), effects)
    return subject(solve(network, remove=False))


def _with(network: Network, effects: Sequence[Wanted]) -> Network:
    return network.with_model(extended(network.model(), effects)) if effects else network


def plan(
    settings: Settings,
    points: Table,
    tracers: Table | None = None,
    lengths: Table | None = None,
    distances: Table | None = None,
    candidates: Table | None = None,
    effects: Sequence[Wanted] = (),
    **_: object,
) -> Plan:
    """Tell what lengths from every listed tracer to every point will determine; UndeterminedError where they do not.

    Where the job's lengths exist, only what they read is planned.
    """
    if tracers is None:
        raise InputError("plan needs to know where the tracers will stand: `inputs: {tracers: tracers.csv}`")
    return planned(Layout(settings, Planned(points, tracers, lengths), distances, effects), candidates)


def simulate(
    settings: Settings,
    options: SimulationOptions,
    points: Table,
    tracers: Table | None = None,
    lengths: Table | None = None,
    effects: Sequence[Wanted] = (),
    **_: object,
) -> Simulation:
    """Return the lengths of a measurement with the mover and tracers of `simulation:`, and with effects in it.

    Where the job's lengths exist, their times and temperatures are those of the simulation.
    """
    if settings.simulation is None or tracers is None:
        raise InputError(
            "simulate needs the truth: the tracers' places in `inputs: tracers`, "
            "and `simulation: {mover_error: 5 um, mover_scale: -25 um/m, tracer_error: 5 mm}`"
        )
    planned = Planned(points, tracers, lengths)
    return simulated(settings, settings.simulation, planned, effects, np.random.default_rng(options.seed))


__all__ = ["KIND", "PLANNED", "SIMULATED", "SUMMARY", "Inputs", "Settings", "check", "plan", "run", "simulate"]
