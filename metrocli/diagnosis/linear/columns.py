"""Columns of many alternatives, each stored at the rows that it changes.

An effect of one tracer, image or point changes a few rows only. Its visible part `M g` is dense, but a product with a
visible vector v needs no projection: `(M g)' v = g' v`, because `M v = v`. So the signatures are stored as they are,
and only those that enter a model are projected. Method: docs/algorithms/what-can-be-seen.md (projection).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.decompositions import grams_of
from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index, Mask
from metrocli.diagnosis.linear.basis import Basis, without_gathering
from metrocli.diagnosis.linear.column_parts import ColumnPart, OwnColumns, StackedColumns, StepColumns, Steps

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix


_MANY, _SMALL = 12, 2000
"""Number of parts from which those with fewer rows are held as one sparse matrix: one product instead of many"""
_DENSE = 2_000_000
"""Most numbers of the columns of many parts whose Gram matrices are computed as of one table"""


@dataclass(frozen=True)
class Stacked:
    """Many small parts as one sparse matrix, such as those of single images, and the other parts."""

    columns: csr_matrix
    """Transposed columns of the small parts, (alternatives*parameters, rows up to the last that they change)"""
    numbers: Index
    """Numbers of their alternatives"""
    others: tuple[ColumnPart, ...]

    @classmethod
    def of(cls, parts: Sequence[ColumnPart]) -> Stacked:
        """Return the parts, apart by their size."""
        from scipy.sparse import csc_matrix

        small = [part for part in parts if isinstance(part, StackedColumns) and len(part.rows) < _SMALL]
        values = [np.moveaxis(part.values, 0, 2).ravel() for part in small]
        counts = [len(part.numbers) * part.values.shape[2] for part in small]
        places = [np.tile(part.rows, count) for part, count in zip(small, counts, strict=True)]
        lengths = np.repeat([len(part.rows) for part in small], counts)
        ends = np.concatenate([[0], np.cumsum(lengths)])
        entries = (np.concatenate([*values, np.zeros(0)]), np.concatenate([*places, np.zeros(0, np.intp)]), ends)
        last = max((int(part.rows.max()) + 1 for part in small if len(part.rows)), default=0)
        columns = csc_matrix(entries, shape=(last, len(lengths)))
        numbers = np.concatenate([*(part.numbers for part in small), np.zeros(0, np.intp)])
        held = {id(part) for part in small}
        return cls(columns.T, numbers, tuple(part for part in parts if id(part) not in held))

    def products(self, visible: Array, parameters: int) -> Array:
        """Return the products with visible vectors (rows, m), (alternatives, parameters, m)."""
        # the table ends with the last row that a small part changes
        sums = self.columns @ visible[: self.columns.shape[1]]
        return np.asarray(sums.reshape(len(self.numbers), parameters, visible.shape[1]))


@dataclass(frozen=True)
class CandidateColumns:
    """The columns of all alternatives of a family."""

    count: int
    """Number of alternatives"""
    parameters: int
    """Number of columns of each"""
    parts: tuple[ColumnPart, ...]
    stacked: list[Stacked] = field(default_factory=list, compare=False, repr=False)
    """Cache: many small parts as one sparse matrix"""

    @classmethod
    def of(cls, values: Array) -> CandidateColumns:
        """Return dense columns (rows, alternatives, parameters)."""
        rows, count, parameters = values.shape
        return cls(count, parameters, (StackedColumns(np.arange(rows), values, np.arange(count)),))

    def products(self, visible: Array, chosen: Sequence[int] | None = None) -> Array:
        """Return the products of the columns with visible vectors (rows, m), (alternatives, parameters, m).

        `chosen` limits them to some alternatives, in this order.
        """
        if chosen is None:
            sums = np.zeros((self.count, self.parameters, visible.shape[1]))
            parts = self.parts
            if len(parts) > _MANY:
                if not self.stacked:
                    self.stacked.append(Stacked.of(parts))
                stacked = self.stacked[0]
                sums[stacked.numbers] = stacked.products(visible, self.parameters)
                parts = stacked.others
            for part in parts:
                sums[part.numbers] = part.products(visible)
            return sums
        sums = np.zeros((len(chosen), self.parameters, visible.shape[1]))
        for part, own, at in self._among(chosen):
            sums[own] = part.products(visible, at)
        return sums

    @cached_property
    def _held(self) -> tuple[Index, Index]:
        """For each alternative, which part holds it (-1 for none) and its place there."""
        part_of, place = np.full(self.count, -1), np.zeros(self.count, dtype=np.intp)
        for number, part in enumerate(self.parts):
            part_of[part.numbers], place[part.numbers] = number, np.arange(len(part.numbers))
        return part_of, place

    def _among(self, chosen: Sequence[int]) -> Iterator[tuple[ColumnPart, Mask, Index]]:
        """Yield the parts that hold some of the alternatives: which of `chosen` these are, and their place in it."""
        numbers = np.asarray(chosen, dtype=np.intp)
        part_of, place = (held[numbers] for held in self._held)
        for number in np.unique(part_of[part_of >= 0]).tolist():
            own = part_of == number
            yield self.parts[number], own, place[own]

    def whole(self, numbers: Sequence[int], rows: int) -> Array:
        """Return the whole columns of some alternatives, (rows, alternatives, parameters)."""
        full = np.zeros((rows, len(numbers), self.parameters))
        for part, own, at in self._among(numbers):
            place, columns = without_gathering(part.rows), without_gathering(np.flatnonzero(own))
            if isinstance(place, slice) or isinstance(columns, slice):
                full[place, columns] = part.dense(at)
            else:
                full[np.ix_(place, columns)] = part.dense(at)
        return full

    def grams(self, basis: Basis) -> Array:
        """Return `g' M g` of each alternative, (alternatives, parameters, parameters), M without a basis."""
        sums = np.zeros((self.count, self.parameters, self.parameters))
        rows = len(basis.local)
        if len(self.parts) > _MANY and rows * self.count * self.parameters <= _DENSE:
            whole = self.whole(range(self.count), rows)
            return np.asarray(grams_of(whole) - basis.grams(whole))
        for part in self.parts:
            sums[part.numbers] = part.grams(basis)
        return sums

    def norms(self) -> Array:
        """Return the norm of each whole column, (alternatives, parameters)."""
        lengths = np.zeros((self.count, self.parameters))
        for part in self.parts:
            lengths[part.numbers] = part.norms()
        return lengths

    def at(self, rows: Mask) -> CandidateColumns:
        """Return the columns at some rows only, which keep their numbers."""
        cut = (part.cut(there) for part in self.parts if (there := rows[part.rows]).any())
        return replace(self, parts=tuple(part for part in cut if len(part.numbers)), stacked=[])

    def only(self, chosen: Sequence[int]) -> CandidateColumns:
        """Return the columns of some alternatives, which are numbered anew."""
        held = self._among(chosen)
        parts = (StackedColumns(part.rows, part.dense(at), np.flatnonzero(own)) for part, own, at in held)
        return CandidateColumns(len(chosen), self.parameters, tuple(parts))

    def weighted(self, factor: Array) -> CandidateColumns:
        """Return the columns with their rows multiplied by a factor (rows,)."""
        return replace(self, parts=tuple(part.weighted(factor) for part in self.parts), stacked=[])

    def of_rows(self, rows: Mask) -> CandidateColumns:
        """Return the columns of a system that has some rows only, which are numbered anew."""
        new = np.cumsum(rows) - 1
        cut = self.at(rows)
        parts = tuple(part.numbered(new[part.rows], part.numbers) for part in cut.parts)
        return replace(cut, parts=parts, stacked=[])

    def followed_by(self, values: Array) -> CandidateColumns:
        """Return the columns with one alternative more, of columns (rows, parameters)."""
        rows = np.flatnonzero(values.any(axis=1))
        part = StackedColumns(rows, values[rows][:, None], np.array([self.count]))
        return replace(self, count=self.count + 1, parts=(*self.parts, part), stacked=[])


def gathered(items: Iterable[tuple[object, OwnColumns | StepColumns]]) -> CandidateColumns:
    """Return the columns of alternatives, each with a label.

    Alternatives of equal labels, such as the periods of a wave in one tracer, share a part with the rows of all of
    them. Steps of the same course share the course.
    """
    by_label: dict[object, list[tuple[int, OwnColumns]]] = {}
    by_course: dict[int, list[tuple[int, StepColumns]]] = {}
    parts: list[ColumnPart] = []
    count = 0
    for number, (label, own) in enumerate(items):
        if isinstance(own, StepColumns):
            by_course.setdefault(id(own.course), []).append((number, own))
        else:
            by_label.setdefault(label, []).append((number, own))
        count, parameters = number + 1, own.parameters
    for steps in by_course.values():
        begins, numbers = np.array([[step.begin, number] for number, step in steps]).T
        parts.append(Steps(steps[0][1].course, begins, numbers))
    for held in by_label.values():
        numbers, first = np.array([number for number, _ in held]), held[0][1].rows
        if all(np.array_equal(columns.rows, first) for _, columns in held):
            if len(first):
                parts.append(StackedColumns(first, side_by_side([columns.values for _, columns in held]), numbers))
            continue
        union = np.unique(np.concatenate([columns.rows for _, columns in held]))
        full = np.zeros((len(union), len(held), parameters))
        for at, (_, own) in enumerate(held):
            full[np.searchsorted(union, own.rows), at] = own.values
        parts.append(StackedColumns(union, full, numbers))
    return CandidateColumns(count, parameters, tuple(parts))


def side_by_side(several: Sequence[Array]) -> Array:
    """Return the columns of alternatives (r, q) at the same rows side by side, (r, alternatives, q)."""
    return several[0][:, None] if len(several) == 1 else np.stack(several, axis=1)


def joined(several: Sequence[CandidateColumns]) -> CandidateColumns:
    """Return the columns of several families of as many parameters, none of them cut, one after the other."""
    parts: list[ColumnPart] = []
    count = 0
    for columns in several:
        parts += [part.numbered(part.rows, part.numbers + count) for part in columns.parts]
        count += columns.count
    return CandidateColumns(count, several[0].parameters, tuple(parts))
