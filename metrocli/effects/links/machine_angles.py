"""Angular errors of a machine that carries a camera: roll, pitch and yaw that grow along an axis."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Local, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.links.of_block import OfBlock
from metrocli.frozen import dataclass
from metrocli.geometry.rotations import cross_matrix


@dataclass(frozen=True)
class MachineAngles(OfBlock):
    """The spindle is turned about its commanded position d by `theta = r (d_i - m)`, to first order.

    Columns rx, ry, rz [rad/mm]: about x, y, z of the machine. m is the middle of all commanded poses along axis i. In
    the spindle's frame points are displaced by the opposite: `X -= theta x (X - d)`.
    """

    axis: int
    poses: str = "spindle"
    """Block of the commanded poses (x, y, z, ...)"""
    takes = gives = Quantity.POINT_IN_MACHINE

    @property
    def blocks(self) -> tuple[str, ...]:
        """The block of commanded poses, and its own block."""
        return (self.poses, self.block)

    def step(self, value: Array, local: Local) -> Step:
        """Return the point (3, n) relative to the spindle as it truly stands."""
        commanded, rates = local.rows(self.poses), local.rows(self.block)
        along = local.members(self.poses)[:, self.axis]
        position = commanded[self.axis] - (along.min() + along.max()) / 2
        lever = value - commanded[:3]
        turned = np.moveaxis(cross_matrix((rates * position).T), 0, -1)
        by_rates = np.moveaxis(cross_matrix(lever.T), 0, -1) * position
        by_pose = np.zeros((3, len(commanded), value.shape[1]))
        by_pose[:, :3] = turned
        by_pose[:, self.axis] -= np.cross(rates, lever, axis=0)
        moved = value - np.einsum("abn,bn->an", turned, lever)
        return Step(moved, np.eye(3)[:, :, None] - turned, {self.poses: by_pose, self.block: by_rates})
