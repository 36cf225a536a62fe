"""Errors of a launch unit or receiver: of its base and tilt encoders, and of the axes they sit on."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Local, Step, through
from metrocli.effects.links.of_block import AtQuantity
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class EncoderOffset(AtQuantity):
    """Zero error of one encoder: `phi += offset` for one of the two angles; column offset [rad]."""

    component: int

    def step(self, value: Array, local: Local) -> Step:
        """Return the angles (2, n)."""
        by_block = np.zeros((2, 1, 1))
        by_block[self.component] = 1.0
        return Step(value + local.rows(self.block) * by_block[:, 0], np.eye(2)[:, :, None], {self.block: by_block})


@dataclass(frozen=True)
class EncoderLag(AtQuantity):
    """Lag of one encoder by its direction: `phi -= s width/2`, s the `direction`; column width [rad]."""

    component: int
    direction: str
    """Condition: 1 where the angle grew, -1 where it fell, 0 if it never moves"""

    def step(self, value: Array, local: Local) -> Step:
        """Return the angles (2, n)."""
        by_block = np.zeros((2, 1, value.shape[1]))
        by_block[self.component, 0] = -local.observations.conditions[self.direction] / 2
        return Step(value + local.rows(self.block) * by_block[:, 0], np.eye(2)[:, :, None], {self.block: by_block})


@dataclass(frozen=True)
class Harmonic(AtQuantity):
    """A harmonic of one encoder: `phi += c cos k phi + s sin k phi` for one of two angles; columns c, s [rad].

    k = 1 is an eccentric disc, k = 2 an oval or bent one.
    """

    component: int
    order: int = 1

    def step(self, value: Array, local: Local) -> Step:
        """Return the angles (2, n)."""
        c, s = local.rows(self.block)
        angle, n = self.order * value[self.component], value.shape[1]
        cos, sin = np.cos(angle), np.sin(angle)
        moved = value.copy()
        moved[self.component] += c * cos + s * sin
        by_angles = np.tile(np.eye(2)[:, :, None], n)
        by_angles[self.component, self.component] += self.order * (s * cos - c * sin)
        by_block = np.zeros((2, 2, n))
        by_block[self.component] = cos, sin
        return Step(moved, by_angles, {self.block: by_block})


@dataclass(frozen=True)
class NonOrthogonality(AtQuantity):
    """The tilt axis is not square to the base axis: `base += angle tan(tilt)`; column angle [rad]."""

    def step(self, value: Array, local: Local) -> Step:
        """Return the angles (2, n)."""
        angle, n = local.rows(self.block)[0], value.shape[1]
        tangent = np.tan(value[1])
        by_angles = np.tile(np.eye(2)[:, :, None], n)
        by_angles[0, 1] = angle * (1 + tangent**2)
        by_block = np.zeros((2, 1, n))
        by_block[0, 0] = tangent
        return Step(np.stack([value[0] + angle * tangent, value[1]]), by_angles, {self.block: by_block})


@dataclass(frozen=True)
class BaseTilt(AtQuantity):
    """The base axis is `Rx(tx) Ry(ty) z`, so the unit sees a beam b as `Ry(-ty) Rx(-tx) b`; columns tx, ty [rad]."""

    def step(self, value: Array, local: Local) -> Step:
        """Return the beam (3, n)."""
        tx, ty = local.rows(self.block)[:, 0]
        cx, sx, cy, sy = np.cos(tx), np.sin(tx), np.cos(ty), np.sin(ty)
        about_x = np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]])
        about_y = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]])
        first = about_x @ value
        x, y, z = first
        seen = about_y @ first
        by_tx = about_y @ np.stack([np.zeros_like(y), z, -y])
        by_ty = np.stack([-sy * x - cy * z, np.zeros_like(y), cy * x - sy * z])
        by_beam = through(about_y[:, :, None], about_x[:, :, None])
        return Step(seen, by_beam, {self.block: np.stack([by_tx, by_ty], axis=1)})
