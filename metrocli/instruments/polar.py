"""Polar instruments: the azimuth, elevation and distance of a point in the frame of a tracker or total station."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.chain import Local, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.arrays import Array
from metrocli.frozen import dataclass

POLAR = ("azimuth", "elevation", "distance")
"""What a polar instrument sees, in this order: `atan2(y, x)`, `atan2(z, sqrt(x^2 + y^2))` [rad], distance [mm]"""
AZIMUTH, ELEVATION, DISTANCE = range(3)
FACE = "face"
"""Condition: 1 in face 1, -1 in face 2; 1 where it is absent"""
_AXIS = 1e-9
"""Least distance from the standing axis, as a share of the distance: on the axis there is no azimuth"""


def face(local: Local) -> Array:
    """Return the face of each reading, (n,) or (1,)."""
    return np.asarray(local.observations.conditions.get(FACE, np.ones(1)))


def polar(point: Array) -> tuple[Array, Array]:
    """Return azimuth, elevation and distance (3, n) of points (3, n), and their derivatives (3, 3, n)."""
    x, y, z = point
    distance = np.sqrt(x * x + y * y + z * z)
    level = np.maximum(np.hypot(x, y), _AXIS * distance)
    by_point = np.zeros((3, 3, len(x)))
    by_point[AZIMUTH, 0], by_point[AZIMUTH, 1] = -y / level**2, x / level**2
    by_point[ELEVATION] = np.stack([-x * z / level, -y * z / level, level]) / distance**2
    by_point[DISTANCE] = point / distance
    return np.stack([np.arctan2(y, x), np.arctan2(z, level), distance]), by_point


def cartesian(seen: Array) -> tuple[Array, Array]:
    """Return points (3, n) of azimuth, elevation and distance (3, n), and their derivatives (3, 3, n)."""
    azimuth, elevation, distance = seen
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    zero = np.zeros_like(distance)
    beam, left, up = np.stack([ce * ca, ce * sa, se]), np.stack([-sa, ca, zero]), np.stack([-se * ca, -se * sa, ce])
    return distance * beam, np.stack([distance * ce * left, distance * up, beam], axis=1)


@dataclass(frozen=True)
class Seen:
    """Link from a point in the instrument's frame to its azimuth, elevation and distance.

    The beam is bent by the air: `elevation += bend d cos e`, bend `k/2R` for a coefficient of refraction k.
    """

    bend: float = 0.0
    takes = Quantity.POINT_IN_TRACKER
    gives = Quantity.POLAR
    blocks = ()

    def step(self, value: Array, local: Local) -> Step:
        """Return azimuth, elevation and distance, (3, n), with their derivatives by the point (3, 3, n)."""
        seen, by_point = polar(value)
        if self.bend:
            x, y, _ = value
            level = np.maximum(np.hypot(x, y), 1e-300)
            seen[ELEVATION] += self.bend * level
            by_point[ELEVATION, :2] += self.bend * np.stack([x, y]) / level
        return Step(seen, by_point)


@dataclass(frozen=True)
class ReadPolar:
    """Link to one of azimuth, elevation and distance as it was read, an azimuth in the turn of the reading."""

    component: int
    takes = Quantity.POLAR
    gives = Quantity.SIGHTING
    blocks = ()

    def step(self, value: Array, local: Local) -> Step:
        """Return the reading, (1, n)."""
        read = value[self.component : self.component + 1]
        if self.component == AZIMUTH:
            given = local.observations.readings
            read = given + np.remainder(read - given + np.pi, 2 * np.pi) - np.pi
        return Step(read, np.eye(3)[self.component, None, :, None])
