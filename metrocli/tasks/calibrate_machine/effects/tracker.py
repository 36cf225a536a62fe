"""Effects on trackers and lasers that read a machine."""

from __future__ import annotations

from dataclasses import replace

from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.effect import ELAPSED, WARMING, Effect, Parameter, change_points, sizes
from metrocli.effects.links.angles import OnPoint
from metrocli.effects.links.motions import LineTerm, ZeroDrift
from metrocli.effects.links.points import Shift
from metrocli.instruments.six_dof import FROM_START
from metrocli.instruments.tracker import FACE
from metrocli.tasks.calibrate_machine.effects.machine import SCHWENKE, VELOCITY
from metrocli.tasks.shared.tracker_effects import TRACKER_EFFECTS

_NEEDS = {"tracker-transit-offset": (FACE,)}
"""What effects need that look like others where all readings are in face 1"""
_NOT_SOUGHT = ("tracker-steering-mirror",)
"""An effect that looks like two others together"""


def _on_points(effect: Effect) -> Effect:
    """Return an effect on azimuth, elevation and distance as one on the coordinates that follow from them."""
    link = effect.link
    if link is None:
        raise ValueError(f"{effect.name} has no link")
    needs = _NEEDS.get(effect.name, ())
    return replace(effect, needs=needs, link=lambda block, where: OnPoint(link(block, where)))  # type: ignore[arg-type]


OF_THE_TRACKER: tuple[Effect, ...] = (
    *(_on_points(effect) for effect in TRACKER_EFFECTS if effect.name not in _NOT_SOUGHT),
    Effect(
        "tracker-drift",
        "the tracker moves on its stand while the machine is measured",
        VELOCITY,
        lambda block, where: Shift(block, Quantity.POINT_IN_MACHINE, sign=-1.0, condition=ELAPSED),
        needs=("t",),
        confused_with=("machine-drift", "tracker-moved", "thermal-growth"),
        formula="point in the machine -= (vx, vy, vz) t    # along the axes of the machine",
        note="For a single tracker it is machine-drift with the opposite sign.",
        usual="1 to 60 um/h",
        reveal="a second reflector, fixed on the table: its readings change with the tracker, not with the machine",
        source=SCHWENKE,
    ),
    Effect(
        "tracker-moved",
        "the tracker was pushed, or its stand settled, while the machine was measured",
        sizes("dx dy dz", "length", "1 mm"),
        lambda block, where: Shift(block, Quantity.POINT_IN_MACHINE, sign=-1.0, since="t"),
        scanned=(Parameter("at", "time", grid=change_points),),
        needs=("t",),
        confused_with=("tracker-drift", "machine-drift"),
        formula="point in the machine -= (dx, dy, dz) for t >= at    # along the axes of the machine",
        usual="10 um to 1 mm",
        reveal="the first points again at the end, or a second reflector, fixed on the table, throughout",
        source="Baarda 1968 (mean shift of some readings)",
    ),
)
"""Effects on the readings of the tracker, and on its stand"""


def _refraction(by: str, condition: str, need: str, rate: tuple[Parameter, ...], usual: str) -> Effect:
    return Effect(
        "laser-refraction-drift",
        "the refractive index of the air changes while the laser measures, without being corrected",
        rate,
        lambda block, where: LineTerm(block, (condition, FROM_START)),
        by=by,
        needs=(need,),
        confused_with=("thermal-growth", "laser-dead-path-drift"),
        formula=f"e += rate {by} s    # e: reading along the line, s: distance from its lowest position",
        note="With one line in the time of the drift it equals thermal-growth. On lines that are each run once "
        "it is a part of the positioning errors.",
        usual=usual,
        reveal="temperature and pressure of the air with each reading; one line measured again at the end",
        source="Birch and Downs 1994: -0.955 ppm/K, +0.268 ppm/hPa",
    )


OF_THE_LASER: tuple[Effect, ...] = (
    Effect(
        "laser-dead-path-drift",
        "the zero of the laser drifts on one line: dead path, stand and optics warm up",
        sizes("rate", "speed", "1 um/min"),
        lambda block, where: LineTerm(block, (ELAPSED,)),
        where=("line",),
        needs=("t",),
        confused_with=("laser-refraction-drift", "machine-drift", "backlash"),
        formula="e += rate t    # e: reading along the line",
        note="A dead path of 1 m in air that warms up by 1 K/h gives 1 um/h. On a line run once in one "
        "direction it is a part of the positioning error.",
        usual="0.05 um/h to 1 um/min",
        reveal="the line run to and fro, and its first target read again at the end",
        source=SCHWENKE,
    ),
    Effect(
        "indexer-drift",
        "the zero of an angle reading drifts on one line: rotary indexer, mirror or polygon, and stand warm up",
        sizes("rate", "angle rate", "10 arcsec/h"),
        lambda block, where: ZeroDrift(block),
        where=("line",),
        needs=("t",),
        confused_with=("backlash",),
        formula="e += rate t    # e: angle that is read about a rotary axis",
        note="On a line run once in one direction it is a part of the positioning error.",
        usual="0.1 to 10 arcsec/h",
        reveal="the line run to and fro, and its first target read again at the end",
        source="ISO 230-3:2020, environmental temperature variation error",
    ),
    _refraction("T", WARMING, "temp", sizes("rate", "expansion", "2e-6 1/K"), "5e-7 to 2e-6 1/K"),
    _refraction("t", ELAPSED, "t", sizes("rate", "rate", "10 ppm/h"), "0.1 to 10 ppm/h"),
)
"""Effects on the displacement that the laser reads"""
