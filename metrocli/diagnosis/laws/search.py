"""The search for laws: one for each number of terms, with the gain that the same search has in each fold.

Method: docs/algorithms/laws.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from metrocli.adjust.model.observations import Index
from metrocli.adjust.robust import SAME
from metrocli.diagnosis.adjusted_job import Ordered
from metrocli.diagnosis.evidence.gain import FoldPrediction, Gain, gain_of
from metrocli.diagnosis.evidence.held_out import Others
from metrocli.diagnosis.evidence.parts import Fixed
from metrocli.diagnosis.evidence.prices import ALIKE, Prices
from metrocli.diagnosis.evidence.search import without_weak_fixed
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.laws.law import Law, law_of
from metrocli.diagnosis.laws.library import Library, Term
from metrocli.diagnosis.laws.steps import NEAR, Lawful, among_terms, forward
from metrocli.frozen import dataclass

_LAW = float(np.log(30.0))
"""What a law pays beyond its tests: formulas are many, and a known cause, or chance, is likelier"""
_SURELY = 5.5
"""Net evidence from which a law of few readings need not be shown by held-out ones"""
_RIVAL = 0.5
"""Share of the net gain of the best term from which another one may be chosen where a part of the readings is left out:
a part is a tenth of them, and does not halve a gain"""
_MOST_ROWS = 25_000
"""Largest number of components of readings for which laws are sought: the columns of all terms are held at once"""


def with_laws(state: State, plain: State, ordered: Ordered = map) -> tuple[State, tuple[Law, ...]]:
    """Return the state with a law in it, and the laws, one for each number of terms; the state itself without any.

    A law explains the readings better than what it replaces. Effects, correlated errors and noise of variance groups
    can imitate one: three jumps do a saturation, an error along the time does a step. So laws are sought beside the
    effects alone, and beside nothing, with `plain` the state of the same effects in white noise. The law has to exceed
    the score of the state by a price of its own.
    """
    m = state.measurement
    if not m.job.places or m.system.rows > _MOST_ROWS or m.job.budget.ended or state.is_exact:
        return state, ()
    library = Library(m.job, plain.measurement.system)
    best: tuple[Lawful, State, Lawful] | None = None
    for base in _bases(plain):
        # what it has to gain is known: a base far behind the state is not searched at all
        start = among_terms(base, library, state.score + _LAW - base.score)
        lawful = start and forward(start, 0.0)
        if start and lawful and lawful.steps and (best is None or lawful.state.score > best[0].state.score):
            best = lawful, base, start
    if best is None or best[0].state.score < state.score + _LAW:
        return state, ()
    lawful, base, start = best
    gains = _gains(lawful, start, ordered)
    simpler = [law_of(lawful.first(count), base, gain, state) for count, gain in enumerate(gains, 1)]
    chosen = max(simpler, key=lambda law: law.gain.log_score)
    # few readings predict held-out ones badly: then large evidence is enough, if they do not speak against it
    surely = best[0].state.score > state.score + _SURELY and chosen.gain.explains
    if not (chosen.gain.shown or surely) or chosen.undoes_positions or _is_named(chosen, state):
        return state, ()
    as_likely = _as_likely(start, lawful.terms[0])
    terms = [part for _, part in lawful.steps[: len(chosen.terms)]]
    found = State.of(base.measurement, (*base.fixed, *terms), base.random, base.logs, 0)
    found = _with_those_beside(found, state)
    kept = {part.key for part in found.fixed}
    replaced = tuple(m.alternative(part.key) for part in state.named if part.key not in kept)
    laws = tuple(
        replace(law, chosen=law is chosen, as_likely=() if count else as_likely, replaced=replaced)
        for count, law in enumerate(simpler)
    )
    return found, laws


def _with_those_beside(found: State, state: State) -> State:
    """Return a state with a law, the effects of another state that pay beside it, and no wrong readings that do not.

    In the white noise in which a law is sought, what pays beside it may not; what seemed wrong without it may be right.
    """
    kept = {part.key for part in found.fixed}
    for key in (part.key for part in state.named if part.key not in kept):
        more = found.plus([found.measurement.effect(*key)]).settled()
        found = max(found, more, key=lambda trial: trial.score)
    return without_weak_fixed(found)


def stood_for(laws: Sequence[Law]) -> set[tuple[str, tuple[str, ...]]]:
    """Return cause and place of the effects for which the chosen law stands: the nearest, and those it replaced."""
    chosen = [law for law in laws if law.chosen]
    return {effect.spot for law in chosen for effect in (*(near for near, _ in law.near), *law.replaced)}


def _as_likely(start: Lawful, chosen: Term) -> tuple[Term, ...]:
    """Return the terms whose evidence is like that of the best single one, the best of each place and its variables."""
    tried = list[tuple[float, Term]]()
    for number, terms in enumerate(start.library.terms):
        tried += zip(start.state.nets(number).tolist(), terms, strict=True)
    tried.sort(key=lambda scored: -scored[0])
    likely = {_subject(chosen): chosen}
    for net, term in tried:
        if net > tried[0][0] - ALIKE:
            likely.setdefault(_subject(term), term)
    return tuple(likely.values())[1:]


def _subject(term: Term) -> tuple[object, ...]:
    return *term.place, term.spot.component, term.form.variables


def _is_named(law: Law, state: State) -> bool:
    """Return whether a law is an identified effect: a part of its parameters, which needs fewer of them."""
    spots = {state.measurement.alternative(part.key).spot for part in state.named}
    # no less alike: a jump is like a saturation by 0.9, and explains far less
    return any(effect.spot in spots and cosine > SAME for effect, cosine in law.near)


def _bases(plain: State) -> Iterator[State]:
    yield plain
    if plain.named:
        yield plain.minus(plain.named)


def _gains(lawful: Lawful, start: Lawful, ordered: Ordered) -> list[Gain]:
    """Return the held-out gain of the laws of 1, 2, ... terms; each fold has the laws that the others choose."""
    pairs = [*ordered(_Folds(lawful, _rivals(start)), start.state.measurement.fold_numbers)]
    return [gain_of(predictions) for predictions in zip(*pairs, strict=True)]


def _rivals(start: Lawful) -> list[Index]:
    """Return the numbers of the terms of each family that may be the first of a law in some fold."""
    nets = [start.state.nets(number) for number in range(len(start.library.terms))]
    least = _RIVAL * max(float(net.max(initial=0.0)) for net in nets) - NEAR
    return [np.flatnonzero(net > least) for net in nets]


@dataclass(frozen=True)
class _Folds:
    """What is compared in each fold. It travels to other processors, so it has no more than that."""

    lawful: Lawful
    rivals: list[Index]
    """Numbers of the terms of each family that may be the first"""

    @cached_property
    def _at_the_place(self) -> list[Index]:
        """Numbers of the terms of each family that act where the first one of the law does, as later ones have to."""
        place, every = self.lawful.terms[0].place, self.lawful.library.terms
        return [np.flatnonzero([term.place == place for term in terms]) for terms in every]

    @cached_property
    def _state(self) -> State:
        """The state with the candidates of the first term alone, and behind them those of later ones."""
        m = self.lawful.state.measurement
        chosen = zip((*m.families, *m.families), (*self.rivals, *self._at_the_place), strict=True)
        *tests, of_readings = m.prices.tests
        prices = Prices((*tests, *tests, of_readings), m.prices.causes, m.prices.dof)
        families = tuple(family.only(some.tolist()) for family, some in chosen)
        return replace(self.lawful.state, measurement=replace(m, families=families, prices=prices), cache={})

    def __call__(self, number: int) -> list[tuple[FoldPrediction, FoldPrediction]]:
        """Return the predictions of a fold without and with laws of 1, 2, ... terms."""
        state, gone = self._state, {id(part) for _, part in self.lawful.steps}
        every = Others.of_fold(state, number)
        fixed = [part for part in state.fixed if id(part) not in gone]
        others, bare = every.keeping(fixed), len(fixed)
        before, pairs = others.predicted(), list[tuple[FoldPrediction, FoldPrediction]]()
        for count in range(len(self.lawful.steps)):
            # once no term enters in a fold, no further one does there
            if len(fixed) == bare + count and (term := self._chosen(others, count)) is not None:
                fixed.append(term)
                others = every.with_fixed(fixed)
            pairs.append((before, others.predicted() if len(fixed) > bare else before))
        return pairs

    def _chosen(self, others: Others, count: int) -> Fixed | None:
        """Return the term that the other readings choose; None if they choose none."""
        lawful, library = self.lawful, self.lawful.library
        best, chosen = 0.0, None
        first = len(library.terms) if count else 0
        for number, terms in enumerate(self._at_the_place if count else self.rivals):
            net = others.nets(first + number)
            if len(net) and net.max() > best:
                best, chosen = float(net.max()), (number, int(terms[np.argmax(net)]))
        # the refined term has a value between those of the scan, which is better where its neighbours are chosen
        term, part = lawful.steps[count]
        if chosen is not None and library.terms[chosen[0]][chosen[1]].is_like(term):
            return part
        if chosen is None:
            return None
        price = lawful.state.measurement.prices.of_columns(chosen[0], 1)
        return lawful.state.measurement.term(library.columns(library.terms[chosen[0]][chosen[1]]), chosen, price)
