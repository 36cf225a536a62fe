"""Geometric errors of a machine with three linear axes, in the names and signs of ISO 230-1 (actual minus commanded).

The lever L_a of axis a is the sum of the positions of the axes nearer to the tool, plus the tool vector T. To first
order, the tool is displaced against the workpiece by `d = sum_a [E_a(x_a) + theta_a(x_a) x L_a] + q`, with
`q = (-C0Y y + B0Z z, -A0Z z, 0)`. The formula holds for all six orders of axes; the place of the bed in the chain makes
no difference to first order.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from functools import cached_property

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Local, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass

AXES = ("X", "Y", "Z")
POSITION = ("x", "y", "z")
"""Conditions of an observation that contain the commanded position"""
SQUARENESS, TOOL = "squareness", "tool"
"""Names of the blocks besides those of the axes"""
SQUARENESS_NAMES = ("A0Z", "B0Z", "C0Y")
ANGLES = ("A", "B", "C")
_MOST_LENGTH, _MOST_ANGLE = 1.0, 1e-3
"""Largest plausible entries of a table [mm, rad]; an error with a larger standard uncertainty is not determined"""


def errors_of(axis: str) -> tuple[str, ...]:
    """Return the names of the six errors of an axis: EXX, EYX, EZX, EAX, EBX, ECX for X."""
    return tuple(f"E{direction}{axis}" for direction in (*AXES, *ANGLES))


ERRORS = tuple(name for axis in AXES for name in errors_of(axis))
ALL_NAMES = (*ERRORS, *SQUARENESS_NAMES)


def is_angle(name: str) -> bool:
    """Return whether an error is an angle (EAX, C0Y) and not a displacement (EXX)."""
    return name[1] in ANGLES or name in SQUARENESS_NAMES


def canonical(name: str) -> str:
    """Return the name of an error as in ISO 230-1; COY, BOZ and AOZ are taken for C0Y, B0Z and A0Z."""
    return name.replace("O", "0") if name in ("COY", "BOZ", "AOZ") else name


def axis_order(chain: str) -> tuple[int, ...]:
    """Return the order of the axes (0 for X) from the workpiece to the tool, from a text such as `wXbYZt` or `XYZ`.

    Raises ValueError if the text is not a chain of the three axes.
    """
    letters = re.sub(r"[\s\[\]]", "", chain)
    match = re.fullmatch(r"w?((?:[XYZ]|b(?=[XYZbt]|$))+)t?", letters)
    order = tuple(AXES.index(letter) for letter in (match[1] if match else "").replace("b", ""))
    if len(order) != 3 or len(set(order)) != 3 or letters.count("b") > 1:
        raise ValueError(f"'{chain}' is not a chain of the axes X, Y and Z from workpiece to tool, such as wXbYZt")
    return order


@dataclass(frozen=True)
class Axis:
    """The six error tables of an axis, linear between knots.

    Unknowns are raw values r at the knots. For straightness r is 0 at both ends. Positioning and angles are
    `E(x) = r(x) - r(reference)`, so that they are 0 at the reference; r is held at 0 at the knot nearest to it.
    """

    letter: str
    knots: Array
    """Positions, ascending"""

    @property
    def block(self) -> str:
        """Name of the axis' block of raw values, (knots, 6)."""
        return f"axis {self.letter}"

    @property
    def number(self) -> int:
        """Number of the axis: 0, 1, 2 for X, Y, Z."""
        return AXES.index(self.letter)

    @property
    def reference(self) -> float:
        """Position at which positioning and angles are 0: position 0, or the lowest position if 0 is out of range."""
        low, high = float(self.knots[0]), float(self.knots[-1])
        return 0.0 if low <= 0 <= high else low

    @property
    def straightness(self) -> Mask:
        """Mask of the two straightness errors among the six errors, (6,)."""
        mask = np.zeros(6, dtype=bool)
        mask[:3] = np.arange(3) != self.number
        return mask

    @cached_property
    def _at_reference(self) -> tuple[Index, Array]:
        lower, share = bracket(self.knots, np.array([self.reference]))
        return np.array([lower[0], lower[0] + 1]), np.array([1 - share[0], share[0]])

    def places(self, position: Array) -> tuple[Index, Array]:
        """Return the knots on which errors depend at each position, (k, n), and their weights, (k, 6, n) or (k, 1, n).

        k is 2, or 4 if the reference lies between two knots.
        """
        lower, share = bracket(self.knots, position)
        index, weight = np.stack([lower, lower + 1]), np.stack([1 - share, share])[:, None, :]
        knots, weights = self._at_reference
        if weights.max() == 1.0:
            return index, weight
        n = len(position)
        shifted = np.where(self.straightness, 0.0, -weights[:, None])[:, :, None]
        return (
            np.concatenate([index, np.repeat(knots[:, None], n, axis=1)]),
            np.concatenate([np.broadcast_to(part, (2, 6, n)) for part in (weight, shifted)]),
        )

    def free(self, estimated: Collection[str]) -> Mask:
        """Return the mask of raw values that are unknown, (knots, 6)."""
        free = np.ones((len(self.knots), 6), dtype=bool)
        knots, weights = self._at_reference
        free[[[0], [-1]], self.straightness] = False
        free[knots[np.argmax(weights)], ~self.straightness] = False
        return np.asarray(free & np.array([name in estimated for name in errors_of(self.letter)]))

    def block_of(self, tables: Mapping[str, Array], estimated: Collection[str]) -> Block:
        """Return the block of raw values for given tables, by name; tables that are not given are zero.

        The tables are given at the knots and in the gauge: zero at the reference, straightness zero at both ends.
        """
        values = np.stack([tables.get(name, np.zeros(len(self.knots))) for name in errors_of(self.letter)], axis=1)
        knots, weights = self._at_reference
        values = values - np.where(self.straightness, 0.0, values[knots[np.argmax(weights)]])
        reach = np.array([_MOST_LENGTH] * 3 + [_MOST_ANGLE] * 3)
        members = tuple(f"{knot:g}" for knot in self.knots)
        return Block(
            self.block, values, errors_of(self.letter), members, self.free(estimated), reach=reach, noun="position"
        )

    @cached_property
    def from_raw(self) -> Array:
        """Matrices that convert raw values to tables, (6, knots, knots)."""
        index, weight = self.places(self.knots)
        n = len(self.knots)
        matrices = np.zeros((6, n, n))
        for knots, weights in zip(index, weight, strict=True):
            for column in range(6):
                np.add.at(matrices[column], (np.arange(n), knots), np.broadcast_to(weights, (6, n))[column])
        return matrices


def bracket(knots: Array, position: Array) -> tuple[Index, Array]:
    """Return the lower knot of the interval of each position, and the position in the interval as a share, 0 to 1."""
    lower = np.clip(np.searchsorted(knots, position, side="right") - 1, 0, len(knots) - 2)
    return lower, (position - knots[lower]) / (knots[lower + 1] - knots[lower])


@dataclass(frozen=True)
class Machine:
    """Three linear axes in their order from workpiece to tool."""

    order: tuple[int, ...]
    axes: tuple[Axis, Axis, Axis]
    """The axes X, Y and Z, in this order"""

    def carried(self, axis: int) -> tuple[int, ...]:
        """Return the numbers of the axes that are nearer to the tool than a given axis."""
        return self.order[self.order.index(axis) + 1 :]

    def lever(self, axis: int, position: Array, tool: Array) -> Array:
        """Return the lever L_a, (3, n), at positions (3, n) with tool vectors (3, n) or (3, 1)."""
        lever = np.repeat(tool, position.shape[1], axis=1) if tool.shape[1] == 1 else tool.copy()
        carried = list(self.carried(axis))
        lever[carried] += position[carried]
        return lever

    def index(self, position: Array) -> dict[str, Index]:
        """Return for each block the knots on which readings at commanded positions (3, n) depend."""
        return {axis.block: axis.places(position[axis.number])[0] for axis in self.axes}

    @property
    def low(self) -> Array:
        """Lowest positions (3,)."""
        return np.array([axis.knots[0] for axis in self.axes])

    @property
    def high(self) -> Array:
        """Highest positions (3,)."""
        return np.array([axis.knots[-1] for axis in self.axes])

    @property
    def home(self) -> Array:
        """Positions of axes whose position is not given: their references (3,)."""
        return np.array([axis.reference for axis in self.axes])


def squareness_block(values: Mapping[str, float], estimated: Collection[str]) -> Block:
    """Return the block of the three squareness errors; those not given are zero."""
    free = np.array([[name in estimated for name in SQUARENESS_NAMES]])
    row = np.array([[values.get(name, 0.0) for name in SQUARENESS_NAMES]])
    return Block(SQUARENESS, row, SQUARENESS_NAMES, free=free, reach=np.array(10 * _MOST_ANGLE))


def tool_block(vectors: Array, names: Sequence[str], uncertainty: float) -> Block:
    """Return the block of tool vectors, (tools, 3); they are unknowns if their uncertainty is not zero."""
    reach = np.array(10 * max(uncertainty, _MOST_LENGTH))
    return Block(TOOL, vectors, ("x", "y", "z"), tuple(names), free=np.array(uncertainty > 0), reach=reach, noun="tool")


@dataclass(frozen=True)
class ErrorMotion:
    """Start of a chain: displacement d and rotation theta of the tool at the commanded position, (6, n)."""

    machine: Machine
    takes = None
    gives = Quantity.ERROR_MOTION

    @property
    def blocks(self) -> tuple[str, ...]:
        """Names of the blocks of the axes, of squareness, and of the tool vectors, which are part of the levers."""
        return (*(axis.block for axis in self.machine.axes), SQUARENESS, TOOL)

    def step(self, value: Array, local: Local) -> Step:
        """Return d and theta, with derivatives by the two (or four) knots of each axis on which a reading depends."""
        position = np.stack([local.observations.conditions[name] for name in POSITION])
        tool = local.rows(TOOL)
        motion, by_block = by_squareness(position, local.members(SQUARENESS)[0])
        by_tool = np.zeros((6, 3, position.shape[1]))
        for axis in self.machine.axes:
            index, weight = axis.places(position[axis.number])
            values = local.members(axis.block)
            error = sum(w * values[i].T for i, w in zip(index, weight, strict=True))
            lever = self.machine.lever(axis.number, position, tool)
            motion[:3] += error[:3] + _crossed(error[3:], lever)
            motion[3:] += error[3:]
            if TOOL in local.wanted:
                by_tool[:3] += _turning(error[3:])
            if axis.block in local.wanted:
                by_block[axis.block] = weight[:, None] * by_errors(lever)
        return Step(motion, by_block={**by_block, TOOL: by_tool})


def by_squareness(position: Array, values: Array) -> tuple[Array, dict[str, Array]]:
    """Return the motion (6, n) that squareness (3,) gives at positions (3, n), and its derivatives, (6, 3, n)."""
    _, y, z = position
    by_value = np.zeros((6, 3, position.shape[1]))
    by_value[0, 1], by_value[0, 2], by_value[1, 0] = z, -y, -z
    return np.einsum("abn,b->an", by_value, values), {SQUARENESS: by_value}


def by_errors(lever: Array) -> Array:
    """Return the derivatives of (d, theta) by the six errors of an axis, (6, 6, n), for levers (3, n).

    `d = E + theta x L`.
    """
    change = np.zeros((6, 6, lever.shape[1]))
    change[np.arange(6), np.arange(6)] = 1.0
    change[:3, 3:] = -_turning(lever)
    return change


def _turning(vectors: Array) -> Array:
    """Return the matrices (3, 3, n) of the cross products with vectors (3, n)."""
    x, y, z = vectors
    none = np.zeros(len(x))
    return np.array([[none, -z, y], [z, none, -x], [-y, x, none]])


def _crossed(first: Array, second: Array) -> Array:
    """Return the cross products of vectors (3, n); `numpy.cross` takes longer to arrange its axes than for these."""
    (a, b, c), (x, y, z) = first, second
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x])


@dataclass(frozen=True)
class ReachedPoint:
    """Link to the place of the reflector: commanded position, plus tool vector, plus displacement."""

    takes = Quantity.ERROR_MOTION
    gives = Quantity.POINT_IN_MACHINE
    blocks = (TOOL,)

    def step(self, value: Array, local: Local) -> Step:
        """Return the point, (3, n), with its derivatives by the motion, (3, 6, 1), and by the tool, (3, 3, 1)."""
        position = np.stack([local.observations.conditions[name] for name in POSITION])
        by_motion = np.eye(6)[:3, :, None]
        return Step(position + local.rows(TOOL) + value[:3], by_motion, {TOOL: np.eye(3)[:, :, None]})
