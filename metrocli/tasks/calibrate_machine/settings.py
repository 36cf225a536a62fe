"""Settings of a calibrate-machine job file, and the columns of its tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

from metrocli.frozen import dataclass
from metrocli.instruments.machine import ALL_NAMES, SQUARENESS_NAMES, axis_order, canonical
from metrocli.settings import (
    Choice,
    Either,
    Flag,
    ListOf,
    MapOf,
    Quantity,
    Section,
    Text,
    Whole,
    setting,
)
from metrocli.tasks.calibrate_machine.files import Inputs
from metrocli.tasks.calibrate_machine.plans.wanted import PathPlan
from metrocli.tasks.shared.environment import Environment
from metrocli.tasks.shared.figures import adjusted
from metrocli.tasks.shared.lengths import REPEATABILITY, REPEATABILITY_WORDS, LengthNoise, Scale
from metrocli.tasks.shared.noise import model_setting
from metrocli.tasks.shared.part import Warm

ON_THE_FLY, STANDSTILL, SIX_DOF, LENGTHS = "on-the-fly", "standstill", "six-dof", "lengths"
_INPUTS = {STANDSTILL: ("points",), ON_THE_FLY: ("path", "track"), SIX_DOF: ("lines",), LENGTHS: ("lengths",)}
"""Inputs that each method needs"""
_NOISE = {
    STANDSTILL: ("beam",),
    ON_THE_FLY: ("beam",),
    SIX_DOF: ("displacement",),
    LENGTHS: ("constant",),
}
"""Standard deviations that each method needs"""
_VECTOR = ListOf(Quantity("length"), 3)
_AXES = 3


@dataclass(frozen=True)
class AxisSettings:
    """The range of an axis and its knots, equally spaced, ends included."""

    range: tuple[float, float] = setting(ListOf(Quantity("length"), 2), "lowest and highest position")
    knots: int = setting(Whole(2, 2000), "knots of each error table, ends included")
    scale: Warm | None = setting(
        Section(Warm), "temperature and expansion of its scale; its positioning is given at 20 degC", default=None
    )

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a fault if the range does not ascend."""
        if self.range[0] >= self.range[1]:
            yield "range", "the range does not ascend: write the lowest position first"


@dataclass(frozen=True)
class AxesSettings:
    """The linear axes; method six-dof with displacement only needs those that have lines."""

    x: AxisSettings | None = setting(Section(AxisSettings), "the X axis", default=None)
    y: AxisSettings | None = setting(Section(AxisSettings), "the Y axis", default=None)
    z: AxisSettings | None = setting(Section(AxisSettings), "the Z axis", default=None)

    @property
    def given(self) -> dict[str, AxisSettings]:
        """The axes by letter, X to Z."""
        named = {"X": self.x, "Y": self.y, "Z": self.z}
        return {letter: axis for letter, axis in named.items() if axis is not None}


@dataclass(frozen=True)
class MachineSettings:
    """The kinematic chain, the axes and the tool vectors."""

    chain: str = setting(Text(), "axes from workpiece to tool with the bed marked, such as wXbYZt", default="wXYZt")
    axes: AxesSettings = setting(Section(AxesSettings), "range and knots of each axis", AxesSettings())
    tool: tuple[float, ...] | None = setting(
        _VECTOR, "vector from the spindle's reference point to the reflector (default: 0)", default=None
    )
    tools: dict[str, tuple[float, ...]] | None = setting(
        MapOf(_VECTOR), "several tool vectors, by the names in the column tool", default=None
    )
    tool_uncertainty: float = setting(
        Quantity("length", minimum=0.0), "standard uncertainty of tool vectors; 0: exact", default=0.0
    )

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a fault for an invalid chain, and for tool vectors given twice or not at all."""
        try:
            axis_order(self.chain)
        except ValueError as error:
            yield "chain", str(error)
        if self.tool is not None and self.tools is not None:
            yield "tools", "both tool and tools are given: keep one of them"
        if self.tools is not None and not self.tools:
            yield "tools", "the list of tools is empty"


@dataclass(frozen=True)
class LateralNoise:
    """Standard deviation perpendicular to the beam, `sqrt(c^2 + (p r)^2)` at distance r."""

    constant: float = setting(Quantity("length", minimum=0.0), "c: the part that does not depend on the distance")
    proportional: float = setting(Quantity("ratio", minimum=0.0), "p: the part proportional to it", default=0.0)


_LATERAL = Either(Quantity("length", positive=True), Section(LateralNoise))


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the tracker (beam, lateral), the laser (displacement ...) or lengths (constant ...)."""

    beam: float | None = setting(Quantity("length", positive=True), "tracker: along the beam", default=None)
    lateral: float | LateralNoise | None = setting(_LATERAL, "tracker: perpendicular to the beam", default=None)
    radial: float | LateralNoise | None = setting(_LATERAL, "another name of lateral", default=None)
    displacement: float | None = setting(Quantity("length", positive=True), "six-dof: along the beam", default=None)
    straightness: float | None = setting(
        Quantity("length", positive=True), "six-dof: perpendicular to the beam", default=None
    )
    angle: float | None = setting(Quantity("angle", positive=True), "six-dof: angles", default=None)
    constant: float | None = setting(
        Quantity("length", positive=True), "lengths: the part that does not depend on the length", default=None
    )
    proportional: float = setting(
        Quantity("ratio", minimum=0.0), "lengths: the part proportional to the path", default=0.0
    )
    repeatability: float | str | None = setting(REPEATABILITY, f"lengths: {REPEATABILITY_WORDS}", default=None)

    model: str = model_setting()

    @property
    def of_lengths(self) -> LengthNoise:
        """The noise of lengths."""
        return LengthNoise(self.constant or 0.0, self.proportional, self.repeatability)

    @property
    def square(self) -> LateralNoise:
        """The noise perpendicular to the beam, from `lateral` or its other name `radial`; zero if neither is given."""
        given = self.lateral if self.lateral is not None else self.radial
        return given if isinstance(given, LateralNoise) else LateralNoise(given or 0.0)

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a fault if both lateral and radial are given, or if the lateral noise is zero."""
        if self.lateral is not None and self.radial is not None:
            yield "radial", "lateral and radial are two names of one setting: keep one of them"
        given = self.lateral if self.lateral is not None else self.radial
        if isinstance(given, LateralNoise) and given.constant == given.proportional == 0.0:
            yield "lateral", "the noise is zero, so readings would have infinite weight: give constant or proportional"


@dataclass(frozen=True)
class Volume:
    """The grid on which the error of the tool is predicted over the volume."""

    grid: tuple[int, ...] = setting(ListOf(Whole(2, 50), 3), "points along x, y and z", default=(7, 6, 6))
    circle: float | None = setting(
        Quantity("length", positive=True), "radius of the circular tests (default: 0.4 of the travel)", default=None
    )


@dataclass(frozen=True)
class Positioning:
    """What the figures of ISO 230-2 are uncertain by, besides the noise of the displacement."""

    scale: float = setting(
        Quantity("ratio", minimum=0.0), "standard uncertainty of all distances in common", default=0.0
    )
    environment: float = setting(
        Quantity("length", minimum=0.0), "range of the readings at rest over the time of a test (E_VE)", default=0.0
    )


@dataclass(frozen=True)
class MachineSimulation:
    """The machine and the instrument that `metrocli simulate` simulates."""

    error: float = setting(Quantity("length", minimum=0.0), "mean length of the error in the volume", default=0.1)
    smooth: bool = setting(Flag(), "smooth error curves instead of straight lines between knots", default=False)
    tracker: tuple[float, ...] = setting(_VECTOR, "place of the tracker in the machine", (-1000.0, -800.0, 300.0))
    points: int = setting(Whole(1, 1_000_000), "standstill, lengths: number of points", default=226)
    interval: float = setting(Quantity("time", positive=True), "all but on-the-fly: time between readings", default=4.0)
    sampling: float = setting(Quantity("time", positive=True), "on-the-fly: time between points", default=0.002)
    feed: float = setting(
        Quantity("speed", positive=True), "on-the-fly: feed for a path without a column feed", default=40.0
    )
    warming: float = setting(Quantity("temperature difference"), "all but on-the-fly: from first to last reading", 0.0)
    step: float = setting(Quantity("length", positive=True), "six-dof: distance between readings", default=25.0)


@dataclass(frozen=True)
class Settings:
    """Estimate the 21 geometric errors of a machine with three linear axes, and report which the data determine."""

    ELSEWHERE: ClassVar[Mapping[str, str]] = {
        "part": "no part is measured here; the scale of an axis has `scale: {temperature: .., expansion: ..}` in `axes`"
    }

    method: str = setting(Choice(ON_THE_FLY, STANDSTILL, SIX_DOF, LENGTHS), "how the machine was measured")
    machine: MachineSettings = setting(Section(MachineSettings), "axes and tools")
    inputs: Any = setting(Section(Inputs), "the files of the job")
    noise: Noise = setting(Section(Noise), "standard deviations of the readings")
    estimate: str | tuple[str, ...] = setting(
        Either(Choice("all"), ListOf(Choice(*ALL_NAMES, "COY", "BOZ", "AOZ"), distinct=True)),
        "errors to estimate; the others are taken as zero",
        default="all",
    )
    scale: Scale | None = setting(
        Section(Scale), "lengths: estimate the scales of the stations; fixed at 1 without it", default=None
    )
    environment: Environment | None = setting(
        Section(Environment), "lengths: the air, and the one that the interferometers assume", default=None
    )
    outliers: str = setting(
        Choice("report", "remove"), "all but on-the-fly: report outliers, or leave them out", default="report"
    )
    corner: float = setting(
        Quantity("length", minimum=0.0), "on-the-fly: length cut off at both ends of each leg", default=10.0
    )
    volume: Volume = setting(Section(Volume), "where the volume is predicted", default=Volume())
    positioning: Positioning = setting(
        Section(Positioning), "six-dof: uncertainty of the figures of ISO 230-2", default=Positioning()
    )
    simulation: MachineSimulation | None = setting(
        Section(MachineSimulation), "the true machine and instrument for `metrocli simulate`", default=None
    )
    plan: PathPlan | None = setting(Section(PathPlan), "requirements for `metrocli plan`", default=None)

    @property
    def estimated(self) -> tuple[str, ...]:
        """Names of the errors to estimate, in the spelling of this program."""
        axes = self.machine.axes.given
        if isinstance(self.estimate, str):
            return ALL_NAMES if len(axes) == _AXES else tuple(f"E{axis}{axis}" for axis in axes)
        return tuple(canonical(name) for name in self.estimate)

    @property
    def scales(self) -> dict[str, Warm]:
        """The scales whose temperature is given, by the letter of their axis."""
        return {letter: axis.scale for letter, axis in self.machine.axes.given.items() if axis.scale is not None}

    @property
    def tools(self) -> dict[str, tuple[float, ...]]:
        """Tool vectors by name; a single vector given by `tool` has the empty name."""
        return self.machine.tools or {"": self.machine.tool or (0.0, 0.0, 0.0)}

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield faults for inputs and noise that the method needs and lacks, and for settings it does not use."""
        needed = _INPUTS[self.method]
        for key in ("points", "path", "track", "lines", "lengths", "stations"):
            given = getattr(self.inputs, key) is not None
            if given != (key in needed) and not (key == "stations" and self.method == LENGTHS):
                verb = "needs" if key in needed else "does not use"
                yield "inputs" + (f".{key}" if given else ""), f"method {self.method} {verb} the input '{key}'"
        if not self.estimated:
            yield "estimate", "the list is empty: leave the key out to estimate all errors, or name some, such as EXX"
        for letter in self.scales:
            if f"E{letter}{letter}" not in self.estimated:
                yield (
                    f"machine.axes.{letter.lower()}.scale",
                    f"the scale changes E{letter}{letter}, which is not estimated: add it, or leave this key out",
                )
        if self.method == ON_THE_FLY and self.outliers == "remove":
            yield "outliers", "method on-the-fly always removes wild points of the track: leave this key out"
        missing = [axis for axis in "XYZ" if axis not in self.machine.axes.given]
        if missing == ["X", "Y", "Z"]:
            yield "machine.axes", "no axis is given: write e.g. `x: {range: [0 mm, 600 mm], knots: 13}`"
        elif missing and self.method != SIX_DOF:
            yield "machine.axes", f"method {self.method} needs all three axes; {' and '.join(missing)} are missing"
        for key in _NOISE[self.method]:
            if getattr(self.noise, key) is None:
                yield "noise", f"method {self.method} needs the noise '{key}'"
        if self.method in (STANDSTILL, ON_THE_FLY) and self.noise.lateral is None and self.noise.radial is None:
            yield "noise", f"method {self.method} needs the noise 'lateral'"
        if self.positioning != Positioning() and self.method != SIX_DOF:
            yield "positioning", f"method {self.method} has no figures of ISO 230-2: leave this key out"
        for key, what in (("scale", "scales of tracking interferometers"), ("environment", "lengths to correct")):
            if getattr(self, key) is not None and self.method != LENGTHS:
                yield key, f"method {self.method} has no {what}: leave this key out"


_STATISTICS = (
    "rank", "possible_rank", "ratio", "readings", "rejected", "critical_w", "noise_factor",
    "repeatability", "repeatability_std", "lines",
)  # fmt: skip
_TRACK = (
    "track_points", "points_used", "cut_at_corners", "cut_standing", "cut_wild", "cut_off_path", "beam_breaks",
    "path_length", "condensed_points", "noise_in_cells",
)  # fmt: skip
"""Of a measurement on the fly"""


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures: squareness errors, tool vectors and statistics."""
    square, tool = dict.fromkeys(SQUARENESS_NAMES, "rad"), {f"{{tool}}.{axis}": "mm" for axis in "xyz"}
    return adjusted(square | tool, (*_STATISTICS, *_TRACK), ["mm", "rad"])
