"""Links that transform points between frames, shared by all instruments."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.chain import IDENTITY, LinkContext, Step
from metrocli.adjust.model.derivatives import through
from metrocli.adjust.model.quantities import OfBlock, Quantity
from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.instruments.axes.joints import times


@dataclass(frozen=True)
class PointOf(OfBlock):
    """Start of a chain: the observed point, a row of a block of coordinates plus a fixed offset [mm]."""

    gives: Quantity
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    takes = None

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point, (3, n), and its derivative by the coordinates in the block."""
        point = local.rows(self.block)
        if any(self.offset):
            point = point + np.array(self.offset)[:, None]
        return Step(point, by_block={self.block: IDENTITY} if self.block in local.wanted else {})


@dataclass(frozen=True)
class FromFrame(OfBlock):
    """Link from a frame to the frame in which its pose is given: `X' = R X + d`."""

    takes: Quantity
    gives: Quantity

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return `R X + d` (3, n), with derivatives R by the point, and (I, -[R X]x) by a step of the pose."""
        poses = local.members(self.block)
        rotation = local.spread(local.blocks[self.block].rotations, self.block)
        turned = times(rotation, value)
        moved = turned + local.spread(poses[:, :3], self.block)
        by_block = {self.block: _shift_and_turn(turned)} if self.block in local.wanted else {}
        return Step(moved, rotation, by_block)


@dataclass(frozen=True)
class ToFrame(OfBlock):
    """Link to a frame from the frame in which its pose is given: `X = R' (X' - d)`."""

    takes: Quantity
    gives: Quantity

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return `R' (X' - d)` (3, n), with its derivatives.

        They are R' by the point and `-R' (I, -[X' - d]x)` by a step of the pose.
        """
        poses = local.members(self.block)
        inverse = local.spread(np.swapaxes(local.blocks[self.block].rotations, 1, 2), self.block)
        from_origin = value - local.spread(poses[:, :3], self.block)
        moved = times(inverse, from_origin)
        by_block = {self.block: -through(inverse, _shift_and_turn(from_origin))} if self.block in local.wanted else {}
        return Step(moved, inverse, by_block)


def _shift_and_turn(vector: Array) -> Array:
    """Return (I, -[v]x), (3, 6, n): the change of vectors v (3, n) by a shift and by a small rotation from the left."""
    x, y, z = vector
    change = np.zeros((3, 6, vector.shape[1]))
    change[0, 0] = change[1, 1] = change[2, 2] = 1.0
    change[0, 4], change[0, 5] = z, -y
    change[1, 3], change[1, 5] = -z, x
    change[2, 3], change[2, 4] = y, -x
    return change


@dataclass(frozen=True)
class DistanceBetween(OfBlock):
    """Link to the distance of two points of one block, `|a - b|`: a scale bar or another calibrated length."""

    takes = None
    gives = Quantity.LENGTH

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the distance, (1, n), with its derivatives by both points, (2, 1, 3, n)."""
        points = local.members(self.block)
        first, second = local.index(self.block)
        difference = (points[first] - points[second]).T
        distance = np.sqrt((difference**2).sum(axis=0))
        direction = (difference / distance)[None]
        return Step(distance[None], by_block={self.block: np.stack([direction, -direction])})
