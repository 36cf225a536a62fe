"""Settings of a locate-launch-unit job."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.nc_program import CONTROLS
from metrocli.settings import Choice, Flag, ListOf, Number, Section, TableFile, WithUnit, setting
from metrocli.settings.sections import content, inputs_of
from metrocli.table import ABSENT, Table
from metrocli.tasks.locate_launch_unit.readings import PLACES, POSES
from metrocli.tasks.shared.environment import Environment
from metrocli.tasks.shared.figures import adjusted
from metrocli.tasks.shared.noise import DECLARED, model_setting
from metrocli.units import parse_quantity

_RANGE = ListOf(WithUnit("length"), length=2)


@dataclass(frozen=True)
class Axes:
    """Lowest and highest position of each axis."""

    x: tuple[float, ...] = setting(_RANGE, "range of x")
    y: tuple[float, ...] = setting(_RANGE, "range of y")
    z: tuple[float, ...] = setting(_RANGE, "range of z")

    def faults(self) -> Iterable[tuple[str, str]]:
        """Check that each range begins with its lowest position."""
        for axis in "xyz":
            low, high = getattr(self, axis)
            if not low < high:
                yield axis, f"the range of {axis} must begin with its lowest position"

    @property
    def box(self) -> Array:
        """Lowest and highest position of x, y, z [mm], (3, 2)."""
        return np.array([self.x, self.y, self.z])


@dataclass(frozen=True)
class ReceiverRange:
    """Measuring range of the receiver."""

    straightness: float = setting(
        WithUnit("length", positive=True),
        "largest distance of the beam from the centre",
        default=parse_quantity("250 um", "length"),
    )
    angle: float = setting(
        WithUnit("angle", positive=True), "largest pitch and yaw", default=parse_quantity("500 urad", "angle")
    )
    distance: float = setting(
        WithUnit("length", positive=True),
        "largest distance from the launch unit",
        default=parse_quantity("4 m", "length"),
    )


@dataclass(frozen=True)
class PlannedLines:
    """The lines to measure from the located unit, and the motion along them."""

    axes: Axes = setting(Section(Axes), "range of each axis")
    step: float = setting(WithUnit("length", positive=True), "distance between measured points")
    standoff: float = setting(WithUnit("length", positive=True), "least distance of receiver and launch unit")
    diagonals: tuple[str, ...] = setting(
        ListOf(Choice("xy", "yz", "xz"), distinct=True), "face diagonals to measure", default=("xy", "yz", "xz")
    )
    range: ReceiverRange = setting(Section(ReceiverRange), "measuring range of the receiver", default=ReceiverRange())
    spindle: float = setting(WithUnit("angle"), "angle of the locked spindle", default=0.0)
    feed: float = setting(
        WithUnit("speed", positive=True), "feed along the lines", default=parse_quantity("2 m/min", "speed")
    )
    dwell: float = setting(WithUnit("time", positive=True), "standstill at each point", default=3.0)
    control: str = setting(Choice(*CONTROLS), "control for which the NC programs are written", default="linuxcnc")
    confidence: float = setting(Number(above=0.0, maximum=0.999), "probability that counts as safe", default=0.95)

    def faults(self) -> Iterable[tuple[str, str]]:
        """Check that a line has room for two points."""
        if self.standoff + self.step > self.range.distance:
            yield "standoff", "no two points fit between standoff and range.distance"


METHODS = ("adjustment", "lines", "closed-loop")


@dataclass(frozen=True)
class Files:
    """Aligned poses, and positions to measure at."""

    poses: Table = content(TableFile(POSES), default=ABSENT)
    places: Table | None = content(
        TableFile(PLACES), "receiver positions to measure at, for simulate and plan", needed=False
    )


Inputs = inputs_of(Files)


@dataclass(frozen=True)
class LaunchUnitNoise:
    """Standard deviations of the readings."""

    encoder: float = setting(WithUnit("angle", positive=True), "standard deviation of each encoder angle")
    distance: float | None = setting(
        WithUnit("length", positive=True), "standard deviation of a distance", default=None
    )
    model: str = model_setting()

    def with_noise_times(self, factor: float) -> LaunchUnitNoise:
        """Return the noise with both parts times a factor."""
        distance = None if self.distance is None else factor * self.distance
        return replace(self, encoder=factor * self.encoder, distance=distance)


@dataclass(frozen=True)
class TrueLaunchUnit:
    """True place of the unit, for `metrocli simulate`."""

    place: tuple[float, ...] = setting(ListOf(WithUnit("length"), length=3), "x, y, z of the unit")
    gamma: float = setting(WithUnit("angle"), "set-up angle of the unit about z", default=0.0)
    distances: bool = setting(Flag(), "whether distances are read", default=False)


@dataclass(frozen=True)
class Settings:
    """Find the launch unit of an interferometer from aligned poses (Kuprin et al.), and plan its measurements."""

    ELSEWHERE: ClassVar[Mapping[str, str]] = {
        "part": "no points of a part are measured here; the machine's growth is the effect machine-scale"
    }

    inputs: Any = setting(Section(Inputs), "the files of the job")
    noise: LaunchUnitNoise = setting(Section(LaunchUnitNoise), "standard deviations of the readings")
    method: str = setting(Choice(*METHODS), "adjustment, or one of the paper's two", default="adjustment")
    environment: Environment | None = setting(
        Section(Environment), "the air, and the one that the interferometer assumes for distances", default=None
    )
    plan: PlannedLines | None = setting(
        Section(PlannedLines), "the lines to measure from the located unit", default=None
    )
    outliers: str = setting(
        Choice("report", "remove"), "report outliers only, or also leave them out", default="report"
    )
    simulation: TrueLaunchUnit | None = setting(
        Section(TrueLaunchUnit), "the truth for `metrocli simulate`", default=None
    )

    def faults(self) -> Iterable[tuple[str, str]]:
        """Check that distances have a standard deviation, and that the method can estimate the noise."""
        distances = self.simulation is not None and self.simulation.distances
        if self.noise.distance is None and (distances or self.method == "closed-loop"):
            yield "noise", "distances need their standard deviation: add `distance: 1 um`"
        if self.noise.model != DECLARED and self.method != "adjustment":
            yield (
                "noise.model",
                "only `method: adjustment` has the residuals from which noise is estimated",
            )


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures; a method as printed has no sigma0."""
    unit = {"x": "mm", "y": "mm", "z": "mm", "gamma": "rad", "air.scale": "1"}
    return adjusted(unit, ("poses", "critical_w", "rejected", "noise_factor"), ["mm", "rad"])
