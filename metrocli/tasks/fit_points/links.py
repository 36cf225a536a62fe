"""Links of a best fit: the scale of a station, the deviation from an unknown place, one coordinate."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.chain import IDENTITY, LinkContext, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.tasks.fit_points.effects import SCALE

PLACE = "place"
"""Block of places that are unknowns"""


@dataclass(frozen=True)
class Scaled:
    """Link from a point to `(1 + s) x`, s the scale of its station."""

    takes = gives = Quantity.POINT_IN_PART
    blocks = (SCALE,)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return `(1 + s) x` (3, n), with its derivatives by the point and by the scale."""
        scale = 1.0 + local.rows(SCALE)[0]
        return Step(scale * value, np.eye(3)[:, :, None] * scale, {SCALE: value[:, None, :]})


@dataclass(frozen=True)
class FromPlace:
    """Link from a point to its deviation from its unknown place, `X - P`."""

    takes = gives = Quantity.POINT_IN_MACHINE
    blocks = (PLACE,)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the deviation (3, n), with its derivatives."""
        return Step(value - local.rows(PLACE), IDENTITY, {PLACE: -np.eye(3)[:, :, None]})


@dataclass(frozen=True)
class Coordinate:
    """Link to one coordinate of a point."""

    axis: int
    takes = Quantity.POINT_IN_MACHINE
    gives = Quantity.LENGTH
    blocks = ()

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the coordinate, (1, n), with its derivative."""
        return Step(value[self.axis][None], np.eye(3)[self.axis][None, :, None])
