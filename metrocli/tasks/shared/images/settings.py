"""Settings that calibrate-camera and align-part share, and the keys of a camera in job files and camera files."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import make_dataclass
from typing import Any, Protocol

from metrocli.frozen import dataclass
from metrocli.geometry.poses import EULER
from metrocli.instruments.lenses.distortion import DISTORTION, OF_FISHEYE, RATIONAL, TILT
from metrocli.instruments.lenses.forms import PROGRAMS
from metrocli.instruments.lenses.lens import PARAMETERS, UNITS
from metrocli.settings import Choice, ListOf, MapOf, Number, Section, Whole, WithUnit, setting
from metrocli.targets.pattern import GRIDS, Pattern
from metrocli.tasks.shared.figures import POSE

ESTIMATE = "estimate"
"""Value of `targets` with which coordinates without a standard deviation are unknowns"""


class ImageSettings(Protocol):
    """The shared settings of image jobs, as far as finding and joining of image points needs them."""

    @property
    def noise(self) -> float | str:
        """Standard deviation of an image coordinate, or 'estimated'."""

    @property
    def pattern(self) -> Pattern | None:
        """What the images show."""

    @property
    def eccentricity(self) -> str:
        """auto, correct or ignore."""


ROLLING = "rolling"
"""Shutter that reads the rows of an image one after another"""


def eccentricity_setting() -> str:
    """Return the setting for the eccentricity of circular targets."""
    text = (
        "perspective moves the centre of a circle's image: correct it (needs radii), ignore it, "
        "or auto: correct it if circles of known size are found in images"
    )
    chosen: str = setting(Choice("auto", "correct", "ignore"), text, default="auto")
    return chosen


def shutter_setting() -> str:
    """Return the setting for how the rows of an image are read."""
    text = "global: all rows of an image at once; rolling: one after another, and `diagnose` looks for motion meanwhile"
    chosen: str = setting(Choice("global", ROLLING), text, default="global")
    return chosen


def targets_setting() -> str:
    """Return the setting for coordinates of targets that have no standard deviation."""
    text = (
        "coordinates of targets without a standard deviation: exact as listed, or unknowns that start at the list, "
        "which then gives only their common place, rotation and size"
    )
    chosen: str = setting(Choice("listed", ESTIMATE), text, default="listed")
    return chosen


def image_faults(
    observations: object, images: object, pattern: Pattern | None, targets: object
) -> Iterable[tuple[str, str]]:
    """Yield (key, message) for what is missing among observations, images, targets and pattern."""
    if (observations is None) == (images is None):
        yield "inputs", "give either observations (a CSV file) or images (with a pattern), exactly one of the two"
    if images is not None and pattern is None:
        example = "pattern: {type: chessboard, columns: 9, rows: 6, pitch: 25 mm}"
        yield "inputs.images", f"images need a pattern that describes their targets, e.g. {example}"
    if targets is None and (observations or pattern) is not None and (pattern is None or pattern.type not in GRIDS):
        yield "inputs", "the key 'targets' is missing in 'inputs': the coordinates of the targets"


SPLINE = "spline"
MODELS = {"opencv": "forward", "fisheye": "fisheye", "backward": "backward", "division": "backward"}
"""The convention of each lens model"""
_TERMS = {
    "fisheye": OF_FISHEYE,
    "backward": tuple(name for name in DISTORTION if name not in TILT),
    "division": RATIONAL,
}
"""Distortion parameters of models that lack some"""
_PX = WithUnit("pixel")
_FOCAL = WithUnit("pixel", minimum=1.0)
_ANGLE = WithUnit("angle")


@dataclass(frozen=True, kw_only=True)
class LensValues:
    """Lens parameters; those not given are 0 (cx, cy: the image centre)."""

    f: float | None = setting(_FOCAL, "focal length, one for both axes", default=None)
    fx: float | None = setting(_FOCAL, "focal length along u", default=None)
    fy: float | None = setting(_FOCAL, "focal length along v", default=None)
    aspect: float | None = setting(Number(), "fx = f (1 + aspect)", default=None)
    cx: float | None = setting(_PX, "principal point", default=None)
    cy: float | None = setting(_PX, "principal point", default=None)
    skew: float | None = setting(Number(), "u += fx skew y'", default=None)
    k1: float | None = setting(Number(), "radial distortion", default=None)
    k2: float | None = setting(Number(), "radial distortion", default=None)
    k3: float | None = setting(Number(), "radial distortion", default=None)
    k4: float | None = setting(Number(), "rational radial distortion; the fourth radial one of a fisheye", default=None)
    k5: float | None = setting(Number(), "rational radial distortion", default=None)
    k6: float | None = setting(Number(), "rational radial distortion", default=None)
    p1: float | None = setting(Number(), "tangential distortion", default=None)
    p2: float | None = setting(Number(), "tangential distortion", default=None)
    s1: float | None = setting(Number(), "thin prism", default=None)
    s2: float | None = setting(Number(), "thin prism", default=None)
    s3: float | None = setting(Number(), "thin prism", default=None)
    s4: float | None = setting(Number(), "thin prism", default=None)
    tau_x: float | None = setting(_ANGLE, "tilt of the sensor about x", default=None)
    tau_y: float | None = setting(_ANGLE, "tilt of the sensor about y", default=None)

    def given(self) -> dict[str, float]:
        """Return the parameters that the file gives, by name."""
        return {name: value for name in PARAMETERS if (value := getattr(self, name)) is not None}


@dataclass(frozen=True, kw_only=True)
class LensModel(LensValues):
    """Lens parameters with the model that they belong to."""

    model: str | None = setting(
        Choice(*MODELS, SPLINE),
        "opencv: distortion of the tangent of the angle from the axis; fisheye: of the angle itself (equidistant); "
        "backward: correction at the measured point; division: backward, with k4 k5 k6 only; "
        "spline: base, with a smooth shift over the image",
        default=None,
    )
    convention: str = setting(
        Choice("forward", "backward"),
        "forward: distortion at the ideal point; backward: correction at the measured point",
        default=None,
    )

    @property
    def formula(self) -> str:
        """Return the model that its parameters belong to."""
        return self.model or "opencv"

    def __post_init__(self) -> None:
        if self.convention is None:
            object.__setattr__(self, "convention", MODELS[self.formula])

    def model_faults(self, chosen: Collection[str], key: str) -> Iterable[tuple[str, str]]:
        """Yield (key, message) for a model and a convention, or parameters, that contradict each other."""
        if self.model and self.convention != MODELS[self.formula]:
            yield (
                "model",
                f"the model {self.model} does not go with the convention {self.convention}: leave out convention",
            )
        named = self.formula if self.model else self.convention
        lacking = set(chosen) - set(_TERMS.get(named, DISTORTION))
        if wrong := [name for name in DISTORTION if name in lacking]:
            yield key, f"the model {named} has no {' '.join(wrong)}"


@dataclass(frozen=True, kw_only=True)
class Extrinsics:
    """The camera in the taper: `X_taper = R(alpha, beta, gamma) X_camera + (x, y, z)`."""

    x: float = setting(WithUnit("length"), "x of the camera's centre")
    y: float = setting(WithUnit("length"), "y of the camera's centre")
    z: float = setting(WithUnit("length"), "z of the camera's centre")
    alpha: float = setting(WithUnit("angle"), "turn about x, first")
    beta: float = setting(WithUnit("angle"), "turn about y, second")
    gamma: float = setting(WithUnit("angle"), "turn about z, third")


_SPREAD: Mapping[str, Any] = {
    "px": WithUnit("pixel", minimum=0.0), "rad": WithUnit("angle", minimum=0.0), "mm": WithUnit("length", minimum=0.0)
}  # fmt: skip
CameraUncertainty: Any = make_dataclass(
    "CameraUncertainty",
    [
        (name, float | None, setting(_SPREAD.get(unit, Number(minimum=0.0)), f"of {name}", default=None))
        for name, unit in ({name: UNITS.get(name, "1") for name in PARAMETERS} | POSE).items()
    ],
    frozen=True,
    kw_only=True,
)
CameraUncertainty.__doc__ = "Standard uncertainties of a camera file: lens parameters, and the camera in the taper."


@dataclass(frozen=True, kw_only=True)
class OfCameraFile:
    """What a camera file does not state."""

    extrinsics: Extrinsics | None = setting(Section(Extrinsics), "the camera in the taper", default=None)
    uncertainty: Any = setting(
        Section(CameraUncertainty), "standard uncertainties, as if independent; what is left out is exact", default=None
    )

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield (key, message) for a pose of which some uncertainties are missing."""
        given = {name for name, value in vars(self.uncertainty).items() if value} if self.uncertainty else set()
        if lacking := sorted(set(EULER) - given, key=EULER.index) if given & set(EULER) else []:
            text = "the pose of the camera has uncertainties of all six or of none: {} missing"
            yield "uncertainty", text.format(" ".join(lacking))


CAMERA_FILES = (".txt", ".xml", ".cameramodel", ".m")
"""Endings of camera files of other programs that are not YAML"""


_SIZE = ListOf(Whole(minimum=2, maximum=100_000), length=2)


@dataclass(frozen=True, kw_only=True)
class StatedShape:
    """A smooth shift of image points over the image, on knots: cubic B-splines, row by row."""

    knots: tuple[int, int] = setting(ListOf(Whole(minimum=4, maximum=1000), length=2), "columns and rows of knots")
    du: tuple[float, ...] = setting(ListOf(Number()), "coefficients of the shift along u [px]")
    dv: tuple[float, ...] = setting(ListOf(Number()), "coefficients of the shift along v [px]")

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield (key, message) for coefficients of another number than the knots."""
        count = self.knots[0] * self.knots[1]
        for key, given in (("du", self.du), ("dv", self.dv)):
            if len(given) != count:
                yield key, f"{len(given)} coefficients: knots {list(self.knots)} have {count}"


@dataclass(frozen=True, kw_only=True)
class CalibratedLens(LensModel):
    """The lens of a calibrated camera, and the size of its images."""

    image_size: tuple[int, int] = setting(_SIZE, "width and height in pixels", default=None)
    pixel_size: float | None = setting(WithUnit("length", positive=True), "side of a pixel", default=None)
    model: str | None = setting(Choice(*MODELS), "opencv, fisheye, backward or division", default=None)
    shape: StatedShape | None = setting(
        Section(StatedShape), "what the lens model spline adds to these, of a single camera", default=None
    )

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield (key, message) for what is missing, and a focal length that is given twice."""
        if self.image_size is None:
            yield "", "the key 'image_size' is missing: width and height in pixels"
        given = set(self.given())
        if not ("f" in given or {"fx", "fy"} <= given):
            yield "", "the focal length is missing: give f, or fx and fy"
        if "f" in given and given & {"fx", "fy"}:
            yield "f", "give either f, or fx and fy"
        if self.shape is not None and self.convention == "backward":
            yield "shape", f"the model {self.model or self.convention} has none: opencv and fisheye have"
        yield from self.model_faults(given, "model")


@dataclass(frozen=True, kw_only=True)
class CameraOfRig(CalibratedLens):
    """One of several calibrated cameras that are fixed to each other."""

    pose: Extrinsics | None = setting(
        Section(Extrinsics), "the camera in the frame of the first; of the first itself none", default=None
    )


@dataclass(frozen=True, kw_only=True)
class CameraFile(CalibratedLens):
    """A calibrated camera, or several that are fixed to each other, written by hand or by another program."""

    program: str | None = setting(Choice(*PROGRAMS), "the program whose file this was", default=None)
    extrinsics: Extrinsics | None = setting(Section(Extrinsics), "the camera, or the first, in the taper", default=None)
    cameras: dict[str, CameraOfRig] | None = setting(
        MapOf(Section(CameraOfRig)), "several cameras by name, the first without a pose", default=None
    )

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield (key, message) for faults of a single camera, or for poses of several that are missing."""
        if self.cameras is None:
            yield from super().faults()
            return
        if self.given() or self.image_size is not None:
            yield "cameras", "with several cameras, lens and image_size stand at each of them"
        for number, (name, camera) in enumerate(self.cameras.items()):
            if camera.shape is not None:
                yield f"cameras.{name}.shape", "several cameras have none: each of them alone may"
            if (camera.pose is None) != (number == 0):
                message = "the first camera has no pose: it is the frame of the others" if number == 0 else ""
                yield f"cameras.{name}", message or "its pose in the frame of the first is missing"
