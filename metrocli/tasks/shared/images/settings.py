"""Settings that calibrate-camera and align-part share, and the keys of a camera in job files and camera files."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from metrocli.frozen import dataclass
from metrocli.instruments.lens import PARAMETERS
from metrocli.settings import Choice, ListOf, Number, Quantity, Section, Whole, setting
from metrocli.targets.pattern import GRIDS, Pattern

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
    if targets is None and (observations is not None or (pattern is not None and pattern.type not in GRIDS)):
        yield "inputs", "the key 'targets' is missing in 'inputs': the coordinates of the targets"


_PX = Quantity("pixel")
_FOCAL = Quantity("pixel", minimum=1.0)


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
    k4: float | None = setting(Number(), "rational radial distortion", default=None)
    k5: float | None = setting(Number(), "rational radial distortion", default=None)
    k6: float | None = setting(Number(), "rational radial distortion", default=None)
    p1: float | None = setting(Number(), "tangential distortion", default=None)
    p2: float | None = setting(Number(), "tangential distortion", default=None)
    s1: float | None = setting(Number(), "thin prism", default=None)
    s2: float | None = setting(Number(), "thin prism", default=None)
    s3: float | None = setting(Number(), "thin prism", default=None)
    s4: float | None = setting(Number(), "thin prism", default=None)

    def given(self) -> dict[str, float]:
        """Return the parameters that the file gives, by name."""
        return {name: value for name in PARAMETERS if (value := getattr(self, name)) is not None}


@dataclass(frozen=True, kw_only=True)
class Extrinsics:
    """The camera in the taper: `X_taper = R(alpha, beta, gamma) X_camera + (x, y, z)`."""

    x: float = setting(Quantity("length"), "x of the camera's centre")
    y: float = setting(Quantity("length"), "y of the camera's centre")
    z: float = setting(Quantity("length"), "z of the camera's centre")
    alpha: float = setting(Quantity("angle"), "turn about x, first")
    beta: float = setting(Quantity("angle"), "turn about y, second")
    gamma: float = setting(Quantity("angle"), "turn about z, third")


@dataclass(frozen=True, kw_only=True)
class CameraFile(LensValues):
    """A calibrated camera written by hand, taken as exact."""

    image_size: tuple[int, int] = setting(
        ListOf(Whole(minimum=2, maximum=100_000), length=2), "width and height in pixels"
    )
    pixel_size: float | None = setting(Quantity("length", positive=True), "side of a pixel", default=None)
    convention: str = setting(
        Choice("forward", "backward"),
        "forward: distortion at the ideal point; backward: correction at the measured point",
        default="forward",
    )
    extrinsics: Extrinsics | None = setting(Section(Extrinsics), "the camera in the taper", default=None)

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield (key, message) for a focal length that is missing or given twice."""
        given = set(self.given())
        if not ("f" in given or {"fx", "fy"} <= given):
            yield "", "the focal length is missing: give f, or fx and fy"
        if "f" in given and given & {"fx", "fy"}:
            yield "f", "give either f, or fx and fy"
