"""Effects on the displacement that a laser reads along a line of a machine."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Local, Step
from metrocli.effects.links.motions import ErrorMotionEffect
from metrocli.frozen import dataclass
from metrocli.instruments.six_dof import ALONG, LINE


@dataclass(frozen=True)
class LineTerm(ErrorMotionEffect):
    """Error along the line: `d += u p c`, u the direction of the line, c a product of conditions; one column p."""

    conditions: tuple[str, ...]

    @property
    def blocks(self) -> tuple[str, ...]:
        """The block of lines, which only readings of a laser have, and its own block."""
        return (LINE, self.block)

    def step(self, value: Array, local: Local) -> Step:
        """Return the motion (6, n)."""
        given = local.observations.conditions
        factor = np.prod([given[name] for name in self.conditions], axis=0)
        by_block = (np.stack([given[name] for name in ALONG]) * factor)[:, None]
        return self.moved(value, by_block[:, 0] * local.rows(self.block), by_block)
