"""What an adjustment returns: values, covariance, statistics, and tests of each reading."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group, Touch, rows_of
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.outcome import Combination, Outcome
from metrocli.adjust.probabilities import chi_square_tail
from metrocli.adjust.schur.covariance import Covariance
from metrocli.adjust.schur.tiles import chunks_of
from metrocli.arrays import Array
from metrocli.frozen import dataclass

_DENSE = 6
"""Unknowns for each entry that a reading touches, up to which whole rows are faster than pairs of blocks"""


@dataclass(frozen=True)
class Solution:
    """The result of an adjustment."""

    outcome: Outcome
    blocks: Mapping[str, Block]
    groups: tuple[Group, ...]
    cost: float
    """Sum of squares of the whitened residuals"""
    iterations: int
    unknowns: int
    conditions: int = 0
    """Inner constraints that the datum added"""
    undetermined: tuple[Combination, ...] = ()
    covariance: Covariance | None = None
    """Covariance of the unknowns for the stated noise of the readings; None unless the outcome is good"""

    @property
    def observations(self) -> int:
        """Number of scalar readings, including priors."""
        return sum(int(group.observations.readings.size) for group in self.groups)

    @property
    def dof(self) -> int:
        """Degrees of freedom: readings and conditions minus unknowns."""
        # the datum's conditions take as many unknowns out as they hold, so they count as readings
        return self.observations - self.unknowns + self.conditions

    @property
    def sigma0(self) -> float:
        """Standard deviation of unit weight: about 1 if the stated noise is right, nan without redundancy."""
        return float(np.sqrt(self.cost / self.dof)) if self.dof > 0 else float("nan")

    @property
    def misfit(self) -> float:
        """Root mean square of the whitened residuals, 0 if there are too few readings, since those fit anything."""
        if self.outcome is Outcome.TOO_FEW or not self.observations:
            return 0.0
        return float(np.sqrt(self.cost / self.observations))

    @property
    def p_value(self) -> float:
        """Probability of a sum of squares at least as large if model and noise are right (global test)."""
        return chi_square_tail(self.dof, self.cost) if self.dof > 0 else float("nan")

    def group(self, name: str) -> Group:
        """Return the group of this name, with its final weights."""
        return next(group for group in self.groups if group.name == name)

    def covariance_or_raise(self) -> Covariance:
        """Return the covariance.

        Raises RuntimeError if the outcome has none; check `outcome` first.
        """
        if self.covariance is None:
            raise RuntimeError(self.outcome.value)
        return self.covariance

    def joint(self, names: Sequence[str]) -> Array:
        """Return the covariance of the free entries of several blocks, in the order of the blocks, row by row."""
        free = [np.flatnonzero(self.blocks[name].free.ravel()) for name in names]
        scale = np.concatenate([self.by_step(name).ravel()[i] for name, i in zip(names, free, strict=True)])
        known = self.covariance_or_raise()
        rows = [
            np.concatenate([known.between(a, b)[np.ix_(free[i], free[j])] for j, b in enumerate(names)], axis=1)
            for i, a in enumerate(names)
        ]
        return np.asarray(np.concatenate(rows, axis=0) * scale[:, None] * scale)

    def by_step(self, block: str) -> Array:
        """Return how much each value of a block changes by a unit step, (members, size): 1 except for phases."""
        return self.blocks[block].space.by_step(self.blocks[block].values)

    def std(self, block: str) -> Array:
        """Return the standard uncertainties of a block, (members, size)."""
        # rounding can leave -1e-30 for an unknown that is known almost exactly
        std: Array = np.sqrt(np.maximum(np.einsum("mii->mi", self.covariance_or_raise().members(block)), 0.0))
        return std * self.by_step(block)


@dataclass(frozen=True)
class Residuals:
    """Residuals of one group with their redundancy and test values."""

    values: Array
    """`reading - predicted` in the unit of the reading, (d, n)"""
    sigma: Array
    """Standard deviation of the readings, (d, n)"""
    redundancy: Array
    """Fraction of an error of the reading that shows in its own residual, 0..1, (d, n)"""
    normalised: Array
    """Baarda's w = v / (sigma sqrt(redundancy)), 0 where the reading is uncontrolled, (d, n)"""

    @classmethod
    def of(cls, observations: Observations, values: Array, redundancy: Array) -> Residuals:
        """Return the residuals of some observations with their tests, from values and redundancies, (d, n) each."""
        # below it the root of the redundancy is rounding, and w would be noise of any size
        controlled = redundancy > 1e-6
        root = np.sqrt(np.where(controlled, redundancy, 1.0))
        normalised = np.where(controlled, observations.whitened(values) / root, 0.0)
        return cls(values, observations.stds, redundancy, normalised)


def residuals_of(solution: Solution, group: Group) -> Residuals:
    """Return residuals, redundancy numbers `r = 1 - diag(J Q J')` and w-tests of one group (Baarda 1968).

    For correlated components all four refer to the decorrelated (whitened) components.
    """
    values, explained = _adjusted(solution, group)
    return Residuals.of(group.observations, values, np.clip(1 - explained, 0.0, 1.0))


def _adjusted(solution: Solution, group: Group) -> tuple[Array, Array]:
    """Return the residuals of a group and diag(J Q J'), both (d, n)."""
    covariance = solution.covariance
    if covariance is None:
        raise RuntimeError(solution.outcome.value)
    members, shape = covariance.eliminated, group.observations.readings.shape
    place = place_in_tiles(solution, group)
    if place is not None:
        return members.residuals(place, solution.blocks, shape), covariance.factor * members.explained(place, shape)
    return _in_chunks(solution, group, covariance)


def place_in_tiles(solution: Solution, group: Group) -> int | None:
    """Return the number of a group whose readings are in tiles of the eliminated block; None for any other."""
    members = solution.covariance_or_raise().eliminated
    places = (place for place, other in enumerate(solution.groups) if other is group and members.reads(place))
    return next(places, None)


def _in_chunks(solution: Solution, group: Group, covariance: Covariance) -> tuple[Array, Array]:
    """Return the residuals of a group without regular order and diag(J Q J'), both (d, n)."""
    residuals, explained = (np.empty(group.observations.readings.shape) for _ in range(2))
    for chunk in chunks_of(group, 0, covariance.layout):
        residuals[:, chunk.rows] = chunk.group.residuals(solution.blocks)
        touches = chunk.group.linear(solution.blocks, covariance.layout.wanted).touches
        explained[:, chunk.rows] = _explained(touches, covariance)
    return residuals, explained


def _explained(touches: Sequence[Touch], covariance: Covariance) -> Array | float:
    """Return diag(J Q J') of readings, (d, n), block by block of what each touches; 0 if nothing is free."""
    entries = sum(touch.jacobian.shape[1] for touch in touches)
    eliminated = any(touch.block == covariance.layout.eliminated for touch in touches)
    width = len(covariance.reduced)
    if not eliminated and 0 < width <= _DENSE * entries:
        d, _, n = touches[0].jacobian.shape
        rows = rows_of(touches, (d, n), covariance.layout.columns, width)
        return np.asarray(covariance.factor * np.einsum("dnw,dnw->dn", rows @ covariance.reduced, rows))
    total: Array | float = 0.0
    for i, first in enumerate(touches):
        for j, second in enumerate(touches[: i + 1]):
            pair = covariance.pairs(first.block, first.index, second.block, second.index)
            pair = np.broadcast_to(pair, (*pair.shape[:2], first.jacobian.shape[2]))
            along = np.einsum("dan,abn->dbn", first.jacobian, pair)
            total = total + (1.0 if i == j else 2.0) * np.einsum("dbn,dbn->dn", along, second.jacobian)
    return total
