"""Movements of whole networks: how each member of a block changes by a shift, a rotation or a scale.

Sums over members are computed from moments of their values, so the movements of all members are never stored.
Method: docs/algorithms/free-networks.md.
"""

from __future__ import annotations

from typing import Protocol, Self

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.geometry.rotations import cross_matrix


class Movement(Protocol):
    """The change of the members of a block by f freedoms, E (members, size, f)."""

    def at(self, values: Array, members: Index | slice) -> Array:
        """Return E for some members, (k, size, f)."""

    def step(self, values: Array, amounts: Array) -> Array:
        """Return `E amounts`, the step by given amounts (f,) of the freedoms, (members, size)."""

    def dot(self, values: Array, change: Array) -> Array:
        """Return `E' change` for a change (members, size), (f,)."""

    def gram(self, values: Array, other: Self, others: Array, weights: Array) -> Array:
        """Return `E' P E2`, E2 the other movement at `others`, P diagonal: weights (members,) or (members, size)."""

    def mixed(self, mix: Array) -> Self:
        """Return combinations of the freedoms, `E mix` with mix (f, k)."""


@dataclass(frozen=True)
class Affine:
    """Movements that are affine in the values v of a member: `M v + t` for each freedom."""

    matrix: Array
    """(f, size, size)"""
    shift: Array
    """(f, size)"""

    def at(self, values: Array, members: Index | slice) -> Array:
        """Return E for some members, (k, size, f)."""
        f, size = self.shift.shape
        full = self.matrix.reshape(f * size, size) @ values[members].T
        full += self.shift.reshape(f * size, 1)
        return full.reshape(f, size, -1).transpose(2, 1, 0)

    def step(self, values: Array, amounts: Array) -> Array:
        """Return `E amounts`, the step by given amounts (f,) of the freedoms, (members, size)."""
        step = values @ np.tensordot(amounts, self.matrix, 1).T
        step += amounts @ self.shift
        return step

    def dot(self, values: Array, change: Array) -> Array:
        """Return `E' change`, (f,)."""
        # sums of `v v'` and `v` are all that an affine movement needs, so memory does not grow with the freedoms
        moments = np.column_stack([change.T @ values, np.ones(len(change)) @ change])
        return np.asarray(np.tensordot(self._columns(), moments, 2))

    def gram(self, values: Array, other: Affine, others: Array, weights: Array) -> Array:
        """Return `E' P E2` from the moments of the values, (f, f'); with weights (members, size) column by column."""
        mine, theirs = self._columns(), other._columns()
        if weights.ndim == 1:
            moments = _moments(values, others, weights)
            return np.asarray(np.einsum("fab,bc,gac->fg", mine, moments, theirs, optimize=True))
        total = np.zeros((len(mine), len(theirs)))
        for a, column in enumerate(weights.T):
            total += mine[:, a] @ _moments(values, others, column) @ theirs[:, a].T
        return total

    def mixed(self, mix: Array) -> Affine:
        """Return combinations of the freedoms, `E mix` with mix (f, k)."""
        return Affine(np.tensordot(mix.T, self.matrix, 1), mix.T @ self.shift)

    def _columns(self) -> Array:
        """Return M with t as its last column, (f, size, size + 1)."""
        return np.concatenate([self.matrix, self.shift[:, :, None]], axis=2)


def _moments(values: Array, others: Array, weights: Array) -> Array:
    """Return `sum w (v, 1) (v', 1)'` over the members, (size + 1, size' + 1)."""
    # most datums weight all members alike: the copy of all values is spared
    weighted = values if (weights == 1).all() else values * weights[:, None]
    moments = np.empty((values.shape[1] + 1, others.shape[1] + 1))
    moments[:-1, :-1], moments[-1, -1] = weighted.T @ others, weights.sum()
    # a product with ones sums faster than `sum(axis=0)` of a long, narrow array
    moments[:-1, -1], moments[-1, :-1] = np.ones(len(weighted)) @ weighted, weights @ others
    return moments


@dataclass(frozen=True)
class Listed:
    """Movements listed for every member at the present values."""

    moves: Array
    """(members, size, f)"""

    def at(self, values: Array, members: Index | slice) -> Array:
        """Return E for some members, (k, size, f)."""
        return np.asarray(self.moves[members])

    def step(self, values: Array, amounts: Array) -> Array:
        """Return `E amounts`, the step by given amounts (f,) of the freedoms, (members, size)."""
        return np.asarray(self.moves @ amounts)

    def dot(self, values: Array, change: Array) -> Array:
        """Return `E' change`, (f,)."""
        return np.asarray(np.tensordot(change, self.moves, 2))

    def gram(self, values: Array, other: Listed, others: Array, weights: Array) -> Array:
        """Return `E' P E2`, (f, f')."""
        weights = weights if weights.ndim == 2 else weights[:, None] * np.ones(self.moves.shape[1])
        return np.asarray(np.einsum("naf,na,nag->fg", self.moves, weights, other.moves, optimize=True))

    def mixed(self, mix: Array) -> Listed:
        """Return combinations of the freedoms, `E mix` with mix (f, k)."""
        return Listed(self.moves @ mix)


def of_points(scale: bool = False) -> Affine:
    """Return the movements of points (3,): shifts along x, y, z, rotations about them and, if wanted, scale."""
    axes = np.eye(3)
    # a rotation about axis a moves a point p by `a x p`
    matrices = [np.zeros((3, 3, 3)), cross_matrix(axes), *([axes[None]] if scale else [])]
    matrix = np.concatenate(matrices)
    shift = np.zeros((len(matrix), 3))
    shift[:3] = axes
    return Affine(matrix, shift)


def of_members(size: int, points: Affine, turns: slice | None = None) -> Affine:
    """Return the movements of members whose first three values are a point, with a left rotation at `turns`."""
    f = len(points.matrix)
    matrix, shift = np.zeros((f, size, size)), np.zeros((f, size))
    matrix[:, :3, :3], shift[:, :3] = points.matrix, points.shift
    if turns is not None:
        # a left rotation adds to the rotation vector of a member as it is, wherever the member lies
        shift[3:6, turns] = np.eye(3)
    return Affine(matrix, shift)
