"""The axes of a machine and their error tables, in the names and signs of ISO 230-1 (actual minus commanded)."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import field
from functools import cached_property

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import LinkContext
from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass
from metrocli.instruments.axes.joints import JointMotion, slide

AXES = ("X", "Y", "Z")
POSITION = ("x", "y", "z")
"""Conditions of an observation that contain the commanded position"""
SQUARENESS, TOOL = "squareness", "tool"
"""Names of the blocks besides those of the axes"""
SQUARENESS_NAMES = ("A0Z", "B0Z", "C0Y")
ANGLES = ("A", "B", "C")
ROWS = 9
"""Rows of an axis among the errors of all axes: six of its tables, then a shift of its line along X, Y, Z"""
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


def spellings(names: Iterable[str]) -> dict[str, str]:
    """Return the names of errors by other spellings: E_X0C, as indices are written, and EC0Y or COY for C0Y."""
    return {
        **{f"E_{name.removeprefix('E')}": name for name in names},
        **{form: name for name in SQUARENESS_NAMES for form in (f"E{name}", name.replace("0", "O"))},
    }


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
    def turns(self) -> bool:
        """Whether it is a rotary axis."""
        return self.location != SQUARENESS

    @property
    def key(self) -> str:
        """Its name in the headings of files, and in job files."""
        return self.letter.lower()

    @property
    def unit(self) -> str:
        """Internal unit of its positions."""
        return "rad" if self.turns else "mm"

    @property
    def block(self) -> str:
        """Name of the axis' block of raw values, (knots, 6)."""
        return f"axis {self.letter}"

    @property
    def number(self) -> int:
        """Number of its direction: 0, 1, 2 for X, Y, Z; it is also that of its positioning error among the six."""
        return AXES.index(self.letter)

    @property
    def coordinate(self) -> str:
        """Name of the condition that holds its commanded position."""
        return self.key

    @property
    def location(self) -> str:
        """Name of the block with the location of its line: squareness, which all linear axes share."""
        return SQUARENESS

    @property
    def members(self) -> Array:
        """The knots that have raw values of their own."""
        return self.knots

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
        # the knot at the reference, if there is one: then `places` need not subtract r there
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

    def nearest(self, position: Array) -> Array:
        """Return positions (n,), or of a rotary axis the knots nearest to them."""
        return position

    def wrapped(self, position: Array) -> Array:
        """Return positions (n,), of a periodic axis within its range."""
        return position

    def motion(self, position: Array, errors: Array, location: Array) -> JointMotion:
        """Return the motion of the tool's side of the axis against its workpiece side at positions (n,).

        errors (9, n) are the six of the tables and a shift of the axis' line, location the values of its block.
        """
        return slide(self.number, position, errors, location)

    @cached_property
    def from_raw(self) -> Array:
        """Matrices that convert raw values to tables, (6, knots, members)."""
        index, weight = self.places(self.knots)
        n = len(self.knots)
        matrices = np.zeros((6, n, len(self.members)))
        for knots, weights in zip(index, weight, strict=True):
            for column in range(6):
                np.add.at(matrices[column], (np.arange(n), knots), np.broadcast_to(weights, (6, n))[column])
        return matrices


def bracket(knots: Array, position: Array) -> tuple[Index, Array]:
    """Return the lower knot of the interval of each position, and the position as a share of the interval.

    The share is 0 to 1 between the knots. The end intervals go on beyond them: a position just outside is extrapolated.
    """
    lower = np.clip(np.searchsorted(knots, position, side="right") - 1, 0, len(knots) - 2)
    return lower, (position - knots[lower]) / (knots[lower + 1] - knots[lower])


@dataclass(frozen=True)
class Machine:
    """Axes in their order from workpiece to tool, linear and rotary."""

    order: tuple[int, ...]
    """Numbers of the axes among `axes`"""
    axes: tuple[Axis, ...]
    """Those of X, Y, Z, A, B, C that the machine has, in this order"""
    bed: int = 0
    """How many of them are on the workpiece's side of the bed"""
    tools: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """Listed tool vectors, (tools, 3): errors of a machine with rotary axes are against the place of these"""

    @property
    def turns(self) -> bool:
        """Whether it has rotary axes, so that its motion is not a sum of displacements."""
        return any(axis.turns for axis in self.axes)

    @property
    def only_turns(self) -> bool:
        """Whether it has no linear axes."""
        return all(axis.turns for axis in self.axes)

    @property
    def at_bed(self) -> int:
        """Number of the axis next to the bed, on the side of the tool if there is one."""
        return self.order[min(self.bed, len(self.order) - 1)]

    def row(self, letter: str, error: int) -> int:
        """Return the number of an error among those of all axes (`Undisturbed`), by the letter of its axis.

        error is 0 to 5 for the six of the tables, 6 to 8 for a shift of the axis' line along X, Y, Z.
        """
        return ROWS * [axis.letter for axis in self.axes].index(letter.upper()) + error

    @staticmethod
    def is_disturbed(value: Array, local: LinkContext) -> bool:
        """Return whether derivatives by the errors of axes (9 axes, n or 1) are used: by effects, or where all are."""
        return value.shape[1] == local.observations.count or local.wanted.issuperset(local.blocks)

    def carried(self, axis: int) -> tuple[int, ...]:
        """Return the numbers of the axes that are nearer to the tool than a given axis."""
        return self.order[self.order.index(axis) + 1 :]

    def lever(self, axis: int, position: Array, tool: Array) -> Array:
        """Return the lever L_a, (3, n), at positions (3, n) with tool vectors (3, n) or (3, 1)."""
        # a copy, since positions are added in place
        lever = np.repeat(tool, position.shape[1], axis=1) if tool.shape[1] == 1 else tool.copy()
        carried = list(self.carried(axis))
        lever[carried] += position[carried]
        return lever

    def index(self, position: Array) -> dict[str, Index]:
        """Return for each block the knots on which readings at commanded positions (axes, n) depend."""
        return {axis.block: axis.places(own)[0] for axis, own in zip(self.axes, position, strict=True)}

    def conditions(self, position: Array) -> dict[str, Array]:
        """Return commanded positions (axes, n) as the conditions of readings."""
        return {axis.coordinate: own for axis, own in zip(self.axes, position, strict=True)}

    def columns(self, position: Array) -> dict[str, Array]:
        """Return commanded positions (axes, n) as columns of a table, by heading: "x [mm]", "a [rad]"."""
        return {f"{axis.key} [{axis.unit}]": own for axis, own in zip(self.axes, position, strict=True)}

    @property
    def low(self) -> Array:
        """Lowest positions (axes,)."""
        return np.array([axis.knots[0] for axis in self.axes])

    @property
    def high(self) -> Array:
        """Highest positions (axes,)."""
        return np.array([axis.knots[-1] for axis in self.axes])

    @property
    def diagonal(self) -> float:
        """Length of the diagonal of the linear travels [mm]."""
        return float(np.linalg.norm([np.ptp(axis.knots) for axis in self.axes if not axis.turns]))

    @property
    def home(self) -> Array:
        """Positions of axes whose position is not given: their references (axes,)."""
        return np.array([axis.reference for axis in self.axes])


def squareness_block(values: Mapping[str, float], estimated: Collection[str]) -> Block:
    """Return the block of the three squareness errors; those not given are zero."""
    free = np.array([[name in estimated for name in SQUARENESS_NAMES]])
    row = np.array([[values.get(name, 0.0) for name in SQUARENESS_NAMES]])
    return Block(SQUARENESS, row, SQUARENESS_NAMES, free=free, reach=np.array(10 * _MOST_ANGLE))


def tool_block(vectors: Array, names: Sequence[str], uncertainty: float) -> Block:
    """Return the block of tool vectors, (tools, 3); they are unknowns if their uncertainty is not zero."""
    reach = np.array(10 * max(uncertainty if np.isfinite(uncertainty) else 0.0, _MOST_LENGTH))
    return Block(TOOL, vectors, ("x", "y", "z"), tuple(names), free=np.array(uncertainty > 0), reach=reach, noun="tool")
