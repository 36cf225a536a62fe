"""Stations of polar instruments in a network: trackers in any pose, levelled instruments, and those over a mark.

A levelled instrument stands along the vertical of its place, which leans by `(x, y)/radius` from z of the network. The
leans are conditions of the readings: constants within an adjustment, so that they do not fix the frame of a network.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from metrocli.adjust.model.blocks import Block, Space
from metrocli.adjust.model.chain import IDENTITY, Chain, Link, LinkContext, Step
from metrocli.adjust.model.quantities import OfBlock, Quantity
from metrocli.arrays import Array, Mask
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.geometry.rotations import rotation_from_vector
from metrocli.instruments.frames import PointOf, ToFrame
from metrocli.instruments.tracer import POINT
from metrocli.instruments.tracker import PolarReading, ReadPolar

STATION, LEVELLED, OVER = "station", "levelled station", "station over a point"
"""Blocks of stations: poses of trackers; places of levelled instruments; offsets from a mark, in the levelled frame"""
ORIENTATION, SETUP = "orientation", "setup"
"""Blocks: azimuth of each round of a levelled station; height of the target of each set-up"""
LEAN, TARGET_LEAN = ("lean_x", "lean_y"), ("target_lean_x", "target_lean_y")
"""Conditions: lean of the vertical at the station and at the point [rad]"""
TARGET_HEIGHT = "target_height"
"""Condition: known height of the target above the point [mm]"""
CURVATURE = "curvature"
"""Condition of height differences: what the curvature of the earth adds [mm]"""


def _leaning(local: LinkContext, names: Sequence[str]) -> Array:
    """Return the leans of the vertical at the readings, (2, n), or (2, 1) zeros where verticals are parallel."""
    given = local.observations.conditions
    return np.stack([given[name] for name in names]) if names[0] in given else np.zeros((2, 1))


def target_vertical(local: LinkContext) -> Array:
    """Return the vertical at the observed points, (3, n) or (3, 1)."""
    x, y = _leaning(local, TARGET_LEAN)
    return np.stack([x, y, np.ones_like(x)])


def station_vertical(local: LinkContext) -> Array:
    """Return the vertical at the stations of the readings, (3, n) or (3, 1)."""
    x, y = _leaning(local, LEAN)
    return np.stack([x, y, np.ones_like(x)])


def listed(point: str) -> str:
    """Return the condition of given coordinates that stands for a point whose coordinates are listed."""
    return f"list of {point}"


def listed_exactly(point: str) -> str:
    """Return the condition of readings that stands for a point of which the list has exact coordinates."""
    return f"exact list of {point}"


def heights_of(mark: str) -> str:
    """Return the condition of height differences that is 1 for those to a mark, -1 for those from it, and else 0."""
    return f"heights of {mark}"


def _levelled(local: LinkContext) -> Array:
    """Return the rotations from the network to the levelled frames of the stations, (3, 3, n) or (3, 3, 1)."""
    x, y = _leaning(local, LEAN)
    # the turn by (-y, x, 0) brings z to the vertical (x, y, 1)
    leaning = rotation_from_vector(np.stack([-y, x, np.zeros_like(x)], axis=1))
    # transposed in the same step: (n, row, column) becomes (column, row, n)
    return np.ascontiguousarray(np.transpose(leaning, (2, 1, 0)))


def _times(matrix: Array, vector: Array) -> Array:
    return np.stack([(row[:, :] * vector).sum(axis=0) for row in matrix])


@dataclass(frozen=True)
class Between(OfBlock):
    """Start of a chain: the vector from the point under a station to the observed point; `index` has both."""

    block: str = POINT
    takes = None
    gives = Quantity.POINT_IN_MACHINE

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the vector, (3, n), with its derivatives by the observed point and the one below, (2, 3, 3, 1)."""
        points = local.members(self.block)
        seen, below = local.index(self.block)
        both = np.stack([IDENTITY, -IDENTITY])
        return Step((points[seen] - points[below]).T, by_block={self.block: both})


@dataclass(frozen=True)
class Raised(OfBlock):
    """The target stands above its point: `X += (h + h0) u`, u the vertical there, h of the set-up, h0 known."""

    block: str = SETUP
    takes = gives = Quantity.POINT_IN_MACHINE

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the place of the target, (3, n)."""
        up = target_vertical(local)
        height = local.rows(self.block)[0] + local.observations.conditions[TARGET_HEIGHT]
        return Step(value + up * height, IDENTITY, {self.block: up[:, None]})


@dataclass(frozen=True)
class IntoLevelled(OfBlock):
    """Link to the levelled frame of a station at S: `L' (X - S)`, L the lean of its vertical."""

    block: str = LEVELLED
    takes = Quantity.POINT_IN_MACHINE
    gives = Quantity.POINT_IN_TRACKER

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point, (3, n), with its derivatives."""
        level = _levelled(local)
        return Step(_times(level, value - local.rows(self.block)), level, {self.block: -level})


@dataclass(frozen=True)
class IntoOver(OfBlock):
    """Link to the levelled frame of a station over a point P: `L' (X - P) - o`, o its offset and height above P."""

    block: str = OVER
    takes = Quantity.POINT_IN_MACHINE
    gives = Quantity.POINT_IN_TRACKER

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point, (3, n), with its derivatives."""
        level = _levelled(local)
        return Step(_times(level, value) - local.rows(self.block), level, {self.block: -IDENTITY})


@dataclass(frozen=True)
class Oriented(OfBlock):
    """Link from a levelled frame to that of the instrument, which is turned about the vertical by gamma."""

    block: str = ORIENTATION
    takes = gives = Quantity.POINT_IN_TRACKER

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point `Rz(-gamma) v`, (3, n), with its derivatives."""
        gamma = local.rows(self.block)[0]
        c, s = np.cos(gamma), np.sin(gamma)
        zero, ones = np.zeros_like(c), np.ones_like(c)
        back = np.stack([np.stack([c, s, zero]), np.stack([-s, c, zero]), np.stack([zero, zero, ones])])
        moved = _times(back, value)
        by_gamma = np.stack([moved[1], -moved[0], np.zeros_like(moved[0])])[:, None]
        return Step(moved, back, {self.block: by_gamma})


@dataclass(frozen=True)
class HeightBetween(OfBlock):
    """Link to a height difference, `H(to) - H(from)` with `H = z + (x^2 + y^2) / 2 radius`.

    The second term is a condition of the readings, a constant within an adjustment.
    """

    curved: bool = False
    takes = None
    gives = Quantity.HEIGHT_DIFFERENCE

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the difference, (1, n), with its derivatives by the two points, (2, 1, 3, 1)."""
        points = local.members(self.block)
        start, end = local.index(self.block)
        height = points[end, 2] - points[start, 2]
        if self.curved:
            height = height + local.observations.conditions[CURVATURE]
        up = np.array([0.0, 0.0, 1.0])[None, :, None]
        return Step(height[None], by_block={self.block: np.stack([-up, up])})


_INTO: Mapping[str, tuple[Link, ...]] = {
    STATION: (ToFrame(STATION, Quantity.POINT_IN_MACHINE, Quantity.POINT_IN_TRACKER),),
    LEVELLED: (IntoLevelled(), Oriented()),
    OVER: (IntoOver(), Oriented()),
}


def sighting(block: str, raised: bool, component: int, bend: float = 0.0) -> Chain:
    """Return the forward model of one component of sightings from the stations of a block.

    `raised` where targets stand above points, `component` is one of azimuth, elevation and distance.
    """
    start: Link = Between() if block == OVER else PointOf(POINT, Quantity.POINT_IN_MACHINE)
    target: tuple[Link, ...] = (Raised(),) if raised else ()
    return Chain((start, *target, *_INTO[block], PolarReading(bend), ReadPolar(component)))


def station_block(values: Array, names: Sequence[str], extent: float) -> Block:
    """Return the block of trackers' poses, (stations, 6)."""
    reach = np.array([extent / 10] * 3 + [0.1] * 3)
    return Block(STATION, values, poses.COLUMNS, tuple(names), reach=reach, space=Space.POSE, noun="station")


def place_block(name: str, values: Array, names: Sequence[str], free: Mask, extent: float) -> Block:
    """Return the block of places of levelled stations, or of their offsets from marks, (stations, 3)."""
    return Block(name, values, ("x", "y", "z"), tuple(names), free, np.array(extent / 10), noun="station")


def orientation_block(values: Array, names: Sequence[str]) -> Block:
    """Return the block of azimuths of rounds, (rounds, 1)."""
    return Block(ORIENTATION, values[:, None], ("gamma",), tuple(names), reach=np.array(0.1), noun="round")


def setup_block(values: Array, names: Sequence[str], free: Mask) -> Block:
    """Return the block of heights of targets, (set-ups, 1)."""
    return Block(SETUP, values[:, None], ("height",), tuple(names), free[:, None], np.array(100.0), noun="setup")
