"""The steps of the search for laws: terms enter a state one by one while each adds evidence.

Method: docs/algorithms/laws.md.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from metrocli.adjust.decompositions import grams_of
from metrocli.arrays import Array, Index, Mask
from metrocli.diagnosis.evidence.held_out import Fold, Others
from metrocli.diagnosis.evidence.parts import Fixed
from metrocli.diagnosis.evidence.prices import LITTLE, Prices
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.laws.library import Library, Place, Term, Where
from metrocli.diagnosis.laws.terms import STEPS
from metrocli.diagnosis.linear.counting import LEAST_TESTS
from metrocli.diagnosis.linear.quadratics import quadratic
from metrocli.frozen import dataclass

MOST_TERMS = 3
_LEAST_DOF = 5
NEAR, _MOST_REFINED = 6.0, 6
"""Terms are compared with refined scans if their gains in the scan are this near to the best, at most so many"""
_FINE, _ROUNDS = 25, 3
"""Values tried in each round between the neighbours of the best scanned value"""


@dataclass(frozen=True)
class Lawful:
    """A state whose candidates are the terms of a library, with the terms that have entered."""

    state: State
    library: Library
    steps: tuple[tuple[Term, Fixed], ...] = ()

    @property
    def terms(self) -> tuple[Term, ...]:
        """The terms, in the order in which they entered."""
        return tuple(term for term, _ in self.steps)

    def plus(self, term: Term, part: Fixed) -> Lawful:
        """Return the state with one more term."""
        return Lawful(self.state.plus([part]), self.library, (*self.steps, (term, part)))

    def first(self, count: int) -> Lawful:
        """Return the state with the first terms only."""
        gone = [part for _, part in self.steps[count:]]
        return Lawful(self.state.minus(gone), self.library, self.steps[:count]) if gone else self


def among_terms(state: State, library: Library, needed: float = 0.0) -> Lawful | None:
    """Return a state whose candidates are terms; None if they cannot gain what is needed even if few were tried."""
    # nearly all terms act at one place of many: those where no law can gain enough are not looked at
    looked_at = library.at(_places(state, library, needed))
    # at the least prices that there can be: true ones take a count of independent tests, which costs more
    plain = Prices(tuple(LEAST_TESTS for _ in looked_at.families) + (1.0,), 1.0, state.measurement.prices.dof)
    tried = _with_candidates(state, looked_at, plain)
    if not _may_gain(Lawful(tried, looked_at), needed):
        return None
    return Lawful(
        _with_candidates(state, library, library.prices, tried.cache if looked_at is library else {}), library
    )


def _places(state: State, library: Library, needed: float) -> list[Place]:
    """Return the places where a law may gain what is needed.

    What changes the readings of a place alone explains at most what leaving these out does.
    """
    if needed <= 0:
        return [*library.places]
    places, system = [], state.measurement.system
    for where in sorted(library.places):
        rows = np.flatnonzero(system.rows_at(dict([where])))
        # without those of a place that has all redundancy nothing is left to explain
        if len(rows) >= state.freedoms or (len(rows) and _gain_without(state, rows) >= needed):
            places.append(where)
    return places


def _gain_without(state: State, rows: Index) -> float:
    """Return by how much the likelihood grows if some rows are left out: more than by any columns in these rows."""
    others = Others.of(Fold(state.measurement, rows), state)
    return float(state.freedoms / 2 * np.log(state.fit.squares / others.fit.squares))


def _may_gain(lawful: Lawful, needed: float) -> bool:
    """Return whether a law of the best terms, at their scanned values, comes near to a gain.

    Further terms seldom gain more than those before them, so that each has its share of what is needed to gain.
    """
    for left in range(MOST_TERMS, 0, -1):
        best = next(iter(best_terms(lawful)), None)
        if best is None or best[0] < max(-NEAR, needed / left - NEAR):
            return False
        needed -= best[0]
        if needed <= 0 or left == 1:
            break
        _, family, number = best
        # under a number of its own: in the whole library that of the scan is another term
        lawful = lawful.plus(*_scanned(lawful, family, number, lawful.library.terms[family][number]))
    return True


def _with_candidates(state: State, library: Library, prices: Prices, cache: dict[object, Any] | None = None) -> State:
    m = replace(state.measurement, families=library.families, scatters=(), knots=(), prices=prices)
    return replace(state, measurement=m, cache={} if cache is None else cache)


def forward(lawful: Lawful, price: float, most: int = MOST_TERMS) -> Lawful:
    """Return the state after the terms that enter: the best first, then those on the same quantity at the same place.

    Each gains more than its price beside those before it, to which `price` is added. A scanned value is refined before
    the next term is sought, so that no term corrects the scan of another.
    """
    library, budget = lawful.library, lawful.state.measurement.job.budget
    while len(lawful.steps) < most and lawful.state.freedoms > _LEAST_DOF and not budget.spent():
        tried = best_terms(lawful)
        if not tried or tried[0][0] < -NEAR:
            break
        # a coarse scan can rank them wrongly: the nearest are compared at refined values
        near = [term for term in tried if term[0] > tried[0][0] - NEAR][:_MOST_REFINED]
        refined = [_refined(lawful, number, at) for _, number, at in near]
        apart = [
            lawful.plus(*both) for both in refined if are_apart(lawful, both[0], library.columns(both[0])[:, None])
        ]
        best = max(apart, key=lambda term: term.state.score, default=lawful)
        if best is lawful or best.state.score < lawful.state.score + price:
            break
        lawful = best
    return lawful


def best_terms(lawful: Lawful) -> list[tuple[float, int, int]]:
    """Return net gain, family and number of the best term of each form on each quantity at each place, the best first.

    All terms of a law act on one quantity at one place.
    """
    place = lawful.terms[0].place if lawful.terms else None
    best: dict[tuple[int, str, Where, str], tuple[float, int, int]] = {}
    for number, terms in enumerate(lawful.library.terms):
        net = lawful.state.nets(number)
        for at in np.argsort(-net, kind="stable").tolist():
            if not np.isfinite(net[at]):
                break
            term = terms[at]
            spot = number, *term.place, term.spot.component
            if (place is None or term.place == place) and spot not in best:
                best[spot] = float(net[at]), number, at
    return sorted(best.values(), key=lambda scored: -scored[0])


def _scanned(lawful: Lawful, family: int, number: int, refined: Term | None = None) -> tuple[Term, Fixed]:
    """Return a term of the scan, or what it is at a refined value, as fixed columns."""
    library, m = lawful.library, lawful.state.measurement
    term = refined or library.terms[family][number]
    # a number of its own for a refined one: products are kept by it, and those of the scanned value are others
    key = family, next(library.numbers) if refined else number
    return term, m.term(library.columns(term), key, m.prices.of_columns(family, len(term.form.factors)))


def _refined(lawful: Lawful, family: int, number: int) -> tuple[Term, Fixed]:
    """Return a term with its scanned value refined between the neighbours of the best one in the scan."""
    library, state = lawful.library, lawful.state
    term = library.terms[family][number]
    if term.form.scanned is None or term.form.kind == STEPS:
        return _scanned(lawful, family, number)
    alike = (
        refined.form.scanned
        for refined in library.terms[family]
        if refined.spot == term.spot and refined.form.variables == term.form.variables
    )
    values = np.array(sorted(value for value in alike if value is not None))
    here = int(np.argmin(np.abs(values - term.form.scanned)))
    low, high = values[max(here - 1, 0)], values[min(here + 1, len(values) - 1)]
    for _ in range(_ROUNDS):
        # equal steps of 1 / s: waves differ by their frequency, saturations by their rate
        tried = [term.at(float(value)) for value in 1 / np.linspace(1 / low, 1 / high, _FINE)]
        columns = np.stack([library.columns(refined) for refined in tried], axis=1)
        n, k, q = columns.shape
        left = state.seen(columns.reshape(n, k * q)).reshape(n, k, q)
        right = (columns.reshape(n, k * q).T @ state.residual).reshape(k, q)
        gram = np.einsum("rkq,rkp->kqp", columns, left)
        gain, _ = quadratic(gram, right, np.sqrt(np.maximum(np.einsum("kqq->kq", grams_of(columns)), 1e-300)))
        best = int(np.argmax(np.where(are_apart(lawful, term, columns), gain, -1.0)))
        term = tried[best]
        low, high = (float(tried[at].form.scanned or 0.0) for at in (max(best - 1, 0), min(best + 1, _FINE - 1)))
    return _scanned(lawful, family, number, term)


def are_apart(lawful: Lawful, term: Term, columns: Array) -> Mask:
    """Return whether scanned terms of the same variables leave something of columns (n, k, q) of k scanned terms.

    Two waves of nearly one period, each a thousand times the law, would stand for one whose size changes.
    """
    n, k, q = columns.shape
    own = term.spot, term.form.variables
    alike = [part for other, part in lawful.steps if other.form.scanned and (other.spot, other.form.variables) == own]
    if not alike or not term.form.scanned:
        return np.ones(k, dtype=bool)
    flat = columns.reshape(n, k * q)
    left = lawful.state.seen(flat) - LITTLE * lawful.state.minus(alike).seen(flat)
    return np.asarray((flat * left).reshape(n, k, q).sum(axis=(0, 2)) >= 0)
