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
            one, dense, at = m.families[family], *m.side_by_side
            shape = one.columns.count, one.columns.parameters
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
        return self.held[family]

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
        ends = np.cumsum([0, *(each.rank for each in self.fixed)])
        j = next(j for j, each in enumerate(self.fixed) if each is one)
        at, lower = self.fit.fixed, self.fit.lower[self.fit.fixed :, self.fit.fixed :]
        inverse = np.linalg.inv(lower)
        own = slice(ends[j], ends[j + 1])
        covariance = inverse[:, own].T @ inverse[:, own]
        w = self.basis.shared[:, self.basis.shared.shape[1] - (len(self.fit.lower) - at) :] @ inverse[:, own]
        return np.asarray(np.linalg.solve(np.linalg.cholesky(covariance), w.T).T)

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
    if key == _NEVER_HELD:
        return within(m, columns)
    if key not in m.held:
        m.held[key] = within(m, columns)
    return m.held[key]


_NEVER_HELD = (HELD_OUT, (0, 0))
"""Key of the columns of held-out rows, of which each fold has its own"""


def _shared_parts(
    m: Measurement, fixed: Sequence[Fixed], random: Sequence[Random], unknowns: bool
) -> list[tuple[object, Array]]:
    """Return the shared columns of unknowns, random and fixed parts with their keys, free of local unknowns.

    Without the unknowns the others are free of these as well.
    """
    others: list[tuple[object, Array]] = [((one.kind, one.key), one.columns) for one in random if not one.local]
    others += [((one.sort, one.key), one.columns) for one in fixed]
    if unknowns:
        return [("unknowns", m.system.basis.shared), *((key, without_local(m, key, one)) for key, one in others)]
    return [(("M", key), _without_unknowns(m, key, one)) for key, one in others]


def _without_unknowns(m: Measurement, key: object, columns: Array) -> Array:
    """Return columns (rows, k) without what the unknowns absorb, computed once for each key but those held out."""
    if key == _NEVER_HELD or ("M", key) not in m.held:
        left, shared = without_local(m, key, columns), m.system.basis.shared
        left = left - shared @ (shared.T @ left)
        if key == _NEVER_HELD:
            return left
        m.held["M", key] = left
    return m.held["M", key]


def shared_columns(m: Measurement, fixed: Sequence[Fixed], random: Sequence[Random], unknowns: bool = True) -> Array:
    """Return the shared columns of unknowns, random and fixed parts side by side, (rows, p)."""
    parts = [one for _, one in _shared_parts(m, fixed, random, unknowns)]
    return np.concatenate([np.zeros((m.system.rows, 0)), *parts], axis=1) if len(parts) != 1 else parts[0]


def _local_parts(m: Measurement, random: Sequence[Random]) -> list[tuple[object, Array]]:
    """Return the columns of errors of single members with their keys, free of the unknowns of these."""
    keys = [((one.kind, one.key), one.columns) for one in random if one.local]
    return [(key, without_local(m, key, columns)) for key, columns in keys]


def local_columns(m: Measurement, random: Sequence[Random]) -> Array:
    """Return the columns of errors of single members, free of their unknowns, (rows, k)."""
    return np.concatenate([np.zeros((m.system.rows, 0)), *(one for _, one in _local_parts(m, random))], axis=1)


def products_of(
    m: Measurement, fixed: Sequence[Fixed], random: Sequence[Random], with_unknowns: bool = False
) -> Products:
    """Return the products of all columns of a state, those of the unknowns where members have errors, or if asked.

    Products of two parts are computed once.
    """
    local = _local_parts(m, random)
    with_unknowns |= bool(local)
    residual = "residual", m.system.residual[:, None]
    shared = [*_shared_parts(m, fixed, random, with_unknowns), residual]
    sizes = [one.shape[1] for _, one in shared]
    ends = np.cumsum([0, *sizes])
    gram = np.empty((ends[-1], ends[-1]))
    for i, first in enumerate(shared):
        own = slice(ends[i], ends[i + 1])
        for j in range(i, len(shared)):
            block = _product(m, first, shared[j])
            gram[own, ends[j] : ends[j + 1]] = block
            gram[ends[j] : ends[j + 1], own] = block.T
    unknowns = sizes[0] if with_unknowns else 0
    kinds = [np.full(unknowns, -1)]
    kinds += [np.full(one.columns.shape[1], j) for j, one in enumerate(random) if not one.local]
    kinds += [np.full(one.rank, -1) for one in fixed]
    of_local = [np.full(one.columns.shape[1], j) for j, one in enumerate(random) if one.local]
    empty, members = np.zeros(0, dtype=np.intp), m.system.basis.members if local else 0
    own = np.zeros((members, 0, 0))
    mixed = np.zeros((members, 0, ends[-1]))
    if local:
        own = np.concatenate(
            [np.concatenate([_of_members(m, one, other) for other in local], axis=2) for one in local], axis=1
        )
        mixed = np.concatenate(
            [np.concatenate([_of_members(m, one, other) for other in shared], axis=2) for one in local], axis=1
        )
    return Products(
        gram[:-1, :-1],
        gram[:-1, -1],
        m.squares,
        m.dof,
        unknowns,
        np.concatenate([*kinds, empty]).astype(np.intp),
        np.concatenate([*of_local, empty]).astype(np.intp),
        own,
        mixed[:, :, :-1],
        mixed[:, :, -1],
    )


def _product(m: Measurement, one: tuple[object, Array], other: tuple[object, Array]) -> Array:
    """Return the product of the columns of two parts, computed once for those of known keys."""
    key = "product", one[0], other[0]
    if _NEVER_HELD in (one[0], other[0]):
        return one[1].T @ other[1]
    if key not in m.held:
        m.held[key] = one[1].T @ other[1]
    return m.held[key]


def _of_members(m: Measurement, one: tuple[object, Array], other: tuple[object, Array]) -> Array:
    """Return the products of the columns of two parts in each local member, (members, k, p)."""
    key = "of members", one[0], other[0]
    if key in m.held:
        return m.held[key]
    order, begins = m.by_member
    found = np.stack([one[1][order[a:b]].T @ other[1][order[a:b]] for a, b in pairwise(begins)])
    if _NEVER_HELD not in (one[0], other[0]):
        m.held[key] = found
    return found


def remade(m: Measurement, one: Random) -> Random:
    """Return a random part of another linearisation in this one."""
    return scatter(m, one.key[0]) if one.kind == SCATTER else m.correlated(one.key[0], LENGTHS[one.key[1]], one.key[2])


def at_sizes(state: State, logs: Array) -> Fit:
    """Return the fit of a state at other sizes of its random parts."""
    return fit_at(state.fit.products, logs)
