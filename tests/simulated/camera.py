"""A camera for the tests of the engine, written without the engine: plain formulas, own random draws."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

SIZE = (2400, 1800)
LENS = {"f": 2600.0, "cx": 1210.0, "cy": 885.0, "k1": -0.12, "k2": 0.09, "p1": 4e-4, "p2": -3e-4}


def rotation(vector: Array) -> Array:
    """Turn about a vector by its length, from its two halves' reflections (quaternion)."""
    angle = np.linalg.norm(vector)
    x, y, z = np.sin(angle / 2) * vector / (angle or 1.0)
    w = np.cos(angle / 2)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def image(points: Array, lens: Mapping[str, float] = LENS) -> Array:
    """Image points (2, n) of points in the camera (n, 3)."""
    x, y = (points[:, :2] / points[:, 2:]).T
    r2 = x**2 + y**2
    k1, k2, p1, p2 = (lens.get(name, 0.0) for name in ("k1", "k2", "p1", "p2"))
    radial = 1 + k1 * r2 + k2 * r2**2
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y**2)
    return np.stack([lens["f"] * u + lens["cx"], lens["f"] * v + lens["cy"]])


def board(columns: int = 9, rows: int = 7, pitch: float = 30.0) -> Array:
    """Targets (n, 3) of a flat board, its corner at the origin."""
    x, y = np.meshgrid(np.arange(columns) * pitch, np.arange(rows) * pitch)
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


@dataclass(frozen=True)
class Seen:
    """What the camera saw, and the truth."""

    points: Array
    """(m, 3)"""
    turns: Array
    """Rotation vectors of targets into the camera (views, 3)"""
    shifts: Array
    uv: Array
    """(2, n)"""
    target: Index
    view: Index

    @property
    def views(self) -> int:
        """Number of views."""
        return len(self.turns)

    @property
    def poses(self) -> Array:
        """True poses (views, 6) of targets in the camera."""
        return np.column_stack([self.shifts, self.turns])

    def noisy(self, sigma: float, seed: int) -> Seen:
        """The same with normal noise."""
        return replace(self, uv=self.uv + sigma * np.random.default_rng(seed).normal(size=self.uv.shape))


def look(
    points: Array,
    views: int,
    seed: int,
    *,
    distance: float = 700.0,
    tilt: float = 45.0,
    off: float = 0.1,
    lens: Mapping[str, float] = LENS,
    inside: bool = False,
) -> Seen:
    """Look at points from random sides: tilted up to `tilt` degrees from their z axis, any roll, `off` the middle of the image."""
    rng = np.random.default_rng(seed)
    centre = points.mean(axis=0)
    turns, shifts = [], []
    for _ in range(views):
        side = rng.uniform(0, 2 * np.pi)
        lean = np.radians(tilt) * np.sqrt(rng.uniform(0.02, 1))
        matrix = rotation(np.array([0, 0, rng.uniform(-np.pi, np.pi)])) @ rotation(
            lean * np.array([np.cos(side), np.sin(side), 0])
        )
        away = distance * rng.uniform(0.8, 1.25)
        aim = away * np.array([*rng.uniform(-off, off, 2), 1.0])
        turns.append(_vector(matrix))
        shifts.append(aim - matrix @ centre)
    m = len(points)
    target, view = np.tile(np.arange(m), views), np.repeat(np.arange(views), m)
    matrices = np.array([rotation(turn) for turn in turns])
    seen = (matrices[view] @ points[target][:, :, None])[:, :, 0] + np.array(shifts)[view]
    uv = image(seen, lens)
    keep = seen[:, 2] > 0
    if inside:
        keep &= (uv > 0).all(axis=0) & (uv < np.array(SIZE)[:, None]).all(axis=0)
    return Seen(points, np.array(turns), np.array(shifts), uv[:, keep], target[keep], view[keep])


def _vector(matrix: Array) -> Array:
    """Rotation vector of a matrix, by its eigenvector of eigenvalue 1."""
    values, vectors = np.linalg.eig(matrix)
    axis = np.real(vectors[:, np.argmin(np.abs(values - 1))])
    odd = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    return axis * np.arctan2(odd @ axis / 2, (np.trace(matrix) - 1) / 2)
