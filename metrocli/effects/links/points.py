"""Effects on points of a part, a board, an artefact or a machine: shifts, growth, stretch, and the bend of a plane.

Shifts and growth serve lengths and angles too.
"""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.chain import LinkContext, Step
from metrocli.adjust.model.quantities import AtQuantity, OfBlock, Quantity
from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.instruments.ball_grid import VIEW

_EYE = np.eye(3)[:, :, None]


@dataclass(frozen=True)
class Shift(AtQuantity):
    """A quantity is displaced: `q += s c d`, c = 1 or a condition; one column of d for each component from `first` on.

    The components are those of the quantity's frame. s = -1 if the frame moves and not the point, as with a camera's
    holder, an instrument or the machine. With `since` there is one more column: q is displaced where that condition
    has at least its value, such as a time.
    """

    sign: float = 1.0
    condition: str = ""
    first: int = 0
    since: str = ""

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the quantity (k, n)."""
        same, rows, given = np.eye(len(value))[:, :, None], local.rows(self.block), local.observations.conditions
        shift = rows[:-1] if self.since else rows
        by_shift = self.sign * same[:, self.first : self.first + len(shift)]
        if self.condition:
            by_shift = by_shift * given[self.condition]
        if self.since:
            by_shift = by_shift * (given[self.since] >= rows[-1])
        moved = value + (by_shift * shift).sum(axis=1)
        if self.since:
            by_shift = np.concatenate([by_shift, np.zeros_like(by_shift[:, :1])], axis=1)
        return Step(moved, same, {self.block: by_shift})


@dataclass(frozen=True)
class Growth(AtQuantity):
    """A point moves away from the origin, or a length grows: `q (1 + s)`; column scale, s [1]."""

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the quantity (k, n), with derivatives `(1 + s) I` by itself and q by the scale."""
        growth = 1 + local.rows(self.block)[0]
        return Step(value * growth, growth * np.eye(len(value))[:, :, None], {self.block: value[:, None]})


@dataclass(frozen=True)
class BallShift(OfBlock):
    """A ball is displaced in the artefact: `x += d` from one view on; columns dx, dy, dz [mm], from_view (number)."""

    takes = gives = Quantity.BALL_IN_ARTEFACT

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the ball (3, n)."""
        rows = local.rows(self.block)
        later = (local.index(VIEW) >= rows[3]).astype(float)
        by_block = np.zeros((3, 4, len(later)))
        by_block[:, :3] = _EYE * later
        return Step(value + rows[:3] * later, _EYE, {self.block: by_block})


@dataclass(frozen=True)
class LinearTerms(AtQuantity):
    """Coordinates of a point grow with others: `x_i += a x_j`, one column a [1 or rad] for each entry (i, j).

    If i = j, a is the scale error of an axis. Otherwise axis j is out of square and also moves the point along i.
    """

    entries: tuple[tuple[int, int], ...]

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n)."""
        errors = local.rows(self.block)
        by_point = np.tile(_EYE, value.shape[1])
        by_block = np.zeros((3, len(errors), value.shape[1]))
        for column, (moved, along) in enumerate(self.entries):
            by_point[moved, along] += errors[column]
            by_block[moved, column] = value[along]
        return Step(value + (by_block * errors).sum(axis=1), by_point, {self.block: by_block})


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
