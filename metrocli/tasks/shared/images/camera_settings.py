"""The keys of a camera in job files and camera files."""

from __future__ import annotations

from collections.abc import Iterable

from metrocli.frozen import dataclass
from metrocli.instruments.lens import PARAMETERS
from metrocli.settings import Choice, ListOf, Number, Quantity, Section, Whole, setting

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
