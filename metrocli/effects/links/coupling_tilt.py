"""Tilt of a camera's holder in the spindle."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Local, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.links.of_block import OfBlock
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class CouplingTilt(OfBlock):
    """The holder is tilted: `R_S <- R_S Ry(beta_s) Rx(alpha_s)`; columns alpha_s, beta_s [rad].

    A point in the taper therefore becomes `X <- Rx' Ry' X`.
    """

    takes = gives = Quantity.POINT_IN_TAPER

    def step(self, value: Array, local: Local) -> Step:
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
