"""Changes of a lens: since its calibration, with time, or with temperature."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Local, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.links.of_block import OfBlock


@dataclass(frozen=True)
class LensChange(OfBlock):
    """Parameters p of the lens as a reading sees them: `p (1 + m c)` or `p + a c`, c = 1 or a condition.

    m, a: columns of its own block.
    """

    multiplied: tuple[tuple[str, ...], ...] = ()
    """For each column the parameters of the lens that it multiplies"""
    added: tuple[tuple[str, ...], ...] = ()
    """For each column the parameters of the lens that it is added to"""
    condition: str = ""
    varies: str = "lens"
    takes = gives = Quantity.PARAMETERS

    def step(self, value: Array, local: Local) -> Step:
        """Return the parameters that each reading sees (size, n), with derivatives by them and by its own block."""
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
