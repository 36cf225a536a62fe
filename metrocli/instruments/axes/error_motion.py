"""The motion of a machine with three linear axes, to first order in its errors.

The lever L_a of axis a is the sum of the positions of the axes nearer to the tool, plus the tool vector T. To first
order, the tool is displaced against the workpiece by `d = sum_a [E_a(x_a) + theta_a(x_a) x L_a] + q`, with
`q = (-C0Y y + B0Z z, -A0Z z, 0)`. The formula holds for all six orders of axes; the place of the bed in the chain makes
no difference to first order.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import LinkContext, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.instruments.axes.joints import crossed
from metrocli.instruments.machine import ANGLES, POSITION, ROWS, SQUARENESS, TOOL, Machine


@dataclass(frozen=True)
class Undisturbed:
    """Start of a chain: the errors of the axes besides their tables, all zero, (9 axes, 1).

    Effects on axes add to them; `Machine.row` gives the row of an error. Without effects they are
    the same at all readings.
    """

    machine: Machine
    takes = None
    gives = Quantity.AXIS_ERRORS
    blocks = ()

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return zeros."""
        # one column stands for all readings, and by its width `is_disturbed` sees that no effect acts
        return Step(np.zeros((ROWS * len(self.machine.axes), 1)))


_POSITIONS = "positions of {axis}"
"""Block of what a rotary axis turned beyond its positions [rad]; a member for each position that is an unknown"""
POSITIONS = tuple(_POSITIONS.format(axis=axis) for axis in ANGLES)
"""Names of these blocks"""
FAR_OFF = 0.2
"""Plausible error of a position of which little is known [rad]"""


def positions_block(letter: str, names: Sequence[str]) -> Block:
    """Return the block of the positions of an axis that are estimated, by name."""
    start, name = np.zeros((len(names), 1)), _POSITIONS.format(axis=letter)
    return Block(name, start, (letter.lower(),), tuple(names), reach=np.array(FAR_OFF), noun="position")


@dataclass(frozen=True)
class EstimatedPositions:
    """Link to the errors of the axes with what rotary axes turned beyond their positions, any angle."""

    machine: Machine
    letters: tuple[str, ...]
    takes = gives = Quantity.AXIS_ERRORS

    @property
    def blocks(self) -> tuple[str, ...]:
        """Names of the blocks of their positions."""
        return tuple(_POSITIONS.format(axis=letter) for letter in self.letters)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the errors (9 axes, n), with their derivatives by the positions."""
        n = local.observations.count
        total, by_block = np.array(np.broadcast_to(value, (len(value), n))), dict[str, Array]()
        for letter, name in zip(self.letters, self.blocks, strict=True):
            row = self.machine.row(letter.lower(), 3 + ANGLES.index(letter))
            total[row] += local.rows(name)[0]
            by_block[name] = np.zeros((len(value), 1, n))
            by_block[name][row] = 1.0
        return Step(total, None, by_block)


@dataclass(frozen=True)
class ErrorMotion:
    """Link to displacement d and rotation theta of the tool at the commanded position, (6, n), to first order."""

    machine: Machine
    takes = Quantity.AXIS_ERRORS
    gives = Quantity.ERROR_MOTION

    @property
    def blocks(self) -> tuple[str, ...]:
        """Names of the blocks of the axes, of squareness, and of the tool vectors, which are part of the levers."""
        return (*(axis.block for axis in self.machine.axes), SQUARENESS, TOOL)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return d and theta, with derivatives by the two (or four) knots of each axis on which a reading depends."""
        position = np.stack([local.observations.conditions[name] for name in POSITION])
        tool = local.rows(TOOL)
        motion, by_block = by_squareness(position, local.members(SQUARENESS)[0])
        by_tool = np.zeros((6, 3, position.shape[1]))
        n = position.shape[1]
        disturbed = np.zeros((6, len(value), n)) if self.machine.is_disturbed(value, local) else None
        for number, axis in enumerate(self.machine.axes):
            index, weight = axis.places(position[axis.number])
            values = local.members(axis.block)
            own = slice(ROWS * number, ROWS * number + 6)
            error = sum(w * values[i].T for i, w in zip(index, weight, strict=True)) + value[own]
            lever = self.machine.lever(axis.number, position, tool)
            motion[:3] += error[:3] + crossed(error[3:], lever)
            motion[3:] += error[3:]
            if TOOL in local.wanted:
                by_tool[:3] += _turning(error[3:])
            if disturbed is not None:
                disturbed[:, own] = by_errors(lever)
            if axis.block in local.wanted:
                by_block[axis.block] = weight[:, None] * by_errors(lever)
        return Step(motion, disturbed, {**by_block, TOOL: by_tool})


def by_squareness(position: Array, values: Array) -> tuple[Array, dict[str, Array]]:
    """Return the motion (6, n) that squareness (3,) gives at positions (3, n), and its derivatives, (6, 3, n)."""
    _, y, z = position
    by_value = np.zeros((6, 3, position.shape[1]))
    # q of the module: `-C0Y y + B0Z z` along x, `-A0Z z` along y, with the columns in the order A0Z, B0Z, C0Y
    by_value[0, 1], by_value[0, 2], by_value[1, 0] = z, -y, -z
    return np.einsum("abn,b->an", by_value, values), {SQUARENESS: by_value}


def by_errors(lever: Array) -> Array:
    """Return the derivatives of (d, theta) by the six errors of an axis, (6, 6, n), for levers (3, n).

    `d = E + theta x L`.
    """
    change = np.zeros((6, 6, lever.shape[1]))
    change[np.arange(6), np.arange(6)] = 1.0
    # `theta x L = -[L]x theta`
    change[:3, 3:] = -_turning(lever)
    return change


def _turning(vectors: Array) -> Array:
    """Return the matrices (3, 3, n) of the cross products with vectors (3, n)."""
    x, y, z = vectors
    none = np.zeros(len(x))
    return np.array([[none, -z, y], [z, none, -x], [-y, x, none]])


@dataclass(frozen=True)
class ReachedPoint:
    """Link to the place of the reflector: commanded position, plus tool vector, plus displacement."""

    takes = Quantity.ERROR_MOTION
    gives = Quantity.POINT_IN_MACHINE
    blocks = (TOOL,)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point, (3, n), with its derivatives by the motion, (3, 6, 1), and by the tool, (3, 3, 1)."""
        position = np.stack([local.observations.conditions[name] for name in POSITION])
        by_motion = np.eye(6)[:3, :, None]
        return Step(position + local.rows(TOOL) + value[:3], by_motion, {TOOL: np.eye(3)[:, :, None]})
