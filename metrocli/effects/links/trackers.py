"""Effects on the readings of a laser tracker: of its scale, its azimuth encoder, and its stand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Local, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.effect import ELAPSED
from metrocli.effects.links.of_block import OfBlock


@dataclass(frozen=True)
class TrackerScale(OfBlock):
    """The tracker's distances are multiplied by `1 + scale`; column scale [1]."""

    takes = gives = Quantity.POINT_IN_TRACKER

    def step(self, value: Array, local: Local) -> Step:
        """Return the point (3, n)."""
        factor = 1 + local.rows(self.block)
        return Step(value * factor, np.eye(3)[:, :, None] * factor, {self.block: value[:, None]})


@dataclass(frozen=True)
class TrackerEccentricity(OfBlock):
    """Eccentric azimuth circle: `azimuth += c1 cos azimuth + s1 sin azimuth`; columns c1, s1 [rad]."""

    takes = gives = Quantity.POINT_IN_TRACKER

    def step(self, value: Array, local: Local) -> Step:
        """Return the point (3, n), turned about the tracker's vertical axis."""
        x, y, z = value
        radius = np.hypot(x, y)
        cosine, sine = x / radius, y / radius
        c1, s1 = local.rows(self.block)
        turn = c1 * cosine + s1 * sine
        c, s = np.cos(turn), np.sin(turn)
        turned = np.stack([c * x - s * y, s * x + c * y, z])
        by_turn = np.stack([-turned[1], turned[0], np.zeros_like(z)])
        growth = (s1 * cosine - c1 * sine) / radius
        by_point = np.zeros((3, 3, len(x)))
        by_point[0, 0] = by_point[1, 1] = c
        by_point[1, 0], by_point[0, 1], by_point[2, 2] = s, -s, 1.0
        by_point += by_turn[:, None] * np.stack([-sine, cosine, np.zeros_like(z)]) * growth
        return Step(turned, by_point, {self.block: by_turn[:, None] * np.stack([cosine, sine])})


@dataclass(frozen=True)
class TrackerMoves(OfBlock):
    """The tracker drifts by `v t` along the machine's axes; columns vx, vy, vz [mm/s]."""

    takes = gives = Quantity.POINT_IN_MACHINE

    def step(self, value: Array, local: Local) -> Step:
        """Return the point (3, n), displaced by `-v t`, since the readings depend only on the relative position."""
        elapsed = local.observations.conditions[ELAPSED]
        moved = value - local.rows(self.block) * elapsed
        return Step(moved, np.eye(3)[:, :, None], {self.block: -np.eye(3)[:, :, None] * elapsed})
