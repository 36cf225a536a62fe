"""Smooth functions of many readings: their columns are computed anew for each product, some readings at a time.

They are most of the columns of all candidates, and a product takes about as long to compute them as to read them from
memory. Method: docs/algorithms/selection-and-levels.md (projection).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import product
from math import comb

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index, Mask
from metrocli.diagnosis.linear.basis import Basis, without_gathering
from metrocli.diagnosis.linear.column_parts import Part
from metrocli.diagnosis.linear.quadratics import whitening
from metrocli.frozen import dataclass

_AT_ONCE = 8192
"""Readings whose terms are computed at once; a processor's cache holds these"""


@dataclass(frozen=True)
class SmoothFunctions:
    """Polynomials of coordinates between their ends, or harmonics of an angle."""

    values: Array
    """Coordinates of all readings, or cosine and sine of the angle, (k, n)"""
    degree: int
    angle: bool
    ends: tuple[Array, Array]
    """The least and the largest of each coordinate, (k, 1)"""

    @classmethod
    def of(cls, values: Array, degree: int, angle: bool) -> SmoothFunctions:
        """Return functions of coordinates (k, n), or of an angle (1, n)."""
        values = np.concatenate([np.cos(values), np.sin(values)]) if angle else values
        return cls(values, degree, angle, _ends(values))

    def between(self, chosen: Index, degree: int) -> SmoothFunctions:
        """Return those between the ends that some readings have, up to a degree."""
        return replace(self, degree=degree, ends=_ends(self.values.take(chosen, axis=1)))

    @property
    def count(self) -> int:
        """Number of functions."""
        return 2 * self.degree if self.angle else number_of_polynomials(len(self.values), self.degree)

    def at(self, chosen: Index | slice) -> Array:
        """Return the functions at some readings, (terms, chosen)."""
        values = self.values[:, chosen]
        if self.angle:
            return harmonics(values, self.degree)
        low, high = self.ends
        return polynomials((2 * values - low - high) / np.where(high > low, high - low, 1.0), self.degree)


@dataclass(frozen=True)
class Terms:
    """One alternative: smooth functions of some readings in each component, turned."""

    first: int
    """First row of the group of the readings"""
    chosen: Index
    """The readings among those of the group, in ascending order"""
    weights: Array
    """By how much a function in each component changes each row of a reading, (n, d, components)"""
    functions: SmoothFunctions
    turn: Array
    """From whitened functions of each component to the columns, (components*terms, parameters)"""
    numbers: Index
    """Number of the alternative in its family, (1,)"""

    @classmethod
    def of(cls, first: int, chosen: Index, weights: Array, functions: SmoothFunctions) -> Terms:
        """Return the functions themselves as columns."""
        width = functions.count * weights.shape[2]
        return cls(first, chosen, weights, functions, np.eye(width), np.zeros(1, dtype=np.intp))

    @property
    def parameters(self) -> int:
        """Number of columns."""
        return int(self.turn.shape[1])

    @property
    def rows(self) -> Index:
        """The rows that it changes, (r,)."""
        d = self.weights.shape[1]
        return np.asarray((self.first + d * self.chosen[:, None] + np.arange(d)).ravel())

    def products(self, visible: Array, at: Index | slice = slice(None)) -> Array:
        """Return the products of some alternatives with visible vectors (rows, m), (alternatives, parameters, m)."""
        found = np.zeros((self.weights.shape[2], self.functions.count, visible.shape[1]))
        n, d, _ = self.weights.shape
        own = visible[self.first : self.first + n * d].reshape(n, d, visible.shape[1])
        for some, terms in self._portions():
            values, weights = own[some], self.weights[some]
            for component, part in enumerate(found):
                part += terms @ (weights[:, :, component, None] * values).sum(axis=1)
        return np.asarray((self.turn.T @ found.reshape(len(self.turn), -1))[None][at])

    def dense(self, at: Index | slice = slice(None)) -> Array:
        """Return the columns of some alternatives at the rows, (r, alternatives, parameters)."""
        parts, components = [np.empty((0, self.parameters))], self.weights.shape[2]
        for some, terms in self._portions():
            # the functions are turned in each component, before these are mixed
            turned = [terms.T @ one for one in self.turn.reshape(components, len(terms), -1)]
            weights = self.weights[some][..., None]
            whitened = sum(weights[:, :, c] * one[:, None] for c, one in enumerate(turned))
            parts.append(np.asarray(whitened).reshape(-1, self.parameters))
        return np.concatenate(parts)[:, None][:, at]

    def norms(self, kept: Mask | None) -> Array:
        """Return the norm of each column at the kept rows, (alternatives, parameters)."""
        return self._held().norms(kept)

    def grams(self, basis: Basis, kept: Mask | None) -> Array:
        """Return `g' M g` of each alternative with zeros at rows that are not kept (r,), M without a basis."""
        return self._held().grams(basis, kept)

    def cut(self, there: Mask) -> Part:
        """Return the part at some of its rows (r,)."""
        by_reading = there.reshape(len(self.chosen), -1)
        some = by_reading.any(axis=1)
        own = replace(self, chosen=self.chosen[some])
        return own._held().cut(by_reading[some].ravel())

    def numbered(self, rows: Index, numbers: Index) -> Part:
        """Return the part with other numbers of its rows and its alternatives."""
        return self._held().numbered(rows, numbers)

    def turned(self, turn: Array) -> Terms:
        """Return the columns times a matrix for each alternative of the family, (all, parameters, parameters)."""
        return replace(self, turn=self.turn @ turn[self.numbers[0]])

    def orthonormal(self, least: float) -> Terms:
        """Return orthonormal columns of the same span, of singular values above `least` of the largest norm."""
        gram = self._gram()
        bound = least**2 * max(float(np.diag(gram).max()), 1e-300)
        found, even = self, False
        for _ in range(2):
            step, even = whitening(gram, bound)
            found = replace(found, turn=found.turn @ step)
            if even:
                break
            gram, bound = found._gram(), 0.0
        return found

    def _gram(self) -> Array:
        """Return the products of the columns with each other, (parameters, parameters)."""
        components, count = self.weights.shape[2], self.functions.count
        found = np.zeros((components, count, components, count))
        for some, terms in self._portions():
            weights = self.weights[some]
            for one, other in product(range(components), repeat=2):
                among = np.einsum("nd,nd->n", weights[:, :, one], weights[:, :, other])
                found[one, :, other] += (terms * among) @ terms.T
        return np.asarray(self.turn.T @ found.reshape(len(self.turn), -1) @ self.turn)

    def _held(self) -> Part:
        return Part(self.rows, self.dense(), self.numbers)

    def _portions(self) -> Iterator[tuple[Index | slice, Array]]:
        """Yield some readings with their functions, (terms, readings)."""
        for start in range(0, len(self.chosen), _AT_ONCE):
            some = without_gathering(self.chosen[start : start + _AT_ONCE])
            yield some, self.functions.at(some)


def number_of_polynomials(coordinates: int, degree: int) -> int:
    """Return the number of products of powers of so many coordinates, of total degree 1 to `degree`."""
    return comb(coordinates + degree, degree) - 1


def polynomials(values: Array, degree: int) -> Array:
    """Return products of powers of coordinates (k, n) without their means over [-1, 1]^k, (terms, n).

    Their total degrees are 1 to `degree`. They span what products of Legendre polynomials do, and need fewer steps.
    """
    found = np.empty((number_of_polynomials(len(values), degree), values.shape[1]))
    found[: len(values)] = values
    # products of the last degree that have no coordinate before each one
    begins, end = [*range(len(values))], len(values)
    for _ in range(degree - 1):
        place = end
        for number, begin in enumerate(begins):
            begins[number], before = place, found[begin:end]
            np.multiply(before, values[number], out=found[place : (place := place + len(before))])
        end = place
    found -= _means(len(values), degree)
    return found


@cache
def _means(coordinates: int, degree: int) -> Array:
    """Return the means of the products over the cube, (terms, 1): each even power p has 1/(p + 1), each odd one 0."""
    last = [tuple(row) for row in np.eye(coordinates, dtype=int).tolist()]
    powers = [*last]
    for _ in range(degree - 1):
        last = [
            (*one[:number], one[number] + 1, *one[number + 1 :])
            for number in range(coordinates)
            for one in last
            if not any(one[:number])
        ]
        powers += last
    each = np.array(powers)
    return np.asarray(np.where(each % 2, 0.0, 1 / (each + 1)).prod(axis=1)[:, None])


def harmonics(values: Array, degree: int) -> Array:
    """Return cos k a and sin k a for k = 1 to `degree`, (2 degree, n), by cos a and sin a (2, n)."""
    found = np.empty((2, degree, values.shape[1]))
    found[:, 0] = values
    before = np.array([[1.0], [0.0]])
    for k in range(1, degree):
        found[:, k] = 2 * values[0] * found[:, k - 1] - before
        before = found[:, k - 1]
    return found.reshape(2 * degree, -1)


def _ends(values: Array) -> tuple[Array, Array]:
    return values.min(axis=1, keepdims=True), values.max(axis=1, keepdims=True)
