"""Settings of a calibrate-machine job file, and the columns of its tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

from metrocli.frozen import dataclass
from metrocli.instruments.axes.chain import WORDS, errors_by_word
from metrocli.instruments.axes.rotary import LOCATIONS, NAMES, SPINDLE_NAMES
from metrocli.instruments.machine import ANGLES, AXES, SQUARENESS_NAMES, is_angle, spellings
from metrocli.settings import Choice, Either, Flag, ListOf, Section, Whole, WithUnit, setting, settings_of
from metrocli.tasks.calibrate_machine.files import Inputs
from metrocli.tasks.calibrate_machine.machine_settings import (
    ESTIMATED,
    VECTOR,
    MachineNoise,
    MachineSettings,
    Positioning,
    VolumeGrid,
)
from metrocli.tasks.calibrate_machine.plans.settings import PathPlan
from metrocli.tasks.shared.environment import Environment
from metrocli.tasks.shared.figures import adjusted
from metrocli.tasks.shared.lengths import Scale
from metrocli.tasks.shared.part import Warm

ON_THE_FLY, STANDSTILL, SIX_DOF, LENGTHS, PROBING = "on-the-fly", "standstill", "six-dof", "lengths", "probing"
TURNING = (STANDSTILL, LENGTHS, PROBING)
"""Methods that read machines with rotary axes in any pose; the others read them with these axes at rest"""
_INPUTS = {
    STANDSTILL: ("points",),
    ON_THE_FLY: ("path", "track"),
    SIX_DOF: ("lines",),
    LENGTHS: ("lengths",),
    PROBING: ("probing", "balls"),
}
"""Inputs that each method needs"""
_OPTIONAL = {
    "stations": (LENGTHS,),
    "reflectors": (STANDSTILL, LENGTHS),
    "distances": TURNING,
    "machine": TURNING,
    "paths": TURNING,
    "network": (STANDSTILL,),
}
"""Further inputs, and the methods that take them"""
_OF_ANY_CHAIN = ("stations", "network")
"""Those that machines without rotary axes take too"""
_POINT_BY_POINT = (STANDSTILL, LENGTHS, PROBING, SIX_DOF)
_OF_METHODS = {
    "instrument": (STANDSTILL, LENGTHS),
    "sensor": (PROBING,),
    "corner": (ON_THE_FLY,),
    "simulation.points": TURNING,
    "simulation.polar": (STANDSTILL,),
    "simulation.interval": _POINT_BY_POINT,
    "simulation.warming": _POINT_BY_POINT,
    "simulation.sampling": (ON_THE_FLY,),
    "simulation.feed": (ON_THE_FLY,),
    "simulation.step": (SIX_DOF,),
    "simulation.tracker": (STANDSTILL, ON_THE_FLY),
    "plan.tracker": (STANDSTILL, ON_THE_FLY),
    "plan.length": (ON_THE_FLY,),
    "plan.seed": (ON_THE_FLY,),
    "plan.sampling": (ON_THE_FLY,),
    "plan.time": (LENGTHS,),
    "plan.setup": (LENGTHS,),
    "plan.uncertainty": TURNING,
}
"""Settings that some methods alone read"""
_NOISE = {
    STANDSTILL: ("beam",),
    ON_THE_FLY: ("beam",),
    SIX_DOF: ("displacement",),
    LENGTHS: ("constant",),
    PROBING: ("probing",),
}
"""Standard deviations that each method needs"""
_OTHER_NOISE = {
    STANDSTILL: ("lateral", "radial"),
    ON_THE_FLY: ("lateral", "radial"),
    SIX_DOF: ("straightness", "angle"),
    LENGTHS: ("proportional", "repeatability"),
    PROBING: (),
}
"""Further ones that it uses"""


@dataclass(frozen=True)
class MachineSimulation:
    """The machine and the instrument that `metrocli simulate` simulates."""

    error: float = setting(WithUnit("length", minimum=0.0), "mean length of the error in the volume", default=0.1)
    smooth: bool = setting(Flag(), "smooth error curves instead of straight lines between knots", default=False)
    tracker: tuple[float, ...] = setting(VECTOR, "place of the tracker in the machine", (-1000.0, -800.0, 300.0))
    points: int = setting(Whole(1, 1_000_000), "standstill, lengths: number of points", default=226)
    interval: float = setting(WithUnit("time", positive=True), "all but on-the-fly: time between readings", default=4.0)
    sampling: float = setting(WithUnit("time", positive=True), "on-the-fly: time between points", default=0.002)
    feed: float = setting(
        WithUnit("speed", positive=True), "on-the-fly: feed for a path without a column feed", default=40.0
    )
    warming: float = setting(WithUnit("temperature difference"), "all but on-the-fly: from first to last reading", 0.0)
    step: float = setting(WithUnit("length", positive=True), "six-dof: distance between readings", default=25.0)
    polar: bool = setting(Flag(), "standstill with rotary axes: write distance and angles", default=False)


@dataclass(frozen=True)
class InstrumentStand:
    """What tracker or stations stand on: where axes turn, it decides which of them they see."""

    on: str = setting(Choice("bed", "workpiece"), "standstill, lengths: what it stands on", default="workpiece")


@dataclass(frozen=True)
class Settings:
    """Estimate the geometric errors of a machine, and report which of them the data determine."""

    ELSEWHERE: ClassVar[Mapping[str, str]] = {
        "part": "no part is measured here; the scale of an axis has `scale: {temperature: .., expansion: ..}` in `axes`"
    }

    method: str = setting(Choice(ON_THE_FLY, STANDSTILL, SIX_DOF, LENGTHS, PROBING), "how the machine was measured")
    machine: MachineSettings = setting(Section(MachineSettings), "axes and tools")
    inputs: Any = setting(Section(Inputs), "the files of the job")
    noise: MachineNoise = setting(
        Section(MachineNoise), "standard deviations of the readings; points of a network have theirs", MachineNoise()
    )
    estimate: str | tuple[str, ...] = setting(
        Either(Choice(*WORDS), ListOf(Choice(*NAMES, *WORDS, also=spellings(NAMES)), distinct=True)),
        "errors to estimate; the others are taken as zero",
        default="all",
    )
    instrument: InstrumentStand = setting(
        Section(InstrumentStand), "where the instrument stands", default=InstrumentStand()
    )
    sensor: str = setting(
        Choice("bed", "tool", "workpiece"), "probing: in whose axes the displacements are", default="bed"
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
        WithUnit("length", minimum=0.0), "on-the-fly: length cut off at both ends of each leg", default=10.0
    )
    volume: VolumeGrid = setting(Section(VolumeGrid), "where the volume is predicted", default=VolumeGrid())
    positioning: Positioning = setting(
        Section(Positioning), "six-dof: uncertainty of the figures of ISO 230-2", default=Positioning()
    )
    simulation: MachineSimulation | None = setting(
        Section(MachineSimulation), "the true machine and instrument for `metrocli simulate`", default=None
    )
    plan: PathPlan = setting(Section(PathPlan), "requirements for `metrocli plan`", default=PathPlan())

    @property
    def _names(self) -> tuple[str, ...]:
        return self.estimate if isinstance(self.estimate, tuple) else (self.estimate,)

    @property
    def angular(self) -> bool:
        """Whether six-dof reads rotary axes: the job has no others, or estimates only their angles."""
        turning = self.machine.axes.turning
        named = set(self._names) <= {f"E{letter}{letter}" for letter in turning}
        return self.method == SIX_DOF and bool(turning) and (named or not self.machine.axes.given)

    @property
    def reads_positioning(self) -> bool:
        """Whether six-dof can read no more than the positioning of single axes: the noise of other channels lacks."""
        noise, three = self.noise, len(self.machine.axes.given) == len(AXES)
        return self.method == SIX_DOF and (
            self.angular or noise.straightness is None or noise.angle is None or not three
        )

    @property
    def estimated(self) -> tuple[str, ...]:
        """Names of the errors to estimate, in the spelling of this program."""
        axes, names = self.machine.axes.given, self._names
        if self.angular and set(names) <= set(WORDS):
            return tuple(f"E{axis}{axis}" for axis in self.machine.axes.turning)
        if not self.machine.turns and len(axes) < len(AXES) and names == ("all",):
            return tuple(f"E{axis}{axis}" for axis in axes)
        letters = self.machine.letters
        if self.method not in TURNING:
            letters = tuple(letter for letter in letters if letter not in ANGLES)
        words = errors_by_word(letters)
        return tuple(dict.fromkeys(word for name in names for word in words.get(name, (name,))))

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
        for key in dict.fromkeys(need for keys in _INPUTS.values() for need in keys):
            given = getattr(self.inputs, key) is not None
            if given != (key in needed):
                verb = "needs" if key in needed else "does not use"
                yield "inputs" + (f".{key}" if given else ""), f"method {self.method} {verb} the input '{key}'"
        for key, methods in _OPTIONAL.items():
            if getattr(self.inputs, key) is not None and self.method not in methods:
                yield f"inputs.{key}", f"method {self.method} does not use the input '{key}'"
            elif getattr(self.inputs, key) is not None and key not in _OF_ANY_CHAIN and not self.machine.turns:
                yield f"inputs.{key}", f"the chain {self.machine.chain} has no rotary axis: leave '{key}' out"
        if self.method == PROBING and not self.machine.turns:
            yield "method", "probing calibrates rotary axes: name them in the chain, such as wCAbXYZt"
        if not self.estimated:
            yield "estimate", "it names no error of the axes: leave the key out for all, or name some, such as EXX"
        for letter in self.scales:
            if f"E{letter}{letter}" not in self.estimated:
                yield (
                    f"machine.axes.{letter.lower()}.scale",
                    f"the scale changes E{letter}{letter}, which is not estimated: add it, or leave this key out",
                )
        if self.method == ON_THE_FLY and self.outliers == "remove":
            yield "outliers", "method on-the-fly always removes wild points of the track: leave this key out"
        missing = [axis for axis in "XYZ" if axis not in self.machine.axes.given]
        for letter in () if self.angular else self.machine.axes.turning:
            if letter not in self.machine.letters:
                where, chain = f"machine.axes.{letter.lower()}", self.machine.chain
                yield where, f"the chain {chain} has no {letter}: add it there, or leave this key out"
        if self.machine.turns or self.angular:
            pass
        elif missing == ["X", "Y", "Z"]:
            yield "machine.axes", "no axis is given: write e.g. `x: {range: [0 mm, 600 mm], knots: 13}`"
        elif missing and self.method != SIX_DOF:
            yield "machine.axes", f"method {self.method} needs all three axes; {' and '.join(missing)} are missing"
        for letter, axis in self.machine.axes.turning.items():
            if axis.positions == ESTIMATED and self.method != STANDSTILL:
                where = f"machine.axes.{letter.lower()}.positions"
                yield where, f"method {self.method} takes positions as the file has them; standstill can estimate them"
            elif axis.positions == ESTIMATED and f"E{letter}{letter}" in self.estimated:
                text = f"estimated positions of {letter} and its table E{letter}{letter} are the same unknowns"
                yield "estimate", f"{text}: leave it out, as `estimate: locations` does"
        yield from self._faults_of_noise()
        if self.positioning != Positioning() and self.method != SIX_DOF:
            yield "positioning", f"method {self.method} has no figures of ISO 230-2: leave this key out"
        unused, used = ("environment", "environment_angle") if self.angular else ("environment_angle", "environment")
        if getattr(self.positioning, unused):
            yield f"positioning.{unused}", f"the lines read no such quantity: write `{used}`"
        for key, methods in _OF_METHODS.items():
            section, _, name = key.rpartition(".")
            owner = getattr(self, section) if section else self
            if self.method not in methods and owner and getattr(owner, name) != getattr(type(owner), name):
                yield key, f"method {self.method} does not use this key (of {' and '.join(methods)}): leave it out"
        if not self.machine.turns and self.method == STANDSTILL and self.simulation and self.simulation.polar:
            yield "simulation.polar", "without rotary axes points.csv has x, y, z of the tracker: leave this key out"
        if not self.machine.turns and self.method in (STANDSTILL, LENGTHS) and self.instrument != InstrumentStand():
            yield "instrument.on", "without rotary axes readings are in the axes of the workpiece: leave this key out"
        if self.volume.circle is not None and self.volume.circle > (most := self.machine.axes.largest_radius):
            yield "volume.circle", f"no plane has room for this radius: at most {most:g} mm"
        for key, what in (("scale", "scales of tracking interferometers"), ("environment", "lengths to correct")):
            if getattr(self, key) is not None and self.method != LENGTHS:
                yield key, f"method {self.method} has no {what}: leave this key out"

    def _faults_of_noise(self) -> Iterator[tuple[str, str]]:
        """Yield a fault for each standard deviation that the readings need and lack; a network has its own."""
        if self.inputs.network is not None:
            if self.noise != MachineNoise():
                yield "noise", "the points have the covariance of their network: leave this key out"
            return
        used = (*_NOISE[self.method], *_OTHER_NOISE[self.method], "model")
        for key in settings_of(MachineNoise):
            if key not in used and getattr(self.noise, key) != getattr(MachineNoise, key):
                yield f"noise.{key}", f"method {self.method} does not use the noise '{key}': leave this key out"
        for key in ("angle",) if self.angular else _NOISE[self.method]:
            if getattr(self.noise, key) is None:
                yield "noise", f"method {self.method} needs the noise '{key}'"
        if self.method in (STANDSTILL, ON_THE_FLY) and self.noise.lateral is None and self.noise.radial is None:
            yield "noise", f"method {self.method} needs the noise 'lateral'"


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
    tool = {f"{{tool}}.{axis}": "mm" for axis in "xyz"}
    square = {name: "rad" if is_angle(name) else "mm" for name in (*SQUARENESS_NAMES, *LOCATIONS, *SPINDLE_NAMES)}
    return adjusted(square | tool, (*_STATISTICS, *_TRACK), ["mm", "rad"])
