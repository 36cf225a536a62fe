"""Normal equations with one block eliminated member by member (Schur complement), their solution and covariance.

With e the unknowns of the eliminated block (block-diagonal D) and r the rest, the normal matrix is [[D, B], [B', N]];
the reduced system is `S = N - B' D^-1 B`. Cost grows linearly with readings and with members of the eliminated block.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from metrocli.adjust.blocks import Array, Block
from metrocli.adjust.groups import Group, Linear, Touch
from metrocli.adjust.layout import Layout
from metrocli.adjust.observations import Index


@dataclass
class Normals:
    """The parts of the normal matrix and of the right side `J' r`, all in whitened readings."""

    d: Array
    """(members, s, s)"""
    b: Array
    """(members, s, width)"""
    n: Array
    """(width, width)"""
    right_e: Array
    """(members, s)"""
    right_r: Array
    """(width,)"""
    cost: float = 0.0

    @cached_property
    def weights(self) -> Array:
        """`W = D^-1 B`: what the eliminated unknowns lose for each unit of the others, (members, s, width)."""
        if not self.d.size:
            return self.b
        return np.asarray(np.linalg.solve(self.d, self.b), dtype=float)

    def reduced(self) -> tuple[Array, Array]:
        """Return `S = N - B' W` and its right side."""
        if not self.d.size:
            return self.n, self.right_r
        members, size, width = self.b.shape
        flat, weights = self.b.reshape(members * size, width), self.weights.reshape(members * size, width)
        return self.n - flat.T @ weights, self.right_r - weights.T @ self.right_e.ravel()

    def damped(self, factor: float) -> Normals:
        """Return the normals with their diagonal enlarged by `1 + factor` (Marquardt)."""
        d, n = self.d.copy(), self.n.copy()
        for matrix in (d, n):
            diagonal = np.einsum("...ii->...i", matrix)
            diagonal += factor * np.where(diagonal > 0, diagonal, 1.0)
        return Normals(d, self.b, n, self.right_e, self.right_r, self.cost)

    def back(self, step_r: Array) -> Array:
        """Return the step of the eliminated unknowns, `D^-1 (right - B step)`, (members, s)."""
        if not self.d.size:
            return self.right_e
        solved: Array = np.linalg.solve(self.d, self.right_e[:, :, None])[:, :, 0] - self.weights @ step_r
        return solved


def assemble(
    groups: Sequence[Group], linears: Sequence[Linear], blocks: Mapping[str, Block], layout: Layout
) -> Normals:
    """Sum the normal equations of all linearised groups."""
    members, size = blocks[layout.eliminated].values.shape if layout.eliminated else (0, 0)
    w = layout.width
    normals = Normals(
        np.zeros((members, size, size)),
        np.zeros((members, size, w)),
        np.zeros((w, w)),
        np.zeros((members, size)),
        np.zeros(w),
    )
    for linear in linears:
        normals.cost += linear.cost
        _add(normals, _Parts.of(linear, blocks, layout))
    if layout.eliminated:
        fixed = ~blocks[layout.eliminated].free
        normals.d[np.nonzero(fixed)[0], np.nonzero(fixed)[1], np.nonzero(fixed)[1]] = 1.0
    return normals


@dataclass(frozen=True)
class _Parts:
    """Derivatives of a group sorted by their part in the normals."""

    index_e: Index | None
    dense: Array
    """(d, columns, n): the eliminated block's columns first, then those of blocks of one member, then the residual"""
    size_e: int
    places: Index
    """Reduced columns of the dense part"""
    several: tuple[tuple[Touch, Index], ...]
    """Touches of other blocks of many members, with the reduced columns (members, size)"""

    @staticmethod
    def of(linear: Linear, blocks: Mapping[str, Block], layout: Layout) -> _Parts:
        index_e, size_e, several = None, 0, []
        dense: list[Array] = []
        places: list[Index] = []
        for touch in linear.touches:
            if touch.block == layout.eliminated:
                free = blocks[touch.block].free
                mask = free.T[:, touch.index] if not free.all() else 1.0
                index_e, size_e = touch.index, touch.jacobian.shape[1]
                dense.insert(0, touch.jacobian * mask)
            elif len(blocks[touch.block].members) == 1:
                columns = layout.columns[touch.block][0]
                dense.append(touch.jacobian[:, columns >= 0])
                places.append(columns[columns >= 0])
            else:
                several.append((touch, layout.columns[touch.block]))
        stacked = np.concatenate([*dense, linear.residual[:, None, :]], axis=1)
        return _Parts(index_e, stacked, size_e, np.concatenate([*places, np.zeros(0, dtype=np.intp)]), tuple(several))


def _add(normals: Normals, parts: _Parts) -> None:
    s, places = parts.size_e, parts.places
    d, c, n = parts.dense.shape
    rows = np.ascontiguousarray(parts.dense.reshape(d * c, n).T).reshape(n, d, c)
    if parts.index_e is None:
        flat = rows.reshape(n * d, c)
        gram = flat.T @ flat
    else:
        each = grams(rows, parts.index_e, len(normals.d))
        normals.d += each[:, :s, :s]
        normals.right_e += each[:, :s, -1]
        normals.b[:, :, places] += each[:, :s, s:-1]
        gram = each[:, s:, s:].sum(axis=0)
    normals.n[np.ix_(places, places)] += gram[:-1, :-1]
    normals.right_r[places] += gram[:-1, -1]
    if parts.several:
        _add_several(normals, parts, rows)


def grams(rows: Array, index: Index, members: int) -> Array:
    """Return `sum of A'A` over the readings of each member, rows (n, d, c) -> (members, c, c).

    Members of like many readings are padded to one length and multiplied together.
    """
    n, d, c = rows.shape
    counts = np.bincount(index, minlength=members)
    order = np.argsort(index, kind="stable")
    ordered = rows if (np.diff(index) >= 0).all() else rows[order]
    starts = np.concatenate([[0], np.cumsum(counts)])
    sums = np.zeros((members, c, c))
    lengths = np.where(counts > 0, 2 ** np.ceil(np.log2(np.maximum(counts, 1))).astype(int), 0)
    for length in np.unique(lengths[lengths > 0]):
        chosen = np.flatnonzero(lengths == length)
        longest = int(counts[chosen].max())
        if (counts[chosen] == longest).all() and len(chosen) == members:
            padded = ordered.reshape(members, longest * d, c)
        else:
            place = starts[chosen, None] + np.arange(longest)
            inside = np.arange(longest) < counts[chosen, None]
            padded = (ordered[np.minimum(place, n - 1)] * inside[:, :, None, None]).reshape(len(chosen), longest * d, c)
        sums[chosen] = np.swapaxes(padded, 1, 2) @ padded
    return sums


def _add_several(normals: Normals, parts: _Parts, rows: Array) -> None:
    from scipy.sparse import csr_matrix

    n, d, _ = rows.shape
    s, width = parts.size_e, len(normals.n)
    values, columns = [], []
    for touch, places in parts.several:
        place = places[touch.index]
        values.append(np.moveaxis(touch.jacobian, -1, 0) * (place >= 0)[:, None, :])
        columns.append(np.broadcast_to(np.maximum(place, 0)[:, None, :], values[-1].shape))
    value, column = np.concatenate(values, axis=2), np.concatenate(columns, axis=2)
    pointers = np.arange(0, value.size + 1, value.shape[2])
    matrix = csr_matrix((value.ravel(), column.ravel(), pointers), shape=(n * d, width))
    normals.n += (matrix.T @ matrix).toarray()
    flat = rows.reshape(n * d, rows.shape[2])
    cross = matrix.T @ flat[:, s:]
    normals.n[:, parts.places] += cross[:, :-1]
    normals.n[parts.places, :] += cross[:, :-1].T
    normals.right_r += cross[:, -1]
    if parts.index_e is not None:
        product = np.einsum("nda,ndb->nab", rows[:, :, :s], value)
        place = (parts.index_e[:, None, None] * s + np.arange(s)[:, None]) * width + column[:, :1, :]
        normals.b += np.bincount(place.ravel(), product.ravel(), minlength=normals.b.size).reshape(normals.b.shape)
