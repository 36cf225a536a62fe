"""Effects that shift and turn points on their way to a camera: poses, the coupling, and the axes of the machine."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.chain import LinkContext, Step
from metrocli.adjust.model.quantities import OfBlock, Quantity
from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.geometry.rotations import cross_matrix
from metrocli.instruments.spindle_camera import SPINDLE

_EYE = np.eye(3)[:, :, None]


@dataclass(frozen=True)
class MachineBow(OfBlock):
    """The machine stands at `d + (b1 e_j + b2 e_k) (d_i - m)^2` instead of d: axis i is bent towards the two others.

    Columns b1, b2 [1/mm]; j and k follow i in the order x, y, z, x; m is the middle of all commanded poses along i.
    Relative to the machine, points are displaced by the opposite. A bend about another point would be this one and a
    slope, which is an error of squareness (ISO 230-1 takes straightness relative to a mean line).
    """

    axis: int
    others = (SPINDLE,)
    takes = gives = Quantity.POINT_IN_MACHINE

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n) relative to the true position of the machine."""
        commanded, bends = local.rows(SPINDLE), local.rows(self.block)
        along, n = local.members(SPINDLE)[:, self.axis], value.shape[1]
        # the middle is that of the file: poses that are estimated move it by less than counts
        position = commanded[self.axis] - (along.min() + along.max()) / 2
        by_bend, by_pose = np.zeros((3, 2, n)), np.zeros((3, len(commanded), n))
        for column, across in enumerate([(self.axis + 1) % 3, (self.axis + 2) % 3]):
            by_bend[across, column] = -(position**2)
            by_pose[across, self.axis] = -2 * position * bends[column]
        return Step(value + (by_bend * bends).sum(axis=1), _EYE, {SPINDLE: by_pose, self.block: by_bend})


@dataclass(frozen=True)
class MachineError(OfBlock):
    """The machine stands at `d + e_i a d_j` instead of d; column a [1 or rad].

    Relative to the machine, points are displaced by `-e_i a d_j`. If i = j, a is the scale error of an axis.
    Otherwise axis j is out of square and also moves the machine along i.
    """

    moved: int
    along: int
    others = (SPINDLE,)
    takes = gives = Quantity.POINT_IN_MACHINE

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n) relative to the true position of the machine."""
        error = local.rows(self.block)[0]
        commanded = local.rows(SPINDLE)
        by_error = np.zeros((3, 1, value.shape[1]))
        by_error[self.moved, 0] = -commanded[self.along]
        by_pose = np.zeros((3, len(commanded), value.shape[1]))
        by_pose[self.moved, self.along] = -error
        return Step(value + by_error[:, 0] * error, _EYE, {SPINDLE: by_pose, self.block: by_error})


@dataclass(frozen=True)
class CouplingTilt(OfBlock):
    """The holder is tilted: `R_S <- R_S Ry(beta_s) Rx(alpha_s)`; columns alpha_s, beta_s [rad].

    A point in the taper therefore becomes `X <- Rx' Ry' X`.
    """

    takes = gives = Quantity.POINT_IN_TAPER

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n)."""
        angles = local.members(self.block)[-1]
        (ca, cb), (sa, sb) = np.cos(angles), np.sin(angles)
        about_x, by_alpha = np.diag([1, ca, ca]), np.diag([0, -sa, -sa])
        about_y, by_beta = np.diag([cb, 1, cb]), np.diag([-sb, 0, -sb])
        about_x[1, 2], about_x[2, 1], by_alpha[1, 2], by_alpha[2, 1] = sa, -sa, ca, -ca
        about_y[0, 2], about_y[2, 0], by_beta[0, 2], by_beta[2, 0] = -sb, sb, -cb, cb
        turn = about_x @ about_y
        by_angles = np.stack([by_alpha @ about_y @ value, about_x @ by_beta @ value], axis=1)
        return Step(turn @ value, turn[:, :, None], {self.block: by_angles})


@dataclass(frozen=True)
class MachineAngles(OfBlock):
    """The spindle is turned about its commanded position d by `theta = r (d_i - m)`, to first order.

    Columns rx, ry, rz [rad/mm]: about x, y, z of the machine. m is the middle of all commanded poses along axis i. In
    the spindle's frame points are displaced by the opposite: `X -= theta x (X - d)`.
    """

    axis: int
    others = (SPINDLE,)
    takes = gives = Quantity.POINT_IN_MACHINE

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n) relative to the spindle as it truly stands."""
        commanded, rates = local.rows(SPINDLE), local.rows(self.block)
        along = local.members(SPINDLE)[:, self.axis]
        position = commanded[self.axis] - (along.min() + along.max()) / 2
        lever = value - commanded[:3]
        turned = np.moveaxis(cross_matrix((rates * position).T), 0, -1)
        by_rates = np.moveaxis(cross_matrix(lever.T), 0, -1) * position
        by_pose = np.zeros((3, len(commanded), value.shape[1]))
        by_pose[:, :3] = turned
        by_pose[:, self.axis] -= np.cross(rates, lever, axis=0)
        moved = value - np.einsum("abn,bn->an", turned, lever)
        return Step(moved, np.eye(3)[:, :, None] - turned, {SPINDLE: by_pose, self.block: by_rates})
