"""Effects on the length reading: drifts, jumps and offsets, and errors that depend on the direction of the beam."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Local, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.links.of_block import OfBlock
from metrocli.frozen import dataclass

_AS_IT_IS = np.ones((1, 1, 1))


@dataclass(frozen=True)
class LengthTerms(OfBlock):
    """Error that is linear in conditions c_k of the readings: `l += sum of p_k c_k`; one column p_k for each c_k."""

    conditions: tuple[str, ...]
    takes = gives = Quantity.LENGTH

    def step(self, value: Array, local: Local) -> Step:
        """Return the length (1, n)."""
        terms = np.stack([local.observations.conditions[name] for name in self.conditions])
        added = (local.rows(self.block) * terms).sum(axis=0)
        return Step(value + added, _AS_IT_IS, {self.block: terms[None]})


@dataclass(frozen=True)
class LengthJump(OfBlock):
    """Jump of a length: `l += step` from the time `at` on; columns step [mm], at [s]."""

    takes = gives = Quantity.LENGTH

    def step(self, value: Array, local: Local) -> Step:
        """Return the length (1, n)."""
        step, at = local.rows(self.block)
        later = (local.observations.conditions["t"] >= at).astype(float)
        by_block = np.zeros((1, 2, len(later)))
        by_block[0, 0] = later
        return Step(value + step * later, _AS_IT_IS, {self.block: by_block})


@dataclass(frozen=True)
class LengthOffset(OfBlock):
    """Zero error of a length: `l += offset`; column offset [mm]."""

    takes = gives = Quantity.LENGTH

    def step(self, value: Array, local: Local) -> Step:
        """Return the length (1, n)."""
        return Step(value + local.rows(self.block), _AS_IT_IS, {self.block: np.ones((1, 1, value.shape[1]))})


@dataclass(frozen=True)
class LengthScale(OfBlock):
    """Scale error of a length: `l (1 + scale)`; column scale [1]."""

    takes = gives = Quantity.LENGTH

    def step(self, value: Array, local: Local) -> Step:
        """Return the length (1, n)."""
        factor = 1 + local.rows(self.block)
        return Step(value * factor, factor[:, None] * _AS_IT_IS, {self.block: value[:, None]})
