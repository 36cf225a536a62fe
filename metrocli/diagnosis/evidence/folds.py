"""Cross-validation: how much better an effect predicts held-out readings, and how its size changes without them.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import cast

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Mask
from metrocli.diagnosis.adjusted_job import Ordered
from metrocli.diagnosis.evidence.gain import FoldPrediction, Gain, gain_of
from metrocli.diagnosis.evidence.held_out import Others
from metrocli.diagnosis.evidence.identified import IdentifiedEffect, all_identified
from metrocli.diagnosis.evidence.likelihood import Fit
from metrocli.diagnosis.evidence.parts import EFFECT, READING, Fixed, Random
from metrocli.diagnosis.evidence.prices import FURTHER, LEVEL, OF_ALL
from metrocli.diagnosis.evidence.state import State
from metrocli.frozen import dataclass

Key = tuple[int, int]
"""Family and number of an effect"""
_RULED_OUT = 1e-3
"""Probability below which a fold leaves an effect out: what it adds is nearly always nothing"""
_FEWEST = 4
"""Fewest units from whose scatter a variance is taken"""
_RATHER_LARGE = 2.0
"""Largest factor that white noise alone may give: a jackknife is rather too large, which few units need"""
_INFLATION = 1.5
"""Variance inflation from which other parts can stand for an effect: they share a third of its information"""


def gains(state: State, names: Sequence[IdentifiedEffect], ordered: Ordered = map, nested: bool = True) -> list[Gain]:
    """Return the gain of each identified effect, then of all together; `ordered` computes the folds.

    In each fold an effect, or a rival of it, predicts with the probability that the other readings give it beside the
    other effects: `p = (1 - w) p_without + w p_with`. Chosen or not, with nothing between, effects near the price would
    lose what supports them and keep what does not: the fold that shows them most is the one without which they are not
    chosen (docs/decisions/270-effects-predict-with-their-probability.md). What is not `nested` has all effects in each
    fold, which takes a third of the time and flatters, most where readings are few.
    """
    by_fold = [*ordered(_Nested(state, tuple(names), nested), state.measurement.fold_numbers)]
    gained = [gain_of(pairs) for pairs in zip(*by_fold, strict=True)]
    # one effect alone is all of them together
    return gained if len(names) > 1 else [*gained, *gained]


@dataclass(frozen=True)
class _Nested:
    """What is compared in each fold."""

    state: State
    names: tuple[IdentifiedEffect, ...]
    nested: bool

    def __call__(self, number: int) -> list[tuple[FoldPrediction, FoldPrediction]]:
        """Return the predictions of a fold without and with each effect, and all of them."""
        state = self.state
        whole = Others.of_fold(state, number)
        # a candidate that the held-out readings have helped to choose would be judged by the readings that chose it
        every_choice = ((name.key, self._chosen(whole, name)) for name in self.names)
        chosen = {key: choice for key, choice in every_choice if choice is not None}
        likely = {key: part for key, (part, weight) in chosen.items() if weight >= 0.5}
        # an effect that only the held-out readings show is their error: unpredicted, it would count against the others
        alone = [part for part in state.named if part.key not in chosen and not whole.fold.shown(part)]
        errors = [replace(part, sort=READING) for part in alone]
        if alone:
            known = state.keeping([part for part in state.fixed if all(part is not own for own in alone)])
            whole = Others.of(whole.fold, known.plus(errors, steps=0))
        # wrong readings, and what has no known cause: waves, and the terms of a law
        beside = [*errors, *(part for part in state.fixed if part.sort != EFFECT)]

        def with_parts(parts: Mapping[Key, Fixed]) -> FoldPrediction:
            # two names can have the same rival
            distinct = {part.key: part for part in parts.values()}
            return whole.with_fixed((*distinct.values(), *beside)).predicted()

        every = with_parts(likely)
        pairs = []
        for key in (name.key for name in self.names):
            part, weight = chosen.get(key, (None, 0.0))
            if part is None:
                # an effect that the others rule out changes no prediction, so that its gain there is exactly 0
                pairs.append((every, every))
            elif key in likely:
                without = with_parts({other: own for other, own in likely.items() if other != key})
                pairs.append((without, without.mixed(every, weight)))
            else:
                pairs.append((every, every.mixed(with_parts({**likely, key: part}), weight)))
        if len(self.names) > 1:
            # the last pair compares none with all: gains of single effects beside the others do not add up to it
            without = with_parts({})
            # all of them are at most as probable as the least of them
            weight = min((chosen[key][1] for key in likely), default=0.0)
            pairs.append((without, without.mixed(every, weight)))
        return pairs

    @cached_property
    def _own_alternatives(self) -> dict[Key, list[Mask]]:
        """Of each effect, which alternatives of each family are it or its rivals."""
        families = self.state.measurement.families
        spots = {
            name.key: {name.alternative.spot, *(rival.alternative.spot for rival in name.rivals)} for name in self.names
        }
        return {
            key: [np.array([alternative.spot in own for alternative in family.alternatives]) for family in families]
            for key, own in spots.items()
        }

    def _chosen(self, whole: Others, name: IdentifiedEffect) -> tuple[Fixed, float] | None:
        """Return the effect, or its rival, that the other readings favour, and its probability; None if it is nearly 0.

        It is `e^a/(1 + e^a + e^b)`, a the net gain of the effect or its best rival and b that of the best other cause.
        """
        m, parts = self.state.measurement, self.state.fixed
        if not self.nested:
            return next(part for part in parts if part.key == name.key), 1.0
        others, owns = whole.keeping(part for part in parts if part.key != name.key), self._own_alternatives[name.key]
        # a first effect has to pay for itself only; a further one has the higher price that the search asks of it
        further = FURTHER if len(parts) > 1 else 0.0
        net, key, rival = -np.inf, name.key, -np.inf
        for number, (family, own) in enumerate(zip(m.families, owns, strict=True)):
            nets = others.nets(number) - (OF_ALL if family.unknown else 0.0) - further
            rival = max(rival, float(nets[~own].max(initial=-np.inf)))
            if own.any() and (best := float(nets[own].max())) > net:
                net, key = best, (number, int(np.argmax(np.where(own, nets, -np.inf))))
            # between which two of the held-out readings something jumped the others do not say: all such jumps are one
            if number == name.key[0] and np.isclose(nets[name.key[1]], net):
                key = name.key
        weight = float(np.exp(net - np.logaddexp.reduce([0.0, net, rival])))
        if weight < _RULED_OUT:
            return None
        return next((part for part in parts if part.key == key), None) or m.effect(*key), weight


def gain_of_parts(state: State, parts: Sequence[Fixed | Random]) -> Gain:
    """Return the gain of some parts of a state, at the sizes with and without them, computed once."""
    # parts are compared by identity: the state holds them, so that their numbers stay theirs as long as the cache lives
    key = ("gain", *map(id, parts))
    if key not in state.cache:
        state.cache[key] = gain_between(state.minus(parts), state)
    return cast("Gain", state.cache[key])


def gain_between(before: State, after: State) -> Gain:
    """Return the gain of one state over another, at the sizes that each has."""
    both = (
        [Others.of_fold(state, number).predicted() for number in state.measurement.fold_numbers]
        for state in (before, after)
    )
    return gain_of([*zip(*both, strict=True)])


def with_jackknife(state: State, effects: Sequence[IdentifiedEffect]) -> tuple[IdentifiedEffect, ...]:
    """Return identified effects with the covariance that leaving out units shows, where it is the larger one.

    Without unit g of G the q sizes change by d_g, and their covariance is C_g. That of the model, C, is multiplied by
    `f = (G - 1)/G sum_g d_g' C^-1 d_g / (q max(1, e_g))`, at least by 1.

    Here `e_g = tr C^-1 C_g / q - 1` (jackknife: Efron 1982; CR3: Bell and McCaffrey 2002). A unit that has more than
    half of what determines a size counts as half: the other units hardly show its errors. White noise alone gives f of
    `E = (G - 1)/G sum_g min(1, e_g)`, large where the units need each other. So f is divided by E/2 where that exceeds
    1 (docs/decisions/269-uncertainties-by-units-left-out.md).
    """
    factors = _factors(state) if effects else {}
    return tuple(replace(effect, covariance=effect.covariance * factors.get(effect.key, 1.0)) for effect in effects)


def least_sure(state: State, effects: Sequence[IdentifiedEffect], unshown: Collection[Key] = ()) -> Fixed | None:
    """Return the effect of the least evidence among the doubtful ones whose size may be nothing; None without one.

    Others can stand for a doubtful one, or its gain is `unshown`. Two that nearly cancel each other may both pay, at
    sizes that hinge on a few images. Any other effect stays, with the uncertainty that it has.
    """
    unsure = {effect.key for effect in effects if effect.level_of_size > LEVEL} & {*_collinear(state), *unshown}
    nets = zip(state.without_fixed().tolist(), state.fixed, strict=True) if unsure else ()
    own = [(net, part) for net, part in nets if part.sort == EFFECT and part.key in unsure]
    return min(own, key=lambda pair: pair[0])[1] if own else None


def surely(state: State) -> State:
    """Return the state without the effects that are least sure, one after the other."""
    while _collinear(state):
        part = least_sure(state, with_jackknife(state, all_identified(state, with_rivals=False)))
        if part is None:
            break
        state = state.minus([part])
    return state


def _collinear(state: State) -> set[Key]:
    """Return the effects whose variance the other fixed parts inflate, so that these can stand for them."""
    estimates = _estimates(state.fixed, state.fit).items()
    inflation = {key: float(np.vdot(gram, covariance)) / len(gram) for key, (_, covariance, gram) in estimates}
    return {key for key, factor in inflation.items() if factor > _INFLATION}


def _factors(state: State) -> dict[Key, float]:
    """Return how many times the variance of the model each effect has over the units that are left out in turn."""
    own = _estimates(state.fixed, state.fit)
    squares: dict[Key, list[tuple[float, float]]] = {key: [] for key in own}
    for number in state.measurement.fold_numbers:
        others = Others.of_fold(state, number)
        # an effect that only this unit shows has no size without it
        for key, (sizes, covariance, _) in _estimates(others.kept, others.fit).items():
            change, q, inverse = sizes - own[key][0], len(sizes), np.linalg.inv(own[key][1])
            more = float(np.vdot(inverse, covariance)) / q - 1
            squares[key].append((float(change @ inverse @ change) / q / max(1.0, more), min(1.0, more)))
    factors = {}
    for key, each in squares.items():
        if len(each) >= _FEWEST:
            scatter, expected = np.sum(each, axis=0) * (len(each) - 1) / len(each)
            factors[key] = max(scatter / state.variance / max(1.0, expected / _RATHER_LARGE), 1.0)
    return factors


def _estimates(parts: Sequence[Fixed], fit: Fit) -> dict[Key, tuple[Array, Array, Array]]:
    """Return sizes of the effects among some fixed parts of a fit, their covariance for the variance 1, and products.

    These are the products of the columns of each, beside all but the fixed parts.
    """
    sizes, lower = fit.sizes[fit.fixed :], fit.lower[fit.fixed :, fit.fixed :]
    root = np.linalg.inv(lower)
    covariance, gram, ends = root.T @ root, lower @ lower.T, np.cumsum([0, *(part.rank for part in parts)]).tolist()
    placed = [(part.key, slice(a, b)) for part, a, b in zip(parts, ends, ends[1:], strict=False) if part.sort == EFFECT]
    return {key: (sizes[own], covariance[own, own], gram[own, own]) for key, own in placed}
