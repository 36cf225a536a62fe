"""What a calibration result states of its cameras, and where two cameras image the same directions."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.effects.links.lens_shape import Knots, KnownShape, unshifted
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.geometry.rotations import nearest_rotation
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
    images = cameras.texts("images", "")
    conventions = cameras.texts("convention") if "convention" in cameras else [convention] * len(cameras)
    place, stated = cameras.stacked(poses.EULER), list[StatedCamera]()
    for row, name in enumerate(cameras.texts("camera")):
        lens = {key: value for of, (key, value) in zip(table.texts("camera"), named, strict=True) if of == name}
        pose = poses.pose_from_euler(place[row, :3], place[row, 3:]) if row else None
        size = tuple(sizes[row])
        stated.append(StatedCamera(name, lens, conventions[row], size, images[row], pose, _shape(result, size, name)))
    return stated


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


GRID = (17, 13)
"""Columns and rows of places over the image"""
_STEP, _ROUNDS = 1e-3, 8
"""Step of the derivatives [px], and rounds of Gauss and Newton"""


@dataclass(frozen=True)
class LensDifference:
    """Image points of the second camera less those of the first, of the same directions."""

    name: str
    """Of the camera, empty for a single one"""
    uv: Array
    """Image points of the first camera, (2, n) px"""
    change: Array
    """(2, n) px; nan where a lens has no inverse"""
    size: tuple[int, int]

    @property
    def rms(self) -> float:
        """Root mean square length [px]."""
        return float(np.sqrt(np.nanmean((self.change**2).sum(axis=0))))

    @property
    def largest(self) -> tuple[float, float, float]:
        """Largest length [px], and u and v where it is."""
        length = np.hypot(*self.change)
        worst = int(np.nanargmax(length))
        return float(length[worst]), float(self.uv[0, worst]), float(self.uv[1, worst])


def lens_differences(first: Result, second: Result) -> list[LensDifference]:
    """Return the difference of each camera that two results of calibrate-camera have, by their names."""
    if not all("camera" in result.tables and "convention" in result.statistics for result in (first, second)):
        return []
    others = {camera.name: camera for camera in stated_cameras(second)}
    pairs = [(camera, others[camera.name]) for camera in stated_cameras(first) if camera.name in others]
    differences = [_difference(camera, other) for camera, other in pairs if camera.size == other.size]
    return [difference for difference in differences if np.isfinite(difference.change).any()]


def _difference(first: StatedCamera, other: StatedCamera) -> LensDifference:
    along = [np.linspace(0, extent - 1, n) for extent, n in zip(first.size, GRID, strict=True)]
    uv = np.stack([part.ravel() for part in np.meshgrid(*along)])
    seen, there = _units(first, uv), _units(other, uv)
    known = np.isfinite(seen).all(axis=0) & np.isfinite(there).all(axis=0)
    # what a turn of the camera explains is not a difference of its lens: the poses of its images take it up
    rotation = nearest_rotation(there[:, known] @ seen[:, known].T)
    wanted, at = rotation @ seen, uv.copy()
    for _ in range(_ROUNDS):
        here = _units(other, at)
        by_u, by_v = ((_units(other, at + step) - here) / _STEP for step in np.eye(2)[:, :, None] * _STEP)
        left = wanted - here
        a, b, c = (by_u * by_u).sum(axis=0), (by_u * by_v).sum(axis=0), (by_v * by_v).sum(axis=0)
        # normal equations of two unknowns for each place, solved in closed form
        p, q = (by_u * left).sum(axis=0), (by_v * left).sum(axis=0)
        at = at + np.stack([c * p - b * q, a * q - b * p]) / (a * c - b * b)
    return LensDifference(first.name, uv, at - uv, first.size)


def _units(camera: StatedCamera, uv: Array) -> Array:
    seen = camera.direction(uv)
    return np.asarray(seen / np.linalg.norm(seen, axis=0))
