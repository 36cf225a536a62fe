"""A pinhole camera with radial distortion, written for the tests alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    size: tuple[int, int] = (640, 480)
    f: float = 700.0
    k1: float = 0.0

    @property
    def middle(self) -> Array:
        return (np.array(self.size) - 1) / 2

    def rays(self, uv: Array) -> Array:
        far = (uv - self.middle) / self.f
        near = far.copy()
        for _ in range(30):
            before, near = near, far / (1 + self.k1 * (near**2).sum(1, keepdims=True))
            if np.array_equal(near, before):
                break
        both = np.column_stack([near, np.ones(len(near))])
        return np.asarray(both / np.linalg.norm(both, axis=1, keepdims=True))

    def project(self, points: Array) -> Array:
        flat = points[:, :2] / points[:, 2:]
        return np.asarray(self.f * flat * (1 + self.k1 * (flat**2).sum(1, keepdims=True)) + self.middle)

    def centre_of_image(self, middle: Array, normal_frame: Array, radius: float) -> Array:
        """Centroid of the imaged disc, by integration over its rim: the ellipse's centre where the lens is straight."""
        turn = np.linspace(0, 2 * np.pi, 3600, endpoint=False)
        rim = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1) * radius
        u, v = (self.project(rim @ normal_frame.T + middle)).T
        cross = u * np.roll(v, -1) - np.roll(u, -1) * v
        return np.array([((w + np.roll(w, -1)) * cross).sum() / (3 * cross.sum()) for w in (u, v)])


def tilted(rng: np.random.Generator, most: float, upright: bool = False) -> Array:
    """Rotation of a plane tilted by up to `most` radians about a random axis, and turned about its normal."""
    axis, angle, turn = rng.uniform(0, 2 * np.pi), rng.uniform(0, most), 0.0 if upright else rng.uniform(0, 2 * np.pi)
    return about_z(axis) @ about_x(angle) @ about_z(turn - axis)


def about_z(angle: float) -> Array:
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])


def about_x(angle: float) -> Array:
    return np.array([[1.0, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
