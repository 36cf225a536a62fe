"""Settings of a machine: its chain, axes and tools, the noise of its readings, and where its volume is predicted."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli.frozen import dataclass
from metrocli.instruments.axes.chain import chain_of
from metrocli.instruments.machine import ANGLES, AXES
from metrocli.instruments.six_dof import LineNoise
from metrocli.instruments.tracker import TrackerNoise
from metrocli.settings import Choice, Either, Flag, ListOf, MapOf, Section, Text, Whole, WithUnit, setting
from metrocli.tasks.shared.lengths import REPEATABILITY, REPEATABILITY_WORDS, LengthNoise
from metrocli.tasks.shared.noise import model_setting
from metrocli.tasks.shared.part import Warm

VECTOR = ListOf(WithUnit("length"), 3)
_TURN = 2 * np.pi
UNKNOWN = "unknown"
GIVEN, ESTIMATED = "given", "estimated"
_ROUNDING = 1e-9
_EXAMPLE = "{range: [0 deg, 360 deg], knots: 13, at: [0 mm, 0 mm, -560 mm]}"


@dataclass(frozen=True)
class AxisSettings:
    """The range of an axis and its knots, equally spaced, ends included."""

    range: tuple[float, float] = setting(ListOf(WithUnit("length"), 2), "lowest and highest position")
    knots: int = setting(Whole(2, 2000), "knots of each error table, ends included")
    scale: Warm | None = setting(
        Section(Warm), "temperature and expansion of its scale; its positioning is given at 20 degC", default=None
    )

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a fault if the range does not ascend."""
        if self.range[0] >= self.range[1]:
            yield "range", "the range does not ascend: write the lowest position first"


@dataclass(frozen=True)
class RotarySettings:
    """The range of a rotary axis, its knots, and a point of its nominal line."""

    range: tuple[float, float] = setting(ListOf(WithUnit("angle"), 2), "lowest and highest position")
    knots: int = setting(Whole(2, 2000), "knots of each error table, ends included")
    at: tuple[float, ...] | None = setting(
        VECTOR, "a point of its nominal line, in the machine with all axes at 0; six-dof needs none", default=None
    )
    sense: int = setting(
        Whole(-1, 1), "-1 where it counts against the right-handed turn of the tool against the workpiece", default=1
    )
    periodic: bool | None = setting(
        Flag(), "whether it takes any turn (default: if its range is 0 to 360 deg)", default=None
    )
    positions: str = setting(
        Choice(GIVEN, ESTIMATED), "standstill: whether its positions are as the file has them, or estimated", GIVEN
    )

    @property
    def any_turn(self) -> bool:
        """Whether it is periodic, so that its first and last knot are one."""
        own = self.range[0] == 0 and abs(self.range[1] - _TURN) < _ROUNDING
        return own if self.periodic is None else self.periodic

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield faults of the range."""
        if self.range[0] >= self.range[1]:
            yield "range", "the range does not ascend: write the lowest position first"
        if self.any_turn and abs(self.range[1] - self.range[0] - _TURN) > _ROUNDING:
            size = np.degrees(self.range[1] - self.range[0])
            yield "range", f"the range of a periodic axis is one turn, not {size:g} deg: write e.g. [0 deg, 360 deg]"
        if self.any_turn and self.knots < 4:
            yield "knots", "a periodic axis needs 4 knots or more: the first and the last are one"
        if self.sense == 0:
            yield "sense", "the sense is 1 or -1"


@dataclass(frozen=True)
class AxesSettings:
    """The axes; method six-dof with displacement only needs those that have lines."""

    x: AxisSettings | None = setting(Section(AxisSettings), "the X axis", default=None)
    y: AxisSettings | None = setting(Section(AxisSettings), "the Y axis", default=None)
    z: AxisSettings | None = setting(Section(AxisSettings), "the Z axis", default=None)
    a: RotarySettings | None = setting(Section(RotarySettings), "the A axis, which turns about X", default=None)
    b: RotarySettings | None = setting(Section(RotarySettings), "the B axis, which turns about Y", default=None)
    c: RotarySettings | None = setting(Section(RotarySettings), "the C axis, which turns about Z", default=None)

    @property
    def given(self) -> dict[str, AxisSettings]:
        """The linear axes by letter, X to Z."""
        named = {"X": self.x, "Y": self.y, "Z": self.z}
        return {letter: axis for letter, axis in named.items() if axis is not None}

    @property
    def largest_radius(self) -> float:
        """Largest radius of a circle that two linear axes reach [mm]; 0 with one."""
        spans = sorted(axis.range[1] - axis.range[0] for axis in self.given.values())
        return spans[-2] / 2 if len(spans) > 1 else 0.0

    @property
    def turning(self) -> dict[str, RotarySettings]:
        """The rotary axes by letter, A to C."""
        named = {"A": self.a, "B": self.b, "C": self.c}
        return {letter: axis for letter, axis in named.items() if axis is not None}


@dataclass(frozen=True)
class MachineSettings:
    """The kinematic chain, the axes and the tool vectors."""

    chain: str = setting(Text(), "axes from workpiece to tool with the bed marked, such as wXbYZt", default="wXYZt")
    axes: AxesSettings = setting(Section(AxesSettings), "range and knots of each axis", AxesSettings())
    tool: tuple[float, ...] | None = setting(
        VECTOR, "vector from the spindle's reference point to the reflector (default: 0)", default=None
    )
    tools: dict[str, tuple[float, ...]] | None = setting(
        MapOf(VECTOR), "several tool vectors, by the names in the column tool", default=None
    )
    tool_uncertainty: float | str = setting(
        Either(WithUnit("length", minimum=0.0), Choice(UNKNOWN)),
        "standard uncertainty of tool vectors; 0: exact; unknown: with rotary axes, nothing is known of them",
        default=0.0,
    )

    @property
    def letters(self) -> tuple[str, ...]:
        """The letters of the axes from workpiece to tool, and b for the bed."""
        return chain_of(self.chain)

    @property
    def turns(self) -> bool:
        """Whether it has rotary axes."""
        return any(letter in ANGLES for letter in self.letters)

    @property
    def tool_std(self) -> float:
        """Standard uncertainty of the tool vectors [mm]; infinite if nothing is known of them."""
        return np.inf if isinstance(self.tool_uncertainty, str) else self.tool_uncertainty

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a fault for an invalid chain, axes that do not belong to it, and tools given twice or not at all."""
        try:
            letters = self.letters
        except ValueError as error:
            yield "chain", str(error)
        else:
            turning = self.axes.turning
            for letter in (angle for angle in ANGLES if angle in letters and angle not in turning):
                yield "axes", f"the chain has {letter}, but no axis is given: write `{letter.lower()}: {_EXAMPLE}`"
            for letter in (name for name, axis in turning.items() if name in letters and axis.at is None):
                yield f"axes.{letter.lower()}", f"the key 'at' is missing: a point of the line of {letter}; {_EXAMPLE}"
            linear = self.axes.given
            for letter in (name for name in AXES if self.turns and (name in letters) != (name in linear)):
                there = "the axes" if letter in letters else f"the chain {self.chain}"
                yield "axes", f"{letter} is missing in {there}"
            if self.tool_uncertainty == UNKNOWN and not self.turns:
                yield "tool_uncertainty", "without rotary axes an unknown tool is one with the place of the tracker"
        if self.tool is not None and self.tools is not None:
            yield "tools", "both tool and tools are given: keep one of them"
        if self.tools is not None and not self.tools:
            yield "tools", "the list of tools is empty"


@dataclass(frozen=True)
class LateralNoise:
    """Standard deviation perpendicular to the beam, `sqrt(c^2 + (p r)^2)` at distance r."""

    constant: float = setting(WithUnit("length", minimum=0.0), "c: the part that does not depend on the distance")
    proportional: float = setting(WithUnit("ratio", minimum=0.0), "p: the part proportional to it", default=0.0)


_LATERAL = Either(WithUnit("length", positive=True), Section(LateralNoise))


@dataclass(frozen=True)
class MachineNoise:
    """Standard deviations of the tracker (beam, lateral), the laser (displacement ...) or lengths (constant ...)."""

    beam: float | None = setting(WithUnit("length", positive=True), "tracker: along the beam", default=None)
    lateral: float | LateralNoise | None = setting(_LATERAL, "tracker: perpendicular to the beam", default=None)
    radial: float | LateralNoise | None = setting(_LATERAL, "another name of lateral", default=None)
    displacement: float | None = setting(WithUnit("length", positive=True), "six-dof: along the beam", default=None)
    straightness: float | None = setting(
        WithUnit("length", positive=True), "six-dof: perpendicular to the beam", default=None
    )
    angle: float | None = setting(
        WithUnit("angle", positive=True), "six-dof: angles; about rotary axes the deviation", default=None
    )
    constant: float | None = setting(
        WithUnit("length", positive=True), "lengths: the part that does not depend on the length", default=None
    )
    proportional: float = setting(
        WithUnit("ratio", minimum=0.0), "lengths: the part proportional to the path", default=0.0
    )
    probing: float | None = setting(
        WithUnit("length", positive=True), "probing: each coordinate of a ball's centre", default=None
    )
    repeatability: float | str | None = setting(REPEATABILITY, f"lengths: {REPEATABILITY_WORDS}", default=None)

    model: str = model_setting()

    @property
    def of_lengths(self) -> LengthNoise:
        """The noise of lengths."""
        return LengthNoise(self.constant or 0.0, self.proportional, self.repeatability)

    @property
    def of_tracker(self) -> TrackerNoise:
        """The noise of a tracker."""
        return TrackerNoise(self.beam or 0.0, self.square.constant, self.square.proportional)

    @property
    def of_laser(self) -> LineNoise:
        """The noise of a laser with six degrees of freedom."""
        return LineNoise(self.displacement or 0.0, self.straightness or 0.0, self.angle or 0.0)

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
class VolumeGrid:
    """The grid on which the error of the tool is predicted over the volume."""

    grid: tuple[int, ...] | None = setting(
        ListOf(Whole(2, 50)), "points along x, y, z, and each rotary axis (default: 7, 6, 6; 5 with them)", default=None
    )
    circle: float | None = setting(
        WithUnit("length", positive=True), "radius of the circular tests (default: 0.4 of the travel)", default=None
    )

    def counts(self, axes: int = 3) -> tuple[int, ...]:
        """Return the number of points along each axis."""
        usual = (7, 6, 6) if axes == len(AXES) else (5,) * axes
        return usual if self.grid is None or len(self.grid) != axes else self.grid


@dataclass(frozen=True)
class Positioning:
    """What the figures of ISO 230-2 are uncertain by, besides the noise of the displacement."""

    scale: float = setting(
        WithUnit("ratio", minimum=0.0), "standard uncertainty of all distances in common", default=0.0
    )
    environment: float = setting(
        WithUnit("length", minimum=0.0), "range of the readings at rest over the time of a test (E_VE)", default=0.0
    )
    environment_angle: float = setting(
        WithUnit("angle", minimum=0.0), "the same of the readings about a rotary axis", default=0.0
    )
