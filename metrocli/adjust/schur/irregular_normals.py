"""Normal equations of readings in no regular order: products of each member's readings, all members at once.

With J and K the derivatives of whitened readings v by a member's own s unknowns and by the `width` reduced ones,
`D = J'J`, `B = J'K` and `N = K'K`, with the right sides J'v and K'v.
Method: docs/algorithms/tiled-elimination.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import LinearGroup, Touch
from metrocli.adjust.schur.layout import Layout
from metrocli.arrays import Array, Index, Mask

MOST_DENSE = 200
"""Most columns whose matrices are dense, and whose products are formed for each member"""


class OutsideTiles:
    """Members whose readings are in no tile: what `EliminatedMembers` has of single readings is empty."""

    def covariance(self, reduced: Array) -> Array:
        """Return the covariance of each member, (members, s, s)."""
        raise NotImplementedError

    def adjusted(self, reduced: Array) -> tuple[Array, tuple[Array, ...]]:
        """Return the covariance of each member (members, s, s), and no variances of single readings."""
        return self.covariance(reduced), ()

    def cross_covariance(self, reduced: Array, chosen: Sequence[int]) -> Sequence[Array]:
        """Return none: no group is in a tile."""
        return ()

    def reading_changes(self, fields: Array, chosen: Sequence[int]) -> Sequence[Array]:
        """Return none: no group is in a tile."""
        return ()


@dataclass(frozen=True)
class IrregularNormals(OutsideTiles):
    """All members of the eliminated block with the sums of their readings; no members if nothing is eliminated."""

    members: Index
    free: Mask
    """(members, s)"""
    d: Array
    """D, (members, s, s)"""
    b: Array
    """B, (members, s, width)"""
    right: Array
    """J'v, (members, s)"""
    n: Array
    """N, of the reduced unknowns, (width, width)"""
    right_r: Array
    """K'v, (width,)"""

    @cached_property
    def _both(self) -> Array:
        """`D^-1 (B, right)`, (members, s, width + 1)."""
        both = np.concatenate([self.b, self.right[:, :, None]], axis=2)
        return np.asarray(np.linalg.solve(self.d, both), dtype=float) if self.d.size else both

    @property
    def _weights(self) -> Array:
        return self._both[:, :, :-1]

    @property
    def _solved(self) -> Array:
        return self._both[:, :, -1]

    def damped(self, factor: float) -> IrregularNormals:
        """Return the same with the diagonal of D multiplied by `1 + factor`."""
        return replace(self, d=self.d + factor * _diagonal(self.d))

    @cached_property
    def reduced(self) -> tuple[Array, Array, float]:
        """Contribution to the reduced system: `N - B' D^-1 B`, `K'v - B' D^-1 J'v`, and `v'J D^-1 J'v`."""
        flat, weights = (x.reshape(self.right.size, len(self.n)) for x in (self.b, self._weights))
        alone = float(np.vdot(self.right, self._solved)) if self.d.size else 0.0
        return self.n - flat.T @ weights, self.right_r - weights.T @ self.right.ravel(), alone

    @property
    def diagonal(self) -> Array:
        """The diagonal of `K'K`, (width,)."""
        return np.diag(self.n)

    def back(self, step: Array) -> Array:
        """Return the members' step, `D^-1 (J'v - B step)`, (members, s)."""
        if not self.d.size:
            return self.right
        return self._solved - self._weights @ step

    def normals(self) -> Array:
        """Return D, (members, s, s)."""
        return self.d

    def inverse(self) -> Array:
        """Return D^-1 with zeros at fixed entries, (members, s, s)."""
        if not self.d.size:
            return self.d
        return np.asarray(np.linalg.inv(self.d), dtype=float) * self.free[:, :, None] * self.free[:, None, :]

    def weights(self) -> Array:
        """Return `W = D^-1 B`, (members, s, width)."""
        return self._weights * self.free[:, :, None]

    def covariance(self, reduced: Array) -> Array:
        """Return `D^-1 + W Q W'` of each member, (members, s, s)."""
        weights = self.weights()
        return self.inverse() + (weights @ reduced) @ np.swapaxes(weights, 1, 2)

    def solved(self, fields: Array) -> Array:
        """Return `D^-1 H` of fields H (members, s, f), (members, s, f), with zeros at fixed entries."""
        return np.asarray(np.linalg.solve(self.d, fields), dtype=float) * self.free[:, :, None]

    def moments(self, fields: Array) -> tuple[Array, Array]:
        """Return `H' W` and `H' D^-1 H` of fields H (members, s, f): (f, width), (f, f)."""
        flat = fields.reshape(self.right.size, fields.shape[2])
        weights = self._weights.reshape(len(flat), self.b.shape[2])
        return flat.T @ weights, flat.T @ self.solved(fields).reshape(flat.shape)


def _diagonal(matrix: Array) -> Array:
    """Return the diagonal as a matrix (..., s, s), with 1 for entries that are not positive."""
    diagonal = np.einsum("...ii->...i", matrix)
    # an unknown that no reading sees has 0 there, and a factor would leave it singular
    return np.where(diagonal > 0, diagonal, 1.0)[..., None] * np.eye(matrix.shape[-1])


@dataclass
class NormalSums:
    """Sums over readings: the arrays of `IrregularNormals`, filled group by group."""

    d: Array
    b: Array
    right_e: Array
    n: Array
    right_r: Array

    @staticmethod
    def empty(members: int, size: int, width: int) -> NormalSums:
        """Return the sums of no readings."""
        shapes = ((members, size, size), (members, size, width), (members, size), (width, width), (width,))
        return NormalSums(*(np.zeros(shape) for shape in shapes))

    def add(self, linear: LinearGroup, blocks: Mapping[str, Block], layout: Layout) -> None:
        """Add the readings of a group."""
        parts = _SortedDerivatives.of(linear, blocks, layout)
        s, places = parts.size_e, parts.places
        rows = parts.rows
        n, d, c = rows.shape
        if not n:
            return
        flat = rows.reshape(n * d, c)
        if parts.index_e is None:
            gram = flat.T @ flat
        else:
            first, used = parts.used_members()
            # of many shared columns the products are not needed for each member, which would take more memory than time
            wide = c > MOST_DENSE
            each = grams(rows, parts.index_e - first, used.stop - first, s if wide else c)
            self.d[used] += each[:, :s, :s]
            self.right_e[used] += each[:, :s, -1]
            self.b[used, :, places] += each[:, :s, s:-1]
            gram = (flat.T @ flat)[s:, s:] if wide else each[:, s:, s:].sum(axis=0)
        self.n[np.ix_(places, places)] += gram[:-1, :-1]
        self.right_r[places] += gram[:-1, -1]
        if parts.scattered:
            _add_scattered(self, parts, rows)

    def normals(self, free: Mask) -> IrregularNormals:
        """Return the normal equations, with 1 on the diagonal of fixed entries."""
        fixed = np.nonzero(~free)
        # D of a fixed entry has no readings: with 1 its step is 0 and the others are as without it
        self.d[fixed[0], fixed[1], fixed[1]] = 1.0
        return IrregularNormals(np.arange(len(free)), free, self.d, self.b, self.right_e, self.n, self.right_r)


@dataclass(frozen=True)
class _SortedDerivatives:
    """Derivatives of a group, sorted by the sums that they enter."""

    index_e: Index | None
    rows: Array
    """(n, d, columns): columns of the eliminated block, then those of blocks of one member, then the residual"""
    size_e: int
    places: Index
    """Reduced columns of the blocks of one member"""
    scattered: tuple[tuple[Touch, Index], ...]
    """Derivatives by blocks of many members, of which a reading uses one, with their reduced columns (members, size)"""

    @staticmethod
    def of(linear: LinearGroup, blocks: Mapping[str, Block], layout: Layout) -> _SortedDerivatives:
        index_e, size_e, scattered = None, 0, []
        dense, places = list[Array](), list[Index]()
        # a reading that uses two members of the block touches it twice; these stay in the reduced system as tied ones
        alone = sum(touch.block == layout.eliminated for touch in linear.touches) == 1
        for touch in linear.touches:
            if touch.block == layout.eliminated and len(layout.tied):
                scattered.append((touch, layout.columns[touch.block]))
            if touch.block == layout.eliminated and alone:
                free = layout.alone(blocks[touch.block])
                mask = free.T[:, touch.index] if not free.all() else 1.0
                index_e, size_e = touch.index, touch.jacobian.shape[1]
                dense.insert(0, touch.jacobian * mask)
            elif touch.block == layout.eliminated:
                continue
            elif len(blocks[touch.block].members) == 1:
                columns = layout.columns[touch.block][0]
                dense.append(touch.jacobian[:, columns >= 0])
                places.append(columns[columns >= 0])
            else:
                scattered.append((touch, layout.columns[touch.block]))
        dense.append(linear.residual[:, None, :])
        # readings first, so that all of one member are adjacent for the products; into the memory in that order
        (d, _, n), columns = dense[-1].shape, sum(part.shape[1] for part in dense)
        rows = np.concatenate([np.moveaxis(part, 2, 0) for part in dense], axis=2, out=np.empty((n, d, columns)))
        every_place = np.concatenate([*places, np.zeros(0, dtype=np.intp)])
        return _SortedDerivatives(index_e, rows, size_e, every_place, tuple(scattered))

    def used_members(self) -> tuple[int, slice]:
        """Return the first eliminated member that these readings use, and the slice from it to the last."""
        index = np.zeros(1, dtype=np.intp) if self.index_e is None else self.index_e
        first, last = int(index.min()), int(index.max())
        return first, slice(first, last + 1)


def grams(rows: Array, index: Index, members: int, own: int) -> Array:
    """Return the first `own` rows of `A'A` for the readings A of each member: (n, d, c) -> (members, own, c).

    `index` (n,) is the member of each reading. Members with similar numbers of readings are padded to one length, and
    multiplied together.
    """
    n, d, c = rows.shape
    counts = np.bincount(index, minlength=members)
    order = np.argsort(index, kind="stable")
    ordered = rows if (np.diff(index) >= 0).all() else rows[order]
    starts = np.concatenate([[0], np.cumsum(counts)])
    sums = np.zeros((members, own, c))
    # powers of two: few batches of equal length, and at most half of a batch is padding
    lengths = np.where(counts > 0, 2 ** np.ceil(np.log2(np.maximum(counts, 1))).astype(int), 0)
    for length in np.unique(lengths[lengths > 0]):
        chosen = np.flatnonzero(lengths == length)
        longest = int(counts[chosen].max())
        if (counts[chosen] == longest).all() and len(chosen) == members:
            padded = ordered.reshape(members, longest * d, c)
        else:
            place = starts[chosen, None] + np.arange(longest)
            inside = np.arange(longest) < counts[chosen, None]
            # a place beyond the end is clipped to a real row, which the mask makes zero
            padded = (ordered[np.minimum(place, n - 1)] * inside[:, :, None, None]).reshape(len(chosen), longest * d, c)
        sums[chosen] = np.swapaxes(padded[:, :, :own], 1, 2) @ padded
    return sums


def _add_scattered(sums: NormalSums, parts: _SortedDerivatives, rows: Array) -> None:
    (n, d, _), s, width = rows.shape, parts.size_e, len(sums.n)
    values, columns = [], []
    for touch, places in parts.scattered:
        place = places[touch.index]
        values.append(np.moveaxis(touch.jacobian, -1, 0) * (place >= 0)[:, None, :])
        columns.append(np.broadcast_to(np.maximum(place, 0)[:, None, :], values[-1].shape))
    value, column = np.concatenate(values, axis=2), np.concatenate(columns, axis=2)
    matrix, gram = (_dense if width <= MOST_DENSE else _sparse)(value, column, width)
    sums.n += gram
    cross = matrix.T @ rows.reshape(n * d, -1)[:, s:]
    sums.n[:, parts.places] += cross[:, :-1]
    sums.n[parts.places, :] += cross[:, :-1].T
    sums.right_r += cross[:, -1]
    if parts.index_e is not None:
        product = np.einsum("nda,ndb->nab", rows[:, :, :s], value)
        first, used = parts.used_members()
        # index of (member, own unknown, column) in the flat b of these members; fixed entries add 0 at column 0
        place = ((parts.index_e - first)[:, None, None] * s + np.arange(s)[:, None]) * width + column[:, :1, :]
        b = sums.b[used]  # a view, so that the sums grow
        b += np.bincount(place.ravel(), product.ravel(), minlength=b.size).reshape(b.shape)


def _dense(value: Array, column: Index, width: int) -> tuple[Array, Array]:
    """Return derivatives (n, d, c) in their columns (n, d, c) as a matrix A (n d, width), and `A'A`."""
    place = np.arange(value.size // value.shape[2])[:, None] * width + column.reshape(-1, value.shape[2])
    size = len(place) * width
    matrix: Array = np.bincount(place.ravel(), value.ravel(), minlength=size).astype(float).reshape(len(place), width)
    return matrix, matrix.T @ matrix


def _sparse(value: Array, column: Index, width: int) -> tuple[Any, Array]:
    """Return the same with a sparse matrix: where rows have few of many columns, most products are of zeros."""
    from scipy.sparse import csr_matrix

    pointers = np.arange(0, value.size + 1, value.shape[2])
    matrix = csr_matrix((value.ravel(), column.ravel(), pointers), shape=(value.size // value.shape[2], width))
    return matrix, (matrix.T @ matrix).toarray()
