"""Effects on lengths and on the beams that measure them."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.chain import LinkContext, Step
from metrocli.adjust.model.quantities import OfBlock, Quantity
from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.instruments.launch_unit import UNIT
from metrocli.instruments.tracer import TRACER

_AS_IT_IS, _EYE = np.ones((1, 1, 1)), np.eye(3)[:, :, None]


@dataclass(frozen=True)
class LengthTerms(OfBlock):
    """Error that is linear in conditions c_k of the readings: `l += sum of p_k c_k`; one column p_k for each c_k."""

    conditions: tuple[str, ...]
    takes = gives = Quantity.LENGTH

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the length (1, n)."""
        terms = np.stack([local.observations.conditions[name] for name in self.conditions])
        added = (local.rows(self.block) * terms).sum(axis=0)
        return Step(value + added, _AS_IT_IS, {self.block: terms[None]})


@dataclass(frozen=True)
class BeamScale(OfBlock):
    """The beam is scaled: `b (1 + scale c)`, c = 1 or a condition; column scale [1], or rate [1/K or 1/s]."""

    condition: str = ""
    others = (TRACER,)
    takes = gives = Quantity.POINT_IN_MACHINE

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n), displaced along its beam, with derivatives by point, tracer and its own block."""
        beam = value - local.rows(TRACER)[:3]
        factor = local.observations.conditions[self.condition] if self.condition else np.ones(beam.shape[1])
        scale = local.rows(self.block)[0] * factor
        by_tracer = np.zeros((3, local.members(TRACER).shape[1], len(factor)))
        by_tracer[:, :3] = -_EYE * scale
        by_block = {TRACER: by_tracer, self.block: (beam * factor)[:, None]}
        return Step(value + beam * scale, _EYE * (1 + scale), by_block)


@dataclass(frozen=True)
class AirGradient(OfBlock):
    """The index of the air changes with height: `b (1 + gradient (z - z0)/2)`; column gradient [1/mm].

    z - z0 is the height of the point above the tracer, along z of the points' frame. The mean index along the beam is
    that of half the height. The bend of the beam changes its length only to the second order of the gradient.
    """

    others = (TRACER,)
    takes = gives = Quantity.POINT_IN_MACHINE

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n), displaced along its beam, with derivatives by point, tracer and its own block."""
        beam = value - local.rows(TRACER)[:3]
        gradient, half = local.rows(self.block)[0], beam[2] / 2
        by_beam = _EYE * (gradient * half)
        by_beam[:, 2] += gradient / 2 * beam
        by_tracer = np.zeros((3, local.members(TRACER).shape[1], len(half)))
        by_tracer[:, :3] = -by_beam
        by_block = {TRACER: by_tracer, self.block: (beam * half)[:, None]}
        return Step(value + gradient * half * beam, _EYE + by_beam, by_block)


@dataclass(frozen=True)
class _BesideBeam(OfBlock):
    """The beam passes a control point at a distance h along a unit vector l across it; column h [mm].

    The beam then runs along `b - h l`.
    """

    others = (UNIT,)
    takes = gives = Quantity.POINT_IN_MACHINE

    def across(self, beam: Array) -> tuple[Array, Array]:
        """Return the unit vector l of beams (3, n), and its derivatives by them (3, 3, n)."""
        raise NotImplementedError

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n) to which a beam without offset would run in this direction, with derivatives."""
        h = local.rows(self.block)[0]
        across, turns = self.across(value - local.rows(UNIT)[:3])
        by_beam = -h * turns
        by_unit = np.zeros((3, local.members(UNIT).shape[1], value.shape[1]))
        by_unit[:, :3] = -by_beam
        return Step(value - h * across, _EYE + by_beam, {UNIT: by_unit, self.block: -across[:, None]})


class BeamOffset(_BesideBeam):
    """The offset is horizontal, to the left of the outgoing beam: it turns the base angles of both ends."""

    def across(self, beam: Array) -> tuple[Array, Array]:
        """Return the horizontal unit vector to the left of beams."""
        ahead, left, level = _level(beam)
        return left, -ahead[:, None] * left[None] / level


class BeamHeight(_BesideBeam):
    """The offset is in the vertical plane of the beam, upwards: it turns the tilt angles of both ends."""

    def across(self, beam: Array) -> tuple[Array, Array]:
        """Return the unit vector up, square to beams in their vertical plane."""
        ahead, left, level = _level(beam)
        length = np.hypot(level, beam[2])
        sine, cosine = beam[2] / length, level / length
        vertical = np.array([0.0, 0.0, 1.0])[:, None]
        up, along = cosine * vertical - sine * ahead, cosine * ahead + sine * vertical
        turn = sine / level * left
        return up, -along[:, None] * up[None] / length - turn[:, None] * left[None]


def _level(beam: Array) -> tuple[Array, Array, Array]:
    """Return the horizontal unit vectors ahead and to the left of beams (3, n), and their horizontal lengths (n,)."""
    level, zero = np.hypot(beam[0], beam[1]), np.zeros(beam.shape[1])
    return np.stack([beam[0], beam[1], zero]) / level, np.stack([-beam[1], beam[0], zero]) / level, level
