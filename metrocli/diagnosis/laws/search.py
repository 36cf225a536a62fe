"""The search for laws: one for each number of terms, with the gain that the same search has in each fold.

Method: docs/algorithms/laws.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index, Mask
from metrocli.diagnosis.adjusted_job import Budget, Ordered
from metrocli.diagnosis.cross_validation import Gain, Held, folds_of, gain_of, held_out_errors, without
from metrocli.diagnosis.laws.library import Library, Term
from metrocli.diagnosis.laws.near import near_effects
from metrocli.diagnosis.laws.steps import LEVEL, Search, Step, forward, plain_tests, start_of, tests_of_terms
from metrocli.diagnosis.laws.terms import columns_of
from metrocli.diagnosis.linear.candidates import Alternative
from metrocli.diagnosis.linear.fitted_columns import FittedColumns, nothing_fitted
from metrocli.diagnosis.linear.projection import System
from metrocli.diagnosis.selection.selection_state import Selection
from metrocli.frozen import dataclass

_ALONE = 0.001
"""Level at which a term enters where no structure was found"""
_MOST_ROWS = 25_000
"""Largest number of components of readings for which laws are sought: the columns of all terms are held at once"""
_FEW = 50
"""Fewest independent tests that any library amounts to"""
_SEEN, _STEPS = 0.5, 400
"""Least change of a reading that is shown beside a law, of that of the most changed; steps of the curve of a law"""


@dataclass(frozen=True)
class LawData:
    """A law beside the readings in which it was found, (n,) each; those of one component of one reading a row.

    A law of one variable that adds to one component is a curve. Readings are then converted into changes of the
    component: divided by their change with it. Those that change less than half as much as the most are left out. Any
    other law stands over what it adds to the readings. Of readings in several units, those that show most of the law
    are here.
    """

    variable: str
    """Empty for a law that is no curve"""
    unit: str
    x: Array
    """The variable, or what the law adds"""
    law: Array
    """What the law adds to the component, or to the readings"""
    residual: Array
    """Residuals of the job extended by the law, plus what it adds (component plus residual)"""
    adds_unit: str
    """Internal unit of the component, or of the readings"""
    curve: tuple[Array, Array] | None
    """The law at equal steps of its variable: variable and law"""


@dataclass(frozen=True)
class Law:
    """A sum of terms on one quantity at one place."""

    terms: tuple[Term, ...]
    sizes: tuple[Array, ...]
    """Coefficient of each factor of each term, in internal units"""
    stds: tuple[Array, ...]
    p_value: float
    """Level of its least significant term beside the others, counted over all that was tried"""
    gain: Gain
    part_of_structure: float
    """Share of the squares that it explains, of those that it and smooth functions explain together"""
    size: float
    """Root mean square of what it explains over the readings on which it acts, in their unit"""
    columns: Array
    """Its visible columns in the linearised system, (rows, factors)"""
    data: LawData | None
    """None for a constant, which has no variable"""
    near: tuple[tuple[Alternative, float], ...] = ()
    """Effects of the catalogue that change the readings nearly as it does, each with the cosine, the nearest first"""
    chosen: bool = False


def laws_in(library: Library, selection: Selection, structured: bool, ordered: Ordered = map) -> tuple[Law, ...]:
    """Return the laws in what the named effects and outliers of a selection leave: one for each number of terms.

    The list is empty if no term is significant, if the measurement is too large or the time of the search is spent. The
    law with the largest held-out log score is chosen. `structured` is whether smooth functions show structure. If they
    do not, a law must be more significant, and its gain shown: it then is structure of its own, such as a wave that no
    smooth function has. A search that is interrupted ends with the terms that it has found.
    """
    if selection.test_set.budget.ended or not fits(selection.test_set.system):
        return ()
    level = LEVEL if structured else _ALONE
    if not library.families or not _worth_counting(selection, library, level):
        return ()
    tests, start = tests_of_terms(selection, library)
    steps = forward(Search(tests, start, library), level)
    if not steps:
        return ()
    gains = _gains(Search(tests, start, library), steps, ordered)
    smooth = _smooth(selection, start)
    found = [_law(library, start, steps[:count], gain, smooth) for count, gain in enumerate(gains, 1)]
    best = max(found, key=lambda one: one.gain.log_score)
    if not structured and not best.gain.shown:
        return ()
    return tuple(
        replace(
            one,
            near=near_effects(selection.test_set, one.columns @ np.concatenate(one.sizes)),
            chosen=one is best and one.gain.log_score > 0,
        )
        for one in found
    )


def fits(system: System) -> bool:
    """Return whether a system is small enough for the columns of all terms."""
    return system.rows <= _MOST_ROWS


def _worth_counting(selection: Selection, library: Library, level: float) -> bool:
    """Return whether a term could be significant if the terms of its kind were few independent ones.

    That spares the simulated noise of the exact count where nothing is near significance.
    """
    fitted, tests = plain_tests(selection, library)
    least = min(float(tests.score(number, fitted).log_p.min()) for number in range(len(tests.families)))
    return bool(least + np.log(_FEW) < np.log(level))


def _gains(search: Search, found: Sequence[Step], ordered: Ordered) -> list[Gain]:
    """Return the held-out gain of the laws of 1, 2, ... terms; each fold has the laws found without it."""
    rows = folds_of(search.library.job, search.tests)
    numbers = sorted({*rows.tolist()} - {-1})
    budget = search.tests.budget
    pairs = [*ordered(_Folds(search, tuple(found), rows, budget.left() / len(numbers)), numbers)]
    budget.ended |= any(ended for _, ended in pairs)
    return [gain_of(one) for one in zip(*(held for held, _ in pairs), strict=True)]


@dataclass(frozen=True)
class _Folds:
    """What is compared in each fold. It travels to other processors, so it has no more than that."""

    search: Search
    found: tuple[Step, ...]
    rows: Index
    """Fold of each row"""
    seconds: float
    """Time for the search without a fold [s of CPU time]"""

    def __call__(self, fold: int) -> tuple[list[tuple[Held, Held]], bool]:
        """Return the predictions of a fold without and with laws of 1, 2, ... terms, and whether time was spent.

        After an interruption it has the laws found with it: their sizes are still estimated without the fold.
        """
        tests, library = self.search.tests, self.search.library
        out = np.flatnonzero(self.rows == fold)
        budget = Budget(self.seconds, tests.budget)
        steps = self.found if tests.budget.interrupted else self._found_without(out, budget)
        before = start_of(tests, nothing_fitted(tests.system))
        base, pairs = held_out_errors(tests, before, out), []
        for count in range(1, len(self.found) + 1):
            columns = [library.system.seen(library.columns(one.term)) for one in steps[:count]]
            after = before.with_columns(np.concatenate(columns, axis=1)) if columns else before
            pairs.append((base, held_out_errors(tests, after, out)))
        return pairs, budget.ended

    def _found_without(self, out: Index, budget: Budget) -> Sequence[Step]:
        trained, start = without(self.search.tests, out)
        trained = replace(trained, budget=budget)
        return forward(Search(trained, start_of(trained, start), self.search.library, out), LEVEL, len(self.found))


def _smooth(selection: Selection, start: FittedColumns) -> FittedColumns:
    """Return the fit of the smooth functions that the selection holds, beside what was named."""
    columns = [one.columns for one in selection.unknown]
    return start.with_columns(np.concatenate(columns, axis=1)) if columns else start


def _law(
    library: Library,
    start: FittedColumns,
    steps: Sequence[Step],
    gain: Gain,
    smooth: FittedColumns,
) -> Law:
    system, terms = library.system, [one.term for one in steps]
    parts = [system.seen(library.columns(term)) for term in terms]
    columns = np.concatenate(parts, axis=1)
    beside = start.beside(columns)
    scale = np.maximum(np.linalg.norm(beside, axis=0), 1e-300)
    inverse = np.linalg.pinv((beside / scale).T @ (beside / scale), rcond=1e-10, hermitian=True)
    sizes = inverse @ ((beside / scale).T @ start.residual) / scale
    stds = np.sqrt(np.diag(inverse)) / scale
    cuts = np.cumsum([part.shape[1] for part in parts])[:-1]
    after = start.with_columns(columns)
    acting = np.concatenate([library.columns(term) for term in terms], axis=1).any(axis=1)
    shown = np.where(acting & system.alike, (start.residual - after.residual) * system.scale, 0.0)
    explained = start.squares - after.squares
    together = start.squares - smooth.with_columns(columns).squares
    return Law(
        tuple(terms),
        tuple(np.split(sizes, cuts)),
        tuple(np.split(stds, cuts)),
        float(np.exp(max(one.log_level for one in steps))),
        gain,
        float(np.clip(explained / max(together, 1e-300), 0.0, 1.0)),
        float(np.sqrt((shown[shown != 0] ** 2).mean())) if shown.any() else 0.0,
        columns,
        _data(library, terms, sizes, after),
    )


def _data(library: Library, terms: Sequence[Term], sizes: Array, after: FittedColumns) -> LawData | None:
    """Return a law over its variable, beside the readings on which it acts."""
    system, spot = library.system, terms[0].spot
    variables = {name for term in terms for name in term.form.variables}
    if not variables:
        return None
    adds = np.concatenate([library.columns(term) for term in terms], axis=1)
    law = (adds @ sizes) * system.scale
    residual = law + after.residual * system.scale
    unit_of_readings, showing = _showing(system, adds @ sizes)
    if len(variables) > 1 or any(term.spot.component != spot.component for term in terms):
        rows = np.flatnonzero(adds.any(axis=1) & showing)
        return LawData("", "", law[rows], law[rows], residual[rows], unit_of_readings, None)
    (name,) = variables
    change = np.where(showing, library.change(spot) * system.scale, 0.0)
    rows = np.flatnonzero((change != 0) & (np.abs(change) >= _SEEN * np.abs(change).max()))
    x = library.values(terms, name)[rows]
    steps = np.linspace(x.min(), x.max(), _STEPS)
    factors = [columns_of([term.form], {name: steps})[:, 0] for term in terms]
    curve = np.concatenate([np.broadcast_to(one, (_STEPS, one.shape[1])) for one in factors], axis=1) @ sizes
    law, residual = law[rows] / change[rows], residual[rows] / change[rows]
    unit, adds_unit = spot.acting.variables_at({})[name].unit, spot.acting.unit_of(spot.component)
    return LawData(name, unit, x, law, residual, adds_unit, (steps, curve))


def _showing(system: System, explained: Array) -> tuple[str, Mask]:
    """Return the unit of the readings that show most of what a law explains (rows,), whitened, and their rows.

    Angles may show nothing of a law of distances.
    """
    of_unit: dict[str, Mask] = {}
    for group in system.model.readings:
        unit = group.observations.unit
        of_unit[unit] = of_unit.get(unit, np.zeros(system.rows, dtype=bool)) | system.rows_of(group)
    return max(of_unit.items(), key=lambda one: float((explained[one[1]] ** 2).sum()))
