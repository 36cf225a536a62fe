"""Effects on points in the frame of the machine."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Local, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.links.of_block import OfBlock
from metrocli.frozen import dataclass

_EYE = np.eye(3)[:, :, None]


@dataclass(frozen=True)
class PointStep(OfBlock):
    """A point is displaced: `x += d` from the time `at` on; columns dx, dy, dz [mm], at [s]."""

    takes = gives = Quantity.POINT_IN_MACHINE

    def step(self, value: Array, local: Local) -> Step:
        """Return the point (3, n)."""
        rows = local.rows(self.block)
        later = (local.observations.conditions["t"] >= rows[3]).astype(float)
        by_block = np.zeros((3, 4, len(later)))
        by_block[:, :3] = _EYE * later
        return Step(value + rows[:3] * later, _EYE, {self.block: by_block})


@dataclass(frozen=True)
class AxisError(OfBlock):
    """Scale or squareness error of the machine: `x_i += a x_j`; column a [1 or rad].

    If i = j, a is the scale error of an axis. Otherwise axis j is out of square and also moves the point along i.
    """

    moved: int
    along: int
    takes = gives = Quantity.POINT_IN_MACHINE

    def step(self, value: Array, local: Local) -> Step:
        """Return the point (3, n)."""
        error = local.rows(self.block)[0]
        by_point = np.tile(_EYE, value.shape[1])
        by_point[self.moved, self.along] += error
        by_block = np.zeros((3, 1, value.shape[1]))
        by_block[self.moved, 0] = value[self.along]
        return Step(value + by_block[:, 0] * error, by_point, {self.block: by_block})
