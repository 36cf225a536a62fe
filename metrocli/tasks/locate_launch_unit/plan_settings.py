"""The section `plan:` of a locate-launch-unit job."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.frozen import dataclass
from metrocli.nc_program import CONTROLS
from metrocli.settings import Choice, ListOf, Number, Quantity, Section, setting
from metrocli.units import parse_quantity

_RANGE = ListOf(Quantity("length"), length=2)


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
class Range:
    """Measuring range of the receiver."""

    straightness: float = setting(
        Quantity("length", positive=True),
        "largest distance of the beam from the centre",
        default=parse_quantity("250 um", "length"),
    )
    angle: float = setting(
        Quantity("angle", positive=True), "largest pitch and yaw", default=parse_quantity("500 urad", "angle")
    )
    distance: float = setting(
        Quantity("length", positive=True),
        "largest distance from the launch unit",
        default=parse_quantity("4 m", "length"),
    )


@dataclass(frozen=True)
class Planned:
    """The lines to measure from the located unit, and the motion along them."""

    axes: Axes = setting(Section(Axes), "range of each axis")
    step: float = setting(Quantity("length", positive=True), "distance between measured points")
    standoff: float = setting(Quantity("length", positive=True), "least distance of receiver and launch unit")
    diagonals: tuple[str, ...] = setting(
        ListOf(Choice("xy", "yz", "xz"), distinct=True), "face diagonals to measure", default=("xy", "yz", "xz")
    )
    range: Range = setting(Section(Range), "measuring range of the receiver", default=Range())
    spindle: float = setting(Quantity("angle"), "angle of the locked spindle", default=0.0)
    feed: float = setting(
        Quantity("speed", positive=True), "feed along the lines", default=parse_quantity("2 m/min", "speed")
    )
    dwell: float = setting(Quantity("time", positive=True), "standstill at each point", default=3.0)
    control: str = setting(Choice(*CONTROLS), "control for which the NC programs are written", default="linuxcnc")
    confidence: float = setting(Number(above=0.0, maximum=0.999), "probability that counts as safe", default=0.95)

    def faults(self) -> Iterable[tuple[str, str]]:
        """Check that a line has room for two points."""
        if self.standoff + self.step > self.range.distance:
            yield "standoff", "no two points fit between standoff and range.distance"
