"""A state of the search: parts at their likeliest sizes, and what they leave of all else.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.evidence.parts import READINGS, Fixed
from metrocli.diagnosis.evidence.prices import FURTHER, OF_ALL, gain_of_columns
from metrocli.diagnosis.evidence.products import local_columns, local_part, shared_columns
from metrocli.diagnosis.evidence.scored import Scored
from metrocli.diagnosis.linear.basis import Basis
from metrocli.diagnosis.linear.quadratics import quadratic
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class State(Scored):
    """Parts that explain the residuals of a measurement, and what they leave of candidates and readings."""

    @cached_property
    def _by_members(self) -> Array:
        """Columns E of the errors of single members, (rows, k): unknowns and these leave `I - b b' - E E'`."""
        m = self.measurement
        columns = local_columns(m, self.random)
        found = np.zeros(columns.shape)
        if columns.shape[1]:
            scale = np.exp(self.logs[self.fit.products.of_local] / 2)
            order, begins = m.by_member
            for member, half in enumerate(self.fit.half):
                rows = order[begins[member] : begins[member + 1]]
                found[rows] = (columns[rows] * scale) @ half.T
        return found

    @cached_property
    def basis(self) -> Basis:
        """Columns b: `P = I - b b'` is what the state leaves of anything; not orthonormal beside random parts."""
        m = self.measurement
        own = self._by_members
        basis = m.system.basis
        if own.shape[1]:
            basis = replace(basis, local=np.concatenate([basis.local, own], axis=1))
        if not self.random and not self.fixed:
            return basis
        from scipy.linalg import solve_triangular

        x = shared_columns(m, self.fixed, self.random, bool(own.shape[1]))
        if own.shape[1]:
            x = x - local_part(m, own, x)
        v = solve_triangular(self.fit.lower, x.T, lower=True, check_finite=False).T
        unknowns = [] if own.shape[1] else [m.system.basis.shared]
        return replace(basis, shared=np.concatenate([*unknowns, v], axis=1))

    def seen(self, values: Array) -> Array:
        """Return what the state leaves of values (rows, ...), `P values`."""
        return np.asarray(values - self.basis.combined(self.basis.coordinates(values)))

    @cached_property
    def residual(self) -> Array:
        """What the state leaves of the residual, `P r` (rows,)."""
        return self.seen(self.measurement.system.residual)

    @cached_property
    def _alone(self) -> bool:
        """Whether no errors of single members are in it, so that products with the columns since entered suffice."""
        return not self._by_members.shape[1]

    @cached_property
    def _since(self) -> Array:
        """Columns that entered, beside the unknowns: `M - v v'` is what is left, (rows, k)."""
        return self.basis.shared[:, self.measurement.system.basis.shared.shape[1] :]

    def ratio_of(self, group: int) -> float:
        """Return the standard deviation of a variance group relative to that of all other readings."""
        rows = self.measurement.units[group][2]
        own = float(rows.sum()) - float(self.basis.squares(rows).sum())
        squares = float((self.residual[rows] ** 2).sum())
        rest = max(self.freedoms - own, 1.0)
        return float(np.sqrt(max(squares, 1e-300) / max(own, 1e-9) / (max(self.fit.squares - squares, 1e-300) / rest)))

    def left(self, family: int) -> tuple[Array, Array]:
        """Return the Gram matrices of the alternatives of a family, and their products with the residual."""
        if family not in self.held:
            m = self.measurement
            one, at = m.families[family], m.side_by_side[1]
            shape = one.columns.count, one.columns.parameters
            taken: Array | None
            if family in at:
                right = self._along[-1, at[family]].reshape(shape)
                taken = self._along[:-1, at[family]].reshape(-1, *shape).transpose(1, 2, 0)
            else:
                right = one.columns.products(self.residual[:, None])[:, :, 0]
                taken = one.columns.products(self._since) if self._alone else None
            if taken is None:
                gram = one.columns.grams(self.basis)
            else:
                gram = (one.gram if self._alone else m.whole_grams(family)) - taken @ np.swapaxes(taken, 1, 2)
            self.held[family] = gram, right
        gram, right = self.held[family]
        return gram, right

    @cached_property
    def _along(self) -> Array:
        """Coordinates of the small families in what the state takes, and last their products with the residual."""
        dense, _ = self.measurement.side_by_side
        taken = self._since.T @ dense if self._alone else self.inside(dense)
        return np.concatenate([taken, (dense.T @ self.residual)[None]])

    def inside(self, columns: Array) -> Array:
        """Return coordinates c of columns (rows, k), (any, k): `columns' P columns` is `columns' columns - c' c`."""
        m, basis = self.measurement, self.basis
        if self._alone:
            return basis.coordinates(columns)
        order, begins = m.by_member
        parts = [basis.shared.T @ columns]
        for rows in (order[a:b] for a, b in pairwise(begins)):
            parts.append(basis.local[rows].T @ columns[rows])
        return np.concatenate(parts)

    def taken_by(self, one: Fixed) -> Array:
        """Return columns d, (rows, rank): without a fixed part the state would leave `P + d d'` of anything."""
        from scipy.linalg import solve_triangular

        ends = np.cumsum([0, *(each.rank for each in self.fixed)])
        j = next(j for j, each in enumerate(self.fixed) if each is one)
        at, lower = self.fit.fixed, self.fit.lower[self.fit.fixed :, self.fit.fixed :]
        inverse = np.linalg.inv(lower)
        own = slice(ends[j], ends[j + 1])
        covariance = inverse[:, own].T @ inverse[:, own]
        w = self.basis.shared[:, self.basis.shared.shape[1] - (len(self.fit.lower) - at) :] @ inverse[:, own]
        lower = np.linalg.cholesky(covariance)
        return np.asarray(solve_triangular(lower, w.T, lower=True, check_finite=False).T)

    def of_family(self, family: int, taken: Array | None = None) -> tuple[Array, Array]:
        """Return the squares that each alternative of a family explains, and its rank; without a part if it is given.

        `taken` are the directions of that part (`taken_by`).
        """
        gram, right = self.left(family)
        if taken is not None:
            along = self.measurement.families[family].columns.products(taken)
            gram = gram + along @ np.swapaxes(along, 1, 2)
            right = right + along @ (taken.T @ self.measurement.system.residual)
        return quadratic(gram, right, self.measurement.families[family].raw)

    def gains_of_family(self, family: int) -> tuple[Array, Array, Array]:
        """Return the gain of each alternative, its price, and the squares that it explains."""
        t, q = self.of_family(family)
        gain = gain_of_columns(t, q, self.fit.squares, self.freedoms)
        price = self.measurement.prices.of_ranks(family, q)
        if self.measurement.families[family].unknown:
            return gain, price + OF_ALL, t
        return gain, price + (FURTHER if self.named or self.readings else 0.0), t

    def gains_of_readings(self) -> tuple[Array, Array, Array]:
        """Return the gain of an error of each reading, its price, and the squares that it explains."""
        gain, q, t = self.of_readings()
        return gain, self.measurement.prices.of_ranks(READINGS, q), t

    def of_readings(self, taken: Array | None = None) -> tuple[Array, Array, Array]:
        """Return the gain of an error of each reading, its rank, and the squares that it explains.

        Without a part if its directions `taken` are given (`taken_by`).
        """
        if taken is None:
            return self._of_readings
        return self._without(taken)

    @cached_property
    def _of_readings(self) -> tuple[Array, Array, Array]:
        return self._without(None)

    def _without(self, taken: Array | None) -> tuple[Array, Array, Array]:
        m = self.measurement
        rows = m.places
        there = rows >= 0
        gram = np.eye(rows.shape[1]) * there[:, :, None] - self.basis.products(rows, rows)
        residual = self.residual
        if taken is not None:
            own = np.where(there[:, :, None], taken[rows], 0.0)
            gram = gram + own @ np.swapaxes(own, 1, 2)
            residual = residual + taken @ (taken.T @ m.system.residual)
        right = np.where(there, residual[rows], 0.0)
        weak = np.einsum("iaa->ia", gram).sum(axis=1) < 1e-3
        t, q = quadratic(gram, right, np.ones(rows.shape))
        q = np.where(weak, 0, q)
        t = np.where(q > 0, t, 0.0)
        return gain_of_columns(t, q, self.fit.squares, self.freedoms), q, t
