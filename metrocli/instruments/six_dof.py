"""Lasers along lines: displacement, straightness in two directions and three angles; or one angle of a rotary axis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Chain, LinkContext, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.arrays import Array, Mask
from metrocli.frozen import dataclass
from metrocli.instruments.axes.error_motion import Undisturbed
from metrocli.instruments.axes.kinematics import motion
from metrocli.instruments.axes.rotary import RotaryAxis
from metrocli.instruments.machine import ROWS, Machine

LINE = "line"
"""Block: offsets of the six channels of each line, and the slope of its beam in two directions across the line"""
COLUMNS = ("ex", "ey", "ez", "ea", "eb", "ec", "slope_1", "slope_2")
CHANNELS = COLUMNS[:6]
POSITION = "position"
"""Condition of an observation: distance along its line, from the middle"""
ACROSS = tuple(f"{which}{axis}" for which in "ab" for axis in "xyz")
"""Conditions: two unit vectors across the line"""
ALONG = tuple(f"along_{axis}" for axis in "xyz")
"""Conditions: unit vector along the line, in the sense of growing positions"""
ABOUT = "about {axis}"
"""Condition: 1 where the line turns the axis, 0 where it stands"""
DISPLACEMENT, TURN = "displacement", "turn"
"""Components of readings of the positioning alone: along a linear axis, about a rotary one"""
ANGULAR = (*CHANNELS[3:], TURN)
"""Components that are angles"""
FROM_START = "from start"
"""Condition: distance from the lowest position of the line"""
_REACH = np.array([10.0] * 3 + [0.1] * 5)


@dataclass(frozen=True)
class LineNoise:
    """Standard deviations along the beam, perpendicular to it, and of angles."""

    displacement: float
    straightness: float
    angle: float

    def covariance(self, along: Array) -> Array:
        """Return the covariance of the channels of lines along unit vectors (3, n), (6, 6, n)."""
        covariance = np.zeros((6, 6, along.shape[1]))
        square = self.straightness**2
        # `straightness^2` in all directions, and along the beam what makes it `displacement^2`
        covariance[:3, :3] = (
            np.eye(3)[:, :, None] * square + (self.displacement**2 - square) * along[:, None] * along[None]
        )
        covariance[np.arange(3, 6), np.arange(3, 6)] = self.angle**2
        return covariance


def line_block(names: Sequence[str], free: Mask | bool = True) -> Block:
    """Return the block of misalignments of the lines, (lines, 8), all zero; those in `free` are unknown."""
    return Block(LINE, np.zeros((len(names), 8)), COLUMNS, tuple(names), np.asarray(free), reach=_REACH, noun="line")


@dataclass(frozen=True)
class Misaligned:
    """Link from an error motion to the six readings of the laser: zero offsets of the channels, and a misaligned beam.

    The slope of the beam acts only on the readings across it. Along the beam it gives a cosine error, `1 - cos a`,
    which is 0.5 um/m at 1 mrad and is neglected.
    """

    takes = Quantity.ERROR_MOTION
    gives = Quantity.ERROR_MOTION
    blocks = (LINE,)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the six channels, (6, n), with their derivatives by the motion and by the line, (6, 8, n)."""
        given = local.observations.conditions
        across = np.stack([given[name] for name in ACROSS]).reshape(2, 3, -1) * given[POSITION]
        by_line = np.zeros((6, 8, local.observations.count))
        by_line[np.arange(6), np.arange(6)] = 1.0
        by_line[:3, 6:] = np.swapaxes(across, 0, 1)
        moved = value + np.einsum("abn,bn->an", by_line, np.broadcast_to(local.rows(LINE), (8, value.shape[1])))
        return Step(moved, np.eye(6)[:, :, None], {LINE: by_line})


@dataclass(frozen=True)
class Displacement:
    """Link from the six channels to the displacement along the line, all that a plain laser or a scale reads."""

    takes = Quantity.ERROR_MOTION
    gives = Quantity.DISPLACEMENT
    blocks = ()

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the displacement, (1, n), with its derivative by the channels, (1, 6, n)."""
        along = np.zeros((1, 6, local.observations.count))
        along[0, :3] = [local.observations.conditions[name] for name in ALONG]
        return Step((along[0] * value).sum(axis=0)[None], along)


@dataclass(frozen=True)
class Turn:
    """Link from the errors of rotary axes to the error of the angle about the axis that a line turns.

    It is what a rotary indexer with a laser, or an autocollimator with a polygon, reads: actual minus commanded in the
    count of the axis, `sense E + zero of the line`.
    """

    machine: Machine
    takes = Quantity.AXIS_ERRORS
    gives = Quantity.ANGLE

    @property
    def blocks(self) -> tuple[str, ...]:
        """Names of the blocks of the axes, and of the lines."""
        return (*(axis.block for axis in self.machine.axes), LINE)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the error of the angle, (1, n), with its derivatives."""
        n, given = local.observations.count, local.observations.conditions
        read, zero = np.zeros((1, n)), np.broadcast_to(local.rows(LINE), (len(COLUMNS), n))
        disturbed, by_line = np.zeros((1, len(value), n)), np.zeros((1, len(COLUMNS), n))
        by_block: dict[str, Array] = {LINE: by_line}
        for number, axis in enumerate(self.machine.axes):
            turns, error = given[ABOUT.format(axis=axis.key)], axis.number + 3
            sense = turns * (axis.sense if isinstance(axis, RotaryAxis) else 1)
            index, weight = axis.places(given[axis.coordinate])
            by_knots = np.zeros((len(weight), 1, 6, n))
            by_knots[:, 0, error] = sense * weight[:, 0]
            values = local.members(axis.block)[:, error]
            row = ROWS * number + error
            read += sense * ((weight[:, 0] * values[index]).sum(axis=0) + value[row]) + turns * zero[error]
            disturbed[0, row] = sense
            by_block[axis.block], by_line[0, error] = by_knots, turns
        return Step(read, disturbed if self.machine.is_disturbed(value, local) else None, by_block)


def line_chain(machine: Machine, positioning: bool = False) -> Chain:
    """Return the forward model of a reading on a line, or of one of the positioning alone."""
    if machine.turns:
        return Chain((Undisturbed(machine), Turn(machine)))
    return Chain((*motion(machine), Misaligned(), *([Displacement()] if positioning else [])))
