"""locate-launch-unit: where the launch unit of an interferometer stands in the machine, and what to measure with it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from metrocli.diagnosis.adjusted_job import Subject
from metrocli.effects.wanted import Wanted
from metrocli.errors import InputError, MetrocliError
from metrocli.plan import Plan
from metrocli.result import Result
from metrocli.settings import Choice, Flag, ListOf, Quantity, Section, TableFile, setting
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.table import Table
from metrocli.tasks.locate_launch_unit.diagnosis import subject
from metrocli.tasks.locate_launch_unit.plan import figures, planned_measurement
from metrocli.tasks.locate_launch_unit.plan_settings import Planned
from metrocli.tasks.locate_launch_unit.readings import PLACES, POSES, read
from metrocli.tasks.locate_launch_unit.report import KIND, report
from metrocli.tasks.locate_launch_unit.simulation import simulated
from metrocli.tasks.locate_launch_unit.solve import How, locate

SIMULATED = ("poses",)
SUMMARY = "interferometer launch unit in the machine; measuring trajectories"
METHODS = ("adjustment", "lines", "closed-loop")


@dataclass(frozen=True)
class Inputs:
    """Aligned poses."""

    poses: Path = setting(TableFile(POSES), "receiver positions and encoder angles of aligned poses")
    places: Path | None = setting(
        TableFile(PLACES), "receiver positions to measure at, for simulate and plan", default=None
    )


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the readings."""

    encoder: float = setting(Quantity("angle", positive=True), "of each encoder angle")
    distance: float | None = setting(Quantity("length", positive=True), "of a distance", default=None)


@dataclass(frozen=True)
class Truth:
    """Where the unit truly is, for `metrocli simulate`."""

    place: tuple[float, ...] = setting(ListOf(Quantity("length"), length=3), "x, y, z of the unit")
    gamma: float = setting(Quantity("angle"), "set-up angle of the unit about z", default=0.0)
    distances: bool = setting(Flag(), "whether distances are read", default=False)


@dataclass(frozen=True)
class Settings:
    """Find the launch unit of an interferometer from aligned poses (Kuprin et al.), and plan its measurements."""

    inputs: Inputs = setting(Section(Inputs), "the files of the job")
    noise: Noise = setting(Section(Noise), "standard deviations of the readings")
    method: str = setting(Choice(*METHODS), "adjustment, or one of the paper's two", default="adjustment")
    plan: Planned | None = setting(Section(Planned), "the lines to measure from there", default=None)
    outliers: str = setting(Choice("report", "remove"), "name outliers, or leave them out", default="report")
    simulation: Truth | None = setting(Section(Truth), "the truth for `metrocli simulate`", default=None)

    def faults(self) -> Iterable[tuple[str, str]]:
        """Distances need their standard deviation."""
        distances = self.simulation is not None and self.simulation.distances
        if self.noise.distance is None and (distances or self.method == "closed-loop"):
            yield "noise", "distances need their standard deviation: add `distance: 1 um`"


def run(settings: Settings, poses: Table, effects: Sequence[Wanted] = (), **_: object) -> Result:
    """Locate the unit; raises InputError, UndeterminedError or NotConvergedError."""
    return report(locate(read(poses), settings.noise, _how(settings, effects)), settings.method)


def diagnosed(settings: Settings, poses: Table, effects: Sequence[Wanted] = (), **_: object) -> Subject:
    """Return the job as diagnosis sees it; raises as `run` does."""
    return subject(locate(read(poses), settings.noise, How(settings.method, effects=effects)))


def _how(settings: Settings, effects: Sequence[Wanted]) -> How:
    return How(settings.method, settings.outliers == "remove", effects)


def compare(settings: Settings, poses: Table, **_: object) -> Table:
    """Return what each method makes of the poses."""
    readings = read(poses)
    rows: list[list[float]] = []
    outcome = []
    for method in METHODS:
        try:
            located = locate(readings, settings.noise, How(method))
        except MetrocliError as error:
            rows.append([float("nan")] * 8)
            outcome.append(str(error).splitlines()[0].removeprefix("error: "))
        else:
            rows.append([*located.values, *np.sqrt(np.diag(located.covariance))])
            outcome.append("")
    names = ("x", "y", "z", "gamma", "sx", "sy", "sz", "sgamma")
    units = {name: "rad" if name.endswith("gamma") else "mm" for name in names}
    columns = dict(zip(names, np.array(rows).T, strict=True))
    return Table({"method": np.array(METHODS), **columns, "refused": np.array(outcome)}, units)


def simulate(
    settings: Settings,
    options: SimulationOptions,
    poses: Table | None = None,
    places: Table | None = None,
    effects: Sequence[Wanted] = (),
) -> Simulation:
    """Return the alignments of a unit at the place of `simulation:`, with effects in them.

    They are made at the listed places, or at those of the poses.
    """
    where = places if places is not None else poses
    if settings.simulation is None or where is None:
        raise InputError(
            "simulate needs the truth, `simulation: {place: [0 mm, 1 m, 1.5 m], gamma: 20 deg}`, and the receiver's "
            "positions, `inputs: {places: places.csv}` or those of the poses"
        )
    return simulated(settings.simulation, settings.noise, where, np.random.default_rng(options.seed), effects)


def plan(
    settings: Settings, poses: Table | None = None, places: Table | None = None, effects: Sequence[Wanted] = ()
) -> Plan:
    """Return the lines to measure from the located unit, with their margins and NC programs.

    Before the poses are measured: what the listed places will determine of a unit at the place of `simulation:`.
    """
    if poses is not None:
        located = locate(read(poses), settings.noise, _how(settings, effects))
        first = f"located from {len(poses)} measured poses"
    elif places is not None and settings.simulation is not None:
        exact = replace(settings.noise, encoder=0.0, distance=0.0)
        expected = simulated(settings.simulation, exact, places, np.random.default_rng(0)).files["poses.csv"]
        located = locate(read(expected), settings.noise, _how(settings, effects))
        first = f"expected of {len(places)} poses that are still to be measured"
    else:
        raise InputError(
            "plan needs measured poses, or before they are measured `inputs: {places: places.csv}` and "
            "`simulation: {place: [0 mm, 1 m, 1.5 m]}`, about where the unit stands"
        )
    if settings.plan is None:
        return Plan(KIND, (first,), figures(located))
    made = planned_measurement(located, settings.plan, settings.noise)
    return replace(made, notes=(first, *made.notes))


__all__ = ["KIND", "SIMULATED", "SUMMARY", "Inputs", "Settings", "compare", "plan", "run", "simulate"]
