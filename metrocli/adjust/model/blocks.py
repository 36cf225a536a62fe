"""Blocks: named arrays of unknowns, each free or fixed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace
from enum import Enum
from functools import cached_property

import numpy as np

from metrocli.arrays import Array as Array
from metrocli.arrays import Mask
from metrocli.frozen import dataclass
from metrocli.geometry import poses

_LEAST_WAVE = 1e-9
"""Amplitude below which a phase is meaningless"""


class Space(Enum):
    """How the values of a block change by a step, and how two values differ."""

    FLAT = "values that add"
    POSE = "poses: shifts add, rotations turn from the left"
    WAVE = "amplitude, phase, and more that adds: steps go along the phasor and across it"

    def moved(self, values: Array, step: Array) -> Array:
        """Return values after a step, both (members, size)."""
        if self is Space.POSE:
            return poses.moved(values, step)
        if self is Space.WAVE:
            moved = values + step
            # a phasor plus a step along and across it: regular where the amplitude is 0 and the phase is any
            moved[:, 0] = np.hypot(values[:, 0] + step[:, 0], step[:, 1])
            moved[:, 1] = values[:, 1] + np.arctan2(step[:, 1], values[:, 0] + step[:, 0])
            return moved
        return values + step

    def difference(self, values: Array, reference: Array) -> Array:
        """Return the step that leads from `reference` to `values`, (members, size)."""
        if self is Space.POSE:
            return poses.difference(values, reference)
        difference = values - reference
        if self is Space.WAVE:
            turn = difference[:, 1].copy()
            difference[:, 0] = values[:, 0] * np.cos(turn) - reference[:, 0]
            difference[:, 1] = values[:, 0] * np.sin(turn)
        return difference

    def by_step(self, values: Array) -> Array:
        """Return how much each value changes by a unit step, (members, size): 1, for a phase 1/amplitude."""
        change = np.ones_like(values)
        if self is Space.WAVE:
            change[:, 1] = 1 / np.maximum(np.abs(values[:, 0]), _LEAST_WAVE)
        return change

    def difference_by_step(self, values: Array, reference: Array) -> Array:
        """Return the derivatives of `difference` by a step of the values, (members, size, size)."""
        if self is Space.POSE:
            return poses.difference_by_step(values, reference)
        derivative = np.array(np.broadcast_to(np.eye(values.shape[-1]), (*values.shape, values.shape[-1])))
        if self is Space.WAVE:
            turn = values[:, 1] - reference[:, 1]
            derivative[:, 0, 0] = derivative[:, 1, 1] = np.cos(turn)
            derivative[:, 1, 0] = np.sin(turn)
            derivative[:, 0, 1] = -derivative[:, 1, 0]
        return derivative


@dataclass(frozen=True)
class Block:
    """Unknowns of one kind: `values` (members, size) with one row for each member (an image, a target, a tracer)."""

    name: str
    values: Array
    columns: tuple[str, ...]
    """Name of each of the `size` unknowns of a member"""
    members: tuple[str, ...] = ("",)
    free: Mask = field(default_factory=lambda: np.array(True))
    """Which entries the adjustment solves for, broadcast to (members, size)"""
    reach: Array = field(default_factory=lambda: np.array(np.inf))
    """Plausible size of each unknown's error, broadcast to (size,); an unknown is undetermined if it is less certain"""
    space: Space = Space.FLAT
    noun: str = ""
    """Name of a member in messages, e.g. 'image', 'target'"""

    def __post_init__(self) -> None:
        values = np.atleast_2d(np.asarray(self.values, dtype=float))
        if values.shape != (len(self.members), len(self.columns)):
            raise ValueError(
                f"block {self.name}: {values.shape} values for {len(self.members)} members x {len(self.columns)}"
            )
        object.__setattr__(self, "values", values)
        free = np.asarray(self.free, dtype=bool)
        object.__setattr__(self, "free", free if free.shape == values.shape else np.broadcast_to(free, values.shape))
        object.__setattr__(self, "reach", np.broadcast_to(np.asarray(self.reach, dtype=float), values.shape[1:]))

    @property
    def size(self) -> int:
        """Number of unknowns of one member."""
        return len(self.columns)

    @cached_property
    def all_free(self) -> bool:
        """Whether every entry is solved for."""
        return bool(self.free.all())

    @cached_property
    def rotations(self) -> Array:
        """R of each member, if the members are poses, (members, 3, 3)."""
        return poses.rotation_of(self.values)

    def with_values(self, values: Array) -> Block:
        """Return the block with other values."""
        return replace(self, values=values)

    def with_columns(self, names: tuple[str, ...], reach: Array) -> Block:
        """Return the block with additional columns, fixed at 0."""
        if not names:
            return self
        shape = (len(self.members), len(names))
        return replace(
            self,
            values=np.concatenate([self.values, np.zeros(shape)], axis=1),
            columns=(*self.columns, *names),
            free=np.concatenate([self.free, np.zeros(shape, dtype=bool)], axis=1),
            reach=np.concatenate([self.reach, reach]),
        )

    def fixed(self) -> Block:
        """Return the block with all entries fixed."""
        return replace(self, free=np.array(False))

    def moved(self, step: Array) -> Block:
        """Return the block after a step (members, size)."""
        return replace(self, values=self.space.moved(self.values, step))

    def row(self, member: str = "") -> Array:
        """Return the values of one member."""
        row: Array = self.values[self.members.index(member)]
        return row

    def named(self, member: str = "") -> dict[str, float]:
        """Return the values of one member as a dictionary by column."""
        return dict(zip(self.columns, self.row(member).tolist(), strict=True))

    def column(self, name: str) -> int:
        """Return the index of the column `name`."""
        return self.columns.index(name)

    def mask(self, names: Sequence[str]) -> Mask:
        """Return a mask (size,) that is True at the named columns."""
        return np.array([column in names for column in self.columns])
