"""A state of the search: fixed columns, random effects and their sizes, with its score and what it leaves of all else.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.evidence.likelihood import Fit, Products, fit_at, likeliest
from metrocli.diagnosis.evidence.measurement import LENGTHS, Measurement
from metrocli.diagnosis.evidence.parts import EFFECT, HELD_OUT, READINGS, SCATTER, UNKNOWN, Fixed, Random, scatter
from metrocli.diagnosis.evidence.prices import FURTHER, OF_ALL, PRIOR, gain_of_columns
from metrocli.diagnosis.linear.basis import Basis
from metrocli.diagnosis.linear.quadratics import quadratic
from metrocli.frozen import dataclass

TRIAL = 2
"""Steps of the sizes in a trial"""


@dataclass(frozen=True)
class State:
    """Parts that explain the residuals of a measurement, at the likeliest sizes."""

    measurement: Measurement
    fixed: tuple[Fixed, ...]
    random: tuple[Random, ...]
    fit: Fit
    held: dict[object, tuple[Array, Array]] = field(default_factory=dict, compare=False, repr=False)
    """Cache of what is left of families"""

    @classmethod
    def of(
        cls,
        measurement: Measurement,
        fixed: Sequence[Fixed] = (),
        random: Sequence[Random] = (),
        logs: Sequence[float] | Array = (),
        steps: int = 12,
    ) -> State:
        """Return a state, its sizes estimated from some on."""
        products = products_of(measurement, fixed, random)
        most = np.array([one.most for one in random])
        fit = likeliest(products, np.array(logs, dtype=float), most, steps)
        return cls(measurement, tuple(fixed), tuple(random), fit)

    @property
    def logs(self) -> Array:
        """ln of the variance of each random part, in that of the noise."""
        return self.fit.logs

    @property
    def named(self) -> tuple[Fixed, ...]:
        """The identified effects."""
        return tuple(one for one in self.fixed if one.sort == EFFECT)

    @property
    def unknown(self) -> tuple[Fixed, ...]:
        """What varies with a covariate for a cause that is not known."""
        return tuple(one for one in self.fixed if one.sort == UNKNOWN)

    @property
    def readings(self) -> tuple[Fixed, ...]:
        """The wrong readings."""
        return tuple(one for one in self.fixed if one.is_reading)

    @cached_property
    def _beside(self) -> tuple[Array, Array]:
        """Gram matrix of the fixed columns beside all others, and their products with what these leave."""
        at = self.fit.fixed
        lower = self.fit.lower[at:, at:]
        return lower @ lower.T, lower @ self.fit.sought[at:]

    @cached_property
    def bare(self) -> float:
        """Squares that unknowns and random parts alone leave."""
        at = self.fit.fixed
        return float(self.fit.squares + self.fit.sought[at:] @ self.fit.sought[at:])

    @cached_property
    def freedoms(self) -> float:
        """Degrees of freedom beside all fixed columns."""
        return float(self.fit.dof - sum(one.rank for one in self.fixed))

    @cached_property
    def noise_freedoms(self) -> float:
        """Degrees of freedom of the white noise alone: without those of the declared one and of the random parts."""
        return max(self.freedoms - PRIOR - float(self.fit.slopes[1][0].sum()), 1.0)

    @property
    def white_squares(self) -> float:
        """Squares of the white noise, by its variance and degrees of freedom."""
        return self.variance * self.noise_freedoms

    @property
    def variance(self) -> float:
        """Variance of the noise, in that declared."""
        return float(self.fit.squares / max(self.freedoms, 1.0))

    @cached_property
    def score(self) -> float:
        """The restricted log-likelihood with the evidence of the fixed parts, less the prices of all parts."""
        return self._score(range(len(self.fixed)))

    def _score(self, kept: Sequence[int]) -> float:
        """Return the score with some of the fixed parts, in their order, at the same sizes of the random parts."""
        squares, dof = self.bare, self.fit.dof
        found = self.measurement.log_scale - (dof * np.log(squares) + self.fit.log_det) / 2
        gram, right = self._beside
        ends = np.cumsum([0, *(one.rank for one in self.fixed)])
        at = np.concatenate([np.arange(ends[j], ends[j + 1]) for j in kept] or [np.zeros(0, dtype=np.intp)])
        if at.size:
            found += _evidence_in_turn(
                gram[np.ix_(at, at)], right[at], [self.fixed[j].rank for j in kept], squares, dof
            )
        return float(found - self._prices([self.fixed[j] for j in kept]))

    def _prices(self, fixed: Sequence[Fixed]) -> float:
        names = sum(one.sort == EFFECT for one in fixed)
        alone = all(not one.is_reading for one in fixed)
        further = FURTHER * max(names - alone, 0)
        noise = len(self.measurement.noise) * self.measurement.price_of_noise
        return noise + further + sum(one.price for one in fixed) + sum(one.price for one in self.random)

    def without_fixed(self) -> Array:
        """Return what each fixed part adds to the score, at the same sizes of the random parts."""
        every = list(range(len(self.fixed)))
        return np.array([self.score - self._score([k for k in every if k != j]) for j in every])

    def explained(self) -> Array:
        """Return the squares that each fixed part explains beside all others."""
        gram, right = self._beside
        ends = np.cumsum([0, *(one.rank for one in self.fixed)])
        if not len(gram):
            return np.zeros(0)
        inverse = np.linalg.pinv(gram, hermitian=True)
        sizes = inverse @ right
        found = []
        for j in range(len(self.fixed)):
            own = slice(ends[j], ends[j + 1])
            found.append(float(sizes[own] @ np.linalg.solve(inverse[own, own], sizes[own])))
        return np.array(found)

    def plus(
        self, fixed: Sequence[Fixed] = (), random: Sequence[Random] = (), logs: Sequence[float] = (), steps: int = TRIAL
    ) -> State:
        """Return the state with further parts, all sizes estimated anew."""
        every = (*self.random, *random)
        return State.of(self.measurement, (*self.fixed, *fixed), every, (*self.logs, *logs), steps)

    def minus(self, parts: Sequence[Fixed | Random], steps: int = TRIAL) -> State:
        """Return the state without some parts, all sizes estimated anew."""
        gone = {id(one) for one in parts}
        kept = [j for j, one in enumerate(self.random) if id(one) not in gone]
        fixed = [one for one in self.fixed if id(one) not in gone]
        random = [self.random[j] for j in kept]
        return State.of(self.measurement, fixed, random, self.logs[kept], steps)

    def beside(self, one: Fixed) -> State:
        """Return the state without a fixed part, at the same sizes of the random parts."""
        others = [other for other in self.fixed if other is not one]
        return State.of(self.measurement, others, self.random, self.logs, 0)

    def with_fixed(self, number: int, one: Fixed) -> State:
        """Return the state with another fixed part in the place of one."""
        fixed = (*self.fixed[:number], one, *self.fixed[number + 1 :])
        return State.of(self.measurement, fixed, self.random, self.logs, TRIAL)

    def at(self, measurement: Measurement, random: bool = True) -> State:
        """Return the state of the same parts, or of the fixed ones, in the measurement with other weights."""
        keys = (one.key for one in self.fixed)
        fixed = [measurement.reading(j) if i == READINGS else measurement.effect(i, j) for i, j in keys]
        if not random:
            return State.of(measurement, fixed)
        return State.of(measurement, fixed, [remade(measurement, one) for one in self.random], self.logs)

    def settled(self) -> State:
        """Return the state with all sizes estimated until they stay."""
        return State.of(self.measurement, self.fixed, self.random, self.logs) if self.random else self

    # -- what is left ----------------------------------------------------------------------------------------------

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
            x = x - _local_part(m, own, x)
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
            one, dense = m.families[family], None if self._alone else m.dense(family)
            right = one.columns.products(self.residual[:, None])[:, :, 0]
            if self._alone:
                gram = one.gram
                if self._since.shape[1]:
                    along = one.columns.products(self._since)
                    gram = gram - along @ np.swapaxes(along, 1, 2)
            elif dense is None:
                gram = one.columns.grams(self.basis)
            else:
                inside = self.inside(dense).reshape(-1, *right.shape).transpose(1, 2, 0)
                gram = m.whole_grams(family) - inside @ np.swapaxes(inside, 1, 2)
            self.held[family] = gram, right
        return self.held[family]

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

    def of_family(self, family: int) -> tuple[Array, Array]:
        """Return the squares that each alternative of a family explains, and its rank."""
        gram, right = self.left(family)
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

    def of_readings(self) -> tuple[Array, Array, Array]:
        """Return the gain of an error of each reading, its rank, and the squares that it explains."""
        m = self.measurement
        rows = m.places
        there = rows >= 0
        gram = np.eye(rows.shape[1]) * there[:, :, None] - self.basis.products(rows, rows)
        right = np.where(there, self.residual[rows], 0.0)
        weak = np.einsum("iaa->ia", gram).sum(axis=1) < 1e-3
        t, q = quadratic(gram, right, np.ones(rows.shape))
        q = np.where(weak, 0, q)
        t = np.where(q > 0, t, 0.0)
        return gain_of_columns(t, q, self.fit.squares, self.freedoms), q, t


def _evidence_in_turn(gram: Array, right: Array, ranks: Sequence[int], squares: float, dof: float) -> float:
    """Return the sum of the evidence of fixed columns, each beside those before it."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    unit = gram / scale / scale[:, None]
    lower = np.linalg.cholesky(unit + 1e-12 * np.eye(len(unit)))
    found = np.linalg.solve(lower, right / scale) ** 2
    # a column that depends on those before it explains nothing
    found = np.where(np.diag(lower) > 1e-5, found, 0.0)
    total, at = 0.0, 0
    for rank in ranks:
        t = float(found[at : at + rank].sum())
        total += float(gain_of_columns(np.array(t), np.array(rank), squares, dof))
        squares, dof, at = max(squares - t, 1e-300), dof - rank, at + rank
    return total


def _local_part(m: Measurement, own: Array, x: Array) -> Array:
    """Return `E E' x` of columns E of single members."""
    order, begins = m.by_member
    found = np.zeros(x.shape)
    for a, b in pairwise(begins):
        rows = order[a:b]
        found[rows] = own[rows] @ (own[rows].T @ x[rows])
    return found


def within(m: Measurement, columns: Array) -> Array:
    """Return columns (rows, k) without what the local unknowns absorb."""
    basis = replace(m.system.basis, shared=np.zeros((m.system.rows, 0)))
    return columns - basis.combined(basis.coordinates(columns)) if basis.members else columns


def without_local(m: Measurement, key: object, columns: Array) -> Array:
    """Return columns (rows, k) without what local unknowns absorb, computed once for each key but those held out."""
    if key == (HELD_OUT, (0, 0)):
        return within(m, columns)
    if key not in m.held:
        m.held[key] = within(m, columns)
    return m.held[key]


def shared_columns(m: Measurement, fixed: Sequence[Fixed], random: Sequence[Random], unknowns: bool = True) -> Array:
    """Return the shared columns of unknowns, random and fixed parts, free of local unknowns, (rows, p).

    Without the unknowns the others are free of these as well.
    """
    others: list[tuple[object, Array]] = [((one.kind, one.key), one.columns) for one in random if not one.local]
    others += [((one.sort, one.key), one.columns) for one in fixed]
    parts = [m.system.basis.shared if unknowns else np.zeros((m.system.rows, 0))]
    for key, columns in others:
        left = without_local(m, key, columns)
        if not unknowns:
            if ("M", key) not in m.held:
                m.held["M", key] = left - m.system.basis.shared @ (m.system.basis.shared.T @ left)
            left = m.held["M", key]
        parts.append(left)
    return np.concatenate(parts, axis=1) if len(parts) > 1 else parts[0]


def local_columns(m: Measurement, random: Sequence[Random]) -> Array:
    """Return the columns of errors of single members, free of their unknowns, (rows, k)."""
    parts = [without_local(m, (one.kind, one.key), one.columns) for one in random if one.local]
    return np.concatenate([np.zeros((m.system.rows, 0)), *parts], axis=1)


def products_of(
    m: Measurement, fixed: Sequence[Fixed], random: Sequence[Random], with_unknowns: bool = False
) -> Products:
    """Return the products of all columns of a state, those of the unknowns where members have errors, or if asked."""
    c, r = local_columns(m, random), m.system.residual
    with_unknowns |= c.shape[1] > 0
    x = shared_columns(m, fixed, random, with_unknowns)
    unknowns = m.system.basis.shared.shape[1] if with_unknowns else 0
    kinds = [np.full(unknowns, -1)]
    kinds += [np.full(one.columns.shape[1], j) for j, one in enumerate(random) if not one.local]
    kinds += [np.full(one.rank, -1) for one in fixed]
    of_local = [np.full(one.columns.shape[1], j) for j, one in enumerate(random) if one.local]
    empty = np.zeros(0, dtype=np.intp)
    k, p = c.shape[1], x.shape[1]
    members = m.system.basis.members if k else 0
    own, mixed, along = np.zeros((members, k, k)), np.zeros((members, k, p)), np.zeros((members, k))
    if members:
        order, begins = m.by_member
        for member, (a, b) in enumerate(pairwise(begins)):
            rows = order[a:b]
            left = c[rows].T
            own[member], mixed[member], along[member] = left @ c[rows], left @ x[rows], left @ r[rows]
    return Products(
        x.T @ x,
        x.T @ r,
        m.squares,
        m.dof,
        unknowns,
        np.concatenate([*kinds, empty]).astype(np.intp),
        np.concatenate([*of_local, empty]).astype(np.intp),
        own,
        mixed,
        along,
    )


def remade(m: Measurement, one: Random) -> Random:
    """Return a random part of another linearisation in this one."""
    return scatter(m, one.key[0]) if one.kind == SCATTER else m.correlated(one.key[0], LENGTHS[one.key[1]], one.key[2])


def at_sizes(state: State, logs: Array) -> Fit:
    """Return the fit of a state at other sizes of its random parts."""
    return fit_at(state.fit.products, logs)
