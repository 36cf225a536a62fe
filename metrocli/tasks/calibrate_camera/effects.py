"""Effects on the image points of a camera calibration."""

from __future__ import annotations

from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.effect import ELAPSED, WARMING, Effect, Parameter, sizes
from metrocli.effects.links.images import LensChange
from metrocli.effects.links.points import Growth, LinearTerms, PlaneBend
from metrocli.tasks.calibrate_camera.image_groups import SERIES, TURN
from metrocli.tasks.calibrate_camera.shape.effect import LENS_SHAPE
from metrocli.tasks.shared.images.places import (
    IMAGE,
    PERSPECTIVE_BLUR,
    image_point,
    moved_target,
    rolling_shutter,
    target_eccentricity,
)

_LENS = "lens"
_SEEN_ONCE = "A target seen in one image only is a wrong reading, not an effect."
_FOCAL = ("f", "fx", "fy")
_IMAGE_VARIANT = "Hastedt, Luhmann and Tecklenburg 2002, Image-variant interior orientation of digital cameras"


def _focal_drift(by: str, condition: str, dimension: str, plausible: str, usual: str) -> Effect:
    return Effect(
        "focal-drift",
        "the focal length changes while the images are taken: the lens warms up or its focus creeps",
        sizes("rate", dimension, plausible),
        lambda block, where: LensChange(block, multiplied=(_FOCAL,), condition=condition),
        where=("by",),
        by=by,
        needs=({"t": "t", "T": "temp"}[by],),
        confused_with=("principal-point-drift",),
        formula=f"f *= 1 + rate {by}",
        note="In a board job the distances of the views absorb most of it.",
        usual=usual,
        reveal="the first views again at the end, near and far, and the temperature of the lens with each image",
        source="Smith and Cope 2010, The effects of temperature variation on single-lens-reflex digital cameras",
    )


_GROUPS = {
    TURN: "`turn` is the angle in degrees about the direction of most images: 90, 180 or 270. It follows from the "
    "poses. Remedy: fix the lens in its mount, and do not turn the camera.",
    SERIES: "Images are one series if their file names begin alike up to the last number (`monday_07.png`). Where all "
    "begin alike, a pause of more than ten usual times between images (`t_s`) parts them.",
}
"""How the images of a group are known, for its effects"""


def _principal_point_of(what: str, kind: str, cause: str, confused: tuple[str, ...], reveal: str) -> Effect:
    """Return another principal point of a group of images than that of the first group, the reference."""
    return Effect(
        f"{what}-principal-point",
        cause,
        sizes("cx cy", "pixel", "200 px"),
        lambda block, where: LensChange(block, added=(("cx",), ("cy",))),
        where=(kind,),
        not_first=(kind,),
        confused_with=confused,
        formula=f"cx += cx_{what}, cy += cy_{what}    # in the images of one {kind}; that of most is the reference",
        note=_GROUPS[kind],
        usual="0.5 to 30 px",
        reveal=reveal,
        source=_IMAGE_VARIANT,
    )


def _scale_of_targets(frame: Quantity) -> Effect:
    return Effect(
        "scale-of-targets",
        "all coordinates of the list are too large or too small: a printed board that grew, a wrong pitch",
        sizes("scale", "ratio", "1 percent"),
        lambda block, where: Growth(block, frame),
        confused_with=("focal-drift",),
        formula="X *= 1 + scale",
        note="`diagnose` reports it as not testable unless something else fixes the scale.",
        usual="1e-5 to 1e-3",
        reveal="a calibrated length among the targets (the poses absorb a wrong scale, so no residual shows it)",
        source="VDI/VDE 2634 part 1: lengths, not residuals, show the scale",
    )


PLACES = (
    IMAGE,
    image_point("point-in-camera", Quantity.POINT_IN_CAMERA),
    image_point("point-on-board", Quantity.POINT_ON_BOARD),
    image_point("point-on-targets", Quantity.POINT_ON_TARGETS),
)
"""Quantities on which effects of one's own can act"""


EFFECTS: tuple[Effect, ...] = (
    Effect(
        "radial-distortion",
        "the lens distorts more, or to a higher order, than the radial terms of the job describe",
        (Parameter("k1", plausible=1.0), Parameter("k2", plausible=2.0), Parameter("k3", plausible=5.0)),
        columns_of=_LENS,
        confused_with=("target-eccentricity", "target-plane-bend"),
        formula="x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶), y' likewise    # those of k1, k2, k3 that the job does "
        "not estimate",
        note="k1, k2 and k3 are correlated above 0.95 among themselves. They become part of the lens that the "
        "result states.",
        usual="0.01 to 0.5",
        reveal="targets up to the corners of the image",
        source="Brown 1971, Close-range camera calibration; OpenCV's order of terms",
    ),
    Effect(
        "decentring-distortion",
        "the elements of the lens do not share one axis",
        (Parameter("p1", plausible=0.01), Parameter("p2", plausible=0.01)),
        columns_of=_LENS,
        confused_with=("thin-prism", "principal-point"),
        formula="x' += 2 p1 x y + p2 (r² + 2 x²)\ny' += p1 (r² + 2 y²) + 2 p2 x y",
        note="Where the principal point is free, images of one board with one camera do not separate it from "
        "thin-prism; either one serves as a correction.",
        usual="1e-5 to 1e-3",
        reveal="targets up to the corners, and the camera turned by 90 degrees about its viewing axis between images",
        source="Brown 1966, Decentering distortion of lenses",
    ),
    Effect(
        "thin-prism",
        "an element of the lens is tilted",
        (Parameter("s1", plausible=0.01), Parameter("s3", plausible=0.01)),
        columns_of=_LENS,
        confused_with=("sensor-tilt", "decentring-distortion", "principal-point"),
        formula="x' += s1 r²\ny' += s3 r²",
        note="Where p1, p2, cx and cy are free it is nearly undetermined: it moves the principal point by many "
        "pixels and leaves the residuals as they are.",
        usual="1e-5 to 1e-3",
        reveal="targets up to the corners (p1, p2, cx and cy absorb most of it)",
        source="Weng, Cohen and Herniou 1992, Camera calibration with distortion models",
    ),
    Effect(
        "sensor-tilt",
        "the sensor is not square to the axis of the lens: the lens or the sensor is mounted askew",
        sizes("tau_x tau_y", "angle", "10 deg"),
        columns_of=_LENS,
        confused_with=("thin-prism", "decentring-distortion", "aspect-ratio", "axis-skew"),
        formula="x' <- cos(tau_x) x' / w\n"
        "y' <- (cos(tau_y) y' - sin(tau_x) sin(tau_y) x') / w\n"
        "w = sin(tau_y) x' - cos(tau_y) sin(tau_x) y' + cos(tau_y) cos(tau_x)    # after the distortion",
        note="To first order it is p1 = tau_x/2, p2 = -tau_y/2, s1 = tau_y/2, s3 = -tau_x/2. Without distortion the "
        "poses, the principal point, aspect-ratio and axis-skew absorb it. Of 20 simulated cameras with 0.02 to 0.05 "
        "rad (20 images, 0.1 px, cx, cy, p1, p2 free) 16 are named so, two as thin-prism, and two look clean.",
        usual="0.1 to 5 deg",
        reveal="targets up to the corners (only the distortion shows where the axis of the lens is), and views tilted "
        "about both axes",
        source="OpenCV's tilted model; Steger 2017, A comprehensive and versatile camera model for cameras with tilt "
        "lenses; IDS, manual of the uEye XS (up to 5 deg)",
    ),
    Effect(
        "stretched-targets",
        "the list of targets is longer in x than in y, or sheared: a printer's feed, paper that grows across its grain",
        (*sizes("stretch", "ratio", "1 percent"), *sizes("shear", "angle", "10 mrad")),
        lambda block, where: LinearTerms(block, Quantity.POINT_ON_BOARD, ((0, 0), (0, 1))),
        confused_with=("aspect-ratio", "axis-skew"),
        formula="X <- X (1 + stretch) + shear Y",
        note="Laser printers differ by 0.1 percent between feed and scan, a digital sensor by less than 1e-4. "
        "While the camera keeps its roll, no reading separates the two.",
        usual="10 to 2000 ppm",
        reveal="the camera turned by 45 and 90 degrees about its viewing axis between images, or the board measured",
        source="affine distortion of a print; VDI/VDE 2634 part 1: calibrated lengths in several directions",
    ),
    Effect(
        "aspect-ratio",
        "pixels are not square, or the pixel clock of a frame grabber is off: fx = f (1 + aspect)",
        (Parameter("aspect", "ratio", plausible=0.01),),
        columns_of=_LENS,
        beside=("f",),
        lacks="goes with f: fx and fy already determine the ratio",
        confused_with=("stretched-targets", "target-plane-bend", "axis-skew"),
        formula="fx = f (1 + aspect), fy = f",
        note="Below 1e-4 for a digital sensor read out directly, to 1e-2 for analog cameras. No candidate "
        "where the job has fx and fy in place of f.",
        usual="1e-5 to 1e-2",
        reveal="the camera turned by 90 degrees about its viewing axis between images",
        source="Fraser 1997, Digital camera self-calibration (affinity)",
    ),
    Effect(
        "axis-skew",
        "the rows and columns of the image are not square to each other",
        (Parameter("skew", "ratio", plausible=0.01),),
        columns_of=_LENS,
        confused_with=("stretched-targets", "aspect-ratio"),
        formula="u += fx skew y'",
        note="It equals aspect-ratio turned by 45 degrees.",
        usual="1e-6 to 1e-4",
        reveal="the camera turned by 45 and 90 degrees about its viewing axis between images",
        source="Fraser 1997 (shear)",
    ),
    Effect(
        "principal-point",
        "the axis of the lens does not meet the image at the point that the job gives",
        sizes("cx cy", "pixel", "200 px"),
        columns_of=_LENS,
        confused_with=("decentring-distortion", "thin-prism"),
        formula="u += cx, v += cy    # added to the values of the job; the result states the sums",
        usual="1 to 50 px",
        reveal="views tilted about both axes, and the camera turned about its viewing axis",
        source="Brown 1971",
    ),
    _principal_point_of(
        "turned",
        TURN,
        "images taken with the camera turned have another principal point: the lens or the sensor sags in its mount",
        ("axis-skew", "aspect-ratio"),
        "images in all four directions, several of each; the lens held firmly in its mount",
    ),
    _principal_point_of(
        "series",
        SERIES,
        "the images of one series have another principal point: the lens was taken off, or touched, between the series",
        ("principal-point-drift",),
        "all images in one series; the lens held firmly in its mount",
    ),
    Effect(
        "series-focal-length",
        "the images of one series have another focal length: the lens was focused anew between the series",
        sizes("change", "ratio", "10 percent"),
        lambda block, where: LensChange(block, multiplied=(_FOCAL,)),
        where=(SERIES,),
        not_first=(SERIES,),
        confused_with=("focal-drift",),
        formula="f *= 1 + change    # in the images of one series; that of most images is the reference",
        note=_GROUPS[SERIES],
        usual="1e-4 to 0.05",
        reveal="all images in one series with a fixed focus; views with much depth",
        source=_IMAGE_VARIANT,
    ),
    target_eccentricity(
        "radial-distortion",
        "1 where nothing corrects it, 0 where the job (`eccentricity: correct`) or the detection does; in "
        "pixels f (r/Z)² times sine and cosine of the tilt. One flat board absorbs nearly all of it.",
    ),
    PERSPECTIVE_BLUR,
    Effect(
        "target-plane-bend",
        "the board is not flat: paper on a bent plate, a plate under its own weight",
        sizes("bxx bxy byy", "curvature", "1e-4 1/mm"),
        lambda block, where: PlaneBend(block),
        confused_with=("radial-distortion", "aspect-ratio"),
        formula="Z_board += bxx X² + bxy X Y + byy Y²",
        note="4e-6 1/mm is 0.16 mm over a board of 400 mm.",
        usual="1e-7 to 1e-5 1/mm",
        reveal="steep views from all sides, or the flatness of the board measured",
        source="mrcal's board warp; plate bending to second order",
    ),
    _focal_drift("t", ELAPSED, "rate", "1e-3 1/h", "1e-5 to 1e-3 1/h"),
    _focal_drift("T", WARMING, "expansion", "5e-5 1/K", "1e-6 to 5e-5 1/K"),
    Effect(
        "principal-point-drift",
        "the sensor or the lens moves sideways in the camera while the images are taken",
        sizes("rate_u rate_v", "image speed", "20 px/h"),
        lambda block, where: LensChange(block, added=(("cx",), ("cy",)), condition=ELAPSED),
        needs=("t",),
        confused_with=("focal-drift",),
        formula="cx += rate_u t, cy += rate_v t",
        note="In a board job the pose of each view absorbs most of it. Remedy: switch the camera on an hour before.",
        usual="0.05 to 3 px/h",
        reveal="the first views again at the end",
        source="Smith and Cope 2010; Elias et al. 2020",
    ),
    rolling_shutter("view", "axis-skew", "aspect-ratio"),
    moved_target(Quantity.POINT_ON_BOARD, "target-plane-bend", _SEEN_ONCE),
    moved_target(Quantity.POINT_ON_TARGETS, "target-plane-bend", _SEEN_ONCE),
    LENS_SHAPE,
    _scale_of_targets(Quantity.POINT_ON_BOARD),
    _scale_of_targets(Quantity.POINT_ON_TARGETS),
)
"""The effects in the order of lists. Of two entries with one name, one is for boards and one for other rigs."""
