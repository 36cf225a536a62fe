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
from typing import Any, cast

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index, Mask
from metrocli.diagnosis.evidence.gain import Held
from metrocli.diagnosis.evidence.likelihood import Fit, Products, fit_at
from metrocli.diagnosis.evidence.measurement import Measurement
from metrocli.diagnosis.evidence.parts import HELD_OUT, Fixed, Random
from metrocli.diagnosis.evidence.prices import gain_of_columns
from metrocli.diagnosis.evidence.products import NEVER_HELD, local_columns, products_of, shared_columns, shared_parts
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.linear.basis import Basis
from metrocli.diagnosis.linear.columns import CandidateColumns
from metrocli.diagnosis.linear.projection import VISIBLE
from metrocli.diagnosis.linear.quadratics import quadratic
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Model:
    """Fixed and random parts with sizes of the random ones, without an estimate of anything."""

    fixed: tuple[Fixed, ...]
    random: tuple[Random, ...]
    logs: Array

    def fitted(self, m: Measurement) -> Fit:
        """Return the fit of the model to all rows, at its sizes, computed once."""
        parts = (*self.fixed, *self.random)
        key = ("fit", *map(id, parts), self.logs.tobytes())
        model, fit = m.fits.get(key, (None, None))
        # in another process other objects can have these identities
        if model is None or any(a is not b for a, b in zip((*model.fixed, *model.random), parts, strict=True)):
            fit = fit_at(products_of(m, self.fixed, self.random), self.logs)
            m.fits[key] = self, fit
        return cast("Fit", fit)

    def with_fixed(self, fixed: Iterable[Fixed]) -> Model:
        """Return the model with other fixed parts."""
        return replace(self, fixed=tuple(fixed))


def folds_of(m: Measurement) -> Index:
    """Return the number of the fold of each row, (rows,): -1 for priors but those of a random effect of a member."""
    rows = np.full(m.system.rows, -1, dtype=np.intp)
    for group in m.job.model.readings:
        # counted from 1, so that 0 stays for the rows of priors
        fold = m.system.spread(group, m.job.folds[group.name].astype(float) + 1)
        rows = np.where(fold > 0, fold.astype(np.intp) - 1, rows)
    member = m.system.basis.member
    own = np.full(m.system.basis.members + 1, -1, dtype=np.intp)  # the last is that of rows without a member
    read = (rows >= 0) & (member >= 0)
    own[member[read]] = rows[read]
    # a member whose readings lie in several folds belongs to none of them, since
    # its last fold has overwritten the others
    own[member[read][own[member[read]] != rows[read]]] = -1
    random = {f"prior of {added.block}" for added in m.job.model.added if added.std}
    for group in (group for group in m.job.model.groups if group.name in random):
        at = m.system.rows_of(group)
        rows[at] = own[member[at]]
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
        # a column that is 1 in one row fits that row exactly, which is the same as leaving the row out
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
    def _held(self) -> dict[object, Any]:
        """Cache of what the held-out rows show of candidates."""
        return {}

    def candidates(self, number: int) -> CandidateColumns:
        """Return the columns of a family at the held-out rows, which are numbered anew."""
        if number not in self._held:
            self._held[number] = self.measurement.families[number].columns.of_rows(self.mask)
        return cast("CandidateColumns", self._held[number])

    def grams(self, number: int, basis: Basis) -> Array:
        """Return the Gram matrices of a family's alternatives at the held-out rows, without what local columns take."""
        key, here = (number, basis.local.shape[1]), ("basis", basis.local.shape[1])
        if here not in self._held:
            self._held[here] = basis.at(self.rows)
        if key not in self._held:
            self._held[key] = self.candidates(number).grams(self._held[here])
        return np.asarray(self._held[key])

    @cached_property
    def freedoms(self) -> float:
        """Directions of the held-out rows that their own local unknowns leave; all where single readings are out."""
        basis = self.measurement.system.basis
        return float((1 - (basis.local[self.rows] ** 2).sum(axis=1)).sum()) if self.whole else float(len(self.rows))

    def shown(self, fixed: Iterable[Fixed]) -> tuple[Fixed, ...]:
        """Return the fixed parts that other readings than those held out show: not the effect of a held-out image."""
        return tuple(part for part in fixed if part.is_reading or part.columns[~self.mask].any())

    def others(self, fixed: Iterable[Fixed]) -> tuple[Fixed, ...]:
        """Return fixed parts without the errors of readings that are held out, with what takes these out."""
        m = self.measurement
        kept = (part for part in self.shown(fixed) if not (part.is_reading and self.mask[m.places[part.number]].any()))
        return (*kept, *self.taken_out)

    def products(self, model: Model) -> Products:
        """Return the products of the columns of a model without the held-out rows."""
        m, fixed = self.measurement, self.others(model.fixed)
        every = products_of(m, fixed, model.random, with_unknowns=True)
        if not self.whole:
            return every
        x = shared_columns(m, fixed, model.random, rows=self.rows)
        r = m.system.residual[self.rows]
        kept = np.ones(len(every.own), dtype=bool)
        if len(kept):
            # held-out members take the products of their own random columns with them
            kept[np.unique(m.system.basis.member[self.rows])] = False
        return replace(
            every,
            gram=every.gram - x.T @ x,
            right=every.right - x.T @ r,
            squares=every.squares - float(r @ r),
            dof=every.dof - self.freedoms,
            own=every.own[kept],
            mixed=every.mixed[kept],
        )

    def predicted(self, model: Model) -> Held:
        """Return the log density of the held-out rows (multivariate t) and their errors of prediction.

        What the other readings do not show predicts nothing, so it is not in the model.
        """
        m = self.measurement
        model = model.with_fixed(self.shown(model.fixed))
        everything = model.fitted(m)
        fit = fit_at(self.products(model), model.logs)
        ranks = sum(part.rank for part in model.fixed)
        fewer = sum(part.rank for part in self.others(model.fixed))
        # ln p(held | others) = ln p(all) - ln p(others), at the same sizes of the random parts
        score = _log_marginal(everything, ranks) - _log_marginal(fit, fewer)
        spared = np.zeros(m.system.rows, dtype=bool)
        for one in model.fixed:
            if one.is_reading:
                # a reading that is named wrong would be predicted badly by any model
                spared[m.places[one.number][m.places[one.number] >= 0]] = True
        kept, basis = ~spared[self.rows], m.system.basis
        if self.whole:
            x = shared_columns(m, self.others(model.fixed), model.random, rows=self.rows)
            errors = m.system.residual[self.rows] - x @ fit.sizes
            shares, variances = 1 - (basis.local[self.rows] ** 2).sum(axis=1), np.ones(len(self.rows))
        else:
            count = len(self.rows)
            # the last unknowns are those of the held-out rows: each is what its reading is off its prediction
            errors, shares = fit.sizes[-count:], np.ones(count)
            variances = (np.linalg.inv(fit.lower[-count:, -count:]) ** 2).sum(axis=0)
        scale = np.where(m.system.alike, m.system.scale, np.nan)[self.rows]
        return Held(score, errors[kept], scale[kept], shares[kept], variances[kept])


def _log_marginal(fit: Fit, ranks: float) -> float:
    """Return ln of the density of the readings of a fit, unknowns and fixed columns integrated with a flat prior."""
    # flat priors of the columns take one degree of freedom each out of the density
    dof = fit.dof - ranks
    at = fit.fixed
    log_det = fit.log_det + 2 * float(np.log(np.diag(fit.lower)[at:]).sum())
    return lgamma(dof / 2) - dof / 2 * float(np.log(np.pi * fit.squares)) - log_det / 2


@dataclass(frozen=True)
class Train:
    """What a model without held-out rows leaves of the candidates."""

    fold: Fold
    state: State
    basis: Basis
    """Of all rows: local unknowns, and the random parts of single members"""
    parts: tuple[tuple[object, Array], ...]
    """Shared columns of all rows with their keys, and last the residual, free of these"""
    fit: Fit
    freedoms: float

    @classmethod
    def of(cls, fold: Fold, model: Model, state: State) -> Train:
        """Return it for a model whose random parts have the sizes of a state."""
        m = fold.measurement
        fit = fit_at(fold.products(model), model.logs)
        basis = state.own
        fixed = fold.others(model.fixed)
        parts = [*shared_parts(m, fixed, model.random), ("residual", m.system.residual[:, None])]
        if local_columns(m, model.random).shape[1]:
            parts = [(key, _free(state, basis, key, columns)) for key, columns in parts]
        return cls(fold, state, basis, tuple(parts), fit, fit.dof - sum(part.rank for part in fixed))

    def nets(self, number: int) -> Array:
        """Return the net gain of each alternative of a family; -inf where it explains nothing."""
        m = self.fold.measurement
        t, q = quadratic(*self.left(number), m.families[number].raw)
        gain = gain_of_columns(t, q, self.fit.squares, self.freedoms)
        return np.where(gain > 0, gain - m.prices.of_ranks(number, q), -np.inf)

    def left(self, number: int) -> tuple[Array, Array]:
        """Return the Gram matrices of a family's alternatives, and their products with the residual.

        Products without whole members are those of all rows, each computed once, less those of the held-out rows.
        """
        from scipy.linalg import solve_triangular

        m, rows = self.fold.measurement, self.fold.rows
        columns, raw = m.families[number].columns, m.families[number].raw
        key, held = ("gram", number, columns.count), self.state.held
        if key not in held:
            held[key] = columns.grams(self.basis)
        gram, along = held[key], self._along(number)
        if self.fold.whole:
            own = self.fold.candidates(number)
            both = np.concatenate([one[rows] for _, one in self.parts], axis=1)
            gram, along = gram - self.fold.grams(number, self.basis), along - own.products(both)
        count, q, p = along.shape
        flat = along[:, :, :-1].reshape(count * q, p - 1)  # no shared unknowns where all tracers are known
        half = solve_triangular(self.fit.lower, flat.T, lower=True, check_finite=False)
        turned = half.T.reshape(count, q, p - 1)
        gram = gram - turned @ np.swapaxes(turned, 1, 2)
        # what only the held-out rows show is zero, not the rounding of a difference
        seen = np.einsum("kqq->kq", gram) > (VISIBLE * raw) ** 2
        return gram * seen[:, :, None] * seen[:, None, :], (along[:, :, -1] - turned @ self.fit.sought) * seen

    def _along(self, number: int) -> Array:
        """Return the products of a family with the shared columns of all rows, (alternatives, parameters, p + 1)."""
        columns, held = self.fold.measurement.families[number].columns, self.state.held
        new = [(key, one) for key, one in self.parts if key == NEVER_HELD or ("along", number, key) not in held]
        found = dict[object, Array]()
        if new:
            ends = np.cumsum([one.shape[1] for _, one in new])[:-1]
            every = columns.products(np.concatenate([one for _, one in new], axis=1))
            for (key, _), own in zip(new, np.split(every, ends, axis=2), strict=True):
                if key == NEVER_HELD:
                    found[key] = own
                else:
                    held["along", number, key] = own
        each = [found[key] if key in found else held["along", number, key] for key, _ in self.parts]
        return np.concatenate(each, axis=2)


def _free(state: State, basis: Basis, key: object, columns: Array) -> Array:
    """Return columns without what the random parts of single members take, computed once for a state."""
    if key == NEVER_HELD:
        return np.asarray(columns - basis.combined(basis.coordinates(columns)))
    if ("free", key) not in state.held:
        state.held["free", key] = columns - basis.combined(basis.coordinates(columns))
    return np.asarray(state.held["free", key])
