"""Effects on points of the machine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrocli.adjust.blocks import Array
from metrocli.adjust.chain import Local, Step
from metrocli.adjust.quantities import Quantity
from metrocli.effects.of_block import OfBlock

_EYE = np.eye(3)[:, :, None]


@dataclass(frozen=True)
class PointStep(OfBlock):
    """`x += d` from the time `at` on; columns dx, dy, dz [mm], at [s]."""

    takes = gives = Quantity.POINT_IN_MACHINE

    def step(self, value: Array, local: Local) -> Step:
        """Return the point (3, n)."""
        rows = local.rows(self.block)
        later = (local.observations.conditions["t"] >= rows[3]).astype(float)
        by_block = np.zeros((3, 4, len(later)))
        by_block[:, :3] = _EYE * later
        return Step(value + rows[:3] * later, _EYE, {self.block: by_block})
