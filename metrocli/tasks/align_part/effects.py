"""Effects on the image points of a part, seen by a camera in the spindle."""

from __future__ import annotations

from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.effect import ELAPSED, WARMING, Effect, Parameter, sizes
from metrocli.effects.links.images import LensChange
from metrocli.effects.links.points import Growth, LinearTerms, Shift
from metrocli.effects.links.shifts import CouplingTilt, MachineAngles, MachineBow, MachineError
from metrocli.tasks.shared.images.places import (
    IMAGE,
    PERSPECTIVE_BLUR,
    image_point,
    moved_target,
    rolling_shutter,
    target_eccentricity,
)

_MENDIKUTE = "Mendikute et al."
_PART, _MACHINE, _TAPER = Quantity.POINT_IN_PART, Quantity.POINT_IN_MACHINE, Quantity.POINT_IN_TAPER


EXPANSION = "part-expansion"


def _spindle_growth(by: str, condition: str, rate: tuple[Parameter, ...], usual: str) -> Effect:
    return Effect(
        "spindle-growth",
        "the spindle grows along its axis while the images are taken: bearings and motor warm up or cool down",
        rate,
        lambda block, where: Shift(block, Quantity.POINT_IN_SPINDLE, sign=-1.0, condition=condition, first=2),
        where=("by",),
        by=by,
        needs=({"t": "t", "T": "temp"}[by],),
        confused_with=("part-drift",),
        formula=f"d_CNC += R_CNC (0, 0, rate {by})",
        note="Where z of the spindle points away from the part (ISO 841), a growing spindle has a negative "
        "rate. A growth that is the same in all poses is absorbed by the place of the part.",
        usual=usual,
        reveal="poses with the spindle tilted, the first poses again at the end, and the spindle's temperature",
        source="ISO 230-3: thermal distortion caused by rotating spindles",
    )


PLACES = (
    IMAGE,
    image_point("point-in-part", _PART),
    image_point("point-in-machine", _MACHINE),
    image_point("point-in-spindle", Quantity.POINT_IN_SPINDLE),
    image_point("point-in-taper", _TAPER),
    image_point("point-in-camera", Quantity.POINT_IN_CAMERA),
)
"""Quantities on which effects of one's own can act"""


EFFECTS: tuple[Effect, ...] = (
    Effect(
        "clamping-angle",
        "the camera's holder is clamped in the spindle at an angle that the 6D job takes as zero",
        sizes("gamma_s", "angle", "2 deg"),
        columns_of="coupling",
        confused_with=("coupling-tilt", "coupling-shift"),
        formula="R_S(gamma_s) = [[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]",
        note="Above 5 mrad only after a tool change. With one position of the spindle the rotation of the part "
        "absorbs it.",
        usual="0.01 mrad to 2 deg",
        reveal="poses with the spindle turned by 90 and 180 degrees",
        source=f"{_MENDIKUTE} eq. 22; ISO 26623",
    ),
    Effect(
        "coupling-tilt",
        "the holder sits tilted in the spindle: dirt or a chip in the taper",
        sizes("alpha_s beta_s", "angle", "0.3 mrad"),
        lambda block, where: CouplingTilt(block),
        confused_with=("principal-point-shift", "coupling-shift"),
        formula="R_S <- R_S Ry(beta_s) Rx(alpha_s)",
        note="Where the spindle does not turn, the pose of the part absorbs most of it.",
        usual="0.01 to 0.3 mrad",
        reveal="poses with the spindle turned by 90 and 180 degrees, at two distances from the part",
        source="ISO 26623: seat of polygonal tapers; the tilt follows the spindle",
    ),
    Effect(
        "coupling-shift",
        "the holder sits sideways in the spindle",
        sizes("dx dy", "length", "0.2 mm"),
        lambda block, where: Shift(block, _TAPER, sign=-1.0),
        confused_with=("coupling-tilt", "principal-point-shift"),
        formula="d_cal += (dx, dy, 0)",
        usual="1 to 200 um",
        reveal="poses with the spindle turned by 90 and 180 degrees (without turning, the part's place absorbs it)",
        source="ISO 26623: repeatability of the seat",
    ),
    Effect(
        EXPANSION,
        "the part is warmer or colder than when its targets were measured",
        sizes("scale", "ratio", "500 ppm"),
        lambda block, where: Growth(block, _PART),
        confused_with=("focal-change", "machine-scale"),
        formula="X *= 1 + scale    # in the part",
        note="`part: {temperature: .., expansion: ..}` in the job adds it with its size and uncertainty.",
        usual="10 to 300 ppm",
        reveal="the temperature of the part; targets at different depths and far apart along all axes",
        source="ISO 1; ISO 230-3: 11.5 ppm/K for steel",
    ),
    Effect(
        "stretched-targets",
        "the list of targets is longer in x than in y, or sheared: it was measured with a wrong scale in one direction",
        (*sizes("stretch", "ratio", "1 percent"), *sizes("shear", "angle", "10 mrad")),
        lambda block, where: LinearTerms(block, _PART, ((0, 0), (0, 1))),
        confused_with=("machine-scale", "machine-squareness", "part-expansion"),
        formula="X <- X (1 + stretch) + shear Y",
        usual="10 to 2000 ppm",
        reveal="the targets measured again, or calibrated lengths in several directions",
        source="affine distortion of a list; VDI/VDE 2634 part 1: calibrated lengths in several directions",
    ),
    moved_target(_PART, "bad-pose", "Where the images of a target show no other, bad-pose is exactly the same change."),
    Effect(
        "bad-pose",
        "in one image the machine was not at the position in the file: not settled, or a wrong line in the file",
        sizes("dx dy dz", "length", "5 mm"),
        lambda block, where: Shift(block, _MACHINE, sign=-1.0),
        where=("image",),
        confused_with=("moved-target",),
        of_all="the machine is not at the positions in the file: its repeatability, or errors from pose to pose",
        formula="d_CNC += (dx, dy, dz)    # of that image",
        note="With one target in the image only two of the three parameters can be found.",
        usual="0.01 to 5 mm",
        reveal="more targets in this image, or the pose approached again",
        source="Baarda 1968 (test of a group of readings)",
    ),
    Effect(
        "focal-change",
        "the focal length is not that of the calibration: temperature, focus, another aperture",
        sizes("ratio", "ratio", "1 percent"),
        lambda block, where: LensChange(block, multiplied=(("f", "fx", "fy"),)),
        confused_with=("part-expansion", "radial-distortion"),
        formula="f *= 1 + ratio",
        note="1e-6 to 5e-5 per K, 1e-3 after refocusing. Where all targets are at one distance, the distance "
        "of the part absorbs it.",
        usual="1e-5 to 1e-3",
        reveal="targets at different distances, and off the middle of the image",
        source="Smith and Cope 2010, The effects of temperature variation on single-lens-reflex digital cameras",
    ),
    Effect(
        "principal-point-shift",
        "the sensor or the lens has moved sideways since the camera was calibrated",
        sizes("du dv", "pixel", "50 px"),
        lambda block, where: LensChange(block, added=(("cx",), ("cy",))),
        confused_with=("coupling-tilt", "coupling-shift"),
        formula="cx += du, cy += dv",
        note="To first order a tilt of the camera moves the image alike.",
        usual="0.05 to 10 px",
        reveal="poses at two distances from the part and with the spindle turned",
        source="Elias et al. 2020, Assessing the influence of temperature changes on the stability of cameras",
    ),
    Effect(
        "machine-scale",
        "an axis of the machine moves farther or less far than it reads: temperature of its scale, wrong pitch",
        sizes("scale", "ratio", "200 ppm"),
        lambda block, where: MachineError(block, "xyz".index(where["axis"]), "xyz".index(where["axis"])),
        where=("axis",),
        confused_with=("part-expansion", "focal-change", "machine-angular"),
        formula="d_CNC += scale (d_CNC along the axis)    # from machine zero",
        usual="1 to 1000 ppm",
        reveal="targets seen from poses far apart along this axis, and a calibrated length along it",
        source="ISO 230-2; ISO 230-3",
    ),
    Effect(
        "machine-squareness",
        "two axes of the machine are not square to each other",
        sizes("angle", "angle", "200 urad"),
        lambda block, where: MachineError(block, "xyz".index(where["pair"][0]), "xyz".index(where["pair"][1])),
        where=("pair",),
        confused_with=("part-drift", "clamping-angle", "machine-angular"),
        formula="xy: x += angle y; xz: x += angle z; yz: y += angle z    # coordinates of d_CNC from machine zero",
        note="The rotation of the part absorbs whatever turns all poses alike.",
        usual="5 urad to 1 mrad",
        reveal="targets in a plane seen from poses far apart along both axes",
        source="ISO 230-1",
    ),
    Effect(
        "machine-straightness",
        "an axis of the machine is bent: it runs on an arc instead of a straight line",
        sizes("b1 b2", "curvature", "1e-7 1/mm"),
        lambda block, where: MachineBow(block, "xyz".index(where["axis"])),
        where=("axis",),
        confused_with=("machine-squareness", "machine-scale"),
        formula="x: dy += b1 x², dz += b2 x²    # d_CNC, from the middle of the poses of the job\ny: dz += b1 "
        "y², dx += b2 y²\nz: dx += b1 z², dy += b2 z²",
        note="An arc of 1 m with 1e-8 1/mm is 2.5 um off in its middle. A slope besides is an error of squareness.",
        usual="1e-9 to 1e-7 1/mm",
        reveal="targets seen from poses in the middle and at both ends of this axis",
        source="ISO 230-1:2012 (EYX, EZX and the like)",
    ),
    Effect(
        "machine-angular",
        "roll, pitch and yaw of an axis of the machine grow along it: the spindle, and the camera in it, turn",
        sizes("rx ry rz", "curvature", "1e-7 1/mm"),
        lambda block, where: MachineAngles(block, "xyz".index(where["axis"])),
        where=("axis",),
        confused_with=("machine-scale", "machine-squareness"),
        formula="R_CNC <- (1 + [theta]x) R_CNC, theta = (rx, ry, rz) (p - m)    # p: position of the axis, m: "
        "middle of the poses",
        note="The lever is that from d_CNC to the camera; what the axes carried by this one move besides is "
        "not in it. With targets near the middle of the image only, roll is not seen.",
        usual="1e-9 to 1e-7 1/mm",
        reveal="targets at different distances and in all corners of the image, from poses far apart along this axis",
        source="ISO 230-1:2012 (EAX, EBX, ECX and the like)",
    ),
    Effect(
        "part-drift",
        "the part moves in the machine while the images are taken: clamping, floor, warming up",
        sizes("vx vy vz", "speed", "0.1 mm/min"),
        lambda block, where: Shift(block, _MACHINE, condition=ELAPSED),
        needs=("t",),
        confused_with=("machine-squareness", "bad-pose", "spindle-growth"),
        formula="d_P += (vx, vy, vz) t",
        usual="1 um/min to 0.1 mm/min",
        reveal="the first poses again at the end",
        source="ISO 230-3: drift over time",
    ),
    _spindle_growth("t", ELAPSED, sizes("rate", "speed", "10 um/min"), "1 um/h to 1 um/min"),
    _spindle_growth("T", WARMING, (Parameter("rate", plausible=0.1, base="mm K-1"),), "1e-3 to 1e-2"),
    Effect(
        "radial-distortion",
        "the distortion of the lens is not that of its calibration",
        (Parameter("dk1", plausible=0.1),),
        lambda block, where: LensChange(block, added=(("k1",),)),
        confused_with=("focal-change",),
        formula="k1 += dk1",
        note="Over a narrow range of radii focal-change stretches the image alike.",
        usual="1e-4 to 1e-2",
        reveal="targets up to the corners of the image",
        source="Brown 1971, Close-range camera calibration",
    ),
    target_eccentricity("focal-change"),
    PERSPECTIVE_BLUR,
    rolling_shutter("spindle", "bad-pose"),
)
"""The effects, in the order of lists"""
