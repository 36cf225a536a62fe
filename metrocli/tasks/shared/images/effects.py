"""Effects on image points that calibrations and alignments share (docs/effects)."""

from __future__ import annotations

from metrocli.effects.effect import Effect, Parameter
from metrocli.effects.links.images import TargetEccentricity
from metrocli.effects.links.points import RowShear
from metrocli.effects.model import Model
from metrocli.tasks.shared.images.settings import ROLLING


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
    found = {} if shutter == ROLLING else {"rolling-shutter": read_at_once}
    return found if "radius" in model.readings[0].observations.conditions else {**found, PERSPECTIVE_BLUR.name: no_dots}


PERSPECTIVE_BLUR = Effect(
    "perspective-blur",
    "dots are blurred in their own plane, by ink or light that spreads, and perspective shows the nearer half larger",
    (Parameter("area", plausible=1.0, base="mm2"),),
    lambda block, where: TargetEccentricity(block, radius=""),
    confused_with=("target-eccentricity",),
    usual="0.01 to 1",
    reveal="larger tilts of the targets, nearer, in all directions; the width of an edge on the targets themselves",
    source="Mallon and Whelan 2007, Which pattern? Biasing aspects of planar calibration patterns",
)
