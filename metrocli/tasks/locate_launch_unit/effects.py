"""Effects on a launch unit and its receiver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from metrocli.adjust.model.chain import Link
from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.acting import PLACE, TIMED, Acting, beam_from, components, point, scalar, seen_from
from metrocli.effects.effect import Effect, sizes
from metrocli.effects.links.angles import BaseTilt, Harmonic, NonOrthogonality
from metrocli.effects.links.lengths import BeamHeight, BeamOffset
from metrocli.effects.links.points import Growth, LinearTerms, Shift
from metrocli.instruments.launch_unit import ENCODERS, TURNED, UNIT

LAUNCH, RECEIVER = UNITS = "launch", "receiver"
"""Names of the two units as places of effects"""
_BEAMS = {LAUNCH: Quantity.BEAM_OUT, RECEIVER: Quantity.BEAM_AT_RECEIVER}
_ANGLES = {LAUNCH: Quantity.LAUNCH_ANGLES, RECEIVER: Quantity.RECEIVER_ANGLES}
AXES, PAIRS = ("x", "y", "z"), ("xy", "xz", "yz")
_MURALIKRISHNAN = "Muralikrishnan et al. 2009, ASME B89.4.19 performance evaluation tests and geometric misalignments"


def _offset(block: str, where: Mapping[str, str]) -> Link:
    at, component = ENCODERS[where["encoder"]]
    return Shift(block, at, first=component)


def _lag(block: str, where: Mapping[str, str]) -> Link:
    at, component = ENCODERS[where["encoder"]]
    return Shift(block, at, sign=-0.5, condition=TURNED.format(**where), first=component)


def _scale(block: str, where: Mapping[str, str]) -> Link:
    axis = AXES.index(where["axis"])
    return LinearTerms(block, Quantity.POINT_IN_MACHINE, ((axis, axis),))


def _squareness(block: str, where: Mapping[str, str]) -> Link:
    pair = where["pair"]
    return LinearTerms(block, Quantity.POINT_IN_MACHINE, ((AXES.index(pair[0]), AXES.index(pair[1])),))


_POSE = ("pose",)
_TURNS = ("base", "tilt")


def _pair(name: str, quantity: Quantity) -> Acting:
    units = ("rad", "rad")
    return Acting(name, quantity, units, _TURNS, (*components(_TURNS, units), *TIMED, *PLACE), _POSE)


PLACES = (
    replace(scalar("angle", Quantity.ANGLE, "rad", ("encoder", "pose")), split={"encoder": ENCODERS}),
    scalar("distance", Quantity.LENGTH, "mm", _POSE),
    _pair("launch-angles", Quantity.LAUNCH_ANGLES),
    _pair("receiver-angles", Quantity.RECEIVER_ANGLES),
    point("point-in-machine", Quantity.POINT_IN_MACHINE, _POSE, *beam_from(UNIT), *seen_from(UNIT)),
    *(
        point(name, quantity, _POSE, *seen_from())
        for name, quantity in (
            ("beam-out", Quantity.BEAM_OUT),
            ("beam-back", Quantity.BEAM_BACK),
            ("beam-at-launch", Quantity.BEAM_AT_LAUNCH),
            ("beam-at-receiver", Quantity.BEAM_AT_RECEIVER),
        )
    ),
)
"""Quantities on which user-defined effects can act"""


EFFECTS: tuple[Effect, ...] = (
    Effect(
        "encoder-eccentricity",
        "the disc of one encoder is not centred on its axis",
        sizes("c1 s1", "angle", "100 arcsec"),
        lambda block, where: Harmonic(block, *ENCODERS[where["encoder"]]),
        where=("encoder",),
        confused_with=("encoder-offset", "base-tilt", "axis-nonorthogonality", "beam-offset"),
        formula="phi += c1 cos phi + s1 sin phi",
        note="Two opposite reading heads cancel it. Over a small range of angles it is nearly a constant.",
        usual="1 to 100 arcsec",
        reveal="poses all around the unit and over the whole range of tilt",
        source=_MURALIKRISHNAN,
    ),
    Effect(
        "encoder-harmonic",
        "the disc of one encoder is oval or bent: its error has two waves in a turn",
        sizes("c2 s2", "angle", "20 arcsec"),
        lambda block, where: Harmonic(block, *ENCODERS[where["encoder"]], order=2),
        where=("encoder",),
        confused_with=("encoder-eccentricity", "axis-nonorthogonality"),
        formula="phi += c2 cos 2 phi + s2 sin 2 phi",
        note="Two opposite reading heads do not cancel it.",
        usual="1 to 20 arcsec",
        reveal="poses all around the unit and over the whole range of tilt",
        source=_MURALIKRISHNAN,
    ),
    Effect(
        "encoder-offset",
        "the zero of one encoder is not aligned with the axes of its unit",
        sizes("offset", "angle", "1 deg"),
        _offset,
        where=("encoder",),
        confused_with=("encoder-eccentricity", "base-tilt", "axis-nonorthogonality", "beam-offset"),
        formula="phi += offset",
        note="The offset of phi1 is gamma itself. Without distances only the pattern in which the beams miss "
        "their common point separates phi2 and phi3.",
        usual="5 arcsec to 1 deg",
        reveal="the same poses with the unit over the top (base + 180 degrees, 180 degrees - tilt), or distances",
        source=_MURALIKRISHNAN,
    ),
    Effect(
        "belt-hysteresis",
        "a belt between axis and encoder stretches: the angle lags by the direction in which the axis came",
        sizes("width", "angle", "200 arcsec"),
        _lag,
        where=("encoder",),
        needs=(TURNED,),
        confused_with=("encoder-offset",),
        formula="phi -= width/2 where the encoder grew since the pose before, += width/2 where it fell",
        note="Axes that come from one side at the end of each move have no such error; reached from one side "
        "only, it is a constant. A move below 0.001 rad keeps the direction. 10 um of clearance on a pulley of "
        "50 mm radius is 40 arcsec.",
        usual="5 to 200 arcsec",
        reveal="the same poses reached from both sides, listed in the order in which they were measured",
        source="Kuprin et al. (axes driven by toothed belts); ISO 230-2:2014, reversal value B",
    ),
    Effect(
        "base-tilt",
        "the base axis of one unit is not parallel to z: of the machine for the launch unit, of the spindle for the "
        "receiver",
        sizes("tx ty", "angle", "1 deg"),
        lambda block, where: BaseTilt(block, _BEAMS[where["unit"]]),
        where=("unit",),
        confused_with=("encoder-eccentricity", "encoder-offset", "machine-squareness"),
        formula="base axis = Rx(tx) Ry(ty) z",
        usual="5 arcsec to 1 deg",
        reveal="poses all around the unit; for the receiver the same positions with the spindle turned by 90 degrees",
        source=_MURALIKRISHNAN,
    ),
    Effect(
        "axis-nonorthogonality",
        "the tilt axis of one unit is not square to its base axis",
        sizes("angle", "angle", "1 deg"),
        lambda block, where: NonOrthogonality(block, _ANGLES[where["unit"]]),
        where=("unit",),
        confused_with=("encoder-offset", "encoder-eccentricity", "beam-offset"),
        formula="base angle += angle tan(tilt)",
        usual="1 arcsec to 0.1 deg",
        reveal="poses with steep and with level beams, and with the unit over the top",
        source=_MURALIKRISHNAN,
    ),
    Effect(
        "beam-offset",
        "the beam passes the intersection of a unit's axes at a distance, in launch unit or receiver (not separable)",
        sizes("h", "length", "2 mm"),
        lambda block, where: BeamOffset(block),
        confused_with=("axis-nonorthogonality", "encoder-offset", "encoder-eccentricity"),
        formula="both base angles -= h/(horizontal distance)    # h to the left of the beam as it leaves the "
        "launch unit",
        note="The offsets of launch unit and receiver add up.",
        usual="10 um to 2 mm",
        reveal="poses near to the unit and far from it",
        source=_MURALIKRISHNAN,
    ),
    Effect(
        "beam-height",
        "the beam passes above or below the intersection of a unit's axes, in launch unit or receiver (not separable)",
        sizes("v", "length", "2 mm"),
        lambda block, where: BeamHeight(block),
        confused_with=("encoder-offset", "encoder-eccentricity"),
        formula="tilt of the launch unit -= v/distance, tilt of the receiver += v/distance",
        usual="10 um to 2 mm",
        reveal="poses near to the unit and far from it, above it and below it",
        source=_MURALIKRISHNAN,
    ),
    Effect(
        "distance-offset",
        "all distances are off by the same amount: their zero is not at the control points",
        sizes("offset", "length", "10 mm"),
        lambda block, where: Shift(block, Quantity.LENGTH),
        needs=("distance",),
        confused_with=("distance-scale",),
        formula="distance += offset",
        usual="1 um to 10 mm",
        reveal="distances from short to long",
        source="zero constant of distance meters: Rüeger, Electronic Distance Measurement",
    ),
    Effect(
        "distance-scale",
        "all distances are too long in proportion: wavelength, air, or the machine's own scale",
        sizes("scale", "ratio", "1 percent"),
        lambda block, where: Growth(block, Quantity.LENGTH),
        needs=("distance",),
        confused_with=("distance-offset", "machine-scale"),
        formula="distance *= 1 + scale",
        usual="0.1 to 20 ppm",
        reveal="distances from short to long, in directions along all axes; air temperature and pressure",
        source="Birch and Downs 1994, at 20 °C, 1013 hPa, 50 %: -0.955 ppm/K at constant relative humidity, "
        "-0.930 ppm/K at constant vapour pressure, +0.268 ppm/hPa",
    ),
    Effect(
        "machine-scale",
        "the scale of one axis of the machine is wrong: it moves farther than it reads, in proportion",
        sizes("scale", "ratio", "1000 ppm"),
        _scale,
        where=("axis",),
        confused_with=("machine-squareness", "distance-scale"),
        formula="r += scale (r along the axis)    # r: true position of the receiver",
        note="Without distances the position of the unit absorbs a common scale of all axes.",
        usual="1 to 1000 ppm",
        reveal="poses far apart along that axis, on both sides of the unit; distances",
        source="ISO 230-1:2012 (EXX, EYY, EZZ); steel scales 11.5 ppm/K",
    ),
    Effect(
        "machine-squareness",
        "two axes of the machine are not square to each other",
        sizes("angle", "angle", "1 mrad"),
        _squareness,
        where=("pair",),
        confused_with=("machine-scale", "base-tilt"),
        formula="xy: x += angle y; xz: x += angle z; yz: y += angle z    # true position of the receiver",
        usual="5 urad to 1 mrad",
        reveal="poses in the four corners of the plane of these axes; distances",
        source="ISO 230-1:2012 (C0Y, B0Z, A0Z)",
    ),
    Effect(
        "bad-pose",
        "in one pose the receiver was not at its listed position",
        sizes("dx dy dz", "length", "100 mm"),
        lambda block, where: Shift(block, Quantity.POINT_IN_MACHINE),
        where=("pose",),
        of_all="the receiver is not at the listed positions: the machine's repeatability, or errors from pose to pose",
        formula="r += (dx, dy, dz)    # r: true position of the receiver in that pose",
        note="Wrong readings of single encoders in the same pose look alike.",
        usual="0.01 to 100 mm",
        reveal="this pose measured again, with a distance, since only that shows an error along the beam",
        source="Baarda 1968 (mean shift of the readings of one pose)",
    ),
)
"""The table of effects in the order of lists"""
