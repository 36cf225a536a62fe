"""Columns of many alternatives, each stored at the rows that it changes.

An effect of one tracer, image or point changes a few rows only. Its visible part `M g` is dense, but a product with a
visible vector v needs no projection: `(M g)' v = g' v`, because `M v = v`. So the signatures are stored as they are,
and only those that enter a model are projected. Method: docs/algorithms/selection-and-levels.md (projection).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index, Mask
from metrocli.diagnosis.linear.basis import Basis

_AT_ONCE = 256
"""Columns whose coordinates are computed at once"""


@dataclass(frozen=True)
class Part:
    """Alternatives that change the same rows."""

    rows: Index
    """The rows that they change, (r,)"""
    values: Array
    """Columns at these rows, (r, alternatives, parameters)"""
    numbers: Index
    """Numbers of the alternatives in their family, (alternatives,)"""

    @property
    def flat(self) -> Array:
        """The columns side by side, (r, alternatives*parameters)."""
        return self.values.reshape(len(self.rows), -1)


@dataclass(frozen=True)
class Columns:
    """The columns of all alternatives of a family."""

    count: int
    """Number of alternatives"""
    parameters: int
    """Number of columns of each"""
    parts: tuple[Part, ...]
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
        m = visible.shape[1]
        if chosen is None:
            found = np.zeros((self.count, self.parameters, m))
            for part in self.parts:
                found[part.numbers] = (part.flat.T @ visible[part.rows]).reshape(len(part.numbers), self.parameters, m)
            return found
        found = np.zeros((len(chosen), self.parameters, m))
        for part, own, at in self._among(chosen):
            values = part.values[:, at].reshape(len(part.rows), -1)
            found[own] = (values.T @ visible[part.rows]).reshape(len(at), self.parameters, m)
        return found

    @cached_property
    def _held(self) -> tuple[Index, Index]:
        """For each alternative, which part holds it (-1 for none) and its place there."""
        part_of, place = np.full(self.count, -1), np.zeros(self.count, dtype=np.intp)
        for number, part in enumerate(self.parts):
            part_of[part.numbers], place[part.numbers] = number, np.arange(len(part.numbers))
        return part_of, place

    def _among(self, chosen: Sequence[int]) -> Iterator[tuple[Part, Mask, Index]]:
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
            full[np.ix_(part.rows, np.flatnonzero(own))] = self._at(part, at)
        return full

    def grams(self, basis: Basis) -> Array:
        """Return `g' M g` of each alternative, (alternatives, parameters, parameters), M without a basis."""
        found = np.zeros((self.count, self.parameters, self.parameters))
        step = max(_AT_ONCE // max(self.parameters, 1), 1)
        for part in self.parts:
            absorbs = basis.at(part.rows)
            for start in range(0, len(part.numbers), step):
                values = self._at(part, slice(start, start + step))
                turned = np.ascontiguousarray(np.moveaxis(values, 1, 0))
                gram = np.matmul(np.swapaxes(turned, 1, 2), turned) - absorbs.grams(values)
                found[part.numbers[start : start + step]] = gram
        return found

    def norms(self) -> Array:
        """Return the norm of each whole column, (alternatives, parameters)."""
        found = np.zeros((self.count, self.parameters))
        for part in self.parts:
            found[part.numbers] = np.linalg.norm(self._at(part, slice(None)), axis=0)
        return found

    def only(self, kept: Mask) -> Columns:
        """Return the columns with zeros at the rows that are not kept; visible vectors are zero there as well."""
        return replace(self, kept=kept if self.kept is None else self.kept & kept)

    def at(self, rows: Mask) -> Columns:
        """Return the columns at some rows only, which keep their numbers."""
        parts = [(part, rows[part.rows]) for part in self.parts]
        cut = (Part(part.rows[there], part.values[there], part.numbers) for part, there in parts if there.any())
        return replace(self, parts=tuple(cut))

    def _at(self, part: Part, chosen: slice | Index) -> Array:
        """Return the columns of some alternatives of a part, (r, alternatives, parameters)."""
        values = part.values[:, chosen]
        return values if self.kept is None else values * self.kept[part.rows, None, None]

    def followed_by(self, values: Array) -> Columns:
        """Return the columns with one alternative more, of columns (rows, parameters)."""
        rows = np.flatnonzero(values.any(axis=1))
        part = Part(rows, values[rows][:, None], np.array([self.count]))
        return replace(self, count=self.count + 1, parts=(*self.parts, part))


def gathered(items: Iterable[tuple[object, Index, Array]]) -> Columns:
    """Return the columns of alternatives, each with a label, its rows (r,) and its values (r, parameters).

    Alternatives of equal labels, such as the times of a jump of one tracer, share a part with the rows of all of them.
    """
    by_label: dict[object, list[tuple[int, Index, Array]]] = {}
    count = 0
    for number, (label, rows, values) in enumerate(items):
        by_label.setdefault(label, []).append((number, rows, values))
        count, parameters = number + 1, values.shape[1]
    parts = []
    for held in by_label.values():
        union = np.unique(np.concatenate([rows for _, rows, _ in held]))
        if not len(union):
            continue
        full = np.zeros((len(union), len(held), parameters))
        for at, (_, rows, values) in enumerate(held):
            full[np.searchsorted(union, rows), at] = values
        parts.append(Part(union, full, np.array([number for number, _, _ in held])))
    return Columns(count, parameters, tuple(parts))


def joined(several: Sequence[Columns]) -> Columns:
    """Return the columns of several families of as many parameters, none of them cut, one after the other."""
    parts, count = [], 0
    for one in several:
        parts += [Part(part.rows, part.values, part.numbers + count) for part in one.parts]
        count += one.count
    return Columns(count, several[0].parameters, tuple(parts))
