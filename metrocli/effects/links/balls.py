"""Effects on a ball grid and on the machine that measures it."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.chain import LinkContext, Step
from metrocli.adjust.model.quantities import OfBlock, Quantity
from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.instruments.ball_grid import HOLLOW, VIEW

_EYE = np.eye(3)[:, :, None]


@dataclass(frozen=True)
class Growth(OfBlock):
    """The artefact is scaled: `x (1 + scale)`; column scale [1]."""

    takes = gives = Quantity.BALL_IN_ARTEFACT

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the ball (3, n)."""
        factor = 1 + local.rows(self.block)
        return Step(value * factor, factor[:, None] * _EYE, {self.block: value[:, None]})


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
class Bending(OfBlock):
    """The artefact sags: `z -= b (rho^2 - mean rho^2)`, rho the distance from its centre; column b [1/mm]."""

    takes = gives = Quantity.MACHINE_READING

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n)."""
        by_block = np.zeros((3, 1, value.shape[1]))
        by_block[2, 0] = -local.observations.conditions[HOLLOW]
        return Step(value + by_block[:, 0] * local.rows(self.block), _EYE, {self.block: by_block})


@dataclass(frozen=True)
class ReadingDrift(OfBlock):
    """The machine's readings drift: `x += v c`, c a condition such as the time; columns vx, vy, vz [mm / unit of c]."""

    condition: str
    takes = gives = Quantity.MACHINE_READING

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n)."""
        term = local.observations.conditions[self.condition]
        return Step(value + local.rows(self.block) * term, _EYE, {self.block: _EYE * term})


@dataclass(frozen=True)
class ReadingStep(OfBlock):
    """The machine's readings step: `x += d` from the time `at` on; columns dx, dy, dz [mm], at [s]."""

    takes = gives = Quantity.MACHINE_READING

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n)."""
        rows = local.rows(self.block)
        later = (local.observations.conditions["t"] >= rows[3]).astype(float)
        by_block = np.zeros((3, 4, len(later)))
        by_block[:, :3] = _EYE * later
        return Step(value + rows[:3] * later, _EYE, {self.block: by_block})


@dataclass(frozen=True)
class ReadingScale(OfBlock):
    """The scale of one axis of the machine is wrong: `x_axis (1 + scale)`; column scale [1]."""

    axis: int
    takes = gives = Quantity.MACHINE_READING

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n)."""
        scale = local.rows(self.block)[0]
        by_point = np.tile(_EYE, value.shape[1])
        by_point[self.axis, self.axis] += scale
        by_block = np.zeros((3, 1, value.shape[1]))
        by_block[self.axis, 0] = value[self.axis]
        return Step(value + by_block[:, 0] * scale, by_point, {self.block: by_block})
