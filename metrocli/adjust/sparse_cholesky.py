"""Cholesky factor of a sparse symmetric matrix by fronts, with solution and selected inverse.

Multifrontal elimination (Duff and Reid 1983) on dense blocks; the entries of the inverse where the matrix has its own
follow from the root downwards by the recursion of Takahashi (1973), at twice the cost of the factor.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from metrocli.adjust.blocks import Array
from metrocli.adjust.dissection import Front, Sparse
from metrocli.adjust.observations import Index


@dataclass(frozen=True)
class _Columns:
    """Columns of the factor: L = [[diagonal, 0], [below, ...]]."""

    diagonal: Array
    """(p, p), lower, Fortran order"""
    below: Array
    """(b, p), Fortran order"""


@dataclass(frozen=True)
class SparseCholesky:
    """`A = L L'`."""

    fronts: Sequence[Front]
    columns: Sequence[_Columns]

    def solve(self, right: Array) -> Array:
        """Return `A^-1 right`, (n,) or (n, k)."""
        from scipy.linalg import solve_triangular

        x = np.array(right, dtype=float).reshape(len(right), -1)
        for front, part in zip(self.fronts, self.columns, strict=True):
            x[front.pivots] = solve_triangular(part.diagonal, x[front.pivots], lower=True, check_finite=False)
            x[front.border] -= part.below @ x[front.pivots]
        for front, part in zip(reversed(self.fronts), reversed(self.columns), strict=True):
            rest = x[front.pivots] - part.below.T @ x[front.border]
            x[front.pivots] = solve_triangular(part.diagonal, rest, lower=True, trans=1, check_finite=False)
        return x.reshape(right.shape)

    @property
    def weakest(self) -> float:
        """Smallest diagonal entry of L."""
        return min(float(np.abs(part.diagonal.diagonal()).min()) for part in self.columns if part.diagonal.size)

    def inverse(self, pattern: Sparse) -> Sparse:
        """Return the entries of `A^-1` where the symmetric `pattern` has its own, which must be among those of A."""
        from scipy.sparse import csr_array

        values = np.zeros(pattern.nnz)
        turn = np.empty(pattern.shape[0], dtype=np.intp)
        for i, front in enumerate(self.fronts):
            turn[front.pivots] = i
        place = np.full(pattern.shape[0], -1, dtype=np.intp)
        pointers, indices = pattern.indptr, pattern.indices
        for i, inverse in self._inverses():
            unknowns, pivots = self.fronts[i].unknowns, self.fronts[i].pivots
            place[unknowns] = np.arange(len(unknowns))
            at = _ranges(pointers[pivots], pointers[pivots + 1])
            rows = np.repeat(np.arange(len(pivots)), pointers[pivots + 1] - pointers[pivots])
            here = turn[indices[at]] >= i
            values[at[here]] = inverse[place[indices[at[here]]], rows[here]]
        upper = csr_array((values, indices, pointers), shape=pattern.shape)
        rows = np.repeat(np.arange(len(turn)), np.diff(pointers))
        missing = csr_array((np.where(turn[indices] < turn[rows], 1.0, 0.0), indices, pointers), shape=pattern.shape)
        mirrored = upper.T.tocsr()
        mirrored.sort_indices()
        upper.sort_indices()
        missing.sort_indices()
        whole = np.where(missing.data > 0, mirrored.data, upper.data)
        return csr_array((whole, upper.indices, upper.indptr), shape=pattern.shape)

    def _inverses(self) -> Iterator[tuple[int, Array]]:
        """Yield the inverse over the unknowns of each front (p + b, p), from the roots downwards."""
        from scipy.linalg import blas, lapack

        children = {child for front in self.fronts for child in front.children}
        waiting = [(i, np.zeros((0, 0), order="F")) for i in range(len(self.fronts)) if i not in children]
        while waiting:
            i, rest = waiting.pop()
            front, part = self.fronts[i], self.columns[i]
            own, _ = lapack.dpotri(part.diagonal, lower=1)
            own = np.tril(own) + np.tril(own, -1).T
            cross = part.below
            if front.border.size:
                share = blas.dtrsm(1.0, part.diagonal, part.below, side=1, lower=1)
                cross = blas.dgemm(-1.0, rest, share)
                own -= share.T @ cross
            yield i, np.concatenate([own, cross])
            whole = _Square(own, cross, rest)
            for child in front.children:
                waiting.append((child, whole.at(_runs(front, self.fronts[child].border))))


def factor(matrix: Sparse, fronts: Sequence[Front]) -> SparseCholesky:
    """Return the factor of a symmetric positive definite matrix; numpy.linalg.LinAlgError where it is not."""
    from scipy.linalg import blas, lapack

    place = np.full(matrix.shape[0], -1, dtype=np.intp)
    columns: list[_Columns] = []
    updates: dict[int, Array] = {}
    for i, front in enumerate(fronts):
        unknowns, p, b = front.unknowns, len(front.pivots), len(front.border)
        place[unknowns] = np.arange(p + b)
        whole = _Square(*(np.zeros(shape, order="F") for shape in ((p, p), (b, p), (b, b))))
        _assemble(whole, matrix, front, place)
        for child in front.children:
            whole.add(updates.pop(child), _runs(front, fronts[child].border))
        diagonal, info = lapack.dpotrf(whole.own, lower=1, clean=1, overwrite_a=1)
        if info:
            raise np.linalg.LinAlgError("the matrix is not positive definite")
        below = whole.cross
        if b:
            below = blas.dtrsm(1.0, diagonal, below, side=1, lower=1, trans_a=1, overwrite_b=1)
            updates[i] = blas.dsyrk(-1.0, below, beta=1.0, c=whole.rest, lower=1, overwrite_c=1)
        columns.append(_Columns(diagonal, below))
        place[unknowns] = -1
    return SparseCholesky(fronts, columns)


_Runs = list[tuple[slice, slice]]
"""Pieces of a child's border: where they stand among the unknowns of its parent, and in the border"""


@dataclass(frozen=True)
class _Square:
    """A symmetric matrix over the unknowns of a front, [[own, cross'], [cross, rest]], its lower triangle at least."""

    own: Array
    cross: Array
    rest: Array

    def piece(self, rows: slice, columns: slice) -> Array:
        """Return a view of a piece of the lower triangle that lies within one of the parts."""
        p = len(self.own)
        if rows.start < p:
            return self.own[rows, columns]
        below = slice(rows.start - p, rows.stop - p)
        if columns.start < p:
            return self.cross[below, columns]
        return self.rest[below, columns.start - p : columns.stop - p]

    def add(self, update: Array, runs: _Runs) -> None:
        """Add the lower triangle of a child's update."""
        for k, (there, here) in enumerate(runs):
            for other, own in runs[: k + 1]:
                if there.start >= other.start:
                    part = self.piece(there, other)
                    part += update[here, own]
                else:
                    part = self.piece(other, there)
                    part += update[here, own].T

    def at(self, runs: _Runs) -> Array:
        """Return the entries at a child's border; the parts must be whole, not triangles."""
        size = sum(here.stop - here.start for _, here in runs)
        known = np.empty((size, size), order="F")
        for there, here in runs:
            for other, own in runs:
                lower = there.start >= other.start
                known[here, own] = self.piece(there, other) if lower else self.piece(other, there).T
        return known


def _assemble(whole: _Square, matrix: Sparse, front: Front, place: Index) -> None:
    """Put the entries of the pivots' columns that are not eliminated yet into the front."""
    starts, ends = matrix.indptr[front.pivots], matrix.indptr[front.pivots + 1]
    at = _ranges(starts, ends)
    columns = np.repeat(np.arange(len(front.pivots)), ends - starts)
    rows, p = place[matrix.indices[at]], len(front.pivots)
    inner, outer = (rows >= 0) & (rows < p), rows >= p
    whole.own[rows[inner], columns[inner]] = matrix.data[at[inner]]
    whole.cross[rows[outer] - p, columns[outer]] = matrix.data[at[outer]]


def _ranges(starts: Index, ends: Index) -> Index:
    """Return all whole numbers from each start up to its end, one after the other."""
    counts = ends - starts
    offsets = np.repeat(starts - np.cumsum(counts) + counts, counts)
    return offsets + np.arange(int(counts.sum()))


def _runs(front: Front, border: Index) -> _Runs:
    """Return the pieces of a child's border that stand together in the front of its parent."""
    unknowns = front.unknowns
    order = np.argsort(unknowns, kind="stable")
    places = order[np.searchsorted(unknowns, border, sorter=order)]
    pivot = places < len(front.pivots)
    breaks = np.flatnonzero((np.diff(places) != 1) | (pivot[1:] != pivot[:-1])) + 1
    starts, ends = np.concatenate([[0], breaks]).tolist(), np.concatenate([breaks, [len(places)]]).tolist()
    return [(slice(int(places[a]), int(places[a]) + b - a), slice(a, b)) for a, b in zip(starts, ends, strict=True)]
