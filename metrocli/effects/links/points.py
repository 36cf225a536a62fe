"""Effects on points of a part, a board or a machine: shifts at a time, growth, stretch, and the bend of a plane."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.chain import LinkContext, Step
from metrocli.adjust.model.quantities import AtQuantity, OfBlock, Quantity
from metrocli.arrays import Array
from metrocli.frozen import dataclass

_EYE = np.eye(3)[:, :, None]


@dataclass(frozen=True)
class PointStep(OfBlock):
    """A point is displaced: `x += s d` from the time `at` on; columns dx, dy, dz [mm], at [s].

    s = -1 if the instrument moves and not the point. Another condition may stand for the time.
    """

    sign: float = 1.0
    condition: str = "t"
    takes = gives = Quantity.POINT_IN_MACHINE

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n)."""
        rows = local.rows(self.block)
        later = self.sign * (local.observations.conditions[self.condition] >= rows[3])
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
    quantity: Quantity = Quantity.POINT_IN_MACHINE
    """In whose frame the axes are"""

    @property
    def takes(self) -> Quantity:
        """The quantity on which it acts."""
        return self.quantity

    gives = takes

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n)."""
        error = local.rows(self.block)[0]
        by_point = np.tile(_EYE, value.shape[1])
        by_point[self.moved, self.along] += error
        by_block = np.zeros((3, 1, value.shape[1]))
        by_block[self.moved, 0] = value[self.along]
        return Step(value + by_block[:, 0] * error, by_point, {self.block: by_block})


@dataclass(frozen=True)
class Growth(AtQuantity):
    """A point moves away from the origin: `X (1 + s)`; column scale, s [1]."""

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n), with derivatives `(1 + s) I` by the point and X by the scale."""
        growth = 1 + local.rows(self.block)[0]
        return Step(value * growth, growth * _EYE, {self.block: value[:, None]})


@dataclass(frozen=True)
class PlaneBend(OfBlock):
    """The board is a quadratic surface: `Z += bxx X^2 + bxy X Y + byy Y^2`; columns bxx, bxy, byy [1/mm]."""

    takes = gives = Quantity.POINT_ON_BOARD

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n)."""
        xx, xy, yy = local.rows(self.block)
        x, y, _ = value
        by_point = np.repeat(np.eye(3)[:, :, None], value.shape[1], axis=2)
        by_point[2, 0], by_point[2, 1] = 2 * xx * x + xy * y, xy * x + 2 * yy * y
        by_bend = np.zeros((3, 3, value.shape[1]))
        by_bend[2] = x * x, x * y, y * y
        bent = value.copy()
        bent[2] += xx * x * x + xy * x * y + yy * y * y
        return Step(bent, by_point, {self.block: by_bend})


@dataclass(frozen=True)
class Stretch(AtQuantity):
    """A point of a list that is longer in x than in y: `X (1 + e)`, `X + g Y`; columns stretch e [1], shear g [rad].

    Growth of both axes alike is a scale, which poses absorb.
    """

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n), with derivatives by the point and by stretch and shear."""
        stretch, shear = local.rows(self.block)
        x, y, _ = value
        by_point = np.repeat(np.eye(3)[:, :, None], value.shape[1], axis=2)
        by_point[0, 0], by_point[0, 1] = 1 + stretch, shear
        by_block = np.zeros((3, 2, value.shape[1]))
        by_block[0] = x, y
        moved = value.copy()
        moved[0] += stretch * x + shear * y
        return Step(moved, by_point, {self.block: by_block})


@dataclass(frozen=True)
class RowShear(OfBlock):
    """An image whose rows are read one after another while it moves: `u += a_u (v - cy)`, `v += a_v (v - cy)`.

    Columns a_u, a_v [1] are the motion of the image, in px, in the time from one row to the next.
    """

    pose: str
    """Block of the poses, one for each image; where one pose serves all, an image has one target and shows no shear"""
    lens: str = "lens"
    """Block of the lens, whose cy is the row at which the pose of the image holds"""
    takes = gives = Quantity.IMAGE_POINT

    @property
    def blocks(self) -> tuple[str, ...]:
        """The blocks of poses and lens, and its own block."""
        return (self.pose, self.lens, self.block)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the image point (2, n), with derivatives by the point, the lens and the motion."""
        shear, lens, cy = local.rows(self.block), local.rows(self.lens), local.blocks[self.lens].column("cy")
        later = value[1] - lens[cy]
        by_point = np.array(np.broadcast_to(np.eye(2)[:, :, None], (2, 2, value.shape[1])))
        by_point[:, 1] += shear
        by_lens = np.zeros((2, len(lens), value.shape[1]))
        by_lens[:, cy] = -shear
        by_shear = np.eye(2)[:, :, None] * later
        return Step(value + shear * later, by_point, {self.lens: by_lens, self.block: by_shear})
