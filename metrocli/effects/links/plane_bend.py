"""Bending of a flat board of targets."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Local, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.links.of_block import OfBlock
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class PlaneBend(OfBlock):
    """The board is a quadratic surface: `Z += bxx X^2 + bxy X Y + byy Y^2`; columns bxx, bxy, byy [1/mm]."""

    takes = gives = Quantity.POINT_ON_BOARD

    def step(self, value: Array, local: Local) -> Step:
        """Return the point (3, n)."""
        xx, xy, yy = local.rows(self.block)
        x, y, _ = value
        by_point = np.repeat(np.eye(3)[:, :, None], value.shape[1], axis=2)
        by_point[2, 0], by_point[2, 1] = 2 * xx * x + xy * y, xy * x + 2 * yy * y
        by_bend = np.zeros((3, 3, value.shape[1]))
        by_bend[2] = x * x, x * y, y * y
        bent = value.copy()
        bent[2] += xx * x * x + xy * x * y + yy * y * y
        return Step(bent, by_point, {self.block: by_bend})
