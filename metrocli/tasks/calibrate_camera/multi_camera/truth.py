"""The truth that `metrocli simulate` starts from: of a camera, or of several that are fixed to each other."""

from __future__ import annotations

from collections.abc import Iterable

from metrocli.frozen import dataclass
from metrocli.settings import MapOf, Section, Whole, WithUnit, setting
from metrocli.tasks.shared.images.settings import Extrinsics, LensValues


def _without_focal(lens: LensValues) -> Iterable[tuple[str, str]]:
    given = set(lens.given())
    if not ("f" in given or {"fx", "fy"} <= given):
        yield "lens", "the focal length is missing: give f, or fx and fy"


@dataclass(frozen=True, kw_only=True)
class TrueCamera:
    """The truth of one of several cameras."""

    lens: LensValues = setting(Section(LensValues), "true lens parameters")
    extrinsics: Extrinsics | None = setting(
        Section(Extrinsics), "the camera in the frame of the first; not for the first itself", default=None
    )

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield (key, message) if the focal length is missing."""
        yield from _without_focal(self.lens)


@dataclass(frozen=True, kw_only=True)
class CameraSimulation:
    """The truth that `metrocli simulate` starts from."""

    lens: LensValues | None = setting(Section(LensValues), "true lens parameters of a single camera", default=None)
    cameras: dict[str, TrueCamera] | None = setting(
        MapOf(Section(TrueCamera)), "the truth of each of several cameras, by its name", default=None
    )
    extrinsics: Extrinsics | None = setting(
        Section(Extrinsics), "rig cmm: the camera, or the first of several, in the reference frame", default=None
    )
    images: int = setting(Whole(minimum=1, maximum=100_000), "rigs board and network: number of images", default=15)
    distance: float = setting(
        WithUnit("length", positive=True), "rigs board and network: mean distance of the camera", default=600.0
    )
    tilt: float = setting(
        WithUnit("angle", positive=True), "rigs board and network: largest tilt of a view", default=0.6
    )
    interval: float | None = setting(
        WithUnit("time", positive=True), "time from image to image; without it no times are written", default=None
    )
    warming: float = setting(
        WithUnit("temperature difference"), "how much the camera warms up from first to last image", default=0.0
    )

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield (key, message) if the lens is missing, or its focal length."""
        if (self.lens is None) is (self.cameras is None):
            yield "lens", "give the lens of a single camera, lens: {...}, or that of each under cameras"
        elif self.lens is not None:
            yield from _without_focal(self.lens)
