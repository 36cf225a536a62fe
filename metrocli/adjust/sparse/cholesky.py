"""Cholesky factor of a sparse symmetric matrix front by front, with solution and selected inverse.

The factor is computed by multifrontal elimination (Duff and Reid 1983) on dense blocks. The entries of the inverse
at the non-zero entries of the matrix follow from the root downwards by the recursion of Takahashi (1973), at twice
the cost of the factor. Only the lower triangle of symmetric matrices is stored, in the order of elimination.
Method: docs/algorithms/nested-dissection.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from metrocli.adjust.sparse.nested_dissection import Front, Sparse
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class _FrontColumns:
    """Columns of the factor that belong to one front: [[diagonal, 0], [below, ...]]."""

    diagonal: Array
    """(p, p), lower, Fortran order"""
    below: Array
    """(b, p), Fortran order"""


@dataclass(frozen=True)
class SparseCholesky:
    """The factor L of `A = L L'`."""

    fronts: Sequence[Front]
    columns: Sequence[_FrontColumns]

    def forward(self, right: Array) -> Array:
        """Return `L^-1 right`, (n,) or (n, k), with the rows in the order of A."""
        from scipy.linalg import blas

        x = np.array(right, dtype=float).reshape(len(right), -1)
        for front, part in zip(self.fronts, self.columns, strict=True):
            x[front.pivots] = blas.dtrsm(1.0, part.diagonal, x[front.pivots], lower=1)
            x[front.border] -= part.below @ x[front.pivots]
        return x.reshape(right.shape)

    def solve(self, right: Array) -> Array:
        """Return `A^-1 right`, (n,) or (n, k)."""
        from scipy.linalg import blas

        x = self.forward(right).reshape(len(right), -1)
        for front, part in zip(reversed(self.fronts), reversed(self.columns), strict=True):
            rest = x[front.pivots] - part.below.T @ x[front.border]
            x[front.pivots] = blas.dtrsm(1.0, part.diagonal, rest, lower=1, trans_a=1)
        return x.reshape(right.shape)

    @property
    def weakest(self) -> float:
        """Smallest diagonal entry of L."""
        return min(float(np.abs(part.diagonal.diagonal()).min()) for part in self.columns if part.diagonal.size)

    def inverse(self, pattern: Sparse) -> Sparse:
        """Return the entries of `A^-1` at the entries of the symmetric `pattern`, which must be among those of A."""
        half = _half(pattern, self.fronts)
        values, place = np.empty(len(half.others)), np.empty(pattern.shape[0], dtype=np.intp)
        # fronts that are nobody's child are the roots, one for each piece of the net
        children = {child for front in self.fronts for child in front.children}
        waiting = [(i, np.zeros((0, 0), order="F")) for i in range(len(self.fronts)) if i not in children]
        while waiting:
            i, rest = waiting.pop()
            front = self.fronts[i]
            # not cleared between fronts: only entries of this front's unknowns are read
            place[front.unknowns] = np.arange(len(front.unknowns))
            known = _inverse(self.columns[i], rest)
            for at, part, rows, columns in _entries(half, front, place, known):
                values[at] = part[rows, columns]
            for child in front.children:
                waiting.append((child, known.at(_runs(place[self.fronts[child].border], len(front.pivots)))))
        return half.mirrored(values)


def factor(matrix: Sparse, fronts: Sequence[Front]) -> SparseCholesky:
    """Return the factor of a symmetric positive definite matrix.

    Raises numpy.linalg.LinAlgError if it is not positive definite.
    """
    from scipy.linalg import blas, lapack

    half, place = _half(matrix, fronts), np.empty(matrix.shape[0], dtype=np.intp)
    columns: list[_FrontColumns] = []
    updates: dict[int, Array] = {}
    for i, front in enumerate(fronts):
        p, b = len(front.pivots), len(front.border)
        place[front.unknowns] = np.arange(p + b)
        whole = _Square(*(np.zeros(shape, order="F") for shape in ((p, p), (b, p), (b, b))))
        for at, part, rows, across in _entries(half, front, place, whole):
            part[rows, across] = matrix.data[half.entries[at]]
        for child in front.children:
            whole.add(updates.pop(child), _runs(place[fronts[child].border], p))
        diagonal, info = lapack.dpotrf(whole.own, lower=1, clean=1, overwrite_a=1)
        if info:
            raise np.linalg.LinAlgError("the matrix is not positive definite")
        below = whole.cross
        if b:
            below = blas.dtrsm(1.0, diagonal, below, side=1, lower=1, trans_a=1, overwrite_b=1)
            updates[i] = blas.dsyrk(-1.0, below, beta=1.0, c=whole.rest, lower=1, overwrite_c=1)
        columns.append(_FrontColumns(diagonal, below))
    return SparseCholesky(fronts, columns)


_Runs = list[tuple[slice, slice]]
"""Consecutive pieces of a child's border: their positions among the unknowns of the parent, and in the border"""


@dataclass(frozen=True)
class _Square:
    """The lower triangle of a symmetric matrix over the unknowns of a front, [[own, ...], [cross, rest]]."""

    own: Array
    cross: Array
    rest: Array

    def piece(self, rows: slice, columns: slice) -> Array:
        """Return a view of a piece that lies within one of the three parts."""
        p = len(self.own)
        if rows.start < p:
            return self.own[rows, columns]
        below = slice(rows.start - p, rows.stop - p)
        if columns.start < p:
            return self.cross[below, columns]
        return self.rest[below, columns.start - p : columns.stop - p]

    def add(self, update: Array, runs: _Runs) -> None:
        """Add the update matrix of a child."""
        # runs are in rising order, so that `other` at or before `there` is the lower triangle
        for k, (there, here) in enumerate(runs):
            for other, own in runs[: k + 1]:
                part = self.piece(there, other)
                part += update[here, own]

    def at(self, runs: _Runs) -> Array:
        """Return the entries at a child's border (lower triangle)."""
        size = runs[-1][1].stop if runs else 0
        known = np.empty((size, size), order="F")
        for k, (there, here) in enumerate(runs):
            for other, own in runs[: k + 1]:
                known[here, own] = self.piece(there, other)
        return known


def _inverse(part: _FrontColumns, rest: Array) -> _Square:
    """Return the inverse at the unknowns of a front, from that at its border `rest`.

    With `G = below diagonal^-1` these are `cross = -rest G` and `own = (diagonal diagonal')^-1 - G' cross` (Takahashi).
    """
    from scipy.linalg import blas, lapack

    own, _ = lapack.dpotri(part.diagonal, lower=1)
    if not len(rest):
        return _Square(own, part.below, rest)
    share = blas.dtrsm(1.0, part.diagonal, part.below, side=1, lower=1)
    cross = blas.dsymm(-1.0, rest, share, lower=1)
    return _Square(blas.dgemm(-1.0, share, cross, beta=1.0, c=own, trans_a=1, overwrite_c=1), cross, rest)


@dataclass(frozen=True)
class _Half:
    """The entries of a symmetric matrix, each listed once, under the unknown of its two that is eliminated first."""

    starts: Index
    """Index of the first entry of each unknown, and the end, (n + 1,)"""
    others: Index
    """The other unknown of each entry"""
    entries: Index
    """Index of each entry in the matrix"""

    def mirrored(self, values: Array) -> Sparse:
        """Return the whole matrix with these values, explicit zeros included."""
        from scipy.sparse import coo_array

        n = len(self.starts) - 1
        firsts = np.repeat(np.arange(n), np.diff(self.starts))
        apart = firsts != self.others
        places = (np.concatenate([firsts, self.others[apart]]), np.concatenate([self.others, firsts[apart]]))
        whole = coo_array((np.concatenate([values, values[apart]]), places), shape=(n, n)).tocsr()
        whole.sort_indices()
        return whole


def _half(matrix: Sparse, fronts: Sequence[Front]) -> _Half:
    turn = np.empty(matrix.shape[0], dtype=np.intp)
    turn[np.concatenate([front.pivots for front in fronts])] = np.arange(len(turn))
    # each pair is kept at the unknown that goes first, since it enters the front of that one
    later = turn[matrix.indices] >= np.repeat(turn, np.diff(matrix.indptr))
    starts = np.concatenate([[0], np.cumsum(later)])[matrix.indptr]
    return _Half(starts, matrix.indices[later], np.flatnonzero(later))


def _entries(half: _Half, front: Front, place: Index, whole: _Square) -> Iterator[tuple[Index, Array, Index, Index]]:
    """Yield for two parts of a front's matrix: the entries that belong there, the part, and their rows and columns."""
    starts, ends = half.starts[front.pivots], half.starts[front.pivots + 1]
    at, p = _ranges(starts, ends), len(front.pivots)
    rows, columns = place[half.others[at]], np.repeat(np.arange(p), ends - starts)
    inner = rows < p
    yield at[inner], whole.own, rows[inner], columns[inner]
    yield at[~inner], whole.cross, rows[~inner] - p, columns[~inner]


def _ranges(starts: Index, ends: Index) -> Index:
    """Return all integers from each start up to its end, one range after the other."""
    counts = ends - starts
    offsets = np.repeat(starts - np.cumsum(counts) + counts, counts)
    return offsets + np.arange(int(counts.sum()))


def _runs(places: Index, p: int) -> _Runs:
    """Return the consecutive pieces of a child's border in the front of its parent, which has p pivots."""
    # also where the pivots of the parent end: a slice must lie in one of the three parts of its matrix
    breaks = np.flatnonzero((np.diff(places) != 1) | (places[1:] == p)) + 1
    starts, ends = np.concatenate([[0], breaks]).tolist(), np.concatenate([breaks, [len(places)]]).tolist()
    return [(slice(int(places[a]), int(places[a]) + b - a), slice(a, b)) for a, b in zip(starts, ends, strict=True)]
