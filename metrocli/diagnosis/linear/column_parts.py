"""Parts of the columns of a family: alternatives at the same rows, and steps that share one course of columns.

Method: docs/algorithms/what-can-be-seen.md (projection).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index, Mask
from metrocli.diagnosis.linear.basis import Basis, rows_with_values, without_gathering
from metrocli.frozen import dataclass

_AT_ONCE = 256
"""Columns whose coordinates are computed at once"""
_SMALL = 100_000
"""Number of products up to which all are held to sum them, which then is faster than stretch by stretch"""


@dataclass(frozen=True)
class OwnColumns:
    """The columns of one alternative at the rows that they change."""

    rows: Index
    """(r,)"""
    values: Array
    """(r, parameters)"""

    @property
    def parameters(self) -> int:
        """Number of columns."""
        return int(self.values.shape[1])

    @classmethod
    def of(cls, full: Array, own: Mask, held: Callable[[Index], Index] = lambda rows: rows) -> OwnColumns:
        """Return some of the columns (rows, k), chosen by a mask (k,), at the rows where any of them is not zero.

        `held` returns the array in which equal rows are stored, so that they are stored once.
        """
        columns = full[:, own]
        rows = rows_with_values(columns)
        return cls(held(rows), columns[rows])


@dataclass(frozen=True)
class Course:
    """Columns in the order of time, of which a step has the rows from some time on."""

    rows: Index
    """In the order of time, (r,)"""
    values: Array
    """(r, parameters)"""

    @classmethod
    def of(cls, own: OwnColumns, times: Array) -> Course:
        """Return columns by the times of all rows, (rows,)."""
        order = np.argsort(times[own.rows], kind="stable")
        return cls(own.rows[order], own.values[order])


@dataclass(frozen=True)
class StepColumns:
    """The columns of one alternative that acts from some time on."""

    course: Course
    begin: int
    """The first row of the course on which it acts"""

    @property
    def parameters(self) -> int:
        """Number of columns."""
        return int(self.course.values.shape[1])

    @property
    def rows(self) -> Index:
        """The rows that it changes, (r,)."""
        return self.course.rows[self.begin :]

    @property
    def values(self) -> Array:
        """Its columns at these rows, (r, parameters)."""
        return self.course.values[self.begin :]


@dataclass(frozen=True)
class StackedColumns:
    """Alternatives that change the same rows."""

    rows: Index
    """The rows that they change, in ascending order, (r,)"""
    values: Array
    """Columns at these rows, (r, alternatives, parameters)"""
    numbers: Index
    """Numbers of the alternatives in their family, (alternatives,)"""

    @cached_property
    def _place(self) -> Index | slice:
        return without_gathering(self.rows)

    def products(self, visible: Array, at: Index | slice = slice(None)) -> Array:
        """Return the products of some alternatives with visible vectors (rows, m), (alternatives, parameters, m)."""
        chosen = self.values[:, at]
        of_part = chosen.reshape(len(self.rows), -1).T @ visible[self._place]
        return np.asarray(of_part.reshape(*chosen.shape[1:], visible.shape[1]))

    def dense(self, at: Index | slice = slice(None)) -> Array:
        """Return the columns of some alternatives at the rows, (r, alternatives, parameters)."""
        return self.values[:, at]

    def norms(self) -> Array:
        """Return the norm of each column, (alternatives, parameters)."""
        return np.asarray(np.sqrt(np.einsum("raq,raq->aq", self.values, self.values)))

    def grams(self, basis: Basis) -> Array:
        """Return `g' (I - b b') g` of each alternative, (alternatives, parameters, parameters)."""
        _, count, q = self.values.shape
        step, absorbs, squares = max(_AT_ONCE // max(q, 1), 1), basis.at(self.rows), np.zeros((count, q, q))
        for start in range(0, count, step):
            values = self.values[:, start : start + step]
            turned = np.ascontiguousarray(np.moveaxis(values, 1, 0))
            squares[start : start + step] = np.matmul(np.swapaxes(turned, 1, 2), turned) - absorbs.grams(values)
        return squares

    def cut(self, there: Mask) -> StackedColumns:
        """Return the part at some of its rows (r,)."""
        own = np.flatnonzero(there)
        return StackedColumns(self.rows[own], self.values.take(own, axis=0), self.numbers)

    def numbered(self, rows: Index, numbers: Index) -> StackedColumns:
        """Return the part with other numbers of its rows and its alternatives."""
        return StackedColumns(rows, self.values, numbers)

    def weighted(self, factor: Array) -> StackedColumns:
        """Return the columns with their rows multiplied by a factor (all rows,)."""
        return StackedColumns(self.rows, self.values * factor[self.rows, None, None], self.numbers)


@dataclass(frozen=True)
class Steps:
    """Alternatives that are the same columns, each from a time of its own on: the times of a jump of one tracer.

    Whatever is summed over the rows of one is the sum over the stretches between the times, from its own time on. So
    the columns are stored once for all times.
    """

    course: Course
    begins: Index
    """The first row of the course for each alternative, (alternatives,)"""
    numbers: Index
    """Numbers of the alternatives in their family, (alternatives,)"""

    @property
    def rows(self) -> Index:
        """The rows of the course, (r,)."""
        return self.course.rows

    @cached_property
    def _stretches(self) -> tuple[Index, Index]:
        """First rows of the stretches between the times, and the stretch with which each alternative begins."""
        first, own = np.unique(self.begins, return_inverse=True)
        return first, own

    def _from_each_on(self, sums: Iterable[Array]) -> Array:
        """Return the sums from each alternative's time on, of those over the stretches, the last stretch first."""
        first, own = self._stretches
        # from the last stretch on, since what acts from a time on is the sum of all later stretches
        sums_so_far = np.cumsum(sums if isinstance(sums, np.ndarray) else np.stack(list(sums)), axis=0)
        return np.asarray(sums_so_far[len(first) - 1 - own])

    def _slices(self) -> Iterator[slice]:
        """Yield the rows of each stretch, the last stretch first."""
        first, _ = self._stretches
        ends = np.append(first[1:], len(self.rows))
        yield from (slice(int(a), int(b)) for a, b in zip(first[::-1], ends[::-1], strict=True))

    def products(self, visible: Array, at: Index | slice = slice(None)) -> Array:
        """Return the products of some alternatives with visible vectors (rows, m), (alternatives, parameters, m)."""
        return np.asarray(self._from_each_on(self._sums(self.course.values, visible.take(self.rows, axis=0)))[at])

    def _sums(self, values: Array, others: Array) -> Iterable[Array]:
        """Return the products of values (r, q) with others (r, m) over each stretch, (q, m), the last stretch first."""
        shape = values.shape[1], others.shape[1]
        if len(values) * math.prod(shape) > _SMALL:
            return (values[own].T @ others[own] for own in self._slices())
        every = (values[:, :, None] * others[:, None, :]).reshape(len(values), -1)
        first, _ = self._stretches
        return np.asarray(np.add.reduceat(every, first, axis=0)[::-1].reshape(len(first), *shape))

    def dense(self, at: Index | slice = slice(None)) -> Array:
        """Return the columns of some alternatives at the rows, (r, alternatives, parameters)."""
        later = np.arange(len(self.rows))[:, None] >= self.begins[at]
        return np.asarray(self.course.values[:, None] * later[:, :, None])

    def norms(self) -> Array:
        """Return the norm of each column, (alternatives, parameters)."""
        squares = self.course.values**2
        return np.asarray(np.sqrt(self._from_each_on(self._sums(squares, np.ones((len(squares), 1))))[:, :, 0]))

    def grams(self, basis: Basis) -> Array:
        """Return `g' (I - b b') g` of each alternative, (alternatives, parameters, parameters)."""
        values = self.course.values
        along = self._from_each_on(self._sums(values, basis.shared[self.rows]))
        half = self._from_each_on(self._sums(values, basis.growth_of_local_grams(self.rows, values)))
        absorbed = half + np.swapaxes(half, 1, 2) + along @ np.swapaxes(along, 1, 2)
        return np.asarray(self._from_each_on(self._sums(values, values)) - absorbed)

    def cut(self, there: Mask) -> Steps:
        """Return the part at some of its rows (r,)."""
        # where each step begins among the rows that are left; one that begins behind the last has no row
        begins = np.concatenate([[0], np.cumsum(there)])[self.begins]
        acts = begins < there.sum()
        own = np.flatnonzero(there)
        return Steps(Course(self.rows[own], self.course.values.take(own, axis=0)), begins[acts], self.numbers[acts])

    def numbered(self, rows: Index, numbers: Index) -> Steps:
        """Return the part with other numbers of its rows and its alternatives."""
        return Steps(Course(rows, self.course.values), self.begins, numbers)

    def weighted(self, factor: Array) -> Steps:
        """Return the columns with their rows multiplied by a factor (all rows,)."""
        course = Course(self.course.rows, self.course.values * factor[self.course.rows, None])
        return Steps(course, self.begins, self.numbers)


ColumnPart = StackedColumns | Steps
"""Columns of some alternatives of a family, at the rows that these change"""
