"""Quantities of image jobs on which effects can act, and effects that both kinds share."""

from __future__ import annotations

from functools import partial

import numpy as np

from metrocli.adjust.model.chain import LinkContext, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.arrays import Array
from metrocli.effects.acting import PLACE, TIMED, Acting, Variable, components, condition, point, seen_from
from metrocli.effects.effect import Effect, Parameter, sizes
from metrocli.effects.links.images import TargetEccentricity
from metrocli.effects.links.points import RowShear, Shift
from metrocli.effects.model import Model
from metrocli.instruments.camera import LENS
from metrocli.tasks.shared.images.settings import ROLLING

WHERE = ("image", "target")
_UV, _PX = ("u", "v"), ("px", "px")
_RADIUS = condition("radius", "mm", "radius")


def _off_centre(value: Array, local: LinkContext) -> Array:
    rows = local.rows(LENS)
    columns = local.blocks[LENS].columns
    return value - rows[[columns.index("cx"), columns.index("cy")]]


def _by_centre(local: LinkContext, by_off: Array) -> Array:
    """Return the derivatives (1, size, n) by the lens of a variable with derivatives (1, 2, n) by the offset."""
    columns = local.blocks[LENS].columns
    by_lens = np.zeros((1, len(columns), by_off.shape[2]))
    by_lens[:, columns.index("cx")], by_lens[:, columns.index("cy")] = -by_off[:, 0], -by_off[:, 1]
    return by_lens


def _off(number: int, value: Array, local: LinkContext) -> Step:
    by_off = np.zeros((1, 2, 1))
    by_off[0, number] = 1.0
    return Step(_off_centre(value, local)[number : number + 1], by_off, {LENS: _by_centre(local, by_off)})


def _from_centre(value: Array, local: LinkContext) -> Step:
    off = _off_centre(value, local)
    size = np.maximum(np.hypot(*off), 1e-300)
    by_off = (off / size)[None]
    return Step(size[None], by_off, {LENS: _by_centre(local, by_off)})


IMAGE = Acting(
    "image",
    Quantity.IMAGE_POINT,
    _PX,
    _UV,
    (
        *components(_UV, _PX),
        *TIMED,
        *PLACE,
        _RADIUS,
        *(Variable(f"off_{name}", "px", partial(_off, number), (LENS,)) for number, name in enumerate(_UV)),
        Variable("from_centre", "px", _from_centre, (LENS,)),
    ),
    WHERE,
)
"""The image point; off_u, off_v and from_centre count from the principal point"""


def image_point(name: str, quantity: Quantity) -> Acting:
    """Return a point on its way to the image as a place to act."""
    return point(name, quantity, WHERE, _RADIUS, *seen_from())


def rolling_shutter(pose: str, *confused_with: str) -> Effect:
    """Return the shear of an image whose rows are read one after another; `pose` is the block of the images' poses."""
    return Effect(
        "rolling-shutter",
        "the camera or the targets move while the rows of the image are read one after another",
        (Parameter("a_u", plausible=0.01), Parameter("a_v", plausible=0.01)),
        lambda block, where: RowShear(block, pose),
        where=("image",),
        confused_with=confused_with,
        of_all="the camera or the targets move in every image: a hand, a carriage that does not stop, vibration",
        formula="u += a_u (v - cy)\nv += a_v (v - cy)    # a: motion of the image in px, from one row to the next",
        note="Sought with `shutter: rolling` only. In a calibration the pose of the image absorbs half of it. "
        "A motion along the view, or a rotation about it, is not in it. 1080 rows in 1/60 s and 1 to 600 px/s "
        "give 1.5e-5 to 9e-3.",
        usual="1e-5 to 1e-2",
        reveal="the image again with camera and targets at rest, or with a global shutter or a flash",
        source="Meingast, Geyer and Sastry 2005, Geometric models of rolling-shutter cameras",
    )


def not_sought(shutter: str, model: Model) -> dict[str, str]:
    """Return the effects that `diagnose` does not look for with a shutter and a list of targets, with the reasons.

    On a real board a shear of single images, or a blur, passes for what bends it or for how it was printed.
    """
    read_at_once = "the rows of an image are read at once; if they are read one after another, write `shutter: rolling`"
    no_dots = "the list of targets has no radius: corners and crosses are found by their edges, not as centroids"
    reasons = {} if shutter == ROLLING else {"rolling-shutter": read_at_once}
    return (
        reasons
        if "radius" in model.readings[0].observations.conditions
        else {**reasons, PERSPECTIVE_BLUR.name: no_dots}
    )


PERSPECTIVE_BLUR = Effect(
    "perspective-blur",
    "dots are blurred in their own plane, by ink or light that spreads, and perspective shows the nearer half larger",
    (Parameter("area", plausible=1.0, base="mm2"),),
    lambda block, where: TargetEccentricity(block, radius=""),
    confused_with=("target-eccentricity",),
    formula="X <- X - area/Z (e_z - n_z n)    # in the camera frame; n: normal of the target's plane\narea = 4 "
    "s²    # s²: variance of the grey values of the dot along each axis",
    note="For centroids of dots with a radius in the list; corners and straight edges do not move. A circle of "
    "radius r blurred by b has r² + 4 b². A sharp circle has factor 1 of target-eccentricity. 1 mm² at f = "
    "2000 px, Z = 400 mm and 45 degrees is 0.006 px.",
    usual="0.01 to 1",
    reveal="larger tilts of the targets, nearer, in all directions; the width of an edge on the targets themselves",
    source="Mallon and Whelan 2007, Which pattern? Biasing aspects of planar calibration patterns",
)


def moved_target(frame: Quantity, confused: str, note: str) -> Effect:
    """Return the effect of a target that is not where its list has it, in the frame of the list."""
    return Effect(
        "moved-target",
        "a target is not at its listed position: it was knocked, mistaken for another, or measured wrongly",
        sizes("dx dy dz", "length", "5 mm"),
        lambda block, where: Shift(block, frame),
        where=("target",),
        confused_with=(confused,),
        of_all="the list of targets is uncertain throughout: printed, or measured less well than it states",
        formula="X_target += (dx, dy, dz)    # in the frame of the list",
        note=note,
        usual="0.01 to 5 mm",
        reveal="this target in more images from other sides, or measured again",
        source="Baarda 1968 (test of a group of readings)",
    )


def target_eccentricity(confused: str, note: str = "") -> Effect:
    """Return the effect of the centre of a circle's image, which is not the image of the circle's centre."""
    return Effect(
        "target-eccentricity",
        "the measured centre of a circle's image is not the image of the circle's centre",
        (Parameter("factor", plausible=2.0),),
        lambda block, where: TargetEccentricity(block),
        needs=("radius",),
        confused_with=(confused,),
        formula="X <- X - factor r²/Z (e_z - n_z n)    # in the camera frame; n: normal of the circle, r: its radius",
        note=note,
        usual="0.5 to 1",
        reveal="larger tilts of the targets; the radius of every target in the list",
        source="Ahn, Warnecke and Kotowski 1999, Systematic geometric image measurement errors of circular targets",
    )
