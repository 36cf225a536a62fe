"""Launch unit and receiver of an interferometer, aimed at each other by four encoders (Kuprin et al., fig. 7).

The beam leaves the launch unit at p along `w = (cos phi2 cos(gamma+phi1), cos phi2 sin(gamma+phi1), sin phi2)`; seen
from the receiver at r it comes from `u = (cos phi3 cos(psi+phi4), cos phi3 sin(psi+phi4), sin phi3)`. Aligned: u = -w.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrocli.adjust.blocks import Array, Block, Mask
from metrocli.adjust.chain import Chain, Local, Step
from metrocli.adjust.quantities import Quantity
from metrocli.instruments.frames import PointOf

UNIT, RECEIVER, SPINDLE = "launch unit", "receiver", "spindle"
"""Blocks: x y z gamma of the unit; the receiver's control point in each pose; the spindle's angle psi in each pose"""
COLUMNS = ("x", "y", "z", "gamma")
LAUNCH, BACK, DISTANCE = "launch", "receiver", "distance"
"""Names of the groups"""
ENCODERS = {
    "phi1": (Quantity.LAUNCH_ANGLES, 0),
    "phi2": (Quantity.LAUNCH_ANGLES, 1),
    "phi3": (Quantity.RECEIVER_ANGLES, 1),
    "phi4": (Quantity.RECEIVER_ANGLES, 0),
}
"""What each encoder reads: which angles of a chain, and which of the two"""
_GAMMA = COLUMNS.index("gamma")
_TURN = 2 * np.pi
_REACH = 0.01
"""How far the unit could plausibly be off, as a share of its distance, and the angle gamma [rad]"""


@dataclass(frozen=True)
class BeamOut:
    """The beam from the launch unit to the receiver: `b = r - p`."""

    block: str = UNIT
    takes = Quantity.POINT_IN_MACHINE
    gives = Quantity.BEAM_OUT

    @property
    def blocks(self) -> tuple[str, ...]:
        """The unit."""
        return (self.block,)

    def step(self, value: Array, local: Local) -> Step:
        """Return b (3, n) with derivatives by the receiver's point and by the unit (3, 4, 1)."""
        by_unit = np.zeros((3, len(COLUMNS), 1))
        by_unit[:, :3, 0] = -np.eye(3)
        return Step(value - local.rows(self.block)[:3], np.eye(3)[:, :, None], {self.block: by_unit})


@dataclass(frozen=True)
class BeamBack:
    """The beam seen from the receiver: `b = p - r`."""

    block: str = UNIT
    takes = Quantity.POINT_IN_MACHINE
    gives = Quantity.BEAM_BACK

    @property
    def blocks(self) -> tuple[str, ...]:
        """The unit."""
        return (self.block,)

    def step(self, value: Array, local: Local) -> Step:
        """Return b (3, n) with derivatives by the receiver's point and by the unit (3, 4, 1)."""
        by_unit = np.zeros((3, len(COLUMNS), 1))
        by_unit[:, :3, 0] = np.eye(3)
        return Step(local.rows(self.block)[:3] - value, -np.eye(3)[:, :, None], {self.block: by_unit})


@dataclass(frozen=True)
class AboutBase:
    """Into the frame of a unit whose base is turned by an angle about z: `b' = Rz(-angle) b`."""

    block: str
    column: int
    takes: Quantity
    gives: Quantity

    @property
    def blocks(self) -> tuple[str, ...]:
        """The block that has the angle."""
        return (self.block,)

    def step(self, value: Array, local: Local) -> Step:
        """Return b' (3, n) with derivatives by b and by the angle."""
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
    """Encoder angles that point along a beam: base `a = atan2(by, bx)`, tilt `e = atan2(bz, sqrt(bx^2 + by^2))`.

    Both are predicted as the reading has them: in its turn of the circle, and in its face, since (a + 180 deg,
    180 deg - e) points the same way. So residuals are small at any angle, however the encoders count.
    """

    takes: Quantity
    gives: Quantity
    blocks = ()

    def step(self, value: Array, local: Local) -> Step:
        """Return base and tilt [rad] (2, n) with their derivatives by the beam."""
        x, y, z = value
        level2 = np.maximum(x * x + y * y, np.finfo(float).tiny)
        level, square = np.sqrt(level2), level2 + z * z
        readings = local.observations.readings
        over = np.cos(readings[1]) < 0
        face = np.where(over, -1.0, 1.0)
        angles = np.stack([np.arctan2(y, x), face * np.arctan2(z, level)]) + np.where(over, np.pi, 0.0)
        by_beam = np.zeros((2, 3, value.shape[1]))
        by_beam[0, 0], by_beam[0, 1] = -y / level2, x / level2
        by_beam[1] = face * np.stack([-x * z / level, -y * z / level, level]) / square
        return Step(angles + _TURN * np.round((readings - angles) / _TURN), by_beam)


@dataclass(frozen=True)
class BeamLength:
    """Distance of the control points, `|b|`."""

    takes = Quantity.BEAM_OUT
    gives = Quantity.LENGTH
    blocks = ()

    def step(self, value: Array, local: Local) -> Step:
        """Return the distance (1, n) with its derivative by the beam."""
        distance = np.sqrt(np.einsum("an,an->n", value, value))
        return Step(distance[None], (value / distance)[None])


def launch_chain() -> Chain:
    """Return the forward model of phi1, phi2."""
    return Chain(
        (
            _receiver(),
            BeamOut(),
            AboutBase(UNIT, _GAMMA, Quantity.BEAM_OUT, Quantity.BEAM_AT_LAUNCH),
            Encoders(Quantity.BEAM_AT_LAUNCH, Quantity.LAUNCH_ANGLES),
        )
    )


def receiver_chain() -> Chain:
    """Return the forward model of phi4, phi3."""
    return Chain(
        (
            _receiver(),
            BeamBack(),
            AboutBase(SPINDLE, 0, Quantity.BEAM_BACK, Quantity.BEAM_AT_RECEIVER),
            Encoders(Quantity.BEAM_AT_RECEIVER, Quantity.RECEIVER_ANGLES),
        )
    )


def distance_chain() -> Chain:
    """Return the forward model of a distance."""
    return Chain((_receiver(), BeamOut(), BeamLength()))


def _receiver() -> PointOf:
    return PointOf(RECEIVER, Quantity.POINT_IN_MACHINE)


def unit_block(place: Array, gamma: float, distance: float) -> Block:
    """Return the unit at a place; an uncertainty beyond 1 % of its `distance` from the receivers says nothing."""
    reach = np.array([_REACH * distance] * 3 + [_REACH])
    return Block(UNIT, np.array([[*place, gamma]]), COLUMNS, reach=reach, noun="launch unit")


def receiver_block(points: Array, names: Sequence[str], free: Mask, distance: float) -> Block:
    """Return the receiver's control points (poses, 3)."""
    return Block(
        RECEIVER, points, ("x", "y", "z"), tuple(names), free=free, reach=np.array(_REACH * distance), noun="pose"
    )


def spindle_block(angles: Array, names: Sequence[str]) -> Block:
    """Return the known angles of the spindle (poses,)."""
    return Block(SPINDLE, angles[:, None], ("psi",), tuple(names), free=np.array(False), noun="pose")


def direction(base: Array, tilt: Array) -> Array:
    """Return unit vectors (n, 3) from base and tilt angles [rad]."""
    return np.stack([np.cos(tilt) * np.cos(base), np.cos(tilt) * np.sin(base), np.sin(tilt)], axis=-1)
