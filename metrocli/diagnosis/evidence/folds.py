"""Cross-validation: how much better an effect predicts held-out readings, chosen anew from the others.

The log density of held-out readings is the difference of two restricted likelihoods, of all readings and of the others,
at the same sizes of the random parts. Without whole local members (images, points) the products of the others are those
of all less their own. Single readings of members are left out by unknowns of their own.
Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from math import lgamma

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index, Mask
from metrocli.diagnosis.adjusted_job import Ordered
from metrocli.diagnosis.evidence.identified import IdentifiedEffect
from metrocli.diagnosis.evidence.likelihood import Fit, Products, fit_at
from metrocli.diagnosis.evidence.measurement import Measurement
from metrocli.diagnosis.evidence.parts import HELD_OUT, Fixed, Random
from metrocli.diagnosis.evidence.prices import FURTHER, OF_ALL, gain_of_columns
from metrocli.diagnosis.evidence.state import State, local_columns, products_of, shared_columns
from metrocli.diagnosis.linear.basis import Basis
from metrocli.diagnosis.linear.projection import VISIBLE
from metrocli.diagnosis.linear.quadratics import quadratic
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Gain:
    """Gain of an explanation: how much better held-out readings are predicted with it."""

    before: float
    """Root mean square error of prediction, in the internal unit of the readings"""
    after: float
    median_before: float
    median_after: float
    log_score: float
    log_score_std: float
    folds: tuple[float, ...] = ()
    """Part of each held-out part of the readings in the log score"""

    @property
    def shown(self) -> bool:
        """Whether the gain exceeds twice its standard error."""
        return self.log_score > 2 * self.log_score_std

    @property
    def reduction(self) -> float:
        """Fraction by which the error decreases."""
        return 1 - self.after / self.before if self.before > 0 else 0.0


@dataclass(frozen=True)
class Held:
    """Prediction of one fold."""

    score: float
    errors: Array
    """Errors of prediction of the readings, in the unit in which they are reported"""
    directions: float
    """Number of independent errors that they amount to"""


@dataclass(frozen=True)
class Model:
    """Fixed and random parts with sizes of the random ones, without an estimate of anything."""

    fixed: tuple[Fixed, ...]
    random: tuple[Random, ...]
    logs: Array

    def with_fixed(self, fixed: Iterable[Fixed]) -> Model:
        """Return the model with other fixed parts."""
        return replace(self, fixed=tuple(fixed))


def folds_of(m: Measurement) -> Index:
    """Return the number of the fold of each row, -1 for priors, (rows,)."""
    rows = np.full(m.system.rows, -1, dtype=np.intp)
    for group in m.job.model.readings:
        fold = m.system.spread(group, m.job.folds[group.name].astype(float) + 1)
        rows = np.where(fold > 0, fold.astype(np.intp) - 1, rows)
    return rows


@dataclass(frozen=True)
class Fold:
    """Held-out rows of a measurement."""

    measurement: Measurement
    rows: Index

    @cached_property
    def whole(self) -> bool:
        """Whether the rows are all those of their local members."""
        basis = self.measurement.system.basis
        return basis.members > 0 and basis.holds_whole_members(self.rows)

    @cached_property
    def taken_out(self) -> tuple[Fixed, ...]:
        """An unknown of each held-out row, where they are not all rows of their members; it takes the row out."""
        if self.whole:
            return ()
        unit = np.zeros((self.measurement.system.rows, len(self.rows)))
        unit[self.rows, np.arange(len(self.rows))] = 1.0
        return (Fixed(0, 0, unit, np.eye(0), 0.0, HELD_OUT),)

    @cached_property
    def mask(self) -> Mask:
        """Which rows are held out, (rows,)."""
        mask = np.zeros(self.measurement.system.rows, dtype=bool)
        mask[self.rows] = True
        return mask

    @cached_property
    def freedoms(self) -> float:
        """Directions of the held-out rows that their own local unknowns leave; all where single readings are out."""
        basis = self.measurement.system.basis
        return float((1 - (basis.local[self.rows] ** 2).sum(axis=1)).sum()) if self.whole else float(len(self.rows))

    def others(self, fixed: Iterable[Fixed]) -> tuple[Fixed, ...]:
        """Return fixed parts without the errors of readings that are held out, with what takes these out."""
        m = self.measurement
        kept = (one for one in fixed if not (one.is_reading and self.mask[m.places[one.number]].any()))
        return (*kept, *self.taken_out)

    def products(self, model: Model) -> Products:
        """Return the products of the columns of a model without the held-out rows."""
        m, fixed = self.measurement, self.others(model.fixed)
        every = products_of(m, fixed, model.random, with_unknowns=True)
        if not self.whole:
            return every
        x = shared_columns(m, fixed, model.random)[self.rows]
        r = m.system.residual[self.rows]
        kept = np.ones(len(every.own), dtype=bool)
        if len(kept):
            kept[np.unique(m.system.basis.member[self.rows])] = False
        return replace(
            every,
            gram=every.gram - x.T @ x,
            right=every.right - x.T @ r,
            squares=every.squares - float(r @ r),
            dof=every.dof - self.freedoms,
            own=every.own[kept],
            mixed=every.mixed[kept],
            along=every.along[kept],
        )

    def predicted(self, model: Model, all_of_it: Fit | None = None) -> Held:
        """Return the log density of the held-out rows (multivariate t) and their errors of prediction."""
        m = self.measurement
        everything = all_of_it or fit_at(products_of(m, model.fixed, model.random), model.logs)
        fit = fit_at(self.products(model), model.logs)
        ranks = sum(one.rank for one in model.fixed)
        fewer = sum(one.rank for one in self.others(model.fixed))
        score = _log_marginal(everything, ranks) - _log_marginal(fit, fewer)
        spared = np.zeros(m.system.rows, dtype=bool)
        for one in model.fixed:
            if one.is_reading:
                spared[m.places[one.number][m.places[one.number] >= 0]] = True
        shown = m.system.alike[self.rows] & ~spared[self.rows]
        if self.whole:
            x = shared_columns(m, self.others(model.fixed), model.random)[self.rows]
            errors = m.system.residual[self.rows] - x @ fit.sizes
            shares = 1 - (m.system.basis.local[self.rows] ** 2).sum(axis=1)
        else:
            errors, shares = fit.sizes[-len(self.rows) :], np.ones(len(self.rows))
        return Held(score, (errors * m.system.scale[self.rows])[shown], float(shares[shown].sum()))


def _log_marginal(fit: Fit, ranks: float) -> float:
    """Return ln of the density of the readings of a fit, unknowns and fixed columns integrated with a flat prior."""
    dof = fit.dof - ranks
    at = fit.fixed
    log_det = fit.log_det + 2 * float(np.log(np.diag(fit.lower)[at:]).sum())
    return lgamma(dof / 2) - dof / 2 * float(np.log(np.pi * fit.squares)) - log_det / 2


def gains(state: State, names: Sequence[IdentifiedEffect], ordered: Ordered = map) -> list[Gain]:
    """Return the gain of each identified effect, then of all together; `ordered` computes the folds.

    In each fold an effect is in the model only if the other readings choose it, or a rival of it, beside the other
    effects.
    """
    rows = folds_of(state.measurement)
    numbers = sorted({*rows.tolist()} - {-1})
    found = [*ordered(_Nested(state, tuple(names), rows), numbers)]
    gained = [gain_of(pairs) for pairs in zip(*found, strict=True)]
    # one effect alone is all of them together
    return gained if len(names) > 1 else [*gained, *gained]


@dataclass(frozen=True)
class _Nested:
    """What is compared in each fold."""

    state: State
    names: tuple[IdentifiedEffect, ...]
    rows: Index

    def __call__(self, number: int) -> list[tuple[Held, Held]]:
        """Return the predictions of a fold without and with each effect, and all of them."""
        state = self.state
        m = state.measurement
        fold = Fold(m, np.flatnonzero(self.rows == number))
        model = Model(state.fixed, state.random, state.logs)
        chosen = {name.key: self._chosen(fold, model, name) for name in self.names}
        readings = state.readings

        def with_names(names: Iterable[IdentifiedEffect]) -> Held:
            own = (one for name in names if (one := chosen[name.key]) is not None)
            return fold.predicted(model.with_fixed((*own, *readings)))

        every = with_names(self.names)
        pairs = []
        for name in self.names:
            others = [other for other in self.names if other is not name]
            before = every if chosen[name.key] is None else with_names(others)
            pairs.append((before, every))
        return pairs if len(self.names) < 2 else [*pairs, (with_names(()), every)]

    def _chosen(self, fold: Fold, model: Model, name: IdentifiedEffect) -> Fixed | None:
        """Return the effect, or its rival, that the other readings choose; None if they choose another one, or none."""
        m = self.state.measurement
        others = model.with_fixed(one for one in model.fixed if one.key != name.key)
        spots = {name.alternative.spot, *(rival.alternative.spot for rival in name.rivals)}
        train = Train.of(fold, others, self.state)
        best, at = -np.inf, (0, 0)
        for number, family in enumerate(m.families):
            net = train.nets(number) - (OF_ALL if family.unknown else 0.0)
            if len(net) and net.max() > best:
                best, at = float(net.max()), (number, int(np.argmax(net)))
        if best <= (FURTHER if others.fixed else 0.0) or m.alternative(at).spot not in spots:
            return None
        return next((one for one in model.fixed if one.key == at), None) or m.effect(*at)


@dataclass(frozen=True)
class Train:
    """What a model without held-out rows leaves of the candidates."""

    fold: Fold
    basis: Basis
    """Of all rows: local unknowns, and the random parts of single members"""
    shared: Array
    """Shared columns and the residual, free of these, (rows, p + 1)"""
    fit: Fit
    freedoms: float

    @classmethod
    def of(cls, fold: Fold, model: Model, state: State) -> Train:
        """Return it for a model whose random parts have the sizes of a state."""
        m = fold.measurement
        fit = fit_at(fold.products(model), model.logs)
        basis = replace(state.basis, shared=np.zeros((m.system.rows, 0)))
        fixed = fold.others(model.fixed)
        x = shared_columns(m, fixed, model.random)
        both = np.concatenate([x, m.system.residual[:, None]], axis=1)
        if local_columns(m, model.random).shape[1]:
            both = both - basis.combined(basis.coordinates(both))
        return cls(fold, basis, both, fit, fit.dof - sum(one.rank for one in fixed))

    def nets(self, number: int) -> Array:
        """Return the net gain of each alternative of a family; -inf where it explains nothing."""
        m = self.fold.measurement
        t, q = quadratic(*self.left(number), m.families[number].raw)
        gain = gain_of_columns(t, q, self.fit.squares, self.freedoms)
        return np.where(gain > 0, gain - m.prices.of_ranks(number, q), -np.inf)

    def left(self, number: int) -> tuple[Array, Array]:
        """Return the Gram matrices of a family's alternatives, and their products with the residual."""
        from scipy.linalg import solve_triangular

        m = self.fold.measurement
        columns, raw = m.families[number].columns, m.families[number].raw
        key = "of train", number, self.basis.local.shape[1]
        if key not in m.held:
            m.held[key] = columns.grams(self.basis)
        gram, both = m.held[key], self.shared
        if self.fold.whole:
            gram = gram - columns.at(self.fold.mask).grams(self.basis)
            both = np.where(self.fold.mask[:, None], 0.0, both)
        along = columns.products(both)
        count, q, p = along.shape
        half = solve_triangular(self.fit.lower, along[:, :, :-1].reshape(-1, p - 1).T, lower=True, check_finite=False)
        turned = half.T.reshape(count, q, p - 1)
        gram = gram - turned @ np.swapaxes(turned, 1, 2)
        # what only the held-out rows show is zero, not the rounding of a difference
        seen = np.einsum("kqq->kq", gram) > (VISIBLE * raw) ** 2
        return gram * seen[:, :, None] * seen[:, None, :], (along[:, :, -1] - turned @ self.fit.sought) * seen


def gain_of(pairs: Sequence[tuple[Held, Held]]) -> Gain:
    """Return the gain from the predictions of all folds without and with what is judged."""
    differences = np.array([after.score - before.score for before, after in pairs])
    spread = float(differences.std(ddof=1)) if len(differences) > 1 else float("inf")
    sides = list(zip(*pairs, strict=True))
    rms = [
        float(np.sqrt(sum((h.errors**2).sum() for h in side) / max(sum(h.directions for h in side), 1e-9)))
        for side in sides
    ]
    medians = [float(np.median(np.abs(np.concatenate([held.errors for held in side])))) for side in sides]
    std = spread * float(np.sqrt(len(differences)))
    return Gain(rms[0], rms[1], medians[0], medians[1], float(differences.sum()), std, tuple(differences.tolist()))


def gain_between(before: State, after: State) -> Gain:
    """Return the gain of one state over another, at the sizes that each has."""
    rows = folds_of(after.measurement)
    pairs = []
    for number in sorted({*rows.tolist()} - {-1}):
        held = []
        for one in (before, after):
            fold = Fold(one.measurement, np.flatnonzero(rows == number))
            held.append(fold.predicted(Model(one.fixed, one.random, one.logs), one.fit))
        pairs.append((held[0], held[1]))
    return gain_of(pairs)
