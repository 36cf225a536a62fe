"""Ideal lines, planes, circles, spheres, cylinders and cones, and the distances of points from them.

Let v lead from the origin to the point, h = a.v along the axis a, and r = |v - h a|. The signed distance is h from a
plane, r - R from a cylinder, and |v| - R from a sphere. It is `cos(w) (r - R) - sin(w) h` from a cone of half angle w
with the radius R at its origin. A line has the vector v - h a, a circle the pair (r - R, h).
Method: docs/algorithms/feature-fits.md.
"""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from metrocli.arrays import Array
from metrocli.frozen import dataclass

Numbers = npt.NDArray[Any]
"""Real, or complex in a derivative"""
_TINY = 1e-150
"""Imaginary step of a derivative: it has no rounding, since nothing is subtracted (Squire and Trapp 1998)"""


class IdealFeature(StrEnum):
    """The ideal features."""

    LINE = "line"
    PLANE = "plane"
    CIRCLE = "circle"
    SPHERE = "sphere"
    CYLINDER = "cylinder"
    CONE = "cone"


_ALONG, _ACROSS, _TILT, _RADIUS, _ANGLE = (2,), (0, 1), (3, 4), (5,), (6,)
UNKNOWNS = {
    IdealFeature.LINE: _ACROSS + _TILT,
    IdealFeature.PLANE: _ALONG + _TILT,
    IdealFeature.CIRCLE: _ACROSS + _ALONG + _TILT + _RADIUS,
    IdealFeature.SPHERE: _ACROSS + _ALONG + _RADIUS,
    IdealFeature.CYLINDER: _ACROSS + _TILT + _RADIUS,
    IdealFeature.CONE: _ACROSS + _TILT + _RADIUS + _ANGLE,
}
"""The components of a step that change each shape"""
ZONE_UNKNOWNS = UNKNOWNS | {IdealFeature.CIRCLE: _ACROSS + _RADIUS}
"""The same for a minimum zone: that of a circle lies in the plane of the least-squares circle (ISO 12181-1)"""
STEP = 7
NUMBERS = ("x", "y", "z", "i", "j", "k", "radius", "half_angle")
"""What describes a feature: a point of it, its direction, radius and half angle"""


@dataclass(frozen=True)
class Ideal:
    """One ideal feature, and the chart of small changes about it."""

    shape: IdealFeature
    origin: Array
    axis: Array
    """Unit vector; of a sphere (0, 0, 1) without a meaning"""
    radius: float = 0.0
    half_angle: float = 0.0
    size: float = 1.0
    """Length that makes a tilt a movement: root mean square distance of the points from their centroid [mm]"""

    def moved(self, step: Array) -> Ideal:
        """Return the feature after a step (7,): across the axis (2), along it, tilts times size (2), radius, angle."""
        origin, axis, radius, angle = self._parts(step)
        return replace(self, origin=origin, axis=axis, radius=float(radius), half_angle=float(angle))

    def deviations(self, points: Numbers, step: Numbers | None = None) -> Numbers:
        """Return the deviations (n, k) of points (n, 3) from the feature after a step (7,)."""
        origin, axis, radius, angle = self._parts(np.zeros(STEP) if step is None else step)
        away = points - origin
        height: Numbers = away @ axis
        if self.shape is IdealFeature.PLANE:
            return height[:, None]
        if self.shape is IdealFeature.SPHERE:
            outside: Numbers = _length(away) - radius
            return outside[:, None]
        across: Numbers = away - height[:, None] * axis
        if self.shape is IdealFeature.LINE:
            return across
        gap = _length(across) - radius
        if self.shape is IdealFeature.CIRCLE:
            return np.stack([gap, height], axis=1)
        tapered: Numbers = np.cos(angle) * gap - np.sin(angle) * height
        return tapered[:, None]

    def by_step(self, points: Array, step: Array | None = None) -> Array:
        """Return the derivative (n, k, 7) of the deviations by the step, at a step."""
        at = np.zeros(STEP) if step is None else step
        # the imaginary part of f(x + i h) over h is the derivative to rounding, at any tiny h
        columns = [np.imag(self.deviations(points, at + 1j * _TINY * direction)) / _TINY for direction in np.eye(STEP)]
        return np.stack(columns, axis=2)

    def by_point(self, points: Array) -> Array:
        """Return the derivative (n, k, 3) of the deviations of each point by that point."""
        columns = [np.imag(self.deviations(points + 1j * _TINY * direction)) / _TINY for direction in np.eye(3)]
        return np.stack(columns, axis=2)

    def numbers(self, centre: Numbers, step: Numbers | None = None) -> Numbers:
        """Return the numbers (8,) that describe the feature: place, direction, radius and half angle.

        The place is the centre of a circle or sphere; else the point of the plane or axis nearest to `centre`, the
        centroid of the points. The radius of a cone is that at its place.
        """
        origin, axis, radius, angle = self._parts(np.zeros(STEP) if step is None else step)
        height = (centre - origin) @ axis
        if self.shape is IdealFeature.PLANE:
            origin = centre - height * axis
        elif self.shape not in (IdealFeature.CIRCLE, IdealFeature.SPHERE):
            origin, radius = origin + height * axis, radius + np.tan(angle) * height
        return np.concatenate([origin, axis, [radius, angle]])

    def numbers_by(self, centre: Array) -> tuple[Array, Array]:
        """Return the derivatives of the numbers by the step (8, 7) and by the centroid of the points (8, 3)."""
        by_step = [np.imag(self.numbers(centre, 1j * _TINY * direction)) / _TINY for direction in np.eye(STEP)]
        by_centre = [np.imag(self.numbers(centre + 1j * _TINY * direction)) / _TINY for direction in np.eye(3)]
        return np.stack(by_step, axis=1), np.stack(by_centre, axis=1)

    def about(self, centre: Array) -> Ideal:
        """Return the same feature with its place as the origin, its axis in one of its two senses.

        A cone widens along its axis; the largest component of any other axis is positive.
        """
        sign = 1.0 if self.half_angle > 0 or self.axis[np.argmax(np.abs(self.axis))] > 0 else -1.0
        if self.half_angle < 0:
            sign = -1.0
        turned = replace(self, axis=sign * self.axis, half_angle=sign * self.half_angle)
        place = turned.numbers(centre)
        return replace(turned, origin=np.real(place[:3]), radius=float(np.real(place[6])))

    @cached_property
    def _tangents(self) -> tuple[Array, Array]:
        return tangents(self.axis)

    def _parts(self, step: Numbers) -> tuple[Numbers, Numbers, Any, Any]:
        first, second = self._tangents
        axis = self.axis + (step[3] * first + step[4] * second) / self.size
        origin = self.origin + step[0] * first + step[1] * second + step[2] * self.axis
        # not `np.linalg.norm`: it takes the absolute value of a complex step, which has no derivative
        return origin, axis / np.sqrt(axis @ axis), self.radius + step[5], self.half_angle + step[6] / self.size


def tangents(axis: Array) -> tuple[Array, Array]:
    """Return two unit vectors square to a unit vector and to each other."""
    least = np.eye(3)[np.argmin(np.abs(axis))]
    first = np.cross(axis, least)
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def _length(vectors: Numbers) -> Numbers:
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=1)))
