"""A state of the search: parts at their likeliest sizes, and what they leave of all else.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index
from metrocli.diagnosis.evidence.likelihood import ROUNDING
from metrocli.diagnosis.evidence.parts import LARGEST, READINGS, Fixed
from metrocli.diagnosis.evidence.prices import FURTHER, OF_ALL, gain_of_columns
from metrocli.diagnosis.evidence.products import local_columns, products_of_members, shared_parts
from metrocli.diagnosis.evidence.scored import Scored
from metrocli.diagnosis.linear.basis import Basis, Columns, squared, without_gathering
from metrocli.diagnosis.linear.quadratics import quadratic, solved
from metrocli.frozen import dataclass

_MOST_HELD = 2_000_000
"""Numbers of the products of a part that are kept"""


@dataclass(frozen=True)
class State(Scored):
    """Parts that explain the residuals of a measurement, and what they leave of candidates and readings."""

    @cached_property
    def _by_members(self) -> Array:
        """Columns E of the errors of single members, (rows, k): unknowns and these leave `I - b b' - E E'`."""
        m = self.measurement
        columns = local_columns(m, self.random)
        across = np.zeros(columns.shape)
        if columns.shape[1]:
            scale = np.exp(self.logs[self.fit.products.of_local] / 2)
            for rows, half in zip(m.rows_of_members, self.fit.half, strict=True):
                across[rows] = (columns[rows] * scale) @ half.T
        return across

    @cached_property
    def own(self) -> Basis:
        """Columns of the local unknowns and of the errors of single members."""
        alone, errors = self.measurement.system.basis.of_members, self._by_members
        return replace(alone, local=np.concatenate([alone.local, errors], axis=1)) if errors.shape[1] else alone

    @cached_property
    def entered(self) -> Array:
        """Columns v beside the unknowns: `P = M - v v'` is left; those of all that is shared beside members' errors."""
        m = self.measurement
        x = np.concatenate([np.zeros((m.system.rows, 0)), *(columns for _, columns in self.parts)], axis=1)
        if not self.members_are_free:
            errors = self._by_members
            for shown, some in zip(self.fit.shown, m.rows_of_members, strict=True):
                rows = without_gathering(some)
                x[rows] -= errors[rows] @ shown[:, :-1]
        return solved(self.fit.lower, x.T).T

    @cached_property
    def parts(self) -> list[tuple[object, Array]]:
        """What is shared and entered, with its keys, free of the unknowns unless members have errors."""
        return shared_parts(self.measurement, self.fixed, self.random, not self.members_are_free)

    def shared_columns(self, rows: Index | slice = slice(None)) -> Array:
        """Return the shared columns of unknowns and parts, and last the residual, at some rows, (rows, p + 1)."""
        system = self.measurement.system
        unknowns = [system.basis.shared[rows]] if self.members_are_free else []
        parts = (columns[rows] for _, columns in self.parts)
        return np.concatenate([*unknowns, *parts, system.residual[rows, None]], axis=1)

    @cached_property
    def basis(self) -> Basis:
        """Columns b: `P = I - b b'` is what the state leaves of anything; not orthonormal beside random parts."""
        unknowns = [self.measurement.system.basis.shared] if self.members_are_free else []
        return replace(self.own, shared=np.concatenate([*unknowns, self.entered], axis=1))

    def seen(self, values: Array) -> Array:
        """Return what the state leaves of values (rows, ...), `P values`."""
        basis = self.measurement.system.basis if self.members_are_free else self.basis
        left = np.asarray(values - basis.combined(basis.coordinates(values)))
        return left - self.entered @ np.tensordot(self.entered.T, values, 1) if self.members_are_free else left

    @cached_property
    def residual(self) -> Array:
        """What the state leaves of the residual, `P r` (rows,)."""
        sizes, ends = self.fit.sizes, np.cumsum([x.shape[1] for _, x in self.parts])
        taken = (x @ sizes[b - x.shape[1] : b] for (_, x), b in zip(self.parts, ends, strict=True))
        left = self.measurement.system.residual - sum(taken)
        if not self.members_are_free:
            shown = self.fit.shown
            errors = shown[:, :, -1] - shown[:, :, :-1] @ sizes
            left -= np.einsum("rk,rk->r", self._by_members, errors[self.measurement.system.basis.member])
        return np.asarray(left)

    @cached_property
    def members_are_free(self) -> bool:
        """Whether no errors of single members are in it, so that products with the columns since entered suffice."""
        return not any(part.local for part in self.random)

    def _with_parts(self, name: object, columns: Callable[[Array], Array], cache: dict[object, Array]) -> Array:
        """Return the products of what is shared with columns of a name, (p, ...), by those with others (rows, k).

        Those with each part are computed once in a cache.
        """
        new = [(key, x) for key, x in self.parts if ("within", name, key) not in cache]
        products = {key: cache["within", name, key] for key, _ in self.parts if ("within", name, key) in cache}
        if new or not products:
            every = columns(np.concatenate([np.zeros((self.measurement.system.rows, 0)), *(x for _, x in new)], axis=1))
            ends = np.cumsum([x.shape[1] for _, x in new])
            for (key, x), end in zip(new, ends, strict=True):
                products[key] = every[end - x.shape[1] : end]
                if products[key].size < _MOST_HELD:
                    cache["within", name, key] = products[key]
            if not new:
                return every
        return np.concatenate([products[key] for key, _ in self.parts])

    @cached_property
    def absorbed(self) -> Array:
        """The share of each reading that the state absorbs, (rows,)."""
        entered = np.einsum("rk,rk->r", self.entered, self.entered)
        if not self.members_are_free:
            return np.asarray(self.own.squares() + entered)
        cache = self.measurement.cache
        if "absorbed" not in cache:
            cache["absorbed"] = self.measurement.system.basis.squares()
        return np.asarray(cache["absorbed"] + entered)

    def of_rows(self, rows: Index) -> Array:
        """Return the products of what the state leaves of rows (n, a), -1 for none, with each other, (n, a, a)."""
        return np.asarray(np.eye(rows.shape[1]) * (rows >= 0)[:, :, None] - self._taken_of(rows))

    def _taken_of(self, rows: Index) -> Array:
        """Return the products of what the state takes of rows (n, a), -1 for none, with each other, (n, a, a)."""
        if rows.ndim == 2 and rows.shape[1] == 1:
            return np.where(rows >= 0, self.absorbed[rows], 0.0)[:, :, None]
        if not self.members_are_free:
            return self.basis.products(rows, rows)
        m = self.measurement
        if rows is not m.places:
            known = m.system.basis.products(rows, rows)
        elif "readings" not in m.cache:
            known = m.cache["readings"] = m.system.basis.products(rows, rows)
        else:
            known = m.cache["readings"]
        entered = np.where((rows >= 0)[:, :, None], self.entered[rows], 0.0)
        return np.asarray(known + entered @ np.swapaxes(entered, 1, 2))

    def ratio_of(self, group: int) -> float:
        """Return the standard deviation of a variance group relative to that of all other readings."""
        rows = self.measurement.units[group][2]
        own = float(rows.sum()) - float(self.absorbed[rows].sum())
        return self.own_noise(own, float((self.residual[rows] ** 2).sum()))[0]

    def own_noise(self, freedoms: float, squares: float) -> tuple[float, float]:
        """Return the standard deviation of readings of some freedoms and squares relative to all others, and its gain.

        With nu_u freedoms and squares S_u of these, of nu and S in all, it is
        `(nu ln(S/nu) - nu_u ln(S_u/nu_u) - (nu - nu_u) ln((S - S_u)/(nu - nu_u)))/2` (Bartlett).
        """
        dof, every = self.freedoms, self.fit.squares
        own = max(squares, 1e-300) / max(freedoms, 1e-9)
        others = max(every - squares, ROUNDING * every, 1e-300) / max(dof - freedoms, 1.0)
        ratio = float(np.sqrt(own / others))
        if min(freedoms, dof - freedoms) < 1 or not 0 < squares < every:
            return ratio, 0.0
        return ratio, float(dof * np.log(every / dof) - freedoms * np.log(own) - (dof - freedoms) * np.log(others)) / 2

    def left(self, family: int) -> tuple[Array, Array]:
        """Return the Gram matrices of the alternatives of a family, and their products with the residual."""
        if family not in self.cache:
            m = self.measurement
            group, at = m.families[family], m.side_by_side[1]
            shape = group.columns.count, group.columns.parameters
            taken: Array | None
            if family in at:
                right = self._along[-1, at[family]].reshape(shape)
                taken = self._along[:-1, at[family]].reshape(-1, *shape).transpose(1, 2, 0)
            else:
                right = group.columns.products(self.residual[:, None])[:, :, 0]
                taken = self._of_columns(family).transpose(1, 2, 0) if self.members_are_free else None
            if taken is None:
                gram = group.columns.grams(self.basis)
            else:
                alone = group.gram if self.members_are_free else m.grams_beside_members(family)
                gram = alone - taken @ np.swapaxes(taken, 1, 2)
            self.cache[family] = gram, right
        products: tuple[Array, Array] = self.cache[family]
        return products

    def _of_columns(self, family: int) -> Array:
        """Return what entered along the columns of a family, (k, alternatives, parameters)."""
        columns, cache = self.measurement.families[family].columns, self.measurement.cache_of_families
        return solved(self.fit.lower, self._with_parts(family, lambda x: columns.products(x).transpose(2, 0, 1), cache))

    @cached_property
    def _along(self) -> Array:
        """Coordinates of the small families in what the state takes, and last their products with the residual."""
        (every, _), cache = self.measurement.side_by_side, self.measurement.cache_of_families
        return np.concatenate([self._inside("side by side", every, cache), (every.T @ self.residual)[None]])

    def _inside(self, name: object, columns: Columns, cache: dict[object, Array]) -> Array:
        """Return coordinates c of columns (rows, k), (any, k): what the unknowns leave of their products is less c'c.

        Those are the local unknowns alone where members have errors.
        """

        def products(x: Array) -> Array:
            return np.asarray(columns.T @ x).T

        if self.members_are_free:
            return solved(self.fit.lower, self._with_parts(name, products, cache))
        p, scale = len(self.fit.lower), np.exp(self.logs[self.fit.products.of_local] / 2)
        errors = (self.fit.half * scale) @ products_of_members(self.measurement, self.random, (name, columns), cache)
        flat = errors.reshape(-1, errors.shape[2])
        taken = np.tensordot(self.fit.shown[:, :, :p], errors, ((0, 1), (0, 1)))
        return np.concatenate([flat, solved(self.fit.lower, self._with_parts(name, products, cache) - taken)])

    def gram(self, name: object, columns: Columns) -> Array:
        """Return `columns' P columns` of columns (rows, k); what does not depend on the state is computed once."""
        basis, cache, key = self.measurement.system.basis, self.measurement.cache, (self.members_are_free, name)
        if key not in cache:
            alone = basis if self.members_are_free else basis.of_members
            cache[key] = squared(columns) - alone.absorbed_of(columns)
        inside = self._inside(name, columns, cache)
        return np.asarray(cache[key] - inside.T @ inside)

    def taken_by(self, part: Fixed) -> Array:
        """Return columns d, (rows, rank): without a fixed part the state would leave `P + d d'` of anything."""
        ends = np.cumsum([0, *(each.rank for each in self.fixed)])
        j = next(j for j, each in enumerate(self.fixed) if each is part)
        at, lower = self.fit.fixed, self.fit.lower[self.fit.fixed :, self.fit.fixed :]
        inverse = np.linalg.inv(lower)
        own = slice(ends[j], ends[j + 1])
        covariance = inverse[:, own].T @ inverse[:, own]
        w = self.entered[:, self.entered.shape[1] - (len(self.fit.lower) - at) :] @ inverse[:, own]
        lower = np.linalg.cholesky(covariance)
        return solved(lower, w.T).T

    def of_family(self, family: int, taken: Array | None = None) -> tuple[Array, Array]:
        """Return the squares that each alternative explains, and its rank; without the part that `taken_by` is for."""
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
        if (group := self.measurement.families[family]).unknown:
            # as large as a correlated error may be, root mean square
            beyond = group.changes(*self.left(family)) > np.exp(LARGEST / 2) * self.measurement.system.rows**0.5
            return np.where(beyond, 0.0, gain), price + OF_ALL, t
        return gain, price + (FURTHER if self.named or self.readings else 0.0), t

    def nets(self, family: int) -> Array:
        """Return the net gain of each alternative of a family, computed once; -inf where it explains nothing."""
        if ("nets", family) not in self.cache:
            gain, price, _ = self.gains_of_family(family)
            self.cache["nets", family] = np.where(gain > 0, gain - price, -np.inf)
        return np.asarray(self.cache["nets", family])

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
        there = (rows := self.measurement.places) >= 0
        own = np.where(there[:, :, None], taken[rows], 0.0)
        residual = self.residual + taken @ (taken.T @ self.measurement.system.residual)
        return self._explained_by_readings(self.of_rows(rows) + own @ np.swapaxes(own, 1, 2), residual)

    @cached_property
    def _of_readings(self) -> tuple[Array, Array, Array]:
        return self._explained_by_readings(self.of_rows(self.measurement.places), self.residual)

    def _explained_by_readings(self, gram: Array, residual: Array) -> tuple[Array, Array, Array]:
        rows = self.measurement.places
        right = np.where(rows >= 0, residual[rows], 0.0)
        weak = np.einsum("iaa->ia", gram).sum(axis=1) < 1e-3
        t, q = quadratic(gram, right, np.ones(rows.shape))
        q = np.where(weak, 0, q)
        t = np.where(q > 0, t, 0.0)
        return gain_of_columns(t, q, self.fit.squares, self.freedoms), q, t
