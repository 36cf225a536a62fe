"""Effects that may disturb the calibration of a machine; docs/effects describes each of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array, Space
from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.acting import (
    MM,
    PLACE,
    TIMED,
    XYZ,
    Acting,
    OfPlace,
    commanded,
    components,
    condition,
    of_pair,
    point,
    seen_from,
)
from metrocli.effects.effect import Effect, Parameter
from metrocli.effects.links.motions import AXES, Backlash, LoadSag, MachineDrift, ScrewPitchError, ThermalGrowth
from metrocli.effects.links.trackers import TrackerEccentricity, TrackerMoves, TrackerScale
from metrocli.tasks.shared.length_effects import LENGTH_EFFECTS
from metrocli.units import parse_quantity

_SCHWENKE = "Schwenke et al. 2008, Geometric error measurement and compensation of machines, CIRP Annals 57"


def _size(name: str, dimension: str, plausible: str) -> Parameter:
    return Parameter(name, dimension, parse_quantity(plausible, dimension))


def _velocity() -> tuple[Parameter, ...]:
    return tuple(_size(name, "speed", "1 um/min") for name in ("vx", "vy", "vz"))


_SHORTEST, _LONGEST = 2.0, 50.0
"""Range of periods that are searched [mm]"""
_TRIED = 1000
"""Number of periods tried, enough for axes up to 1 m: two neighbours then differ by less than a quarter of a turn"""


def _periods(conditions: Mapping[str, Array]) -> Array:
    """Return periods so close that the phase at the ends of an axis is off by at most a sixteenth of a turn."""
    longest = max(float(np.ptp(conditions[axis])) for axis in AXES)
    count = int(np.ceil(8 * longest * (1 / _SHORTEST - 1 / _LONGEST))) + 1
    return np.asarray(1 / np.linspace(1 / _LONGEST, 1 / _SHORTEST, count))


_PLACES = ("axis", "pair")
_OF_PLACE: Mapping[str, OfPlace] = {"axis": commanded, "pair": of_pair}
_MOTION = (*XYZ, "rx", "ry", "rz")
_APPROACH = tuple(condition(f"from_{axis}", "1", f"from_{axis}") for axis in XYZ)
PLACES = (
    Acting(
        "error-motion",
        Quantity.ERROR_MOTION,
        (*MM, *["rad"] * 3),
        _MOTION,
        (*components(_MOTION, (*MM, *["rad"] * 3)), *TIMED[:1], *PLACE, *_APPROACH),
        _PLACES,
        _OF_PLACE,
    ),
    replace(point("point-in-machine", Quantity.POINT_IN_MACHINE, _PLACES, *_APPROACH), of_place=_OF_PLACE),
    point("point-in-tracker", Quantity.POINT_IN_TRACKER, (), *seen_from(), *_APPROACH),
    point("coordinates", Quantity.POINT_IN_TRACKER, (), *seen_from(), *_APPROACH),
    Acting("across-leg", Quantity.ACROSS_LEG, MM[:2], ("first", "second"), (*TIMED[:1], *PLACE)),
)
"""Quantities on which effects of one's own can act; rx, ry, rz are rotations about the axes"""


OF_MACHINES: tuple[Effect, ...] = (
    Effect(
        "backlash",
        "the axis stops at another place when it arrives from the other side: play, friction and wind-up of its drive",
        (_size("width", "length", "20 um"),),
        lambda block, where: Backlash(block, where["axis"]),
        where=("axis",),
        needs=("from_{axis}",),
        usual="1 to 20 um",
        reveal="the same points approached from both sides; lines run in both directions",
        source="ISO 230-2:2014, reversal value B; left out by Sanders et al. 2023, section 1.1",
    ),
    Effect(
        "screw-pitch-error",
        "the screw or the scale has an error that repeats with every turn and is too short-waved for the knots",
        (_size("amplitude", "length", "10 um"), _size("phase", "angle", "6.3 rad")),
        lambda block, where: ScrewPitchError(block, where["axis"]),
        where=("axis",),
        scanned=(Parameter("period", "length", grid=_periods, tried=_TRIED),),
        space=Space.WAVE,
        usual="0.5 to 10 um",
        reveal="a line of points closer than a quarter of the pitch, not at multiples of the pitch",
        source="ISO 230-2:2014 (targets not at multiples of the pitch, for this error)",
    ),
    Effect(
        "thermal-growth",
        "the scale of an axis grows while the machine is measured",
        (_size("rate", "rate", "60 ppm/h"),),
        lambda block, where: ThermalGrowth(block, where["axis"]),
        where=("axis",),
        needs=("t",),
        confused_with=("machine-drift", "tracker-drift"),
        usual="1 to 60 ppm/h",
        reveal="the far points of the axis measured again at the end; the temperature of its scale",
        source="ISO 230-3:2020; 11.5 um/m/K for steel",
    ),
    Effect(
        "machine-drift",
        "the tool moves against the workpiece while the machine is measured: spindle and column warm up",
        _velocity(),
        lambda block, where: MachineDrift(block),
        needs=("t",),
        confused_with=("tracker-drift", "thermal-growth"),
        usual="1 to 60 um/h",
        reveal="a second reflector, fixed on the table: its readings change with the tracker, not with the machine",
        source="ISO 230-3:2020, environmental temperature variation error",
    ),
    Effect(
        "load-sag",
        "a carriage bends the structure that carries it: the tool sinks with the product of two positions; "
        "no error of a rigid body does this",
        (_size("c", "curvature", "1e-6 1/mm"),),
        lambda block, where: LoadSag(block, where["pair"]),
        where=("pair",),
        usual="1e-8 to 1e-6 1/mm",
        reveal="points over the whole plane of the two axes, also in its corners",
        source=_SCHWENKE,
    ),
    Effect(
        "tracker-eccentricity",
        "the horizontal circle of the tracker is not centred on its axis",
        tuple(_size(name, "angle", "20 arcsec") for name in ("c1", "s1")),
        lambda block, where: TrackerEccentricity(block),
        confused_with=("tracker-scale",),
        usual="0.1 to 20 arcsec",
        reveal="the same points from the other side of the machine, or with the tracker turned on its stand; two faces",
        source="ASME B89.4.19-2021; Muralikrishnan et al. 2009, Laser tracker error determination, J. Res. NIST 114",
    ),
    Effect(
        "tracker-scale",
        "all distances of the tracker are too long or too short by one factor: wavelength or refractive index of air",
        (_size("scale", "ratio", "5 ppm"),),
        lambda block, where: TrackerScale(block),
        confused_with=("tracker-eccentricity",),
        usual="0.1 to 5 ppm",
        reveal="a calibrated length between two nests, measured by the tracker along its beam",
        source="the refractive index of air changes by 1 ppm/K and 0.27 ppm/hPa (Birch and Downs 1994)",
    ),
    Effect(
        "tracker-drift",
        "the tracker moves on its stand while the machine is measured",
        _velocity(),
        lambda block, where: TrackerMoves(block),
        needs=("t",),
        confused_with=("machine-drift", "thermal-growth"),
        usual="1 to 60 um/h",
        reveal="a second reflector, fixed on the table: its readings change with the tracker, not with the machine",
        source=_SCHWENKE,
    ),
)
"""Effects on machine and tracker. A single tracker cannot separate machine-drift and tracker-drift."""

_NOT_WITH_LENGTHS = ("tracker-eccentricity", "tracker-scale", "tracker-drift")
OF_LENGTHS = (*(effect for effect in OF_MACHINES if effect.name not in _NOT_WITH_LENGTHS), *LENGTH_EFFECTS)
"""Effects on the machine and on lengths"""
EFFECTS = (*OF_MACHINES, *LENGTH_EFFECTS)
"""All effects, in the order of the documentation; each method has those that act on what it reads"""
