"""Rotary axes: their error tables, where their lines lie, and the conditions that separate the two.

Six tables of a rotary axis hold ten directions that are not errors of its motion: constants, and what turns once with
the turning part, belong to the place of the axis and of what rides on it. So the tables are orthogonal to them
(`gauge`), and the location errors are those of the axis average line (ISO 230-1, ISO 230-7).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Chain, LinkContext, Step
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.model.quantities import Quantity
from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass
from metrocli.instruments.axes.joints import JointMotion, turn
from metrocli.instruments.machine import ALL_NAMES, ANGLES, AXES, Axis, Machine, bracket, errors_of

SPINDLE = "spindle"
SPINDLE_NAMES = ("EA0S", "EB0S", "EC0S")
ANGLE = "angle_{axis}"
"""Condition: commanded position of a rotary axis [rad]"""
_TURN = 2 * np.pi
_HELD = 1e-6
"""Standard deviation of the conditions [mm]; nothing pulls at them, so its size only has to be far below the noise"""
_MOST_OFF, _MOST_TURNED = 10.0, 1e-2
"""Largest plausible location errors [mm, rad]"""


def location_names(letter: str) -> tuple[str, ...]:
    """Return the location errors of a rotary axis and its zero position: EX0C, EY0C, EA0C, EB0C, EC0C for C."""
    across = [i for i in range(3) if ANGLES[i] != letter]
    directions = [kind[i] for kind in (AXES, ANGLES) for i in across]
    return tuple(f"E{direction}0{letter}" for direction in (*directions, letter))


LOCATIONS = tuple(name for letter in ANGLES for name in location_names(letter))
ROTARY_ERRORS = tuple(name for letter in ANGLES for name in errors_of(letter))
NAMES = (*ALL_NAMES, *ROTARY_ERRORS, *LOCATIONS, *SPINDLE_NAMES)


@dataclass(frozen=True)
class RotaryAxis(Axis):
    """The six error tables of a rotary axis, linear between knots, and a point of its nominal line.

    Knots are in rad. A periodic axis takes any turn; its first and its last knot are one.
    """

    at: tuple[float, ...] = (0.0, 0.0, 0.0)
    sense: int = 1
    """-1 if it counts against the right-handed turn of the tool against the workpiece"""
    periodic: bool = False
    head: bool = False
    """Whether it is on the tool's side of the bed"""

    @property
    def number(self) -> int:
        """Number of its direction: 0, 1, 2 for A, B, C."""
        return ANGLES.index(self.letter)

    @property
    def coordinate(self) -> str:
        """Name of the condition that holds its commanded position."""
        return ANGLE.format(axis=self.key)

    @property
    def location(self) -> str:
        """Name of the block of its location errors."""
        return f"place of {self.letter}"

    @property
    def members(self) -> Array:
        """The knots that have values of their own."""
        return self.knots[:-1] if self.periodic else self.knots

    @property
    def straightness(self) -> Mask:
        """No table is zero at both ends."""
        return np.zeros(6, dtype=bool)

    def wrapped(self, position: Array) -> Array:
        """Return positions (n,), of a periodic axis within its range."""
        low = self.knots[0]
        return np.asarray(low + np.mod(position - low, _TURN) if self.periodic else position)

    def places(self, position: Array) -> tuple[Index, Array]:
        """Return the two knots on which errors depend at each position, (2, n), and their weights, (2, 1, n)."""
        lower, share = bracket(self.knots, self.wrapped(position))
        # the last knot of a periodic axis is the first again, so its number wraps
        return np.stack([lower, lower + 1]) % len(self.members), np.stack([1 - share, share])[:, None, :]

    def nearest(self, position: Array) -> Array:
        """Return the knot nearest to each position, (n,)."""
        index, weight = self.places(position)
        return np.asarray(self.members[np.where(weight[0, 0] >= weight[1, 0], index[0], index[1])])

    def free(self, estimated: Collection[str]) -> Mask:
        """Return the mask of values that are unknown, (members, 6)."""
        named = np.array([name in estimated for name in errors_of(self.letter)])
        return np.broadcast_to(named, (len(self.members), 6))

    def block_of(self, tables: Mapping[str, Array], estimated: Collection[str]) -> Block:
        """Return the block of the tables, by name, given at the knots; tables that are not given are zero."""
        n = len(self.members)
        values = np.stack([tables.get(name, np.zeros(n))[:n] for name in errors_of(self.letter)], axis=1)
        reach, members = np.array([1.0] * 3 + [1e-3] * 3), tuple(f"{np.degrees(knot):g}" for knot in self.members)
        return Block(
            self.block, values, errors_of(self.letter), members, self.free(estimated), reach=reach, noun="position"
        )

    def motion(self, position: Array, errors: Array, location: Array) -> JointMotion:
        """Return the motion of the tool's side of the axis against its workpiece side at positions (n,)."""
        return turn(self.number, self.sense * position, errors, location, (np.array(self.at), self.head))

    def location_block(self, values: Mapping[str, float], estimated: Collection[str]) -> Block:
        """Return the block of the location errors and the zero position; those not given are zero."""
        names = location_names(self.letter)
        row, free = (
            np.array([[values.get(name, 0.0) for name in names]]),
            np.array([[name in estimated for name in names]]),
        )
        reach = np.array([_MOST_OFF] * 2 + [_MOST_TURNED] * 3)
        return Block(self.location, row, names, free=free, reach=reach)

    def conditions(self, free: Mask) -> Array:
        """Return the ten directions of the tables that are not errors of the motion, of length 1, (10, members, 6).

        Across the axis and in the two tilts: constants, and `(cos s, -+sin s), (+-sin s, cos s)`, upper sign for a
        table. The axial table has the mean 0, and the angle is 0 at the reference. Directions that need a table that is
        not free are left out.
        """
        i, n = self.number, len(self.members)
        j, k = (i + 1) % 3, (i + 2) % 3
        cos, sin = np.cos(self.sense * self.members), np.sin(self.sense * self.members) * (-1.0 if self.head else 1.0)
        ones, none, angles = np.ones(n), np.zeros(n), []
        # shift 0 are displacements, 3 are angles: both have the same four directions across the axis
        for shift in (0, 3):
            for first, second in ((ones, none), (none, ones), (cos, -sin), (sin, cos)):
                angles.append(np.zeros((n, 6)))
                angles[-1][:, j + shift], angles[-1][:, k + shift] = first, second
        angles += [np.zeros((n, 6)), np.zeros((n, 6))]
        angles[-2][:, i] = 1.0
        index, weight = self.places(np.array([self.reference]))
        angles[-1][index[:, 0], i + 3] = weight[:, 0, 0]
        # conditions of near-zero std take these ten out, rather than a choice of unknowns that would couple all
        # knots (docs/decisions/190-conditions-hold-the-gauge.md)
        held = [unit / np.linalg.norm(unit) for unit in angles if free[np.abs(unit) > 0].all()]
        return np.array(held).reshape(-1, n, 6)

    def in_gauge(self, block: Block) -> Block:
        """Return the block of the tables without the directions that are not errors of the motion (`conditions`)."""
        # the ten directions are not orthogonal where knots are uneven, so each alone would leave a part of another
        basis, _ = np.linalg.qr(self.conditions(block.free).reshape(-1, block.values.size).T)
        flat = block.values.ravel()
        return block.with_values((flat - basis @ (basis.T @ flat)).reshape(block.values.shape))


@dataclass(frozen=True)
class Combinations:
    """The forward model of conditions: linear combinations of all entries of some blocks."""

    weights: Mapping[str, Array]
    """Those of each block, (conditions, members, columns)"""
    takes = None
    gives = Quantity.PARAMETERS

    @property
    def blocks(self) -> tuple[str, ...]:
        """Names of the blocks."""
        return tuple(self.weights)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the combinations (conditions, 1) and their derivatives by each member."""
        applied = sum(np.einsum("cmk,mk->c", own, local.members(name)) for name, own in self.weights.items())
        derivatives = {name: np.swapaxes(own, 0, 1)[..., None] for name, own in self.weights.items()}
        return Step(np.asarray(applied)[:, None], by_block=derivatives)


def turning_axes(machine: Machine) -> list[RotaryAxis]:
    """Return the rotary axes of a machine."""
    return [axis for axis in machine.axes if isinstance(axis, RotaryAxis)]


def gauge(machine: Machine, blocks: Mapping[str, Block]) -> tuple[Group, ...]:
    """Return the conditions that hold the tables of the rotary axes apart from their locations, one group an axis."""
    groups = []
    for axis in turning_axes(machine):
        block = blocks[axis.block]
        weights = axis.conditions(block.free)
        if len(weights):
            # rad in place of mm: 1e-9 rad at a metre is what 1e-6 mm is
            scale = np.where((np.abs(weights[:, :, 3:]) > 0).any(axis=(1, 2)), 1e-3 * _HELD, _HELD)
            index = {axis.block: np.arange(len(block.members))[:, None]}
            held = Observations(np.zeros((len(weights), 1)), scale[:, None], index)
            groups.append(Group(f"gauge of {axis.letter}", Chain((Combinations({axis.block: weights}),)), held))
    return tuple(groups)


def spindle_block(values: Mapping[str, float], estimated: Collection[str]) -> Block:
    """Return the block of the angles by which the axes of the tool vectors stand off; those not given are zero."""
    free = np.array([[name in estimated for name in SPINDLE_NAMES]])
    row = np.array([[values.get(name, 0.0) for name in SPINDLE_NAMES]])
    return Block(SPINDLE, row, SPINDLE_NAMES, free=free, reach=np.array(_MOST_TURNED))
