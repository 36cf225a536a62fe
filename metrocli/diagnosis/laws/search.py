"""The search for laws: one for each number of terms, with the gain that the same search has in each fold.

Method: docs/algorithms/laws.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.robust import SAME
from metrocli.diagnosis.adjusted_job import Ordered
from metrocli.diagnosis.evidence.gain import FoldPrediction, Gain, gain_of
from metrocli.diagnosis.evidence.held_out import Others, fold_numbers
from metrocli.diagnosis.evidence.parts import Fixed
from metrocli.diagnosis.evidence.prices import ALIKE
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.laws.library import Library, Term
from metrocli.diagnosis.laws.steps import Lawful, among_terms, columns_of_terms, forward
from metrocli.diagnosis.laws.terms import columns_of
from metrocli.diagnosis.linear.candidates import Candidate
from metrocli.diagnosis.linear.quadratics import quadratic
from metrocli.frozen import dataclass

_LAW = float(np.log(30.0))
"""What a law pays beyond its tests: formulas are many, and a known cause, or chance, is likelier"""
_SURELY = 5.5
"""Net evidence from which a law of few readings need not be shown by held-out ones"""
_MOST_ROWS = 25_000
"""Largest number of components of readings for which laws are sought: the columns of all terms are held at once"""
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
    """exp of minus the net evidence of its least term beside the others"""
    gain: Gain
    part_of_structure: float
    """Share of the squares that it explains, of those above the noise"""
    size: float
    """Root mean square of what it explains over the readings on which it acts, in their unit"""
    data: LawData | None
    """None for a constant, which has no variable"""
    near: tuple[tuple[Candidate, float], ...] = ()
    """Effects of the catalogue that change the readings nearly as it does, each with the cosine, the nearest first"""
    replaced: tuple[Candidate, ...] = ()
    """Effects that were identified before it was found, and that it replaces"""
    as_likely: tuple[Term, ...] = ()
    """Single terms of other variables, or at other places, that explain the readings as well as its only one.

    The best comes first.
    """
    chosen: bool = False


@dataclass(frozen=True)
class LawSearchResult:
    """A state that holds where laws were sought, and the laws, one for each number of terms."""

    state: State
    laws: tuple[Law, ...] = ()


def with_laws(state: State, plain: State, ordered: Ordered = map) -> LawSearchResult:
    """Return the state with a law in it, where a law explains the readings better than what it replaces.

    Effects, correlated errors and noise of variance groups can imitate a law: three jumps do a saturation, an error
    along the time does a step. So laws are sought beside the effects alone, and beside nothing, with `plain` the state
    of the same effects in white noise. The law has to exceed the score of the state by a price of its own.
    """
    m = state.measurement
    if not m.job.places or m.system.rows > _MOST_ROWS or m.job.budget.ended:
        return LawSearchResult(state)
    library = Library(m.job, plain.measurement.system)
    best: tuple[Lawful, State, Lawful] | None = None
    for base in _bases(plain):
        # what it has to gain is known: a base far behind the state is not searched at all
        start = among_terms(base, library, state.score + _LAW - base.score)
        lawful = start and forward(start, 0.0)
        if start and lawful and lawful.steps and (best is None or lawful.state.score > best[0].state.score):
            best = lawful, base, start
    if best is None or best[0].state.score < state.score + _LAW:
        return LawSearchResult(state)
    lawful, base, start = best
    gains = _gains(lawful, base, ordered)
    simpler = [_law(lawful.first(count), base, gain, state) for count, gain in enumerate(gains, 1)]
    chosen = max(simpler, key=lambda law: law.gain.log_score)
    # few readings predict held-out ones badly: then large evidence is enough, if they do not speak against it
    surely = best[0].state.score > state.score + _SURELY and chosen.gain.log_score > 0
    if not (chosen.gain.shown or surely) or _is_named(chosen, state):
        return LawSearchResult(state)
    as_likely = _as_likely(start, lawful.terms[0])
    kept = {part.key for part in base.fixed}
    replaced = tuple(m.alternative(part.key) for part in state.named if part.key not in kept)
    laws = tuple(
        replace(law, chosen=law is chosen, as_likely=() if count else as_likely, replaced=replaced)
        for count, law in enumerate(simpler)
    )
    terms = [part for _, part in lawful.steps[: len(chosen.terms)]]
    return LawSearchResult(State.of(base.measurement, (*base.fixed, *terms), base.random, base.logs, 0), laws)


def stood_for(laws: Sequence[Law]) -> set[tuple[str, tuple[str, ...]]]:
    """Return cause and place of the effects for which the chosen law stands: the nearest, and those it replaced."""
    chosen = [law for law in laws if law.chosen]
    return {effect.spot for law in chosen for effect in (*(near for near, _ in law.near), *law.replaced)}


def _as_likely(start: Lawful, chosen: Term) -> tuple[Term, ...]:
    """Return the terms whose evidence is like that of the best single one, the best of each place and its variables."""
    tried = list[tuple[float, Term]]()
    for number, terms in enumerate(start.library.terms):
        gain, price, _ = start.state.gains_of_family(number)
        tried += zip(np.where(gain > 0, gain - price, -np.inf).tolist(), terms, strict=True)
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


def _gains(lawful: Lawful, base: State, ordered: Ordered) -> list[Gain]:
    """Return the held-out gain of the laws of 1, 2, ... terms; each fold has the laws that the others choose."""
    pairs = [*ordered(_Folds(lawful), fold_numbers(base.measurement))]
    return [gain_of(predictions) for predictions in zip(*pairs, strict=True)]


@dataclass(frozen=True)
class _Folds:
    """What is compared in each fold. It travels to other processors, so it has no more than that."""

    lawful: Lawful

    def __call__(self, number: int) -> list[tuple[FoldPrediction, FoldPrediction]]:
        """Return the predictions of a fold without and with laws of 1, 2, ... terms."""
        state, gone = self.lawful.state, {id(part) for _, part in self.lawful.steps}
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
        place = lawful.terms[0].place
        best, chosen = 0.0, None
        for number, terms in enumerate(library.terms):
            net = others.nets(number)
            if count:
                # later terms act where the first one of the law does
                net = np.where([term.place == place for term in terms], net, -np.inf)
            if len(net) and net.max() > best:
                best, chosen = float(net.max()), (number, int(np.argmax(net)))
        # the refined term has a value between those of the scan, which is better where its neighbours are chosen
        term, part = lawful.steps[count]
        if chosen is not None and library.terms[chosen[0]][chosen[1]].is_like(term):
            return part
        if chosen is None:
            return None
        price = lawful.state.measurement.prices.of_columns(chosen[0], 1)
        return lawful.state.measurement.term(library.columns(library.terms[chosen[0]][chosen[1]]), chosen, price)


def _law(lawful: Lawful, base: State, gain: Gain, instead: State) -> Law:
    library, terms, state = lawful.library, lawful.terms, lawful.state
    system = base.measurement.system
    whole = columns_of_terms(library, terms)
    left = base.seen(whole)
    # columns of unit length: powers of a variable differ by many decades, and the cut of the pseudo-inverse is relative
    scale = np.maximum(np.sqrt(np.maximum((whole * left).sum(axis=0), 0.0)), 1e-300)
    inverse = np.linalg.pinv((whole / scale).T @ (left / scale), rcond=1e-10, hermitian=True)
    sizes = inverse @ ((whole / scale).T @ base.residual) / scale
    stds = np.sqrt(np.maximum(np.diag(inverse), 0.0) * state.variance) / scale
    cuts = np.cumsum([len(term.form.factors) for term in terms])[:-1]
    acting = whole.any(axis=1)
    shown = np.where(acting & system.in_reported_unit, (base.residual - state.residual) * system.scale, 0.0)
    # the smaller of both variances: the share is of what is above the noise, and structure left over is no noise
    noise = min(state.variance, instead.variance) * base.freedoms
    part = (base.fit.squares - state.fit.squares) / max(base.fit.squares - noise, 1e-300)
    nets = state.without_fixed()[-len(terms) :]
    return Law(
        terms,
        tuple(np.split(sizes, cuts)),
        tuple(np.split(stds, cuts)),
        float(np.exp(-max(float(nets.min()), 0.0))),
        gain,
        float(np.clip(part, 0.0, 1.0)),
        float(np.sqrt((shown[shown != 0] ** 2).mean())) if shown.any() else 0.0,
        _data(library, terms, sizes, state.residual),
        near_effects(base, left @ sizes),
    )


def _data(library: Library, terms: Sequence[Term], sizes: Array, after: Array) -> LawData | None:
    """Return a law over its variable, beside the readings on which it acts; `after` is the residual with it (rows,)."""
    system, spot = library.system, terms[0].spot
    variables = {name for term in terms for name in term.form.variables}
    if not variables:
        return None
    adds = columns_of_terms(library, terms)
    law = (adds @ sizes) * system.scale
    residual = law + after * system.scale
    unit_of_readings, showing = system.showing(adds @ sizes)
    if len(variables) > 1 or any(term.spot.component != spot.component for term in terms):
        rows = np.flatnonzero(adds.any(axis=1) & showing)
        return LawData("", "", law[rows], law[rows], residual[rows], unit_of_readings, None)
    (name,) = variables
    change = np.where(showing, library.change(spot) * system.scale, 0.0)
    rows = np.flatnonzero((change != 0) & (np.abs(change) >= _SEEN * np.abs(change).max()))
    x = library.values(terms, name)[rows]
    steps = np.linspace(x.min(), x.max(), _STEPS)
    factors = [columns_of([term.form], {name: steps})[:, 0] for term in terms]
    curve = np.concatenate([np.broadcast_to(factor, (_STEPS, factor.shape[1])) for factor in factors], axis=1) @ sizes
    # divided by the change per unit of the component: each reading shows the law itself
    law, residual = law[rows] / change[rows], residual[rows] / change[rows]
    unit, adds_unit = spot.acting.variables_at({})[name].unit, spot.acting.unit_of(spot.component)
    return LawData(name, unit, x, law, residual, adds_unit, (steps, curve))


_LEAST, _MOST = 0.9, 2
"""Smallest cosine of an effect that is reported as nearly the law, and the largest number of them"""


def near_effects(state: State, shown: Array) -> tuple[tuple[Candidate, float], ...]:
    """Return the effects whose visible columns nearly contain what a law explains, (rows,), with the cosine.

    Each is at its best place and with its best scanned values; the nearest comes first.
    """
    size, nearest = float(shown @ shown), dict[str, tuple[Candidate, float]]()
    for family in (pair for pair in state.measurement.families if not pair.unknown):
        inside, _ = quadratic(family.gram, family.columns.products(shown[:, None])[:, :, 0], family.raw)
        best = int(np.argmax(inside))
        cosine = float(np.sqrt(min(inside[best] / max(size, 1e-300), 1.0)))
        before = nearest[family.name][1] if family.name in nearest else _LEAST
        if cosine > before:
            nearest[family.name] = family.alternatives[best], cosine
    return tuple(sorted(nearest.values(), key=lambda pair: -pair[1])[:_MOST])
