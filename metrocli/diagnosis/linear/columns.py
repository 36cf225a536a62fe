"""Columns of many alternatives, each stored at the rows that it changes.

An effect of one tracer, image or point changes a few rows only. Its visible part `M g` is dense, but a product with a
visible vector v needs no projection: `(M g)' v = g' v`, because `M v = v`. So the signatures are stored as they are,
and only those that enter a model are projected. Method: docs/algorithms/selection-and-levels.md (projection).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index, Mask
from metrocli.diagnosis.linear.basis import Basis

_AT_ONCE = 256
"""Columns whose coordinates are computed at once"""
_SMALL = 100_000
"""Number of products up to which all are held to sum them, which then is faster than stretch by stretch"""


@dataclass(frozen=True)
class Own:
    """The columns of one alternative at the rows that they change."""

    rows: Index
    """(r,)"""
    values: Array
    """(r, parameters)"""


@dataclass(frozen=True)
class Course:
    """Columns in the order of time, of which a step has the rows from some time on."""

    rows: Index
    """(r,)"""
    values: Array
    """(r, parameters)"""


@dataclass(frozen=True)
class Step:
    """The columns of one alternative that acts from some time on."""

    course: Course
    begin: int
    """The first row of the course on which it acts"""

    @property
    def rows(self) -> Index:
        """The rows that it changes, (r,)."""
        return self.course.rows[self.begin :]

    @property
    def values(self) -> Array:
        """Its columns at these rows, (r, parameters)."""
        return self.course.values[self.begin :]


@dataclass(frozen=True)
class Part:
    """Alternatives that change the same rows."""

    rows: Index
    """The rows that they change, (r,)"""
    values: Array
    """Columns at these rows, (r, alternatives, parameters)"""
    numbers: Index
    """Numbers of the alternatives in their family, (alternatives,)"""

    def products(self, visible: Array, at: Index | slice = slice(None)) -> Array:
        """Return the products of some alternatives with visible vectors (rows, m), (alternatives, parameters, m)."""
        chosen = self.values[:, at]
        found = chosen.reshape(len(self.rows), -1).T @ visible[self.rows]
        return np.asarray(found.reshape(*chosen.shape[1:], visible.shape[1]))

    def dense(self, at: Index | slice = slice(None)) -> Array:
        """Return the columns of some alternatives at the rows, (r, alternatives, parameters)."""
        return self.values[:, at]

    def norms(self, kept: Mask | None) -> Array:
        """Return the norm of each column at the kept rows, (alternatives, parameters)."""
        return np.asarray(np.linalg.norm(_kept(self.values, kept), axis=0))

    def grams(self, basis: Basis, kept: Mask | None) -> Array:
        """Return `g' M g` of each alternative with zeros at rows that are not kept (r,), M without a basis."""
        _, count, q = self.values.shape
        step, absorbs, found = max(_AT_ONCE // max(q, 1), 1), basis.at(self.rows), np.zeros((count, q, q))
        for start in range(0, count, step):
            values = _kept(self.values[:, start : start + step], kept)
            turned = np.ascontiguousarray(np.moveaxis(values, 1, 0))
            found[start : start + step] = np.matmul(np.swapaxes(turned, 1, 2), turned) - absorbs.grams(values)
        return found

    def cut(self, there: Mask) -> Part:
        """Return the part at some of its rows (r,)."""
        return Part(self.rows[there], self.values[there], self.numbers)

    def numbered(self, rows: Index, numbers: Index) -> Part:
        """Return the part with other numbers of its rows and its alternatives."""
        return Part(rows, self.values, numbers)


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
        found = np.cumsum(sums if isinstance(sums, np.ndarray) else np.stack(list(sums)), axis=0)
        return np.asarray(found[len(first) - 1 - own])

    def _slices(self) -> Iterator[slice]:
        """Yield the rows of each stretch, the last stretch first."""
        first, _ = self._stretches
        ends = np.append(first[1:], len(self.rows))
        yield from (slice(int(a), int(b)) for a, b in zip(first[::-1], ends[::-1], strict=True))

    def products(self, visible: Array, at: Index | slice = slice(None)) -> Array:
        """Return the products of some alternatives with visible vectors (rows, m), (alternatives, parameters, m)."""
        return np.asarray(self._from_each_on(self._sums(self.course.values, visible[self.rows]))[at])

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

    def norms(self, kept: Mask | None) -> Array:
        """Return the norm of each column at the kept rows, (alternatives, parameters)."""
        squares = _kept(self.course.values, kept) ** 2
        return np.asarray(np.sqrt(self._from_each_on(self._sums(squares, np.ones((len(squares), 1))))[:, :, 0]))

    def grams(self, basis: Basis, kept: Mask | None) -> Array:
        """Return `g' M g` of each alternative with zeros at rows that are not kept (r,), M without a basis."""
        values = _kept(self.course.values, kept)
        absorbed = self._from_each_on(basis.growth_of_grams(self.rows, values, self._slices()))
        return np.asarray(self._from_each_on(self._sums(values, values)) - absorbed)

    def cut(self, there: Mask) -> Steps:
        """Return the part at some of its rows (r,)."""
        begins = np.concatenate([[0], np.cumsum(there)])[self.begins]
        acts = begins < there.sum()
        return Steps(Course(self.rows[there], self.course.values[there]), begins[acts], self.numbers[acts])

    def numbered(self, rows: Index, numbers: Index) -> Steps:
        """Return the part with other numbers of its rows and its alternatives."""
        return Steps(Course(rows, self.course.values), self.begins, numbers)


def _kept(values: Array, kept: Mask | None) -> Array:
    return values if kept is None else values * kept.reshape(-1, *[1] * (values.ndim - 1))


@dataclass(frozen=True)
class Columns:
    """The columns of all alternatives of a family."""

    count: int
    """Number of alternatives"""
    parameters: int
    """Number of columns of each"""
    parts: tuple[Part | Steps, ...]
    kept: Mask | None = None
    """The rows at which they are not zero (rows,), None for all; shared by the folds without a copy of the values"""

    @classmethod
    def of(cls, values: Array) -> Columns:
        """Return dense columns (rows, alternatives, parameters)."""
        rows, count, parameters = values.shape
        return cls(count, parameters, (Part(np.arange(rows), values, np.arange(count)),))

    def products(self, visible: Array, chosen: Sequence[int] | None = None) -> Array:
        """Return the products of the columns with visible vectors (rows, m), (alternatives, parameters, m).

        `chosen` limits them to some alternatives, in this order.
        """
        if chosen is None:
            found = np.zeros((self.count, self.parameters, visible.shape[1]))
            for part in self.parts:
                found[part.numbers] = part.products(visible)
            return found
        found = np.zeros((len(chosen), self.parameters, visible.shape[1]))
        for part, own, at in self._among(chosen):
            found[own] = part.products(visible, at)
        return found

    @cached_property
    def _held(self) -> tuple[Index, Index]:
        """For each alternative, which part holds it (-1 for none) and its place there."""
        part_of, place = np.full(self.count, -1), np.zeros(self.count, dtype=np.intp)
        for number, part in enumerate(self.parts):
            part_of[part.numbers], place[part.numbers] = number, np.arange(len(part.numbers))
        return part_of, place

    def _among(self, chosen: Sequence[int]) -> Iterator[tuple[Part | Steps, Mask, Index]]:
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
            full[np.ix_(part.rows, np.flatnonzero(own))] = _kept(part.dense(at), self._kept_of(part))
        return full

    def grams(self, basis: Basis) -> Array:
        """Return `g' M g` of each alternative, (alternatives, parameters, parameters), M without a basis."""
        found = np.zeros((self.count, self.parameters, self.parameters))
        for part in self.parts:
            found[part.numbers] = part.grams(basis, self._kept_of(part))
        return found

    def norms(self) -> Array:
        """Return the norm of each whole column, (alternatives, parameters)."""
        found = np.zeros((self.count, self.parameters))
        for part in self.parts:
            found[part.numbers] = part.norms(self._kept_of(part))
        return found

    def only(self, kept: Mask) -> Columns:
        """Return the columns with zeros at the rows that are not kept; visible vectors are zero there as well."""
        return replace(self, kept=kept if self.kept is None else self.kept & kept)

    def at(self, rows: Mask) -> Columns:
        """Return the columns at some rows only, which keep their numbers."""
        cut = (part.cut(there) for part in self.parts if (there := rows[part.rows]).any())
        return replace(self, parts=tuple(part for part in cut if len(part.numbers)))

    def turned(self, turn: Array) -> Columns:
        """Return the columns of each alternative times a matrix of its own, (alternatives, parameters, parameters)."""
        parts = (
            Part(part.rows, np.einsum("rak,akj->raj", part.dense(), turn[part.numbers]), part.numbers)
            for part in self.parts
        )
        return replace(self, parts=tuple(parts))

    def of_rows(self, rows: Mask) -> Columns:
        """Return the columns of a system that has some rows only, which are numbered anew."""
        new = np.cumsum(rows) - 1
        cut = self.at(rows)
        return replace(cut, parts=tuple(part.numbered(new[part.rows], part.numbers) for part in cut.parts))

    def _kept_of(self, part: Part | Steps) -> Mask | None:
        return None if self.kept is None else self.kept[part.rows]

    def followed_by(self, values: Array) -> Columns:
        """Return the columns with one alternative more, of columns (rows, parameters)."""
        rows = np.flatnonzero(values.any(axis=1))
        part = Part(rows, values[rows][:, None], np.array([self.count]))
        return replace(self, count=self.count + 1, parts=(*self.parts, part))


def gathered(items: Iterable[tuple[object, Own | Step]]) -> Columns:
    """Return the columns of alternatives, each with a label.

    Alternatives of equal labels, such as the periods of a wave in one tracer, share a part with the rows of all of
    them. Steps of the same course share the course.
    """
    by_label: dict[object, list[tuple[int, Own]]] = {}
    by_course: dict[int, list[tuple[int, Step]]] = {}
    count = 0
    for number, (label, one) in enumerate(items):
        if isinstance(one, Step):
            by_course.setdefault(id(one.course), []).append((number, one))
        else:
            by_label.setdefault(label, []).append((number, one))
        count, parameters = number + 1, one.values.shape[1]
    parts: list[Part | Steps] = []
    for steps in by_course.values():
        begins, numbers = np.array([[one.begin, number] for number, one in steps]).T
        parts.append(Steps(steps[0][1].course, begins, numbers))
    for held in by_label.values():
        numbers, first = np.array([number for number, _ in held]), held[0][1].rows
        if all(np.array_equal(one.rows, first) for _, one in held):
            if len(first):
                parts.append(Part(first, side_by_side([one.values for _, one in held]), numbers))
            continue
        union = np.unique(np.concatenate([one.rows for _, one in held]))
        full = np.zeros((len(union), len(held), parameters))
        for at, (_, one) in enumerate(held):
            full[np.searchsorted(union, one.rows), at] = one.values
        parts.append(Part(union, full, numbers))
    return Columns(count, parameters, tuple(parts))


def side_by_side(several: Sequence[Array]) -> Array:
    """Return the columns of alternatives (r, q) at the same rows side by side, (r, alternatives, q)."""
    return several[0][:, None] if len(several) == 1 else np.stack(several, axis=1)


def joined(several: Sequence[Columns]) -> Columns:
    """Return the columns of several families of as many parameters, none of them cut, one after the other."""
    parts: list[Part | Steps] = []
    count = 0
    for one in several:
        parts += [part.numbered(part.rows, part.numbers + count) for part in one.parts]
        count += one.count
    return Columns(count, several[0].parameters, tuple(parts))
