"""Effects that displace a point: by a constant, or in proportion to a condition such as time."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Local, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.links.of_block import AtQuantity, OfBlock
from metrocli.frozen import dataclass

_EYE = np.eye(3)[:, :, None]


@dataclass(frozen=True)
class Shift(AtQuantity):
    """A point is displaced: `X += s d c`, c = 1 or a condition; d has one to three columns, along x, y, z.

    x, y, z are those of the quantity's frame; `first` is 2 if d has one column along z. s = -1 if the frame moves and
    not the point, as with a camera's holder or the machine.
    """

    sign: float = 1.0
    condition: str = ""
    first: int = 0

    def step(self, value: Array, local: Local) -> Step:
        """Return the point (3, n)."""
        shift = local.rows(self.block)
        by_shift = self.sign * _EYE[:, self.first : self.first + len(shift)]
        if self.condition:
            by_shift = by_shift * local.observations.conditions[self.condition]
        return Step(value + (by_shift * shift).sum(axis=1), _EYE, {self.block: by_shift})


@dataclass(frozen=True)
class MachineBow(OfBlock):
    """The machine stands at `d + (b1 e_j + b2 e_k) (d_i - m)^2` instead of d: axis i is bent towards the two others.

    Columns b1, b2 [1/mm]; j and k follow i in the order x, y, z, x; m is the middle of all commanded poses along i.
    Relative to the machine, points are displaced by the opposite. A bend about another point would be this one and a
    slope, which is an error of squareness (ISO 230-1 takes straightness relative to a mean line).
    """

    axis: int
    poses: str = "spindle"
    """Block of the commanded poses (x, y, z, ...)"""
    takes = gives = Quantity.POINT_IN_MACHINE

    @property
    def blocks(self) -> tuple[str, ...]:
        """The block of commanded poses, and its own block."""
        return (self.poses, self.block)

    def step(self, value: Array, local: Local) -> Step:
        """Return the point (3, n) relative to the true position of the machine."""
        commanded, bends = local.rows(self.poses), local.rows(self.block)
        along, n = local.members(self.poses)[:, self.axis], value.shape[1]
        # the middle is that of the file: poses that are estimated move it by less than counts
        position = commanded[self.axis] - (along.min() + along.max()) / 2
        by_bend, by_pose = np.zeros((3, 2, n)), np.zeros((3, len(commanded), n))
        for column, across in enumerate([(self.axis + 1) % 3, (self.axis + 2) % 3]):
            by_bend[across, column] = -(position**2)
            by_pose[across, self.axis] = -2 * position * bends[column]
        return Step(value + (by_bend * bends).sum(axis=1), _EYE, {self.poses: by_pose, self.block: by_bend})


@dataclass(frozen=True)
class MachineError(OfBlock):
    """The machine stands at `d + e_i a d_j` instead of d; column a [1 or rad].

    Relative to the machine, points are displaced by `-e_i a d_j`. If i = j, a is the scale error of an axis.
    Otherwise axis j is out of square and also moves the machine along i.
    """

    moved: int
    along: int
    poses: str = "spindle"
    """Block of the commanded poses (x, y, z, ...)"""
    takes = gives = Quantity.POINT_IN_MACHINE

    @property
    def blocks(self) -> tuple[str, ...]:
        """The block of commanded poses, and its own block."""
        return (self.poses, self.block)

    def step(self, value: Array, local: Local) -> Step:
        """Return the point (3, n) relative to the true position of the machine."""
        error = local.rows(self.block)[0]
        commanded = local.rows(self.poses)
        by_error = np.zeros((3, 1, value.shape[1]))
        by_error[self.moved, 0] = -commanded[self.along]
        by_pose = np.zeros((3, len(commanded), value.shape[1]))
        by_pose[self.moved, self.along] = -error
        return Step(value + by_error[:, 0] * error, _EYE, {self.poses: by_pose, self.block: by_error})
