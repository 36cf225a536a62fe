"""Held-out readings: what a model predicts of them, and what the others leave of the candidates.

The log density of held-out readings is the difference of two restricted likelihoods, of all readings and of the others,
at the same sizes of the random parts. The products of the others follow with the weight 0 of the held-out rows.
Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import field, replace
from functools import cached_property
from itertools import pairwise
from math import lgamma
from typing import Any

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index, Mask
from metrocli.diagnosis.evidence.gain import FoldPrediction
from metrocli.diagnosis.evidence.likelihood import Fit, fit_at
from metrocli.diagnosis.evidence.measurement import Measurement
from metrocli.diagnosis.evidence.parts import Fixed
from metrocli.diagnosis.evidence.prices import gain_of_columns
from metrocli.diagnosis.evidence.reweighted import Reweighted, directions_without
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.linear.projection import VISIBLE
from metrocli.diagnosis.linear.quadratics import factored, quadratic, solved
from metrocli.frozen import dataclass

_MOST_HELD = 2_000_000
"""Numbers of the products without a fold that are kept"""
_SHOWN = 1e-9
"""Share of the squares of a column below which those before it say all of it"""
_HARDLY = 1e-4
"""Share of a unit column below which the other readings do not show a direction: no prediction has its uncertainty"""


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
    def mask(self) -> Mask:
        """Which rows are held out, (rows,)."""
        mask = np.zeros(self.measurement.system.rows, dtype=bool)
        mask[self.rows] = True
        return mask

    def shown(self, part: Fixed) -> bool:
        """Return whether other readings than those held out show a part: not the effect of a held-out image."""
        return part.is_reading or bool(part.columns[~self.mask].any())

    def holds(self, part: Fixed) -> bool:
        """Return whether a part is the error of a held-out reading."""
        return part.is_reading and bool(part.columns[self.rows].any())


@dataclass(frozen=True)
class Others:
    """The readings that are not held out, with the parts of a state at its sizes."""

    fold: Fold
    state: State
    """A state that has all of these parts and more"""
    fixed: tuple[Fixed, ...]
    """The fixed parts that they show, and the errors of held-out readings"""
    whole: Fit
    """Of all readings with these"""
    without: Reweighted
    """The products of the state without the held-out rows"""
    kept: tuple[Fixed, ...]
    """The fixed parts that they show"""
    columns: Index
    """The columns of the products that are kept"""
    fit: Fit
    """Of the readings that are not held out"""
    cache: dict[object, Any] = field(default_factory=dict, compare=False, repr=False)
    """Cache of products with candidates"""

    @classmethod
    def of(cls, fold: Fold, state: State) -> Others:
        """Return them with the fixed parts of a state that they show: what they do not show predicts nothing."""
        without = Reweighted.of(state, fold.rows, np.full(len(fold.rows), -1.0))
        dof = without.products.dof - len(fold.rows) + without.lost
        every, count = replace(without.products, dof=dof), len(state.fixed)
        shown = [j for j, part in enumerate(state.fixed) if fold.shown(part)]
        kept = [j for j in shown if not fold.holds(state.fixed[j])]
        fit = fit_at(every.keeping(kept, count), state.logs)
        if unseen := _unseen_parts(fit, [state.fixed[j].rank for j in kept]):
            gone = {kept[at] for at in unseen}
            shown, kept = ([j for j in some if j not in gone] for some in (shown, kept))
            fit = fit_at(every.keeping(kept, count), state.logs)
        fixed, own = (tuple(state.fixed[j] for j in some) for some in (shown, kept))
        fit = _without_unseen_unknowns(fit)
        return cls(fold, state, fixed, state.fit.keeping(shown, count), without, own, every.columns(kept, count), fit)

    @classmethod
    def of_fold(cls, state: State, number: int) -> Others:
        """Return them for a fold by its number, computed once for a state of few columns."""
        fold, key = Fold(state.measurement, np.flatnonzero(state.measurement.folds == number)), ("others", number)
        others = state.cache.get(key) or cls.of(fold, state)
        if others.without.shared.size + others.fit.lower.size < _MOST_HELD:
            state.cache[key] = others
        # with a cache of its own: what it holds of candidates is not kept
        return replace(others, cache={})

    def with_fixed(self, fixed: Sequence[Fixed]) -> Others:
        """Return them with fixed parts, of which some may not be in the state."""
        new = [part for part in fixed if all(part is not own for own in self.state.fixed)]
        # without the others: of two jumps between the same readings, the later one would not be seen beside the first
        return Others.of(self.fold, self.state.keeping(fixed).plus(new, steps=0)) if new else self.keeping(fixed)

    def keeping(self, fixed: Iterable[Fixed]) -> Others:
        """Return them with some of the fixed parts."""
        ids = {id(part) for part in fixed}
        shown, kept = ([j for j, part in enumerate(some) if id(part) in ids] for some in (self.fixed, self.kept))
        count = len(self.kept)
        return replace(
            self,
            fixed=tuple(self.fixed[j] for j in shown),
            whole=self.whole.keeping(shown, len(self.fixed)),
            kept=tuple(self.kept[j] for j in kept),
            columns=self.columns[self.fit.products.columns(kept, count)],
            fit=self.fit.keeping(kept, count),
        )

    def predicted(self) -> FoldPrediction:
        """Return the log density of the held-out rows (multivariate t) and their errors of prediction."""
        m, rows = self.fold.measurement, self.fold.rows
        basis, ranks = m.system.basis, sum(part.rank for part in self.fixed)
        # ln p(held | others) = ln p(all) - ln p(others), at the same sizes of the random parts
        others = _log_marginal(self.fit, self._ranks) - self.without.log_det / 2
        spared = np.zeros(m.system.rows, dtype=bool)
        for part in self.fixed:
            if part.is_reading:
                # a reading that is named wrong would be predicted badly by any model
                spared |= part.columns.any(axis=1)
        if self.fold.whole:
            # predicted but for the local unknowns, and the errors of single members, which only these rows show
            shared, sizes, at = self.without.shared, self.fit.sizes, self.fit.fixed
            # the columns before the fixed ones are all kept: they are not copied
            first, fixed = shared[:, :at], shared[:, self.columns[at:]]
            errors = shared[:, -1] - first @ sizes[:at] - fixed @ sizes[at:]
            shares = 1 - (basis.local[rows] ** 2).sum(axis=1)
            # three images hardly determine the lens with which a fourth is predicted
            variances = 1 + _variances(self.fit, first, fixed, self.cache)
        else:
            errors, shares, variances = self.without.predicted(self.fit, self.columns)
        scale, kept = np.where(m.system.in_reported_unit, m.system.scale, np.nan)[rows], ~spared[rows]
        score = _log_marginal(self.whole, ranks) - others
        return FoldPrediction(score, errors[kept], scale[kept], shares[kept], variances[kept])

    @property
    def _ranks(self) -> int:
        return sum(part.rank for part in self.kept)

    def nets(self, number: int) -> Array:
        """Return the net gain of each alternative of a family; -inf where it explains nothing."""
        m = self.fold.measurement
        t, q = quadratic(*self.left(number), m.families[number].raw)
        gain = gain_of_columns(t, q, self.fit.squares, self.fit.dof - self._ranks)
        return np.where(gain > 0, gain - m.prices.of_ranks(number, q), -np.inf)

    def left(self, number: int) -> tuple[Array, Array]:
        """Return the Gram matrices of a family's alternatives, and their products with the residual."""
        if number in self.cache:
            gram, along = self.cache[number]
        else:
            gram, along = self._beside_members(number)
            if along.size < _MOST_HELD:
                self.cache[number] = gram, along
        count, q, _ = along.shape
        flat = along[:, :, self.columns].reshape(count * q, len(self.columns))
        turned = solved(self.fit.lower, flat.T).T.reshape(count, q, len(self.columns))
        gram = gram - turned @ np.swapaxes(turned, 1, 2)
        # what only the held-out rows show is zero, not the rounding of a difference
        shown = np.einsum("kqq->kq", gram) > (VISIBLE * self.state.measurement.families[number].raw) ** 2
        return gram * shown[:, :, None] * shown[:, None, :], (along[:, :, -1] - turned @ self.fit.sought) * shown

    def _beside_members(self, number: int) -> tuple[Array, Array]:
        """Return the Gram matrices of a family, and products with all shared columns and the residual, (..., p + 1).

        They are without what the single members have. Those without whole members are those of all rows, each computed
        once, less those of the held-out rows.
        """
        state, rows, columns = self.state, self.fold.rows, self.fold.measurement.families[number].columns
        every, key, cache = _beside_members(state), ("beside members", number, columns.count), state.cache
        if key not in cache:
            cache[key] = columns.grams(state.own), columns.products(every)
        gram, along = cache[key]
        if self.fold.whole:
            if "rows" not in self.cache:
                self.cache["rows"] = state.own.at(rows), every[rows]
            basis, some = self.cache["rows"]
            own = columns.of_rows(self.fold.mask)
            return gram - own.grams(basis), along - own.products(some)
        if "directions" not in self.cache:
            directions, turn = directions_without(state.own, rows)
            self.cache["directions"] = directions, turn.T @ every[rows]
        directions, held_out = self.cache["directions"]
        shown = columns.products(directions)
        return gram - shown @ np.swapaxes(shown, 1, 2), along - shown @ held_out


def _is_seen(fit: Fit) -> Mask:
    """Return whether the readings of a fit tell each shared column from those before it."""
    return np.asarray(np.diag(fit.lower) ** 2 > _SHOWN * np.diag(fit.products.gram))


def _variances(fit: Fit, first: Array, fixed: Array, cache: dict[object, Any]) -> Array:
    """Return the variances of rows x (n, p) of the shared columns with Gram matrix M, without what its readings miss.

    They are `z'M z` with `z = (M + d)^-1 x`. That of a direction of the eigenvalue l is 1/l where l is much larger than
    d. It is nothing where l is rounding, as for the errors of a held-out image whose deviation the job states. The rows
    come as the columns before the fixed ones, which are the same for all fits of a fold, and the fixed ones.
    """
    from scipy.linalg.lapack import dtrtrs

    # those of unknowns have the length 1 over all readings, and one that these do not show is nearly 0 here
    least = _HARDLY * np.maximum(np.diag(fit.products.gram), 1.0)
    if (np.diag(fit.lower) ** 2 > least).all():
        at = fit.fixed
        if "first" not in cache:
            begun = solved(fit.lower[:at, :at], first.T)
            cache["first"] = begun, np.einsum("pn,pn->n", begun, begun)
        begun, squares = cache["first"]
        rest = solved(fit.lower[at:, at:], fixed.T - fit.lower[at:, :at] @ begun)
        return np.asarray(squares + np.einsum("pn,pn->n", rest, rest))
    lower = factored(fit.lower @ fit.lower.T, least)
    z = np.asarray(dtrtrs(lower.T, solved(lower, np.hstack([first, fixed]).T))[0])
    return np.asarray(((fit.lower.T @ z) ** 2).sum(axis=0))


def _unseen_parts(fit: Fit, ranks: Sequence[int]) -> list[int]:
    """Return the numbers of the fixed parts of which a column is like those before it, which the readings show."""
    seen, ends = _is_seen(fit)[fit.fixed :], np.cumsum([0, *ranks]).tolist()
    return [at for at, (a, b) in enumerate(pairwise(ends)) if not seen[a:b].all()]


def _without_unseen_unknowns(fit: Fit) -> Fit:
    """Return a fit whose density is without directions of the shared unknowns that its readings do not show.

    They take no degree of freedom, and their determinant is that of rounding.
    """
    first = fit.products.unknowns
    lost = ~_is_seen(fit)[:first]
    if not lost.any():
        return fit
    products = replace(fit.products, dof=fit.products.dof + int(lost.sum()))
    log_det = fit.log_det - 2 * float(np.log(np.diag(fit.lower)[:first][lost]).sum())
    return replace(fit, products=products, log_det=log_det)


def _log_marginal(fit: Fit, ranks: float) -> float:
    """Return ln of the density of the readings of a fit, unknowns and fixed columns integrated with a flat prior."""
    # flat priors of the columns take one degree of freedom each out of the density
    dof = fit.dof - ranks
    at = fit.fixed
    log_det = fit.log_det + 2 * float(np.log(np.diag(fit.lower)[at:]).sum())
    return lgamma(dof / 2) - dof / 2 * float(np.log(np.pi * fit.squares)) - log_det / 2


def _beside_members(state: State) -> Array:
    """Return all shared columns of a state, and last the residual, free of what single members have, (rows, p + 1)."""
    if "beside members" not in state.cache:
        every, own = state.shared_columns(), state.own
        free = state.members_are_free
        state.cache["beside members"] = every if free else every - own.combined(own.coordinates(every))
    return np.asarray(state.cache["beside members"])
