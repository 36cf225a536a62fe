"""Changes of a lens since its calibration, with time, or with temperature."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Local, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.links.of_block import OfBlock
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class LensChange(OfBlock):
    """Lens parameters p change to `p (1 + m c)` or `p + a c`, c = 1 or a condition of the readings.

    m, a are the columns of its own block.
    """

    multiplied: tuple[tuple[str, ...], ...] = ()
    """For each column m: names of the lens parameters that it multiplies"""
    added: tuple[tuple[str, ...], ...] = ()
    """For each column a: names of the lens parameters to which it is added"""
    condition: str = ""
    """Name of the condition c; empty for c = 1"""
    varies: str = "lens"
    """Block of the lens"""
    takes = gives = Quantity.PARAMETERS

    def step(self, value: Array, local: Local) -> Step:
        """Return the lens parameters for each reading (size, n), with derivatives by the input and its own block."""
        names, theta = local.blocks[self.varies].columns, local.rows(self.block)
        passed = local.observations.conditions[self.condition] if self.condition else np.ones(value.shape[1])
        changed = value.copy()
        by_value = np.repeat(np.eye(len(names))[:, :, None], value.shape[1], axis=2)
        by_own = np.zeros((len(names), len(theta), value.shape[1]))
        for place, name in enumerate(names):
            for column, chosen in enumerate(self.multiplied):
                if name in chosen:
                    by_own[place, column] = value[place] * passed
                    by_value[place, place] += theta[column] * passed
            for column, chosen in enumerate(self.added):
                if name in chosen:
                    by_own[place, column] = passed
            changed[place] += (by_own[place] * theta).sum(axis=0)
        return Step(changed, by_value, {self.block: by_own})
