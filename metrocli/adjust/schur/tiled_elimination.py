"""Elimination of the members of a tile: Cholesky factors and products in arrays that run along the members.

J are the derivatives of the whitened readings by a member's own unknowns, K those by the other unknowns, and
`D = J'J = L L'`. Then `U = L^-1 J'`, `Y = U K = L^-1 B`, and the reduced system loses `Y'Y`. The members are the last
axis of all arrays, so that each operation runs over adjacent numbers. Method: docs/algorithms/tiled-elimination.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from metrocli.adjust.schur.batched_cholesky import backward, cholesky, complement, forward
from metrocli.adjust.schur.tile_rows import (
    TileRows,
    add_products,
    adjusted_variance,
    flattened,
    products_by_member,
    propagated,
    times_covariance,
    with_zeros,
)
from metrocli.arrays import Array, Index, Mask


class EliminatedTile:
    """A tile with its members eliminated."""

    def __init__(
        self, members: Index | slice, free: Mask, rows: Sequence[TileRows], width: int, damping: float = 0
    ) -> None:
        self.members, self.free, self.rows, self.width, self.damping = members, free.T, tuple(rows), width, damping
        self.right = np.zeros(self.free.shape)
        """J' residual, (s, k)"""
        for part in self.rows:
            self.right += np.einsum("damk,dmk->ak", part.own, part.residual)

    def damped(self, factor: float) -> EliminatedTile:
        """Return the same with the diagonal of D multiplied by `1 + factor` (Marquardt)."""
        return EliminatedTile(self.members, self.free.T, self.rows, self.width, factor)

    def _normal(self) -> Array:
        """Return D with 1 on the diagonal of fixed entries, (s, s, k)."""
        s, k = self.free.shape
        normal = np.zeros((s, s, k))
        for part in self.rows:
            normal += np.einsum("damk,dbmk->abk", part.own, part.own)
        diagonal = np.einsum("aak->ak", normal)
        diagonal[~self.free] = 1.0
        if self.damping:
            diagonal += self.damping * np.where(diagonal > 0, diagonal, 1.0)
        return normal

    @cached_property
    def factor(self) -> Array:
        """L of `D = L L'`, (s, s, k).

        Raises LinAlgError if a member is singular.
        """
        return cholesky(self._normal())

    def forward(self, right: Array) -> Array:
        """Return `L^-1 right`, (s, ..., k)."""
        return forward(self.factor, right)

    def backward(self, right: Array) -> Array:
        """Return `L'^-1 right`, (s, ..., k)."""
        return backward(self.factor, right)

    def whitened(self, part: TileRows) -> Array:
        """Return `U = L^-1 J'` of the readings of one group, (s, d, m, k)."""
        return self.forward(np.moveaxis(part.own, 1, 0))

    def coupling(self) -> tuple[Array, Index]:
        """Return Y and the reduced column of each of its rows, (rows, s, k) and (rows,), -1 if fixed.

        A column may occur in several rows: one for each reading that uses it.
        """
        return self._combined(len(self.free), [self.whitened(part) for part in self.rows])

    def _combined(self, w: int, weights: Sequence[Array]) -> tuple[Array, Index]:
        """Return the sums over the readings of weights (w, d, m, k) times K, (rows, w, k), and the columns (rows,)."""
        pairs = [(weight, other) for weight, part in zip(weights, self.rows, strict=True) for other in part.others]
        places = [other.places.ravel() for _, other in pairs]
        rows = np.empty((sum(len(place) for place in places), w, self.free.shape[1]))
        at = 0
        for weight, other in pairs:
            # a view into `rows`: the products are written where they are needed
            out = rows[at : at + other.places.size].reshape(*other.places.shape, *rows.shape[1:])
            at += other.places.size
            # all slots use the one member: its sum over the slots is one row, not one row for each
            if len(out) == 1 < other.jacobian.shape[2]:
                np.einsum("admk,dcmk->cak", weight, other.jacobian, out=out[0])
                continue
            first, second = weight.transpose(1, 2, 0, 3), other.jacobian.swapaxes(1, 2)
            np.multiply(first[0][:, None], second[0][:, :, None], out=out)
            for d in range(1, len(first)):
                out += first[d][:, None] * second[d][:, :, None]
        return rows, np.concatenate([*places, np.zeros(0, dtype=np.intp)])

    @cached_property
    def reduced(self) -> tuple[Array, Array, float]:
        """Contribution to the reduced system: its matrix, its right side, and the decrease by the members alone.

        Raises LinAlgError if a member is singular. With few readings per member, the contribution is `X'X` with `X =
        Z'K`, from the combinations Z of readings that do not depend on the member (see `complement`); else `K'K - Y'Y`.
        """
        # one row and column more: fixed unknowns have the column -1, and their products fall there
        matrix, right = np.zeros((self.width + 1,) * 2), np.zeros(self.width + 1)
        # `K'K - Y'Y` would cancel most digits where a member uses up most of its readings
        if self._few:
            spare = self._spare()
            rows, places = self._combined(len(spare[0]), spare)
            flat = flattened(rows)
            residual = sum(
                np.einsum("qdmk,dmk->qk", z, part.residual) for z, part in zip(spare, self.rows, strict=True)
            )
            np.add.at(matrix, (places[:, None], places), flat @ flat.T)
            np.add.at(right, places, flat @ np.ravel(residual))
        else:
            for part in self.rows:
                add_products(part, matrix, right)
            rows, places = self.coupling()
            flat = flattened(rows)
            np.subtract.at(matrix, (places[:, None], places), flat @ flat.T)
            np.subtract.at(right, places, flat @ self.forward(self.right).ravel())
        fall = self.forward(self.right)
        return matrix[:-1, :-1], right[:-1], float(np.vdot(fall, fall))

    @property
    def _few(self) -> bool:
        """Whether the combinations that do not depend on the member are at most as many as its unknowns."""
        # X'X is the complement for `D = J'J` only: damping changes D, and fixed entries have zero columns in J
        s, scalars = len(self.free), sum(part.own.shape[0] * part.own.shape[2] for part in self.rows)
        # above 2 s there are more such combinations than unknowns, and `K'K - Y'Y` takes fewer products
        return s <= scalars <= 2 * s and bool(self.free.all()) and not self.damping

    def _spare(self) -> list[Array]:
        """Return Z, the combinations of readings that do not depend on the member, for each group, (q, d, m, k)."""
        s, k = self.free.shape
        columns = [part.own.swapaxes(1, 2).reshape(-1, s, k) for part in self.rows]
        # Householder gives L as well, without squaring J: it fills the cached property `factor`
        self.factor, spare = complement(columns[0] if len(columns) == 1 else np.concatenate(columns))
        parts, at = [], 0
        for part, column in zip(self.rows, columns, strict=True):
            mine = spare[at : at + len(column)].swapaxes(0, 1)
            parts.append(mine.reshape(len(mine), *part.residual.shape))
            at += len(column)
        return parts

    @property
    def diagonal(self) -> Array:
        """The diagonal of `K'K`, (width,)."""
        diagonal = np.zeros(self.width + 1)
        for part in self.rows:
            for other in part.others:
                squares = np.einsum("dcmk,dcmk->mc", other.jacobian, other.jacobian)
                shared = len(other.places) < len(squares)
                np.add.at(diagonal, other.places, squares.sum(axis=0, keepdims=True) if shared else squares)
        return diagonal[:-1]

    def back(self, step: Array) -> Array:
        """Return the members' step, `D^-1 J' (residual - K step)`, (k, s)."""
        right, full = self.right.copy(), np.append(step, 0.0)
        for part in self.rows:
            for other in part.others:
                seen = other.along(full)
                for a in range(len(right)):
                    right[a] -= np.einsum("dmk,dmk->k", part.own[:, a], seen)
        return self.backward(self.forward(right)).T

    def normals(self) -> Array:
        """Return D, (k, s, s)."""
        return np.moveaxis(self._normal(), -1, 0)

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
        """Return `W = D^-1 B`: the members move by `-W` for each unit of the other unknowns, (k, s, width)."""
        rows, places = self.coupling()
        solved = self.backward(np.ascontiguousarray(rows.swapaxes(0, 1)))
        full = np.zeros((self.width + 1, *rows.shape[1:]))
        np.add.at(full, places, solved.swapaxes(0, 1))
        return np.ascontiguousarray(full[:-1].transpose(2, 1, 0))

    def solved(self, fields: Array) -> Array:
        """Return `D^-1 H` of fields H (k, s, f), (k, s, f)."""
        return self.backward(self.forward(fields.transpose(1, 2, 0))).transpose(2, 0, 1)

    def moments(self, fields: Array) -> tuple[Array, Array]:
        """Return `H' W` and `H' D^-1 H` of fields H (k, s, f): (f, width), (f, f)."""
        through = self.forward(fields.transpose(1, 2, 0))
        rows, places = self.coupling()
        flat = flattened(np.ascontiguousarray(through.swapaxes(0, 1)))
        coupled = np.zeros((self.width + 1, len(flat)))
        np.add.at(coupled, places, flattened(rows) @ flat.T)
        return coupled[:-1].T, flat @ flat.T

    def covariance(self, reduced: Array) -> Array:
        """Return `D^-1 + W Q W'` of each member, (k, s, s)."""
        return self._covariance(propagated(self.coupling(), reduced)[1])

    def _covariance(self, between: Array) -> Array:
        """Return `L'^-1 (I + Y Q Y') L^-1` of each member, (k, s, s)."""
        inner = between.copy()
        for a in range(len(inner)):
            inner[a, a] += 1.0
        half = self.backward(inner)
        full = self.backward(np.ascontiguousarray(half.swapaxes(0, 1)))
        return self._members(full)

    def adjusted(self, reduced: Array) -> tuple[Array, tuple[Array, ...]]:
        """Return `D^-1 + W Q W'` (k, s, s), and for each group the variance of its adjusted readings, (d, m k).

        That variance is `diag(J D^-1 J' + A Q A')` with `A = K - J W`.
        """
        own = [self.whitened(part) for part in self.rows]
        coupled = self._combined(len(self.free), own)
        product, between = propagated(coupled, reduced)
        explained = self._left(reduced) if self._few else self._explained(own, product, between, with_zeros(reduced))
        return self._covariance(between), tuple(part.reshape(len(part), -1) for part in explained)

    def cross_covariance(self, reduced: Array, chosen: Sequence[int]) -> list[Array]:
        """Return the covariance of the members with the adjusted readings of chosen groups, each (s, d, m, k).

        It is `Q_ee J' + Q_er K' = L'^-1 (U + Y Q Y' U - Y Q K')`, with Q = `reduced`. With few readings per member,
        `K' = Y'U + X'Z'` leaves `L'^-1 (U - Y Q X' Z')`, with `X = Z'K`.
        """
        if self._few:
            return self._cross_covariance_of_few(reduced, chosen)
        own = [self.whitened(part) for part in self.rows]
        product, between = propagated(self._combined(len(self.free), own), reduced)
        parts, at = [], 0
        for i, (part, u) in enumerate(zip(self.rows, own, strict=True)):
            total = u + np.einsum("abk,bdmk->admk", between, u) if i in chosen else None
            for other in part.others:
                mine = product[at : at + other.places.size].reshape(*other.places.shape, *product.shape[1:])
                at += other.places.size
                if total is not None:
                    mine = np.broadcast_to(mine, (u.shape[2], *mine.shape[1:]))
                    total -= np.einsum("mcak,dcmk->admk", mine, other.jacobian)
            if total is not None:
                parts.append(self.backward(total))
        return parts

    def _cross_covariance_of_few(self, reduced: Array, chosen: Sequence[int]) -> list[Array]:
        spare = self._spare()
        own = [self.whitened(part) for part in self.rows]
        (y, places), (x, _) = self._combined(len(self.free), own), self._combined(len(spare[0]), spare)
        between = products_by_member(y, times_covariance(x, places, reduced))
        return [self.backward(own[i] - np.einsum("aqk,qdmk->admk", between, spare[i])) for i in chosen]

    def reading_changes(self, fields: Array, chosen: Sequence[int]) -> list[Array]:
        """Return `H' J'` of fields H (k, s, f) for the readings of chosen groups, each (f, d, m, k)."""
        return [np.einsum("ksf,dsmk->fdmk", fields, self.rows[i].own) for i in chosen]

    def _left(self, reduced: Array) -> list[Array]:
        """Return the variance of each adjusted reading as `1 - diag(Z (I - X Q X') Z')`, with `X = Z'K`."""
        spare = self._spare()
        left = -propagated(self._combined(len(spare[0]), spare), reduced)[1]
        for a in range(len(left)):
            left[a, a] += 1.0
        return [1 - np.einsum("qdmk,rdmk,qrk->dmk", z, z, left) for z in spare]

    def _explained(self, own: Sequence[Array], product: Array, between: Array, reduced: Array) -> list[Array]:
        """Return the variance of each adjusted reading, for each group, (d, m, k).

        With U of the reading itself: `U'U + U' Y Q Y' U - 2 U' Y Q K' + K Q K'`.
        """
        parts, at = [], 0
        for part, u in zip(self.rows, own, strict=True):
            total = np.einsum("admk,admk->dmk", u, u)
            for a in range(len(u)):
                total += np.einsum("dmk,bdmk,bk->dmk", u[a], u, between[a])
            for other in part.others:
                slots, size = other.places.shape
                mine = product[at : at + slots * size].reshape(slots, size, len(u), -1)
                mine = np.broadcast_to(mine, (u.shape[2], *mine.shape[1:]))
                at += slots * size
                for c in range(size):
                    along = np.einsum("admk,mak->dmk", u, mine[:, c])
                    total -= 2 * along * other.jacobian[:, c]
            for first in part.others:
                for second in part.others:
                    total += adjusted_variance(first, second, reduced)
            parts.append(total)
        return parts
