"""The Jacobian of a measurement as a dense matrix: derivatives of readings by the free unknowns, and `J'J`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.decompositions import thin_svd
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group, rows_of
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass

_CHUNK = 4000
"""Number of readings whose rows are held in memory at a time"""
_STEPS, _AS_PREDICTED = 6, 1e-3
"""Most steps to a least sum of squares, and relative difference from its prediction at which they end"""
_UNSEEN = 1e-9
"""Singular values below this fraction of the largest are of directions that the readings do not show"""


@dataclass(frozen=True)
class Unknowns:
    """The free entries of blocks, numbered in order."""

    columns: Mapping[str, Index]
    """Number of each entry of a block, (members, size); -1 if it is fixed"""
    size: int

    def names(self, blocks: Mapping[str, Block]) -> list[tuple[str, str, str]]:
        """Return (block, member, column) of each unknown."""
        labels = [("", "", "")] * self.size
        for name, columns in self.columns.items():
            for member, column in zip(*np.nonzero(columns >= 0), strict=True):
                block = blocks[name]
                labels[columns[member, column]] = (name, block.members[member], block.columns[column])
        return labels

    def spread(self, name: str, values: Array) -> Array:
        """Return values of the unknowns (size, ...) as entries of a block (members, size, ...), 0 where it is fixed."""
        columns = self.columns[name]
        mask = (columns >= 0).reshape(*columns.shape, *(1,) * (values.ndim - 1))
        return np.where(mask, values[np.maximum(columns, 0)], 0.0)

    def reach(self, blocks: Mapping[str, Block]) -> Array:
        """Return the plausible reach of each unknown, (size,)."""
        reach = np.ones(self.size)
        for name, columns in self.columns.items():
            full = np.broadcast_to(blocks[name].reach, columns.shape)
            reach[columns[columns >= 0]] = full[columns >= 0]
        return reach


def unknowns_of(blocks: Mapping[str, Block], names: Sequence[str]) -> Unknowns:
    """Return the free entries of the named blocks."""
    columns, place = {}, 0
    for name in names:
        free = blocks[name].free
        columns[name] = np.full(free.shape, -1, dtype=np.intp)
        columns[name][free] = place + np.arange(free.sum())
        place += int(free.sum())
    return Unknowns(columns, place)


def rows(group: Group, blocks: Mapping[str, Block], unknowns: Unknowns) -> Array:
    """Return the derivatives of the whitened predictions by the unknowns, (d, n, size)."""
    touches = group.linear(blocks, frozenset(unknowns.columns)).touches
    d, n = group.observations.readings.shape
    return rows_of(touches, (d, n), unknowns.columns, unknowns.size)


def normal_matrix(groups: Sequence[Group], blocks: Mapping[str, Block], unknowns: Unknowns) -> Array:
    """Return `J'J` of the whitened readings of all groups, (size, size)."""
    total = np.zeros((unknowns.size,) * 2)
    for group in groups:
        n = group.observations.count
        for start in range(0, n, _CHUNK):
            part = group if n <= _CHUNK else group.selected(np.arange(start, min(start + _CHUNK, n)))
            flat = rows(part, blocks, unknowns).reshape(-1, unknowns.size)
            total += flat.T @ flat
    return total


def least_square(group: Group, blocks: Mapping[str, Block]) -> float:
    """Return the least sum of squares of the whitened residuals of a group over all values of the free unknowns.

    Gauss-Newton steps from the present values; the last one is that after which the sum is as predicted. Returns 0, a
    bound that always holds, where the readings are not twice as many as the unknowns, or where the steps do not settle.
    """
    unknowns = unknowns_of(blocks, [name for name in group.chain.blocks if blocks[name].free.any()])
    # fewer readings fit almost anything, so that a small sum would prove nothing
    if group.observations.readings.size < 2 * unknowns.size:
        return 0.0
    state, residual = dict(blocks), _whitened(group, blocks)
    for _ in range(_STEPS):
        design = rows(group, state, unknowns).reshape(-1, unknowns.size)
        # columns of length 1, so that one bound on the singular values serves unknowns of any unit
        size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
        u, values, vt = thin_svd(design / size)
        seen = values > _UNSEEN * values[0]
        along = u[:, seen].T @ residual
        step = (vt[seen].T @ (along / values[seen])) / size
        left = float(residual @ residual - along @ along)
        state = {
            name: state[name].moved(unknowns.spread(name, step)) if name in unknowns.columns else state[name]
            for name in state
        }
        residual = _whitened(group, state)
        # `left` is the least sum of the linear model: where the true sum agrees, the model holds as far as there
        if abs(float(residual @ residual) - left) <= _AS_PREDICTED * left:
            return left
    return 0.0


def _whitened(group: Group, blocks: Mapping[str, Block]) -> Array:
    return np.asarray(group.observations.whitened(group.residuals(blocks))).ravel()


def unit_noise(group: Group, sigma: Array | float = 1.0) -> Group:
    """Return the group with uncorrelated noise of one standard deviation `sigma` in every component."""
    observations = replace(group.observations, covariance=None, ratios=None, sigma=np.asarray(sigma, dtype=float))
    return group.with_observations(observations)


def covariance_of(solution: Solution, unknowns: Unknowns) -> Array:
    """Return the covariance of unknowns after an adjustment, (size, size)."""
    known = solution.covariance_or_raise()
    total = np.zeros((unknowns.size,) * 2)
    flat = {name: columns.ravel() for name, columns in unknowns.columns.items() if (columns >= 0).any()}
    for name, places in flat.items():
        for other, others in flat.items():
            block = known.between(name, other)
            inside, outside = places >= 0, others >= 0
            total[np.ix_(places[inside], others[outside])] = block[np.ix_(inside, outside)]
    return total
