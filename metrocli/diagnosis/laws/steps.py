"""The steps of the search for laws: terms enter one by one while each adds evidence.

Method: docs/algorithms/laws.md.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index
from metrocli.diagnosis.laws.library import Library, Term, Where
from metrocli.diagnosis.laws.terms import STEPS
from metrocli.diagnosis.linear.basis import grams_of
from metrocli.diagnosis.linear.candidates import Alternative, Family
from metrocli.diagnosis.linear.columns import Columns, Remembered
from metrocli.diagnosis.linear.counted_tests import score_tests_of
from metrocli.diagnosis.linear.distributions import log_tail
from metrocli.diagnosis.linear.fitted_columns import FittedColumns, nothing_fitted
from metrocli.diagnosis.linear.quadratics import quadratic
from metrocli.diagnosis.linear.score_tests import ScoreTests
from metrocli.diagnosis.selection.selection_state import Selection
from metrocli.effects.effect import Effect, Parameter
from metrocli.frozen import dataclass

MOST_TERMS = 3
LEVEL = 0.01
"""Level at which a term enters where structure is left, counted over all that were tried"""
_SEED = 17
_LEAST_DOF = 5
_NEAR, _MOST_REFINED = 6.0, 6
"""Terms are compared with refined scans if their levels (ln) in the scan are this near to the best, at most so many"""
_FINE, _ROUNDS = 25, 3
"""Values tried in each round between the neighbours of the best scanned value"""


@dataclass(frozen=True)
class Step:
    """A term that entered, with its visible columns where it was found."""

    family: int
    term: Term
    columns: Array
    log_level: float


def tests_of_terms(selection: Selection, library: Library) -> tuple[ScoreTests, FittedColumns]:
    """Return the tests of the terms, and the fit of what was named, whose columns are the first family."""
    system = selection.test_set.system
    unknown = {id(one) for one in selection.unknown}
    named = [one.columns for one in selection.chosen if id(one) not in unknown]
    columns = np.concatenate([*named, np.zeros((system.rows, 0))], axis=1)
    effect = Effect("named", "", (Parameter("size"),))
    single = Columns.of(columns[:, None])
    raw = np.ones((1, columns.shape[1]))
    kept = Family("named", (Alternative(effect, ()),), single, raw, single.grams(system.basis))
    tests = score_tests_of(system, library.families, np.random.default_rng(_SEED))
    tests = replace(
        tests,
        families=(kept, *tests.families),
        tests=(1.0, *tests.tests),
        budget=selection.test_set.budget,
    )
    return tests, start_of(tests, nothing_fitted(system))


def plain_tests(selection: Selection, library: Library) -> tuple[FittedColumns, ScoreTests]:
    """Return the fit of what was named, and tests of the terms without the exact count of them."""
    fitted = selection.fitted(without=selection.unknown).alone()
    return fitted, replace(selection.test_set, families=library.families, remembered=Remembered())


def start_of(tests: ScoreTests, fitted: FittedColumns) -> FittedColumns:
    columns = tests.visible(0, 0)
    return fitted.with_columns(columns) if columns.shape[1] else fitted


@dataclass(frozen=True)
class Search:
    """Where terms are sought: their tests, what is fitted already, and which rows are held out."""

    tests: ScoreTests
    start: FittedColumns
    library: Library
    out: Index | None = None

    def visible(self, term: Term) -> Array:
        """Return the visible columns of a term in the rows that are not held out, (rows, factors)."""
        columns = self.library.columns(term)
        if self.out is not None:
            columns[self.out] = 0.0
        return self.tests.system.seen(columns)


def forward(search: Search, level: float = LEVEL, most: int = MOST_TERMS) -> list[Step]:
    """Return the terms that enter: the most significant first, then those on the same quantity at the same place.

    A scanned value is refined before the next term is sought, so that no term corrects the scan of another. The search
    ends with what it has found where its time is spent.
    """
    tests, fitted, steps = search.tests, search.start, list[Step]()
    while len(steps) < most and fitted.dof > _LEAST_DOF and not tests.budget.spent():
        found = _best_at_each_spot(search, fitted, steps[0].term.place if steps else None)
        if not found or found[0][0] > np.log(level):
            break
        near = [one for one in found if one[0] < min(found[0][0] + _NEAR, float(np.log(level)))][:_MOST_REFINED]
        refined = [refined_step(search, fitted, *one) for one in near]
        squares = [fitted.with_columns(step.columns).squares for step in refined]
        levels = [_level(tests, fitted, step, left) for step, left in zip(refined, squares, strict=True)]
        best = refined[int(np.argmin(levels))]
        steps.append(best)
        fitted = fitted.with_columns(best.columns)
    return steps


def _best_at_each_spot(
    search: Search, fitted: FittedColumns, place: tuple[str, Where] | None
) -> list[tuple[float, int, Term]]:
    """Return level, family and term of the best term of each form on each quantity at each place, the best first."""
    found: dict[tuple[int, str, Where, str], tuple[float, int, Term]] = {}
    for number, terms in enumerate(search.library.terms, 1):
        chosen = [i for i, term in enumerate(terms) if place is None or term.place == place]
        if not chosen:
            continue
        score = search.tests.score(number, fitted, None if place is None else chosen)
        for at in np.argsort(score.log_p, kind="stable").tolist():
            term = terms[chosen[at]]
            spot = number, *term.place, term.spot.component
            if spot not in found:
                found[spot] = search.tests.overall(search.tests.level(number, float(score.log_p[at]))), number, term
    return sorted(found.values(), key=lambda one: one[0])


def refined_step(search: Search, fitted: FittedColumns, level: float, family: int, term: Term) -> Step:
    """Return a term with its scanned value refined; its level stays that of the scan, which counts what was tried."""
    refined = _refined(search, fitted, family, term)
    return Step(family, refined, search.visible(refined), level)


def _level(tests: ScoreTests, fitted: FittedColumns, step: Step, squares: float) -> float:
    """Return ln of the level of a refined term, by which terms on different quantities are compared."""
    q = float(step.columns.shape[1])
    share = np.array(np.clip(1 - squares / max(fitted.squares, 1e-300), 0.0, 1.0))
    return tests.overall(tests.level(step.family, float(log_tail(share, q, max(fitted.dof - q, 1.0)))))


def _refined(search: Search, fitted: FittedColumns, family: int, term: Term) -> Term:
    """Return a term with its scanned value refined between the neighbours of the best one in the scan."""
    if term.form.scanned is None or term.form.kind == STEPS:
        return term
    alike = (
        one.form.scanned
        for one in search.library.terms[family - 1]
        if one.spot == term.spot and one.form.variables == term.form.variables
    )
    values = np.array(sorted(value for value in alike if value is not None))
    here = int(np.argmin(np.abs(values - term.form.scanned)))
    low, high = values[max(here - 1, 0)], values[min(here + 1, len(values) - 1)]
    for _ in range(_ROUNDS):
        tried = [term.at(float(value)) for value in 1 / np.linspace(1 / low, 1 / high, _FINE)]
        columns = np.stack([search.visible(one) for one in tried], axis=1)
        n, k, q = columns.shape
        left = fitted.beside(columns.reshape(n, k * q)).reshape(n, k, q)
        right = (left.reshape(n, k * q).T @ fitted.residual).reshape(k, q)
        gain, _ = quadratic(grams_of(left), right, np.maximum(np.linalg.norm(left, axis=0), 1e-300))
        best = int(np.argmax(gain))
        term = tried[best]
        low, high = (float(tried[at].form.scanned or 0.0) for at in (max(best - 1, 0), min(best + 1, _FINE - 1)))
    return term
