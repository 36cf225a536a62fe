"""Affine distortion of a flat list of points (stretched along one axis, sheared), and of an image read row by row."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Local, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.links.of_block import AtQuantity, OfBlock
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Stretch(AtQuantity):
    """A point of a list that is longer in x than in y: `X (1 + e)`, `X + g Y`; columns stretch e [1], shear g [rad].

    Growth of both axes alike is a scale, which poses absorb.
    """

    def step(self, value: Array, local: Local) -> Step:
        """Return the point (3, n), with derivatives by the point and by stretch and shear."""
        stretch, shear = local.rows(self.block)
        x, y, _ = value
        by_point = np.repeat(np.eye(3)[:, :, None], value.shape[1], axis=2)
        by_point[0, 0], by_point[0, 1] = 1 + stretch, shear
        by_block = np.zeros((3, 2, value.shape[1]))
        by_block[0] = x, y
        moved = value.copy()
        moved[0] += stretch * x + shear * y
        return Step(moved, by_point, {self.block: by_block})


@dataclass(frozen=True)
class RowShear(OfBlock):
    """An image whose rows are read one after another while it moves: `u += a_u (v - cy)`, `v += a_v (v - cy)`.

    Columns a_u, a_v [1] are the motion of the image, in px, in the time from one row to the next.
    """

    pose: str
    """Block of the poses, one for each image; where one pose serves all, an image has one target and shows no shear"""
    lens: str = "lens"
    """Block of the lens, whose cy is the row at which the pose of the image holds"""
    takes = gives = Quantity.IMAGE_POINT

    @property
    def blocks(self) -> tuple[str, ...]:
        """The blocks of poses and lens, and its own block."""
        return (self.pose, self.lens, self.block)

    def step(self, value: Array, local: Local) -> Step:
        """Return the image point (2, n), with derivatives by the point, the lens and the motion."""
        shear, lens, cy = local.rows(self.block), local.rows(self.lens), local.blocks[self.lens].column("cy")
        later = value[1] - lens[cy]
        by_point = np.array(np.broadcast_to(np.eye(2)[:, :, None], (2, 2, value.shape[1])))
        by_point[:, 1] += shear
        by_lens = np.zeros((2, len(lens), value.shape[1]))
        by_lens[:, cy] = -shear
        by_shear = np.eye(2)[:, :, None] * later
        return Step(value + shear * later, by_point, {self.lens: by_lens, self.block: by_shear})
