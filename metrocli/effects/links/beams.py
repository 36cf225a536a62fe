"""Effects on the beam `b = x - x0` from an instrument to a point; they act by displacing the point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Local, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.effect import ELAPSED
from metrocli.effects.links.of_block import OfBlock
from metrocli.instruments.launch_unit import UNIT
from metrocli.instruments.tracer import TRACER

_EYE = np.eye(3)[:, :, None]


@dataclass(frozen=True)
class BeamScale(OfBlock):
    """The beam is scaled: `b (1 + scale c)`, c = 1 or a condition; column scale [1], or rate [1/K or 1/s]."""

    tracer: str = TRACER
    condition: str = ""
    takes = gives = Quantity.POINT_IN_MACHINE

    @property
    def blocks(self) -> tuple[str, ...]:
        """The block of tracers, where the beams begin, and its own block."""
        return (self.tracer, self.block)

    def step(self, value: Array, local: Local) -> Step:
        """Return the point (3, n), displaced along its beam, with derivatives by point, tracer and its own block."""
        beam = value - local.rows(self.tracer)[:3]
        factor = local.observations.conditions[self.condition] if self.condition else np.ones(beam.shape[1])
        scale = local.rows(self.block)[0] * factor
        by_tracer = np.zeros((3, local.members(self.tracer).shape[1], len(factor)))
        by_tracer[:, :3] = -_EYE * scale
        by_block = {self.tracer: by_tracer, self.block: (beam * factor)[:, None]}
        return Step(value + beam * scale, _EYE * (1 + scale), by_block)


@dataclass(frozen=True)
class TracerDrift(OfBlock):
    """A tracer moves: `x0 += v t`, which from the tracer looks like `x -= v t`; columns vx, vy, vz [mm/s]."""

    takes = gives = Quantity.POINT_IN_MACHINE

    def step(self, value: Array, local: Local) -> Step:
        """Return the point (3, n)."""
        t = local.observations.conditions[ELAPSED]
        return Step(value - local.rows(self.block) * t, _EYE, {self.block: -_EYE * t})


@dataclass(frozen=True)
class BeamOffset(OfBlock):
    """The beam passes a control point at a horizontal distance h, to the left of the outgoing beam; column h [mm].

    The beam then runs along `b - h l`, l the horizontal unit vector to the left of b. This turns the base angles of
    both ends.
    """

    unit: str = UNIT
    takes = gives = Quantity.POINT_IN_MACHINE

    @property
    def blocks(self) -> tuple[str, ...]:
        """The block of the launch unit, where the beams begin, and its own block."""
        return (self.unit, self.block)

    def step(self, value: Array, local: Local) -> Step:
        """Return the point (3, n) to which a beam without offset would run in this direction, with derivatives."""
        beam = value - local.rows(self.unit)[:3]
        h, level = local.rows(self.block)[0], np.hypot(beam[0], beam[1])
        zero = np.zeros_like(level)
        ahead = np.stack([beam[0], beam[1], zero]) / level
        left = np.stack([-beam[1], beam[0], zero]) / level
        by_beam = h / level * ahead[:, None] * left[None]
        by_unit = np.zeros((3, local.members(self.unit).shape[1], len(level)))
        by_unit[:, :3] = -by_beam
        return Step(value - h * left, _EYE + by_beam, {self.unit: by_unit, self.block: -left[:, None]})
