"""Affine distortion of a flat list of points: stretched along one axis, and sheared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Local, Step
from metrocli.effects.links.of_block import AtQuantity


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
