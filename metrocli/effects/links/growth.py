"""Uniform growth about the origin of a frame."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Local, Step
from metrocli.effects.links.of_block import AtQuantity
from metrocli.frozen import dataclass

_EYE = np.eye(3)[:, :, None]


@dataclass(frozen=True)
class Growth(AtQuantity):
    """A point moves away from the origin: `X (1 + s)`; column scale, s [1]."""

    def step(self, value: Array, local: Local) -> Step:
        """Return the point (3, n), with derivatives `(1 + s) I` by the point and X by the scale."""
        growth = 1 + local.rows(self.block)[0]
        return Step(value * growth, growth * _EYE, {self.block: value[:, None]})
