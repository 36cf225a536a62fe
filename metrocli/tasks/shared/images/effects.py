"""Effects on image points that calibrations and alignments share (docs/effects)."""

from __future__ import annotations

from metrocli.effects.effect import Effect, Parameter
from metrocli.effects.links.affine import RowShear
from metrocli.effects.links.eccentricity import TargetEccentricity


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
