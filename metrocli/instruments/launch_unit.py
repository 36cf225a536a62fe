"""Launch unit and receiver of an interferometer, aimed at each other by four encoders (Kuprin et al., fig. 7).

The beam leaves the launch unit at p along `w = (cos phi2 cos(gamma+phi1), cos phi2 sin(gamma+phi1), sin phi2)`. The
receiver at r points towards the launch unit along `u = (cos phi3 cos(psi+phi4), cos phi3 sin(psi+phi4), sin phi3)`. If
both are aligned, u = -w.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Chain, Link, LinkContext, Step
from metrocli.adjust.model.quantities import OfBlock, Quantity
from metrocli.arrays import Array, Mask
from metrocli.frozen import dataclass
from metrocli.instruments.frames import PointOf
from metrocli.instruments.tracer import AIR

UNIT, RECEIVER, SPINDLE = "launch unit", "receiver", "spindle"
"""Blocks: x, y, z, gamma of the launch unit; control point of the receiver and spindle angle psi in each pose"""
COLUMNS = ("x", "y", "z", "gamma")
DISTANCE = "distance"
"""Name of the group of distances; groups of angles have the names of the encoders"""
OVER = "over"
"""Condition of a reading: 1 if the unit points over the top (tilt beyond 90 degrees), else 0"""
ENCODERS = {
    "phi1": (Quantity.LAUNCH_ANGLES, 0),
    "phi2": (Quantity.LAUNCH_ANGLES, 1),
    "phi3": (Quantity.RECEIVER_ANGLES, 1),
    "phi4": (Quantity.RECEIVER_ANGLES, 0),
}
"""For each encoder, the pair of angles it belongs to, and its number in this pair"""
TURNED = "turned_{encoder}"
"""Condition of a reading: 1 where this angle grew since the pose before, -1 where it fell, 0 if it never moves"""
_GAMMA = COLUMNS.index("gamma")
_TURN = 2 * np.pi
_REACH = 0.01
"""Plausible reach of the place of the unit as a share of its distance, and of gamma [rad]"""


@dataclass(frozen=True)
class BeamOut(OfBlock):
    """Link to the beam from the launch unit to the receiver: `b = r - p`."""

    block: str = UNIT
    takes = Quantity.POINT_IN_MACHINE
    gives = Quantity.BEAM_OUT

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return b, (3, n), with its derivatives by the receiver's point and by the unit, (3, 4, 1)."""
        by_unit = np.zeros((3, len(COLUMNS), 1))
        by_unit[:, :3, 0] = -np.eye(3)
        return Step(value - local.rows(self.block)[:3], np.eye(3)[:, :, None], {self.block: by_unit})


@dataclass(frozen=True)
class BeamBack(OfBlock):
    """Link to the beam from the receiver to the launch unit: `b = p - r`."""

    block: str = UNIT
    takes = Quantity.POINT_IN_MACHINE
    gives = Quantity.BEAM_BACK

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return b, (3, n), with its derivatives by the receiver's point and by the unit, (3, 4, 1)."""
        by_unit = np.zeros((3, len(COLUMNS), 1))
        by_unit[:, :3, 0] = np.eye(3)
        return Step(local.rows(self.block)[:3] - value, -np.eye(3)[:, :, None], {self.block: by_unit})


@dataclass(frozen=True)
class AboutBase(OfBlock):
    """Link to the frame of a unit whose base is rotated by an angle about z: `b' = Rz(-angle) b`."""

    column: int
    takes: Quantity
    gives: Quantity

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return b', (3, n), with its derivatives by b and by the angle."""
        angle = local.rows(self.block)[self.column]
        c, s = np.cos(angle), np.sin(angle)
        zero = np.zeros_like(c)
        back = np.array([[c, s, zero], [-s, c, zero], [zero, zero, zero + 1]])
        turned = np.stack([c * value[0] + s * value[1], c * value[1] - s * value[0], value[2]])
        by_block = np.zeros((3, local.blocks[self.block].size, value.shape[1]))
        by_block[0, self.column], by_block[1, self.column] = turned[1], -turned[0]
        return Step(turned, back, {self.block: by_block})


@dataclass(frozen=True)
class Encoders:
    """Link to the angles of a beam: base `a = atan2(by, bx)`, tilt `e = atan2(bz, sqrt(bx^2 + by^2))`.

    If the condition `over` is 1, the unit points over the top and the angles are (a + 180 deg, 180 deg - e), which
    give the same direction.
    """

    takes: Quantity
    gives: Quantity
    blocks = ()

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return base and tilt [rad], (2, n), with their derivatives by the beam."""
        over = local.observations.conditions.get(OVER, np.zeros(1))
        # one beam for all readings of a single pose
        x, y, z = np.broadcast_to(value, (3, max(value.shape[1], len(over))))
        # a vertical beam has no base angle; the least number keeps the division finite
        level2 = np.maximum(x * x + y * y, np.finfo(float).tiny)
        level, square = np.sqrt(level2), level2 + z * z
        face = 1 - 2 * over
        angles = np.stack([np.arctan2(y, x), face * np.arctan2(z, level)]) + np.pi * over
        by_beam = np.zeros((2, 3, len(x)))
        by_beam[0, 0], by_beam[0, 1] = -y / level2, x / level2
        by_beam[1] = face * np.stack([-x * z / level, -y * z / level, level]) / square
        return Step(angles, by_beam)


@dataclass(frozen=True)
class Reading:
    """Link to the reading of one encoder of a pair of angles.

    Whole turns are added to the prediction to bring it near the reading, so that residuals are small at any angle and
    for any way of counting of the encoder.
    """

    takes: Quantity
    component: int
    gives = Quantity.ANGLE
    blocks = ()

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the angle [rad], (1, n), with its derivatives by both angles."""
        angle = value[self.component]
        turns = np.round((local.observations.readings[0] - angle) / _TURN)
        by_angles = np.zeros((1, 2, 1))
        by_angles[0, self.component] = 1.0
        return Step((angle + _TURN * turns)[None], by_angles)


@dataclass(frozen=True)
class BeamLength:
    """Link to the distance of the control points, `|b|`; in air `|b| (1 + e)`, e the relative error of its index."""

    in_air: bool = False
    takes = Quantity.BEAM_OUT
    gives = Quantity.LENGTH

    @property
    def blocks(self) -> tuple[str, ...]:
        """Name of the block of the air, if there is one."""
        return (AIR,) if self.in_air else ()

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the distance, (1, n), with its derivatives by the beam and by the air."""
        distance = np.sqrt(np.einsum("an,an->n", value, value))
        if not self.in_air:
            return Step(distance[None], (value / distance)[None])
        scale = 1 + local.rows(AIR)[0]
        return Step((scale * distance)[None], (scale * value / distance)[None], {AIR: distance[None, None]})


def encoder_chain(name: str) -> Chain:
    """Return the forward model of phi1, phi2 (launch unit), phi3 or phi4 (receiver)."""
    angles, component = ENCODERS[name]
    if angles is Quantity.LAUNCH_ANGLES:
        beam: Link = BeamOut()
        base = AboutBase(UNIT, _GAMMA, Quantity.BEAM_OUT, Quantity.BEAM_AT_LAUNCH)
    else:
        beam, base = BeamBack(), AboutBase(SPINDLE, 0, Quantity.BEAM_BACK, Quantity.BEAM_AT_RECEIVER)
    return Chain((_receiver(), beam, base, Encoders(base.gives, angles), Reading(angles, component)))


def distance_chain(in_air: bool = False) -> Chain:
    """Return the forward model of a distance, `in_air` with an error of its refractive index."""
    return Chain((_receiver(), BeamOut(), BeamLength(in_air)))


def _receiver() -> PointOf:
    return PointOf(RECEIVER, Quantity.POINT_IN_MACHINE)


def unit_block(place: Array, gamma: float, distance: float) -> Block:
    """Return the block of the launch unit at a place; its plausible reach is 1 % of its distance from the receivers."""
    reach = np.array([_REACH * distance] * 3 + [_REACH])
    return Block(UNIT, np.array([[*place, gamma]]), COLUMNS, reach=reach, noun="launch unit")


def receiver_block(points: Array, names: Sequence[str], free: Mask, distance: float) -> Block:
    """Return the block of the receiver's control points, (poses, 3)."""
    return Block(
        RECEIVER, points, ("x", "y", "z"), tuple(names), free=free, reach=np.array(_REACH * distance), noun="pose"
    )


def spindle_block(angles: Array, names: Sequence[str]) -> Block:
    """Return the block of the known angles of the spindle, (poses,)."""
    return Block(SPINDLE, angles[:, None], ("psi",), tuple(names), free=np.array(False), noun="pose")


def direction(base: Array, tilt: Array) -> Array:
    """Return unit vectors (n, 3) from base and tilt angles [rad]."""
    return np.stack([np.cos(tilt) * np.cos(base), np.cos(tilt) * np.sin(base), np.sin(tilt)], axis=-1)
