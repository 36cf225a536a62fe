"""Effects on the stations and targets of a network, and on its height differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrocli.adjust.model.chain import IDENTITY, Chain, LinkContext, Step
from metrocli.adjust.model.groups import ReadBlock, ReadEntries
from metrocli.adjust.model.quantities import OfBlock, Quantity
from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.instruments.stations import OVER, SETUP, heights_of, station_vertical, target_vertical
from metrocli.instruments.tracer import POINT

IN_ORDER = "station in order"
"""Condition of readings without times: the number of their station"""
BEGUN = "first time of the station"
"""Condition: the earliest time at which the station of a reading read [s]"""


@dataclass(frozen=True)
class StationDrift(OfBlock):
    """A station moves by `v (t - t0)`, as its points by the opposite; columns vx, vy, vz [mm/s].

    t0 is the first time at which it read.
    """

    takes = gives = Quantity.POINT_IN_MACHINE

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n)."""
        conditions = local.observations.conditions
        elapsed = conditions["t"] - conditions[BEGUN]
        return Step(value - local.rows(self.block) * elapsed, IDENTITY, {self.block: -IDENTITY * elapsed})


@dataclass(frozen=True)
class TargetRaised(OfBlock):
    """The target stands higher above its point: `X += dh u`, u the vertical there; column dh [mm]."""

    others = (SETUP,)  # only sightings of raised targets have this block
    takes = gives = Quantity.POINT_IN_MACHINE

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n)."""
        up = target_vertical(local)
        return Step(value + up * local.rows(self.block)[0], IDENTITY, {self.block: up[:, None]})


@dataclass(frozen=True)
class StationRaised(OfBlock):
    """A station stands higher over its point than listed: `X -= dh u`, u the vertical there; column dh [mm]."""

    others = (OVER,)
    takes = gives = Quantity.POINT_IN_MACHINE

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point relative to the true station, (3, n)."""
        up = station_vertical(local)
        return Step(value - up * local.rows(self.block)[0], IDENTITY, {self.block: -up[:, None]})


@dataclass(frozen=True)
class ListedWrongly(OfBlock):
    """The listed coordinates X0 of a point are off by d, so that they read `X - X0 + d`; columns dx, dy, dz [mm]."""

    point: str
    reader: ReadBlock | ReadEntries | None = None
    others = (POINT,)
    takes = gives = Quantity.PARAMETERS

    def within(self, before: Chain) -> ListedWrongly:
        """Return the effect for what reads the coordinates before it."""
        # another given point that is wrong may stand between
        readers = [link for link in before.links if isinstance(link, ReadBlock | ReadEntries)]
        return replace(self, reader=readers[-1] if readers else None)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the coordinates less their list, (c, n)."""
        if self.reader is None:
            raise ValueError("ListedWrongly acts behind what reads coordinates")
        number, index = local.blocks[POINT].members.index(self.point), local.index(POINT)
        c, n = len(self.reader.columns), local.observations.count
        if isinstance(self.reader, ReadBlock):
            of_point = index == number
        else:
            # all coordinates are one reading: each row is that of the point in its slot
            of_point = (index[self.reader.slots, 0] == number)[:, None]
        by_block = np.zeros((c, 3, n))
        by_block[np.arange(c), np.asarray(self.reader.columns)] = of_point
        shift = (by_block * local.rows(self.block)).sum(axis=1)
        return Step(value + shift, np.eye(c)[:, :, None], {self.block: by_block})


@dataclass(frozen=True)
class ExactListedWrongly(OfBlock):
    """The exact listed coordinates X0 of a point are off by d: all reads it at `X0 - d`; columns dx, dy, dz."""

    point: str
    others = (POINT,)
    varies = POINT
    takes = gives = Quantity.PARAMETERS

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the coordinates of the points that readings use, (3, n), slot after slot."""
        here = np.array([name == self.point for name in local.blocks[POINT].members])[local.index(POINT).ravel()]
        by_block = -np.eye(3)[:, :, None] * here
        return Step(value - local.rows(self.block) * here, by_block={self.block: by_block})


@dataclass(frozen=True)
class HeightStep(OfBlock):
    """A mark stands higher in some height differences: `dh += s h`; columns h [mm], and a time or a method.

    s is 1 for differences to the mark, -1 from it, and 0 for others, and for those of other methods or before the time.
    """

    mark: str
    by: str
    """Condition: t or method"""
    takes = gives = Quantity.HEIGHT_DIFFERENCE

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the height difference (1, n)."""
        conditions, (height, at) = local.observations.conditions, local.rows(self.block)
        affected = conditions[self.by] >= at if self.by == "t" else conditions[self.by] == at
        sign = conditions[heights_of(self.mark)] * affected
        by_block = np.zeros((1, 2, len(sign)))
        by_block[0, 0] = sign
        return Step(value + height * sign, np.ones((1, 1, 1)), {self.block: by_block})
