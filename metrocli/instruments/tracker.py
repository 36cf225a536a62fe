"""Laser trackers and other polar instruments: points from a distance and two angles."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Block, Space
from metrocli.adjust.model.chain import Chain, LinkContext, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments.frames import ToFrame

TRACKER, LEG = "tracker", "leg"
"""Blocks: pose of the tracker in the machine; two unit vectors across each leg of a path"""
_REACH = np.array([1.0] * 3 + [1e-3] * 3)
"""Plausible error of the pose after the rough alignment [mm, rad]; a larger reach costs numerical accuracy"""


@dataclass(frozen=True)
class TrackerNoise:
    """Standard deviations along the beam, and perpendicular to it, `sqrt(c^2 + (p r)^2)` at distance r."""

    beam: float
    constant: float
    proportional: float

    def times(self, factor: float) -> TrackerNoise:
        """Return the noise with all its parts times a factor."""
        return TrackerNoise(factor * self.beam, factor * self.constant, factor * self.proportional)

    def lateral(self, distance: Array) -> Array:
        """Return the standard deviation perpendicular to the beam."""
        return np.asarray(np.sqrt(self.constant**2 + (self.proportional * distance) ** 2))

    def covariance(self, points: Array) -> Array:
        """Return the covariance, (3, 3, n), of points (3, n) in the tracker's frame.

        It is `s_l^2 I + (s_b^2 - s_l^2) b b'`, with b the unit vector of the beam.
        """
        distance = np.sqrt((points**2).sum(axis=0))
        beam = points / np.maximum(distance, 1e-300)
        lateral = self.lateral(distance) ** 2
        return np.asarray(np.eye(3)[:, :, None] * lateral + (self.beam**2 - lateral) * beam[:, None] * beam[None])

    def drawn(self, points: Array, rng: np.random.Generator) -> Array:
        """Return random noise of points (3, n), along and perpendicular to the beam."""
        distance = np.sqrt((points**2).sum(axis=0))
        beam = points / distance
        noise = rng.normal(size=points.shape) * self.lateral(distance)
        along = (beam * noise).sum(axis=0)
        return np.asarray(noise + beam * (rng.normal(size=along.shape) * self.beam - along))


def tracker_block(pose: Array, tool_uncertainty: float = 0.0) -> Block:
    """Return the block of the tracker's pose in the machine, (6,); its reach allows for uncertain tool vectors."""
    reach = _REACH * np.repeat([max(1.0, 10 * tool_uncertainty), 1.0], 3)
    return Block(TRACKER, pose[None], poses.COLUMNS, reach=reach, space=Space.POSE)


def leg_block(across: Array) -> Block:
    """Return the block of two unit vectors across each leg in the tracker's frame, from `across` (legs, 2, 3)."""
    columns = tuple(f"{which}{axis}" for which in "ab" for axis in "xyz")
    names = tuple(str(i + 1) for i in range(len(across)))
    return Block(LEG, across.reshape(-1, 6), columns, names, free=np.array(False), noun="leg")


@dataclass(frozen=True)
class AcrossLeg:
    """Link to the two coordinates of a point across its leg; that along the leg is not used (Sanders et al. 1.2.5)."""

    takes = Quantity.POINT_IN_TRACKER
    gives = Quantity.ACROSS_LEG
    blocks = (LEG,)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return `A p`, (2, n), and its derivative A by the point p."""
        rows = local.rows(LEG)
        across = rows.reshape(2, 3, rows.shape[1])
        return Step(np.einsum("abn,bn->an", across, value), across)


def point_chain(to: Chain) -> Chain:
    """Return the forward model of the end of a chain as measured by the tracker."""
    return Chain((*to.links, ToFrame(TRACKER, Quantity.POINT_IN_MACHINE, Quantity.POINT_IN_TRACKER)))


def path_chain(to: Chain) -> Chain:
    """Return the forward model of the coordinates of a point across its leg."""
    return Chain((*point_chain(to).links, AcrossLeg()))


POLAR = ("azimuth", "elevation", "distance")
"""What a polar instrument sees, in this order: `atan2(y, x)`, `atan2(z, sqrt(x^2 + y^2))` [rad], distance [mm]"""
AZIMUTH, ELEVATION, DISTANCE = range(3)
FACE = "face"
"""Condition: 1 in face 1, -1 in face 2; 1 where it is absent"""
_AXIS = 1e-9
"""Least distance from the standing axis, as a share of the distance: on the axis there is no azimuth"""


def face(local: LinkContext) -> Array:
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
class PolarReading:
    """Link from a point in the instrument's frame to its azimuth, elevation and distance.

    The beam is bent by the air: `elevation += bend d cos e`, bend `k/2R` for a coefficient of refraction k.
    """

    bend: float = 0.0
    takes = Quantity.POINT_IN_TRACKER
    gives = Quantity.POLAR
    blocks = ()

    def step(self, value: Array, local: LinkContext) -> Step:
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

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the reading, (1, n)."""
        read = value[self.component : self.component + 1]
        if self.component == AZIMUTH:
            given = local.observations.readings
            # the turn of the reading, so that no residual is near a whole one
            read = given + np.remainder(read - given + np.pi, 2 * np.pi) - np.pi
        return Step(read, np.eye(3)[self.component, None, :, None])
