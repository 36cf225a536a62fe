"""The linearised readings of a tile: derivatives by its members and by other blocks, and their products.

Each of the k members of a tile has m readings (slots) of d components, and s unknowns of its own. In each slot all
members use the same members of the other blocks.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import LinearGroup
from metrocli.adjust.schur.layout import Layout
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class OtherBlock:
    """Derivatives of the readings of a tile by another block."""

    jacobian: Array
    """(d, size, m, k)"""
    places: Index
    """Reduced columns of the member that each slot uses, (m, size), -1 if fixed; (1, size) if all use the same"""

    def along(self, step: Array) -> Array:
        """Return `K step`, (d, m, k), for a step of the reduced unknowns with a 0 at its end, (width + 1,)."""
        if len(self.places) == self.jacobian.shape[2]:
            return np.asarray(np.einsum("dcmk,mc->dmk", self.jacobian, step[self.places]))
        return np.asarray(np.einsum("dcmk,c->dmk", self.jacobian, step[self.places[0]]))


@dataclass(frozen=True)
class TileRows:
    """The linearised, whitened readings of one group in a tile: `v = residual - J own_step - K reduced_step`."""

    own: Array
    """Derivatives by the members' own unknowns (J), (d, s, m, k), zero at fixed entries"""
    residual: Array
    """(d, m, k)"""
    others: tuple[OtherBlock, ...]
    """Derivatives by the other blocks (K)"""

    @staticmethod
    def of(linear: LinearGroup, members: Index | slice, blocks: Mapping[str, Block], layout: Layout) -> TileRows:
        """Return the rows of `members` of the eliminated block, from a group linearised in the order of a lattice."""
        d, k = len(linear.residual), len(blocks[layout.eliminated or ""].free[members])
        others: list[OtherBlock] = []
        own = np.zeros(0)
        for touch in linear.touches:
            jacobian = touch.jacobian.reshape(d, touch.jacobian.shape[1], -1, k)
            if touch.block == layout.eliminated:
                block = blocks[touch.block]
                own = jacobian if block.all_free else jacobian * block.free[members].T[:, None, :]
            else:
                places = layout.columns[touch.block]
                others.append(OtherBlock(jacobian, places[touch.index]))
        return TileRows(own, linear.residual.reshape(d, -1, k), tuple(others))


def flattened(rows: Array) -> Array:
    """Return (rows, s, k) as a matrix (rows, s k)."""
    return rows.reshape(len(rows), rows.shape[1] * rows.shape[2])


def with_zeros(matrix: Array) -> Array:
    """Return the matrix with one more row and column of zeros, the place of fixed unknowns (column -1)."""
    return np.pad(matrix, (0, 1))


def times_covariance(rows: Array, places: Index, reduced: Array) -> Array:
    """Return `Q Y` of Y (rows, s, k), whose rows have the reduced columns `places` (rows,), with Q = `reduced`."""
    chosen = with_zeros(reduced)[np.ix_(places, places)]
    return (chosen @ flattened(rows)).reshape(rows.shape)


def products_by_member(first: Array, second: Array, symmetric: bool = False) -> Array:
    """Return the sum over the rows of first (rows, a, k) times second (rows, b, k), (a, b, k).

    Of a `symmetric` result half is computed."""
    result = np.empty((first.shape[1], *second.shape[1:]))
    for a in range(first.shape[1]):
        for b in range(a + 1 if symmetric else second.shape[1]):
            result[a, b] = np.einsum("rk,rk->k", first[:, a], second[:, b])
            if symmetric:
                result[b, a] = result[a, b]
    return result


def propagated(coupled: tuple[Array, Index], reduced: Array) -> tuple[Array, Array]:
    """Return `Q Y` and `Y' Q Y`, with Q the covariance of the reduced unknowns: (rows, s, k), (s, s, k)."""
    rows, places = coupled
    product = times_covariance(rows, places, reduced)
    return product, products_by_member(rows, product, symmetric=True)


def by_slot(jacobian: Array, slots: int) -> Array:
    """Return derivatives as one matrix for each slot, or one for all of them: (slots, size, d m k / slots)."""
    d, size, m, k = jacobian.shape
    if slots == m:
        return jacobian.transpose(2, 1, 0, 3).reshape(m, size, d * k)
    return jacobian.transpose(1, 0, 2, 3).reshape(1, size, d * m * k)


def add_products(part: TileRows, matrix: Array, right: Array) -> None:
    """Add `K'K` and `K'v` of one group to a matrix and a right side with a place for fixed unknowns at their end."""
    for i, block in enumerate(part.others):
        first, residual = (by_slot(x, len(block.places)) for x in (block.jacobian, part.residual[:, None]))
        # slots can use the same member, and places of fixed unknowns (-1) all meet in the extra column
        np.add.at(right, block.places, (first @ residual.swapaxes(1, 2))[:, :, 0])
        for other in part.others[: i + 1]:
            slots = max(len(block.places), len(other.places))
            left = by_slot(block.jacobian, slots)
            gram = left @ (left if other is block else by_slot(other.jacobian, slots)).swapaxes(1, 2)
            np.add.at(matrix, (block.places[:, :, None], other.places[:, None, :]), gram)
            if other is not block:
                np.add.at(matrix, (other.places[:, :, None], block.places[:, None, :]), gram.swapaxes(1, 2))


def adjusted_variance(first: OtherBlock, second: OtherBlock, reduced: Array) -> Array:
    """Return `diag(K1 Q12 K2')` for the derivatives by two blocks, (d, m, k): their part of `diag(K Q K')`."""
    d, _, m, k = first.jacobian.shape
    total = np.zeros((d, m, k))
    rows = np.broadcast_to(first.places, (m, first.places.shape[1]))
    columns = np.broadcast_to(second.places, (m, second.places.shape[1]))
    q = reduced[rows[:, :, None], columns[:, None, :]]
    for a in range(q.shape[1]):
        total += first.jacobian[:, a] * np.einsum("dbmk,mb->dmk", second.jacobian, q[:, a])
    return total
