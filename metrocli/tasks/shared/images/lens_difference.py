"""Where two cameras image the same directions: the difference over the image after the best rotation of one of them.

A rotation of a camera is a rotation of its poses, not a difference of its lens (mrcal, differencing).
"""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.geometry.rotations import nearest_rotation
from metrocli.result import Result
from metrocli.tasks.shared.images.calibrated import StatedCamera, stated_cameras

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
    pairs = [(one, others[one.name]) for one in stated_cameras(first) if one.name in others]
    found = [_difference(one, other) for one, other in pairs if one.size == other.size]
    return [one for one in found if np.isfinite(one.change).any()]


def _difference(one: StatedCamera, other: StatedCamera) -> LensDifference:
    along = [np.linspace(0, extent - 1, n) for extent, n in zip(one.size, GRID, strict=True)]
    uv = np.stack([part.ravel() for part in np.meshgrid(*along)])
    seen, there = _units(one, uv), _units(other, uv)
    known = np.isfinite(seen).all(axis=0) & np.isfinite(there).all(axis=0)
    # what a turn of the camera explains is no difference of its lens: the poses of its images take it up
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
    return LensDifference(one.name, uv, at - uv, one.size)


def _units(camera: StatedCamera, uv: Array) -> Array:
    seen = camera.direction(uv)
    return np.asarray(seen / np.linalg.norm(seen, axis=0))
