"""Held-out readings: what a model predicts of them, and what the others leave of the candidates.

The log density of held-out readings is the difference of two restricted likelihoods, of all readings and of the others,
at the same sizes of the random parts. Without whole local members (images, points) the products of the others are those
of all less their own. Single readings of members are left out by unknowns of their own.
Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cached_property
from math import lgamma

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index, Mask
from metrocli.diagnosis.evidence.gain import Held
from metrocli.diagnosis.evidence.likelihood import Fit, Products, fit_at
from metrocli.diagnosis.evidence.measurement import Measurement
from metrocli.diagnosis.evidence.parts import HELD_OUT, Fixed, Random
from metrocli.diagnosis.evidence.prices import gain_of_columns
from metrocli.diagnosis.evidence.products import local_columns, products_of, shared_columns
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.linear.basis import Basis
from metrocli.diagnosis.linear.projection import VISIBLE
from metrocli.diagnosis.linear.quadratics import quadratic
from metrocli.frozen import dataclass


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
        flat = along[:, :, :-1].reshape(count * q, p - 1)  # no shared unknowns where all tracers are known
        half = solve_triangular(self.fit.lower, flat.T, lower=True, check_finite=False)
        turned = half.T.reshape(count, q, p - 1)
        gram = gram - turned @ np.swapaxes(turned, 1, 2)
        # what only the held-out rows show is zero, not the rounding of a difference
        seen = np.einsum("kqq->kq", gram) > (VISIBLE * raw) ** 2
        return gram * seen[:, :, None] * seen[:, None, :], (along[:, :, -1] - turned @ self.fit.sought) * seen
