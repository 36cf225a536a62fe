"""Effects on the machine that is calibrated."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from metrocli.adjust.model.blocks import Space
from metrocli.adjust.model.quantities import Quantity
from metrocli.arrays import Array
from metrocli.effects.effect import Effect, Parameter, sizes
from metrocli.effects.links.motions import (
    AXES,
    AngularReversal,
    Backlash,
    BacklashGrowth,
    Hysteresis,
    LoadSag,
    MachineDrift,
    ScrewPitchError,
    ServoLag,
    StraightnessReversal,
    ThermalGrowth,
)
from metrocli.effects.links.points import Shift
from metrocli.instruments.machine_path import SINCE, SPEED

SCHWENKE = "Schwenke et al. 2008, Geometric error measurement and compensation of machines, CIRP Annals 57"


LINEAR = tuple(AXES)
PAIRS = ("xy", "xz", "yz")
VELOCITY = sizes("vx vy vz", "speed", "1 um/min")
"""Parameters of a drift"""


_SHORTEST, _LONGEST = 2.0, 50.0
"""Range of periods that are searched [mm]"""
_TRIED = 1000
"""Number of periods tried, enough for axes up to 1 m: two neighbours then differ by less than a quarter of a turn"""


def _periods(conditions: Mapping[str, Array]) -> Array:
    """Return periods so close that the phase at the ends of an axis is off by at most a sixteenth of a turn."""
    longest = max(float(np.ptp(conditions[axis])) for axis in AXES)
    count = int(np.ceil(8 * longest * (1 / _SHORTEST - 1 / _LONGEST))) + 1
    return np.asarray(1 / np.linspace(1 / _LONGEST, 1 / _SHORTEST, count))


_BEHIND = 0.02
"""Least mean of `exp(-2 w/length)` behind turns: with a shorter length hardly a reading shows it"""
_ALIKE = 0.7
"""Largest cosine with plain backlash, which a longer length is more like"""
_LONGEST_BUILD_UP = 300.0
"""Longest length that is searched [mm]"""


def _lengths(conditions: Mapping[str, Array]) -> Array:
    """Return lengths of build-up, each 1.3 times the one before, that readings behind the turns of some axis show."""
    tried: Array = _LONGEST_BUILD_UP * 1.3 ** -np.arange(40.0)[::-1]
    since = [conditions[name] for axis in AXES if (name := SINCE.format(axis=axis)) in conditions]
    shown = np.zeros(len(tried), dtype=bool)
    for way in since:
        lacking = np.exp(-way[np.isfinite(way)] / tried[:, None])
        if lacking.size:
            square = (lacking**2).mean(axis=1)
            shown |= (square > _BEHIND) & (lacking.mean(axis=1) < _ALIKE * np.sqrt(square))
    return np.asarray(tried[shown | (tried == tried[0])])


OF_THE_MACHINE: tuple[Effect, ...] = (
    Effect(
        "backlash",
        "the axis stops at another place when it arrives from the other side: play, friction and wind-up of its drive",
        sizes("width", "length", "20 um"),
        lambda block, where: Backlash(block, axis=where["axis"]),
        where=("axis",),
        among=LINEAR,
        needs=("from_{axis}",),
        formula="d_axis += width/2 where from_axis = +1, -= width/2 where from_axis = -1",
        note="Where all points are approached from one side it is a constant shift, which is not seen and does "
        "no harm. On the fly, and along laser lines, the order of the readings gives the direction.",
        usual="1 to 20 um",
        reveal="the same points approached from both sides; lines run in both directions",
        source="ISO 230-2:2014, reversal value B; left out by Sanders et al. 2023, section 1.1",
    ),
    Effect(
        "backlash-growth",
        "the play of an axis is not the same along its travel: its screw or rack is worn, or winds up",
        sizes("growth", "ratio", "50 ppm"),
        lambda block, where: BacklashGrowth(block, axis=where["axis"]),
        where=("axis",),
        among=LINEAR,
        needs=("from_{axis}",),
        confused_with=("backlash",),
        formula="d_axis += growth pos/2 where from_axis = +1, -= where -1    # pos: commanded, from machine zero",
        usual="1 to 50 ppm",
        reveal="points along the whole axis, each approached from both sides",
        source="ISO 230-2:2014, reversal value B at each target position",
    ),
    Effect(
        "hysteresis",
        "the backlash of an axis is not there at once: it builds up over the way since the axis turned, by friction",
        sizes("width", "length", "20 um"),
        lambda block, where: Hysteresis(block, axis=where["axis"]),
        where=("axis",),
        among=LINEAR,
        needs=(SINCE,),
        scanned=(Parameter("length", "length", grid=_lengths, tried=12),),
        confused_with=("backlash",),
        formula="d_axis -= s width exp(-w/length)    # s: sign of the last move, w: way since the axis turned",
        note="Beside backlash of the same width it is the error of the direction before at the turn, and of "
        "the new one far from it. Not tested where a tenth of the moves contradict from_x, from_y, from_z.",
        usual="1 to 20 um",
        reveal="points close behind a turn and far from it, listed in the order of travel",
        source="Dahl 1976, Solid friction damping of mechanical vibrations, AIAA Journal 14",
    ),
    Effect(
        "straightness-reversal",
        "an axis that turns shifts what it carries across its direction: play and friction of its guides",
        sizes("width", "length", "10 um"),
        lambda block, where: StraightnessReversal(block, axis=where["reversal"][0], shifted=where["reversal"][1]),
        where=("reversal",),
        needs=("from_{reversal[0]}",),
        confused_with=("backlash", "angular-reversal"),
        formula="d_b += width/2 where from_a = +1, -= width/2 where from_a = -1    # reversal ab: axis a "
        "turns, the point shifts along b",
        note="With tools of one length, angular-reversal looks the same.",
        usual="0.5 to 10 um",
        reveal="the same points approached from both sides of the axis that turns; lines run in both directions",
        source="ISO 230-1:2012 (EYX, EZX, ...); ISO 230-2:2014, reversal value B, formed across the axis",
    ),
    Effect(
        "angular-reversal",
        "an axis that turns tips its carriage: it is driven beside its guides, and these give way",
        sizes("rx ry rz", "angle", "5 arcsec"),
        lambda block, where: AngularReversal(block, axis=where["axis"]),
        where=("axis",),
        among=LINEAR,
        needs=("from_{axis}",),
        confused_with=("backlash", "straightness-reversal"),
        formula="theta += r/2, d += r/2 x L where from_axis = +1, -= where -1    # r = (rx, ry, rz), L: lever "
        "from the axis to the tool",
        note="With tools of one length it is a shift. Where all points are approached from one side it is not "
        "seen and does no harm.",
        usual="0.2 to 5 arcsec",
        reveal="lines run in both directions with angles read; points from both sides with tools of different length",
        source="ISO 230-1:2012 (EAX, EBX, ECX, ...); ISO 230-2:2014, reversal value B, formed of the angles",
    ),
    Effect(
        "servo-lag",
        "an axis in motion is behind its command by its speed times a time: the gain of its control is finite",
        sizes("tau", "time", "60 ms"),
        lambda block, where: ServoLag(block, axis=where["axis"]),
        where=("axis",),
        among=LINEAR,
        needs=(SPEED,),
        confused_with=("backlash",),
        formula="d_axis -= tau v    # v: speed of the axis, with its sign",
        note="A gain of 1 m/min per mm is 60 ms; feed-forward leaves less than 1 ms. A lag common to all axes "
        "is along the path and not seen: estimate that of at most two axes.",
        usual="0.05 to 60 ms",
        reveal="the same diagonals in both directions, and at two feeds; lines of a laser at standstill",
        source="ISO 230-4:2005 (circles at a feed); Mechanical Engineers' Handbook, Controller Design",
    ),
    Effect(
        "screw-pitch-error",
        "the screw or the scale has an error that repeats with every turn and is too short-waved for the knots",
        (*sizes("amplitude", "length", "10 um"), *sizes("phase", "angle", "6.3 rad")),
        lambda block, where: ScrewPitchError(block, axis=where["axis"]),
        where=("axis",),
        among=LINEAR,
        scanned=(Parameter("period", "length", grid=_periods, tried=_TRIED),),
        space=Space.WAVE,
        formula="d_axis += amplitude sin(2 pi pos/period + phase)    # pos: commanded position",
        note="A job gives the period, `diagnose` scans 2 to 50 mm, but not on the fly: a path does not measure "
        "along its legs.",
        usual="0.5 to 10 um",
        reveal="a line of points closer than a quarter of the pitch, not at multiples of the pitch",
        source="ISO 230-2:2014 (targets not at multiples of the pitch, for this error)",
    ),
    Effect(
        "thermal-growth",
        "the scale of an axis grows while the machine is measured",
        sizes("rate", "rate", "60 ppm/h"),
        lambda block, where: ThermalGrowth(block, axis=where["axis"]),
        where=("axis",),
        among=LINEAR,
        needs=("t",),
        confused_with=("machine-drift", "tracker-drift"),
        formula="d_axis += rate t pos    # pos: commanded position from machine zero",
        note="Steel grows by 11.5 um/m/K, so 1 K/h gives 12 ppm/h.",
        usual="1 to 60 ppm/h",
        reveal="the far points of the axis measured again at the end; the temperature of its scale",
        source="ISO 230-3:2020; 11.5 um/m/K for steel",
    ),
    Effect(
        "machine-drift",
        "the tool moves against the workpiece while the machine is measured: spindle and column warm up",
        VELOCITY,
        lambda block, where: MachineDrift(block),
        needs=("t",),
        confused_with=("tracker-drift", "thermal-growth"),
        formula="d += (vx, vy, vz) t",
        note="For a single tracker it is tracker-drift with the opposite sign.",
        usual="1 to 60 um/h",
        reveal="a second reflector, fixed on the table: its readings change with the tracker, not with the machine",
        source="ISO 230-3:2020, environmental temperature variation error",
    ),
    Effect(
        "repeatability",
        "the carrier does not return to the same place: its positions at stops scatter more than declared",
        sizes("dx dy dz", "length", "10 um"),
        lambda block, where: Shift(block, Quantity.POINT_IN_MACHINE),
        where=("stop",),
        not_first=("stop",),
        throughout=True,
        noise="repeatability",
        of_all="the carrier does not return to the same place: its positions at stops scatter more than declared",
        confused_with=("moved-point",),
        formula="p += (dx, dy, dz)    # p: place of the reflector at that stop, common to all lengths read there",
        note="`diagnose` looks for the scatter of all stops, `{name: repeatability, std: 2 um}`; the extended "
        "job declares `noise: {repeatability: ..}`, sqrt(declared² + std²). Not testable where each stop has "
        "one reading.",
        usual="0.5 to 10 um",
        reveal="several readings at each stop, such as stations that read at once",
        source="ISO 230-2:2014, repeatability of positioning R",
    ),
    Effect(
        "load-sag",
        "a carriage bends the structure that carries it: the tool sinks with the product of two positions; "
        "no error of a rigid body does this",
        sizes("c", "curvature", "1e-6 1/mm"),
        lambda block, where: LoadSag(block, pair=where["pair"]),
        where=("pair",),
        among=PAIRS,
        formula="dz += c a b    # a, b: commanded positions of the two axes",
        note="2 to 50 um at the end of a gantry or ram.",
        usual="1e-8 to 1e-6 1/mm",
        reveal="points over the whole plane of the two axes, also in its corners",
        source=SCHWENKE,
    ),
)
"""Effects on the machine"""
