"""An orthonormal basis of the columns of all unknowns: dense for the shared ones, member by member for the local ones.

A reading uses one point (or one image). The columns of different points are orthogonal, so their part of the basis has
as many numbers a row as a point has unknowns. Time and memory are then linear in the readings.

Method: docs/algorithms/what-can-be-seen.md (projection).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cached_property
from itertools import combinations_with_replacement, pairwise
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from metrocli.adjust.decompositions import grams_of, triangular_turn
from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index, Mask
from metrocli.frozen import dataclass

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

Columns: TypeAlias = "Array | csr_matrix"
"""Columns (rows, k), sparse where most of their numbers are zero"""
_THIN = 0.05
"""Share of numbers that are not zero below which columns are kept as a sparse matrix"""
_THICK = 0.15
"""Share of numbers that are not zero above which a product of columns takes less time as of a table"""
_FEW = 0.1
"""Share of the rows with a value below which these rows are gathered"""
_SAMPLE = 1000
"""Rows by which the share of those with a value is estimated"""
_AT_ONCE, _LARGE = 25_000, 4_000_000
"""Rows that are combined at once, and numbers of columns from which they are held without those that are zero"""


@dataclass(frozen=True)
class Basis:
    """Orthonormal columns b with `b b' = J (J'J)^- J'`: those of local unknowns, then those of the shared ones."""

    local: Array
    """Entries of each row in the columns of its member, (rows, q)"""
    member: Index
    """Local member of each row, (rows,); -1 if it uses none"""
    members: int
    shared: Array
    """Columns of the other unknowns, orthogonal to the local ones, (rows, k)"""

    @cached_property
    def sparse(self) -> csr_matrix:
        """The local columns, (rows, members*q)."""
        from scipy.sparse import csr_matrix

        rows, q = self.local.shape
        there = self.member >= 0
        columns = (self.member[there][:, None] * q + np.arange(q)).ravel()
        ends = np.concatenate([[0], np.cumsum(there * q)])
        return csr_matrix((self.local[there].ravel(), columns, ends), shape=(rows, self.members * q))

    @cached_property
    def of_members(self) -> Basis:
        """The local columns alone."""
        return replace(self, shared=np.zeros((len(self.local), 0)))

    def coordinates(self, values: Array) -> Array:
        """Return `b' values`, (columns, ...), of values (rows, ...)."""
        flat, sparse, shared = flat_columns(values), self.sparse, self.shared
        if _has_few(flat):
            there = rows_with_values(flat)
            flat, sparse, shared = flat[there], sparse[there], shared[there]
        along = np.concatenate([sparse.T @ flat, shared.T @ flat])
        return np.asarray(along.reshape(len(along), *values.shape[1:]))

    def combined(self, coordinates: Array) -> Array:
        """Return `b coordinates`, (rows, ...)."""
        flat = flat_columns(coordinates)
        count = self.sparse.shape[1]
        sums = self.sparse @ flat[:count] + self.shared @ flat[count:]
        return np.asarray(sums.reshape(len(sums), *coordinates.shape[1:]))

    def take_from(self, values: Array, coordinates: Array) -> None:
        """Subtract `b coordinates` from values (rows, k) where they are, some rows at a time."""
        count = self.sparse.shape[1]
        for start in range(0, len(values), _AT_ONCE):
            rows = slice(start, start + _AT_ONCE)
            values[rows] -= self.sparse[rows] @ coordinates[:count] + self.shared[rows] @ coordinates[count:]

    def squares(self, rows: Index | Mask | slice = slice(None)) -> Array:
        """Return the sum of squares of each row, the share of a reading that the unknowns absorb."""
        numbers = np.arange(len(self.local))[rows]
        # at least one chunk, also of no rows, so that there is something to join
        chunks = (numbers[start : start + _AT_ONCE] for start in range(0, max(len(numbers), 1), _AT_ONCE))
        pairs = ((self.local[chunk], self.shared[chunk]) for chunk in chunks)
        return np.concatenate([sum(np.einsum("rk,rk->r", part, part) for part in pair) for pair in pairs])

    @property
    def trace(self) -> float:
        """The sum of squares of all rows: the number of directions that the unknowns absorb."""
        return float(np.vdot(self.local, self.local) + np.vdot(self.shared, self.shared))

    def grams(self, values: Array) -> Array:
        """Return `g' b b' g` of columns (rows, k, q), k at a time, (k, q, q): the squares that the unknowns absorb."""
        if np.bincount(self.member + 1)[1:].max(initial=0) <= 1:
            # one row for each member that is read: its column has the length of its row
            inside = np.linalg.norm(self.local, axis=1)[:, None, None] * values
            parts = [inside, np.tensordot(self.shared.T, values, 1)] if self.shared.shape[1] else [inside]
        else:
            parts = [self.coordinates(values)]
        return np.asarray(sum(grams_of(part) for part in parts))

    def absorbed_of(self, columns: Columns) -> Array:
        """Return `g' b b' g` of columns (rows, k), dense or sparse, (k, k)."""
        if isinstance(columns, np.ndarray):
            inside = self.coordinates(columns)
            return np.asarray(inside.T @ inside)
        shared = columns.T @ self.shared
        gram = shared @ shared.T
        for rows, local_columns in self._by_whole_members:
            local = columns[rows].T @ local_columns
            if local.nnz > _THICK * local.shape[0] * local.shape[1]:
                local = local.toarray()
            gram += squared(local.T)
        return np.asarray(gram)

    @cached_property
    def _by_whole_members(self) -> list[tuple[Index | slice, csr_matrix]]:
        """All rows, those of some whole members at once, with their local columns."""
        order = np.argsort(self.member, kind="stable")
        # each stretch is moved back to where the member of its first row begins
        begins = np.searchsorted(self.member[order], self.member[order[::_AT_ONCE]])
        stretches = (np.sort(order[a:b]) for a, b in pairwise([*np.unique(begins), len(order)]))
        return [(without_gathering(rows), self.at(rows).sparse) for rows in stretches]

    def growth_of_local_grams(self, rows: Index, values: Array) -> Array:
        """Return U, so that `V'U + U'V` over the last of some rows is `g' b b' g` of a column g that has only these.

        b are the local columns. The column has values V (r, q) at rows (r,). The row l of b adds `u'v + v'u` to what
        the later rows of its member have summed up to, with `u = l'A + l'l v/2` and `A = sum l v'` of these rows.
        """
        member, values = self.member[rows][::-1], values[::-1]
        # backwards, because the sums run from the last row to the first: a step acts from some time on
        local = np.where(member[:, None] >= 0, self.local[rows][::-1], 0.0)
        # half of `l'l v v'`: U enters twice, as `V'U + U'V`
        growth = np.einsum("rk,rk->r", local, local)[:, None] * values / 2
        for _, at in members_of_equal_size(member, self.members):
            if at.shape[1] > 1:
                added = local[at][..., :, None] * values[at][..., None, :]
                before = np.cumsum(added, axis=1)[:, :-1]
                growth[at[:, 1:]] += np.einsum("mrk,mrkq->mrq", local[at[:, 1:]], before)
        return np.asarray(growth[::-1])

    def at(self, rows: Index) -> Basis:
        """Return some rows of the basis, with the columns of the members that they use."""
        if len(rows) == len(self.local):
            return self
        some = without_gathering(rows)
        member, used = self.member[some], np.zeros(self.members + 1, dtype=bool)
        used[member] = True
        # rows without a member have the number -1, that of the last entry
        number = np.append(np.cumsum(used[:-1]) - 1, -1)
        return Basis(self.local[some], number[member], int(used[:-1].sum()), self.shared[some])

    def products(self, rows: Index, others: Index) -> Array:
        """Return the products of rows (..., a) with other rows (..., b), (..., a, b); a row of number -1 is zero."""
        if others is rows and rows.ndim == 2 and rows.shape[1] == 1:
            return np.where(rows >= 0, self.squares(rows[:, 0])[:, None], 0.0)[:, :, None]
        of_rows = self.member[rows], self.local[rows], self.shared[rows]
        of_others = of_rows if others is rows else (self.member[others], self.local[others], self.shared[others])
        same = (of_rows[0][..., :, None] == of_others[0][..., None, :]) & (of_rows[0][..., :, None] >= 0)
        local, shared = (
            np.einsum("...ak,...bk->...ab", one, other) for one, other in zip(of_rows[1:], of_others[1:], strict=True)
        )
        there = (rows >= 0)[..., :, None] & (others >= 0)[..., None, :]
        return np.where(there, np.where(same, local, 0.0) + shared, 0.0)

    def weighted(self, factor: Array) -> tuple[Basis, float]:
        """Return the basis of columns whose rows are multiplied by a factor (rows,), and ln of the determinant.

        The determinant is that of the Gram matrix of the multiplied columns, by which the new basis is orthonormal.
        """
        local = self.local * factor[:, None]
        gram = np.zeros((self.members + 1, local.shape[1], local.shape[1]))
        for i, j in combinations_with_replacement(range(local.shape[1]), 2):
            sums = np.bincount(self.member + 1, local[:, i] * local[:, j], self.members + 1)
            # rows without a member are counted at 0; the roll brings them to the end, where index -1 finds them
            gram[:, i, j] = gram[:, j, i] = np.roll(sums, -1)
        is_zero = np.einsum("mqq->mq", gram) == 0
        # 1 for columns of a member that are 0: they stay 0, and add nothing to the determinant
        lower = np.linalg.cholesky(gram + np.eye(local.shape[1]) * is_zero[:, :, None])
        log_det = 2 * float(np.log(np.einsum("mqq->mq", lower)).sum())
        inverse = np.linalg.inv(lower)
        orthonormal = np.where((self.member >= 0)[:, None], np.einsum("rq,rpq->rp", local, inverse[self.member]), 0.0)
        local_basis = replace(self.of_members, local=orthonormal)
        shared = self.shared * factor[:, None]
        # what is orthogonal to a member stays so where all its weights, or none, have changed alike
        uneven = self._uneven(factor)
        changed = local_basis.at(uneven)
        shared[uneven] -= changed.combined(changed.coordinates(shared[uneven]))
        if shared.shape[1]:
            lower = np.linalg.cholesky(shared.T @ shared)
            log_det += 2 * float(np.log(np.diag(lower)).sum())
            shared = triangular_turn(shared, np.linalg.inv(lower))
        return replace(local_basis, shared=shared), log_det

    def _uneven(self, factor: Array) -> Index:
        """Return the rows of the members whose rows have different factors, (rows,)."""
        low, high = np.full(self.members + 1, np.inf), np.zeros(self.members + 1)
        np.minimum.at(low, self.member, factor)
        np.maximum.at(high, self.member, factor)
        uneven = high > low
        uneven[-1] = False  # rows without a member
        return np.flatnonzero(uneven[self.member])

    def rows(self, rows: Index) -> Array:
        """Return some rows of all columns, (rows, columns)."""
        return np.concatenate([self.sparse[rows].toarray(), self.shared[rows]], axis=1)

    def holds_whole_members(self, rows: Index) -> bool:
        """Whether some rows contain all rows of each local member that they use."""
        counts, totals = (np.bincount(of + 1, minlength=self.members + 1) for of in (self.member[rows], self.member))
        return bool(((counts == 0) | (counts == totals))[1:].all())


def members_of_equal_size(member: Index, members: int) -> Iterator[tuple[Index, Index]]:
    """Yield members that have as many rows as each other (k,), and these rows (k, count), by the member of each row.

    Rows without a member, -1, are in none.
    """
    order = np.argsort(member, kind="stable")
    order = order[member[order] >= 0]
    counts = np.bincount(member[order], minlength=members)
    starts = np.cumsum(counts) - counts
    for count in np.unique(counts[counts > 0]).tolist():
        chosen = np.flatnonzero(counts == count)
        step = max(_AT_ONCE // count, 1)
        for some in (chosen[start : start + step] for start in range(0, len(chosen), step)):
            yield some, order[starts[some][:, None] + np.arange(count)]


def without_gathering(rows: Index) -> Index | slice:
    """Return rows in ascending order as a slice if they are evenly spaced: what is stored for them needs no copy."""
    if len(rows) < 2:
        return rows
    first, last, step = int(rows[0]), int(rows[-1]), int(rows[1] - rows[0])
    # the last comparison is of all rows; the first two spare it for most
    even = step > 0 and last - first == step * (len(rows) - 1) and bool((np.diff(rows) == step).all())
    return slice(first, last + 1, step) if even else rows


def thin(columns: Array) -> Columns:
    """Return columns (rows, k) as a sparse matrix where few of their numbers are not zero, such as those of points."""
    from scipy.sparse import csr_matrix

    return csr_matrix(columns) if np.count_nonzero(columns) < _THIN * columns.size else columns


def thin_together(several: Iterable[Array], rows: int) -> Columns:
    """Return some columns (rows, k) each side by side; a table of all is made only if it is small."""
    from scipy.sparse import csr_matrix, hstack

    joined = hstack([csr_matrix((rows, 0)), *map(csr_matrix, several)], format="csr")
    size = rows * joined.shape[1]
    return joined if joined.nnz < _THIN * size or size > _LARGE else joined.toarray()


def squared(columns: Columns) -> Array:
    """Return the products of columns (rows, k), dense or sparse, with each other, (k, k)."""
    products = columns.T @ columns
    return np.asarray(products if isinstance(products, np.ndarray) else products.toarray())


def rows_with_values(columns: Array) -> Index:
    """Return the rows where any of some columns (rows, k) is not zero."""
    has_value = np.zeros(len(columns), dtype=bool)
    # column by column: `(columns != 0).any(axis=1)` makes a table of all first
    for column in columns.T:
        has_value |= column != 0
    return np.flatnonzero(has_value)


def _has_few(columns: Array) -> bool:
    """Return whether few rows of some columns (rows, k) have a value, by some of them."""
    sample = columns[:: max(len(columns) // _SAMPLE, 1)]
    return bool(sample.any(axis=1).sum() < _FEW * len(sample))


def flat_columns(values: Array) -> Array:
    """Return values (rows, ...) as columns, (rows, k)."""
    return values.reshape(len(values), math.prod(values.shape[1:]))
