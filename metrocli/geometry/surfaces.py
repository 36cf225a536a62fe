"""Ideal surfaces of a part: planes, cylinders, cones and spheres, with signed distance, normal and curvature.

All four are one formula. Let v lead from the origin of the surface to the point, h = a.v along the axis a, and r be
the length of what is square to it. The signed distance is `o = s (c r - t h - R)`. A plane has c = 0, t = -1. A
cylinder has c = 1, t = 0. A cone has the cosine and sine of its half angle. A sphere has c = 1 and no axis: r = |v|.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass

_SMALL = 1e-12
"""Distance from an axis [mm] below which the direction away from it is not defined"""


@dataclass(frozen=True)
class Shape:
    """Surfaces near points: what a small movement of each point changes."""

    distance: Array
    """Signed distance, positive on the outside (n,)"""
    normal: Array
    """Its gradient: the outward normal (n, 3)"""
    bend: Array
    """Its second derivative (n, 3, 3)"""

    def of(self, rows: Index | slice) -> Shape:
        """Return the shape at some of the points."""
        return Shape(self.distance[rows], self.normal[rows], self.bend[rows])


@dataclass(frozen=True)
class Surface:
    """One ideal surface; `plane`, `cylinder`, `cone` and `sphere` make them."""

    name: str
    origin: Array
    axis: Array
    cosine: float
    sine: float
    radius: float
    sign: float
    """+1 if the material is on the inside of the surface, -1 if it is outside, as at a bore"""


def plane(name: str, point: Array, normal: Array) -> Surface:
    """Return a plane through a point, with its outward normal."""
    return Surface(name, point, normal / np.linalg.norm(normal), 0.0, -1.0, 0.0, 1.0)


def cylinder(name: str, point: Array, axis: Array, radius: float, sign: float) -> Surface:
    """Return a cylinder about the axis through a point."""
    return Surface(name, point, axis / np.linalg.norm(axis), 1.0, 0.0, radius, sign)


def cone(name: str, apex: Array, axis: Array, half_angle: float, sign: float) -> Surface:
    """Return a cone that widens from its apex along the axis."""
    unit = axis / np.linalg.norm(axis)
    return Surface(name, apex, unit, float(np.cos(half_angle)), float(np.sin(half_angle)), 0.0, sign)


def sphere(name: str, centre: Array, radius: float, sign: float) -> Surface:
    """Return a sphere."""
    return Surface(name, centre, np.zeros(3), 1.0, 0.0, radius, sign)


@dataclass(frozen=True)
class Surfaces:
    """The surfaces of a part, as arrays over the surfaces."""

    names: tuple[str, ...]
    origin: Array
    """(S, 3)"""
    axis: Array
    """(S, 3); zero for a sphere"""
    cosine: Array
    sine: Array
    radius: Array
    sign: Array

    @classmethod
    def of(cls, surfaces: Sequence[Surface]) -> Surfaces:
        """Return the surfaces side by side."""
        columns = [np.array([getattr(surface, name) for surface in surfaces], dtype=float) for name in cls._numbers()]
        return cls(tuple(surface.name for surface in surfaces), *columns)

    @staticmethod
    def _numbers() -> tuple[str, ...]:
        return ("origin", "axis", "cosine", "sine", "radius", "sign")

    def reversed(self, surface: int) -> Surfaces:
        """Return the surfaces with the material of one of them on the other side."""
        values = {name: getattr(self, name) for name in self._numbers()}
        sign = self.sign.copy()
        sign[surface] *= -1
        return Surfaces(self.names, **{**values, "sign": sign})

    def distances(self, points: Array, surface: Index) -> tuple[Array, Array]:
        """Return signed distances (...) of points (..., n, 3) from a surface each (n,) or (..., n), and the normals."""
        along, radial, length = self._parts(points, surface)
        c, t, s = self.cosine[surface], self.sine[surface], self.sign[surface]
        distance = s * (c * length - t * along - self.radius[surface])
        outward = radial / np.maximum(length, _SMALL)[..., None]
        return distance, s[..., None] * (c[..., None] * outward - t[..., None] * self.axis[surface])

    def nearest(self, points: Array, levels: Array | float = 0.0) -> Index:
        """Return the surface whose distance from each point (..., 3) is nearest to the level (S,) of that surface."""
        of_all = np.broadcast_to(np.arange(len(self.names)), (*points.shape[:-1], len(self.names)))
        distance, _ = self.distances(points[..., None, :], of_all)
        return np.asarray(np.argmin(np.abs(distance - levels), axis=-1), dtype=np.intp)

    def shape(self, points: Array, surface: Index) -> Shape:
        """Return distance, normal and curvature at points (n, 3), each on the surface of its index (n,)."""
        distance, normal = self.distances(points, surface)
        _, radial, length = self._parts(points, surface)
        outward = radial / np.maximum(length, _SMALL)[:, None]
        axis = self.axis[surface]
        # the projection square to the axis and to the direction away from it: a surface bends around its axis only;
        # a sphere has axis 0 and bends in both directions
        across = np.eye(3) - outward[:, :, None] * outward[:, None, :] - axis[:, :, None] * axis[:, None, :]
        curvature = self.sign[surface] * self.cosine[surface] / np.maximum(length, _SMALL)
        return Shape(distance, normal, curvature[:, None, None] * across)

    def _parts(self, points: Array, surface: Index) -> tuple[Array, Array, Array]:
        """Return height along the axis, the vector away from it, and its length."""
        from_origin = points - self.origin[surface]
        axis = self.axis[surface]
        along = np.einsum("...k,...k->...", from_origin, axis)
        radial = from_origin - along[..., None] * axis
        return along, radial, np.linalg.norm(radial, axis=-1)
