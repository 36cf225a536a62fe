"""What a calibration result states of its cameras: lens and its shape, images, and where each of several is."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.effects.links.lens_shape import Knots, KnownShape, unshifted
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments.lenses.lens import direction
from metrocli.result import Result
from metrocli.table import Table

CAMERAS, LENS_SHAPE = "cameras", "lens_shape"
"""Tables of several cameras, and of the shift over the image that a spline adds to its base lens"""
DIRECTIONS, SHAPE_COVARIANCE = "lens_shape_directions", "lens_shape_covariance"
"""Arrays D (coefficients, k) and the covariance of lens, pose in the taper, and z: the coefficients are the stated ones
plus D z"""


@dataclass(frozen=True)
class StatedCamera:
    """A camera as a result states it."""

    name: str
    """Empty for a single camera"""
    lens: Mapping[str, float]
    convention: str
    size: tuple[int, int]
    images: str = "*"
    """Names of its images, with one *; empty if there are none"""
    pose: Array | None = None
    """In the frame of the first of several (6,); None for the first and for a single camera"""
    shape: KnownShape | None = None

    def direction(self, uv: Array) -> Array:
        """Return vectors (3, n), of any length, to what is seen at image points (2, n) px."""
        u, v = unshifted(uv, self.shape)
        return direction(self.lens, u, v, self.convention)


def of_each(table: Table) -> list[tuple[str, Index]]:
    """Return the name and the rows of each camera of a table; the name is empty where there is one."""
    if "camera" not in table:
        return [("", np.arange(len(table)))]
    names = np.array(table.texts("camera"))
    return [(name, np.flatnonzero(names == name)) for name in dict.fromkeys(names.tolist())]


def stated_cameras(result: Result) -> list[StatedCamera]:
    """Return the cameras of a calibration result."""
    table, convention = result.tables["camera"], str(result.statistics["convention"])
    named = list(zip(table.texts("parameter"), table.numbers("value").tolist(), strict=True))
    cameras = result.tables.get(CAMERAS)
    if cameras is None:
        width, height = (int(float(result.statistics[name])) for name in _SIZE)  # type: ignore[arg-type]
        return [StatedCamera("", dict(named), convention, (width, height), shape=_shape(result, (width, height)))]
    sizes = cameras.stacked(_SIZE).astype(int).tolist()
    images = cameras.texts("images") if "images" in cameras else [""] * len(cameras)
    conventions = cameras.texts("convention") if "convention" in cameras else [convention] * len(cameras)
    place, found = cameras.stacked(poses.EULER), list[StatedCamera]()
    for row, name in enumerate(cameras.texts("camera")):
        lens = {key: value for of, (key, value) in zip(table.texts("camera"), named, strict=True) if of == name}
        pose = poses.pose_from_euler(place[row, :3], place[row, 3:]) if row else None
        size = tuple(sizes[row])
        found.append(StatedCamera(name, lens, conventions[row], size, images[row], pose, _shape(result, size, name)))
    return found


_SIZE = ("image_width", "image_height")


def _shape(result: Result, image_size: tuple[int, int], camera: str = "") -> KnownShape | None:
    if LENS_SHAPE not in result.tables:
        return None
    table = result.tables[LENS_SHAPE]
    rows = dict(of_each(table)).get(camera)
    if rows is None:
        return None
    knots = Knots(image_size, (len(np.unique(table.numbers("u")[rows])), len(np.unique(table.numbers("v")[rows]))))
    return KnownShape(knots, table.stacked(("du", "dv"))[rows].T)
