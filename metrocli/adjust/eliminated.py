"""The unknowns of a portion's members eliminated: Cholesky factors and products in arrays that run along the members.

With D = L L' the normal matrix of a member, J its derivatives by its own unknowns and K those by the others, both in
whitened readings: `U = L^-1 J'`, `Y = U K = L^-1 B`, and the reduced system loses `Y'Y`. All arrays have the members as
last axis, so that each operation is one sweep over numbers that lie side by side.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from metrocli.adjust.blocks import Array, Block, Mask
from metrocli.adjust.groups import Linear
from metrocli.adjust.layout import Layout
from metrocli.adjust.observations import Index

_SINGULAR = 1e-15
"""A pivot below this share of its diagonal element is rounding"""


@dataclass(frozen=True)
class Beside:
    """Derivatives of the readings of a portion by another block."""

    jacobian: Array
    """(d, size, m, k)"""
    places: Index
    """Reduced columns of the member that each slot touches, (m, size), -1 where fixed; (1, size) if it is but one"""

    def along(self, step: Array) -> Array:
        """Return what the readings see of a step of the reduced unknowns, ending in a zero (width + 1,), (d, m, k)."""
        if len(self.places) == self.jacobian.shape[2]:
            return np.asarray(np.einsum("dcmk,mc->dmk", self.jacobian, step[self.places]))
        return np.asarray(np.einsum("dcmk,c->dmk", self.jacobian, step[self.places[0]]))


@dataclass(frozen=True)
class Rows:
    """The readings of one group in a portion, linearised and whitened: m readings of d components for k members."""

    own: Array
    """(d, s, m, k), zero at fixed entries"""
    residual: Array
    """(d, m, k)"""
    beside: tuple[Beside, ...]

    @staticmethod
    def of(linear: Linear, members: Index | slice, blocks: Mapping[str, Block], layout: Layout) -> Rows:
        """Return the readings of `members` of the eliminated block in the order of a lattice."""
        d, k = len(linear.residual), len(blocks[layout.eliminated or ""].free[members])
        beside: list[Beside] = []
        own = np.zeros(0)
        for touch in linear.touches:
            jacobian = touch.jacobian.reshape(d, touch.jacobian.shape[1], -1, k)
            if touch.block == layout.eliminated:
                block = blocks[touch.block]
                own = jacobian if block.all_free else jacobian * block.free[members].T[:, None, :]
            else:
                places = layout.columns[touch.block]
                beside.append(Beside(jacobian, places[touch.index]))
        return Rows(own, linear.residual.reshape(d, -1, k), tuple(beside))


class Eliminated:
    """A portion whose members are eliminated."""

    def __init__(self, members: Index | slice, free: Mask, rows: Sequence[Rows], width: int, damping: float = 0) -> None:
        self.members, self.free, self.rows, self.width = members, free.T, tuple(rows), width
        s, k = self.free.shape
        self.normal, self.right = np.zeros((s, s, k)), np.zeros((s, k))
        """D (s, s, k), and its right side"""
        for part in self.rows:
            self.normal += np.einsum("damk,dbmk->abk", part.own, part.own)
            self.right += np.einsum("damk,dmk->ak", part.own, part.residual)
        diagonal = np.einsum("aak->ak", self.normal)
        if not self.free.all():
            diagonal[~self.free] = 1.0
        if damping:
            diagonal += damping * np.where(diagonal > 0, diagonal, 1.0)

    def damped(self, factor: float) -> Eliminated:
        """Return the same with the diagonal of D enlarged by `1 + factor`."""
        return Eliminated(self.members, self.free.T, self.rows, self.width, factor)

    @cached_property
    def factor(self) -> Array:
        """L with the inverses of its diagonal on the diagonal, (s, s, k); LinAlgError where a member is singular."""
        s, k = self.free.shape
        factor = np.empty((s, s, k))
        for a in range(s):
            for b in range(a + 1):
                rest = self.normal[a, b].copy()
                for c in range(b):
                    rest -= factor[a, c] * factor[b, c]
                if a == b:
                    if not (rest > _SINGULAR * self.normal[a, a]).all():
                        raise np.linalg.LinAlgError("a member is not determined by its own readings")
                    factor[a, a] = 1 / np.sqrt(rest)
                else:
                    factor[a, b] = rest * factor[b, b]
        return factor

    def forward(self, right: Array) -> Array:
        """Return `L^-1` times right, (s, ..., k)."""
        solved = np.empty_like(right)
        for a in range(len(right)):
            rest = right[a]
            for b in range(a):
                rest = rest - self.factor[a, b] * solved[b]
            np.multiply(rest, self.factor[a, a], out=solved[a])
        return solved

    def backward(self, right: Array) -> Array:
        """Return `L'^-1` times right, (s, ..., k)."""
        solved = np.empty_like(right)
        for a in reversed(range(len(right))):
            rest = right[a]
            for b in range(a + 1, len(right)):
                rest = rest - self.factor[b, a] * solved[b]
            np.multiply(rest, self.factor[a, a], out=solved[a])
        return solved

    def whitened(self, part: Rows) -> Array:
        """Return `U = L^-1 J'` of the readings of one group, (s, d, m, k)."""
        return self.forward(np.moveaxis(part.own, 1, 0))

    def coupling(self) -> tuple[Array, Index]:
        """Return Y and the reduced column of each of its rows, (rows, s, k) and (rows,), -1 where fixed.

        A column may stand in several rows.
        """
        s, k = self.free.shape
        pairs = [(part, beside) for part in self.rows for beside in part.beside]
        places = [beside.places.ravel() for _, beside in pairs]
        rows = np.empty((sum(len(place) for place in places), s, k))
        at = 0
        for part in self.rows:
            whitened = self.whitened(part)
            for beside in part.beside:
                size = beside.places.size
                out = rows[at : at + size].reshape(*beside.places.shape, s, k)
                at += size
                if len(out) == 1 < beside.jacobian.shape[2]:
                    np.einsum("admk,dcmk->cak", whitened, beside.jacobian, out=out[0])
                    continue
                first, second = whitened.transpose(1, 2, 0, 3), beside.jacobian.swapaxes(1, 2)
                np.multiply(first[0][:, None], second[0][:, :, None], out=out)
                for d in range(1, len(first)):
                    out += first[d][:, None] * second[d][:, :, None]
        return rows, np.concatenate([*places, np.zeros(0, dtype=np.intp)])

    def add(self, matrix: Array, right: Array) -> None:
        """Add `K'K` and `K' residual` to a matrix and a right side with a place more for fixed unknowns, the last."""
        for part in self.rows:
            _add(part, matrix, right)

    @cached_property
    def loss(self) -> tuple[Array, Array]:
        """`Y'Y` and `Y' U residual`, which the reduced system loses, (width, width) and (width,)."""
        matrix, right = np.zeros((self.width + 1,) * 2), np.zeros(self.width + 1)
        rows, places = self.coupling()
        flat = _flat(rows)
        np.add.at(matrix, (places[:, None], places), flat @ flat.T)
        np.add.at(right, places, flat @ self.forward(self.right).ravel())
        return matrix[:-1, :-1], right[:-1]

    def back(self, step: Array) -> Array:
        """Return the members' own step, `D^-1 J' (residual - K step)`, (k, s)."""
        right, full = self.right.copy(), np.append(step, 0.0)
        for part in self.rows:
            for beside in part.beside:
                seen = beside.along(full)
                for a in range(len(right)):
                    right[a] -= np.einsum("dmk,dmk->k", part.own[:, a], seen)
        return self.backward(self.forward(right)).T

    def fall(self, step: Array) -> float:
        """Return the right side times a step (k, s)."""
        return float(np.einsum("sk,ks->", self.right, step))

    def normals(self) -> Array:
        """Return D, (k, s, s)."""
        return np.moveaxis(self.normal, -1, 0)

    def inverse(self) -> Array:
        """Return D^-1 with zeros at fixed entries, (k, s, s)."""
        s, k = self.free.shape
        unit = np.zeros((s, s, k))
        for a in range(s):
            unit[a, a] = 1.0
        return self._members(self.backward(self.forward(unit)))

    def _members(self, matrices: Array) -> Array:
        """Return matrices (s, s, k) with zeros at fixed entries as (k, s, s)."""
        return np.moveaxis(matrices * self.free * self.free[:, None], -1, 0)

    def weights(self) -> Array:
        """Return `W = D^-1 B`, (k, s, width)."""
        rows, places = self.coupling()
        solved = self.backward(np.ascontiguousarray(rows.swapaxes(0, 1)))
        full = np.zeros((self.width + 1, *rows.shape[1:]))
        np.add.at(full, places, solved.swapaxes(0, 1))
        return np.ascontiguousarray(full[:-1].transpose(2, 1, 0))

    def moments(self, fields: Array) -> tuple[Array, Array, Array]:
        """Return `H' W`, `H' D^-1 H` and `D^-1 H` of fields H (k, s, f): (f, width), (f, f), (k, s, f)."""
        through = self.forward(fields.transpose(1, 2, 0))
        rows, places = self.coupling()
        flat = _flat(np.ascontiguousarray(through.swapaxes(0, 1)))
        coupled = np.zeros((self.width + 1, len(flat)))
        np.add.at(coupled, places, _flat(rows) @ flat.T)
        return coupled[:-1].T, flat @ flat.T, self.backward(through).transpose(2, 0, 1)

    def shared(self, reduced: Array) -> tuple[Array, Array, Array]:
        """Return Y, `Y Q` and `Y Q Y'`, of the reduced unknowns' covariance Q: (rows, s, k) twice, (s, s, k)."""
        rows, places = self.coupling()
        chosen = _padded(reduced)[np.ix_(places, places)]
        product = (chosen @ _flat(rows)).reshape(rows.shape)
        s, k = self.free.shape
        between = np.empty((s, s, k))
        for a in range(s):
            for b in range(a + 1):
                between[a, b] = between[b, a] = np.einsum("rk,rk->k", rows[:, a], product[:, b])
        return rows, product, between

    def covariance(self, reduced: Array) -> Array:
        """Return `D^-1 + W Q W'` of each member, (k, s, s)."""
        inner = self.shared(reduced)[2]
        for a in range(len(inner)):
            inner[a, a] += 1.0
        half = self.backward(inner)
        full = self.backward(np.ascontiguousarray(half.swapaxes(0, 1)))
        return self._members(full)

    def explained(self, reduced: Array) -> list[Array]:
        """Return the variance of each reading as adjusted, `diag(A Q A')`, for each group of rows, (d, m k).

        With `U` the reading's own part, `U'U + U' Y Q Y' U - 2 U' Y Q K' + K Q K'`.
        """
        _, product, between = self.shared(reduced)
        found, at = [], 0
        for part in self.rows:
            u = self.whitened(part)
            total = np.einsum("admk,admk->dmk", u, u)
            for a in range(len(u)):
                total += np.einsum("dmk,bdmk,bk->dmk", u[a], u, between[a])
            for beside in part.beside:
                slots, size = beside.places.shape
                mine = product[at : at + slots * size].reshape(slots, size, len(u), -1)
                mine = np.broadcast_to(mine, (u.shape[2], *mine.shape[1:]))
                at += slots * size
                for c in range(size):
                    along = np.einsum("admk,mak->dmk", u, mine[:, c])
                    total -= 2 * along * beside.jacobian[:, c]
            for first in part.beside:
                for second in part.beside:
                    total += _variance(first, second, _padded(reduced))
            found.append(total.reshape(len(total), -1))
        return found


def _flat(rows: Array) -> Array:
    """Return (rows, s, k) as a matrix (rows, s k)."""
    return rows.reshape(len(rows), rows.shape[1] * rows.shape[2])


def _padded(matrix: Array) -> Array:
    """Return a matrix with a row and a column of zeros more, the place of fixed unknowns."""
    return np.pad(matrix, (0, 1))


def _slots(jacobian: Array, slots: int) -> Array:
    """Return derivatives as matrices to multiply, (slots, size, d m k / slots)."""
    d, size, m, k = jacobian.shape
    if slots == m:
        return jacobian.transpose(2, 1, 0, 3).reshape(m, size, d * k)
    return jacobian.transpose(1, 0, 2, 3).reshape(1, size, d * m * k)


def _add(part: Rows, matrix: Array, right: Array) -> None:
    """Add `K'K` and `K' residual` of one group."""
    for i, one in enumerate(part.beside):
        first, residual = (_slots(x, len(one.places)) for x in (one.jacobian, part.residual[:, None]))
        np.add.at(right, one.places, (first @ residual.swapaxes(1, 2))[:, :, 0])
        for other in part.beside[: i + 1]:
            slots = max(len(one.places), len(other.places))
            left = _slots(one.jacobian, slots)
            gram = left @ (left if other is one else _slots(other.jacobian, slots)).swapaxes(1, 2)
            np.add.at(matrix, (one.places[:, :, None], other.places[:, None, :]), gram)
            if other is not one:
                np.add.at(matrix, (other.places[:, :, None], one.places[:, None, :]), gram.swapaxes(1, 2))


def _variance(first: Beside, second: Beside, reduced: Array) -> Array:
    """Return `K Q K'` of the derivatives by two blocks, (d, m, k)."""
    d, _, m, k = first.jacobian.shape
    total = np.zeros((d, m, k))
    rows = np.broadcast_to(first.places, (m, first.places.shape[1]))
    columns = np.broadcast_to(second.places, (m, second.places.shape[1]))
    q = reduced[rows[:, :, None], columns[:, None, :]]
    for a in range(q.shape[1]):
        total += first.jacobian[:, a] * np.einsum("dbmk,mb->dmk", second.jacobian, q[:, a])
    return total
