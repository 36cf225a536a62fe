"""The search: the moves that raise the score of a state, until none does.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.robust import SAME
from metrocli.diagnosis.evidence.parts import CORRELATED, EFFECT, SCATTER, Fixed, Random
from metrocli.diagnosis.evidence.state import State, at_sizes
from metrocli.diagnosis.evidence.variances import Found, correlated_errors, noisier_groups, scattered_effects
from metrocli.diagnosis.evidence.weights import with_noise
from metrocli.diagnosis.linear.projection import READING
from metrocli.diagnosis.noise import AS_OTHERS, DECLARED_SIGMA
from metrocli.frozen import dataclass

_MOST = 60
_CORRELATED = 4
"""Largest number of correlated errors: what more of them explain is small beside these"""
_GAINED = 1e-3
"""Least gain of the score by a move: less is rounding"""
_AT_ONCE = 60
"""Wrong readings of one step, at most"""
_SURE = 2.5
"""Net evidence below which a part is left out on trial"""
_APART = 0.3
"""Largest correlation of wrong readings that are taken in one step"""
_NEAR = 3.0
"""Moves whose quick net gain is so near to the best are tried"""
_MOST_TRIED = 3
_SWAPS, _CERTAIN, _TRIED = 3, 30.0, 3
"""Rounds of swaps, the net evidence beyond which a part is not tried to be replaced, and by how many others"""
_ESTIMATES, _STAYS = 6, 1.03
"""Largest number of estimates of the noise of a group, and the ratio of two that ends them"""
_ALIKE = float(np.log(20.0))
"""Difference of scores up to which two causes explain the readings alike"""
_MASKED, _TOGETHER = 2.0, 8
"""Variance of the noise, in that declared, from which several wrong readings are sought together, and how many"""


@dataclass(frozen=True)
class Move:
    """Parts that may enter, with their quick net gain."""

    net: float
    fixed: tuple[Fixed, ...] = ()
    found: Found | None = None
    noise: Mapping[int, float] | None = None
    given: bool = False
    """Whether the noise is that of prior values, whose stated sigma is wrong"""

    @property
    def is_cause(self) -> bool:
        """Whether known effects enter, at a place or at all their places."""
        return any(one.sort == EFFECT for one in self.fixed) or (self.found is not None and self.found.kind == SCATTER)

    @property
    def keys(self) -> tuple[tuple[int, ...], ...]:
        """Keys of the parts that enter."""
        return (*(one.key for one in self.fixed), *(() if self.found is None else (self.found.key,)))

    def made(self, state: State) -> State:
        """Return the state after the move."""
        if self.noise is not None:
            return _with_noise(state, self.noise)
        if self.found is not None:
            return state.plus(random=[self.found.part(state.measurement)], logs=[self.found.log])
        return state.plus(self.fixed)


def _with_noise(state: State, noise: Mapping[int, float]) -> State:
    """Return a state whose variance groups have a noise of their own, estimated until it stays."""
    for _ in range(_ESTIMATES):
        after = state.at(with_noise(state.measurement, noise))
        if after.score < state.score and state.measurement.noise:
            return state
        state, noise = after, {number: after.ratio_of(number) for number in noise}
        if all(1 / _STAYS < ratio < _STAYS for ratio in noise.values()):
            break
    return state


def moves(state: State, quiet: set[int] | None = None) -> list[Move]:
    """Return what may enter a state, the best first; `quiet` are covariates that showed nothing before."""
    found = [*_names(state), *_readings(state), *_masked_readings(state)]
    random = scattered_effects(state)[:1]
    if sum(one.kind == CORRELATED for one in state.random) < _CORRELATED:
        random += correlated_errors(state, quiet)
    found += [Move(one.net, found=one) for one in random]
    found += _noise(state)
    return sorted((one for one in found if one.net > -1), key=lambda one: -one.net)


def _noise(state: State) -> list[Move]:
    """Return the noisier variance groups of one step: the most certain, and those of its kind nearly as certain."""
    of_readings = [one[0] not in (READING, DECLARED_SIGMA) for one in state.measurement.units]
    # one of many units that is quieter than the others is no cause for anything
    groups = [
        one
        for one in noisier_groups(state)
        if one[0] > 0 and (one[2] > AS_OTHERS or (one[2] < 1 / AS_OTHERS and not of_readings[one[1]]))
    ]
    if not groups:
        return []
    kind = state.measurement.units[groups[0][1]][0]
    alike = [one for one in groups if state.measurement.units[one[1]][0] == kind and one[0] > groups[0][0] / 2]
    return [Move(groups[0][0], noise={number: ratio for _, number, ratio in alike}, given=kind == DECLARED_SIGMA)]


def _names(state: State, most: int = 2) -> list[Move]:
    """Return the effects, and unknown causes, of the largest net gains.

    Left out is what the error of one reading explains as well: beside its dead path, a jump after the first reading of
    a tracer is an error of that reading. How many readings there are is no evidence for the jump.
    """
    m = state.measurement
    _, rank, by_readings = state.of_readings()
    taken = {m.alternative(one.key).form for one in (*state.named, *state.unknown)}
    found: list[tuple[float, int, int]] = []
    for family in range(len(m.families)):
        gain, price, explained = state.gains_of_family(family)
        net = gain - price
        single = by_readings[rank <= m.families[family].columns.parameters].max(initial=0.0)
        for at in np.argsort(-net)[:4].tolist():
            if gain[at] > 0 and single < SAME * explained[at] and m.alternative((family, at)).form not in taken:
                found.append((float(net[at]), family, at))
    found.sort(reverse=True)
    return [Move(net, (m.effect(family, at),)) for net, family, at in found[:most]]


def _readings(state: State) -> list[Move]:
    """Return the wrong readings of one step: the most certain, and others nearly as bad that it does not imitate."""
    m = state.measurement
    gain, price, t = state.gains_of_readings()
    net = gain - price
    taken = {one.number for one in state.readings}
    order = [i for i in np.argsort(-net)[:_AT_ONCE].tolist() if net[i] > 0 and i not in taken]
    chosen: list[Fixed] = []
    for i in (i for i in order if t[i] > t[order[0]] / 4):
        one = m.reading(i)
        if all(np.abs(other.columns.T @ m.system.seen(one.columns)).max(initial=0.0) < _APART for other in chosen):
            chosen.append(one)
    return [Move(float(net[order[0]]), tuple(chosen))] if chosen else []


def _with_all_readings(state: State) -> State:
    """Return the state with the wrong readings that show at the same sizes of the random parts, step by step."""
    while found := _readings(state):
        other = state.plus(found[0].fixed, steps=0)
        if other.score <= state.score:
            break
        state = other
    return state


def _masked_readings(state: State) -> list[Move]:
    """Return the wrong readings that show only together: each of them passes for noise beside the others.

    They are sought where the noise is larger than declared: the worst is taken out, and so on.
    """
    if state.variance < _MASKED or state.random:
        return []
    best, at = state, state
    most = min(_TOGETHER, len(state.measurement.places) // 4)
    for _ in range(most):
        gain, _, t = at.gains_of_readings()
        worst = int(np.argmax(np.where(gain > 0, t, -np.inf)))
        if gain[worst] <= 0 or worst in {one.number for one in at.readings}:
            break
        at = at.plus([state.measurement.reading(worst)])
        best = at if at.score > best.score else best
    new = best.fixed[len(state.fixed) :]
    return [Move(best.score - state.score, new)] if len(new) > 1 else []


def forward(
    state: State, most: int = _MOST, stop: Callable[[State], bool] | None = None, without: tuple[int, ...] = ()
) -> State:
    """Return the state after the moves that raise its score, each the best of those tried, until none does."""
    quiet: set[int] = set()
    for _ in range(most):
        best = _best(state, [one for one in moves(state, quiet) if without not in one.keys])
        if best is None or best.score <= state.score + _GAINED:
            whole = without_weak_random(state)
            if whole is state or whole.score <= state.score + _GAINED:
                break
            best = whole
        state = without_weak_fixed(best.settled())
        if stop is not None and stop(state):
            break
    return state


def _best(state: State, possible: Sequence[Move]) -> State | None:
    """Return the best of the states after moves; where sizes stay as they are, the quick gains are exact."""
    if not possible or possible[0].net <= 0:
        return None
    first, tried = possible[0].net, list[State]()
    for move in possible[:_MOST_TRIED]:
        if move.net < first - max(_NEAR, 0.3 * first):
            break
        made = move.made(state)
        tried.append(_with_all_readings(made) if any(one.is_reading for one in move.fixed) else made)
        if not state.random and move.fixed:
            break
    best = max(tried, key=lambda one: one.score)
    alike = [(one, move) for one, move in zip(tried, possible, strict=False) if one.score > best.score - _ALIKE]
    # a sigma that the job states explains as much as an effect at all places: it is what can be corrected
    given = [one for one, move in alike if move.given]
    # so can an effect, and noise of its place does not say what is wrong there
    names = [one for one, move in alike if move.fixed] if best.measurement is not state.measurement else []
    return next(iter([*given, *names]), best)


def pruned(state: State) -> State:
    """Return the state without the parts that no longer pay, the weakest first."""
    return without_weak_random(without_weak_fixed(state))


def without_weak_fixed(state: State) -> State:
    """Return the state without the effects and wrong readings that no longer pay, the weakest first."""
    while state.fixed:
        nets = state.without_fixed()
        worst = int(np.argmin(nets))
        if nets[worst] > (_SURE if state.random else 0.0):
            break
        other = state.minus([state.fixed[worst]])
        if other.score < state.score:
            break
        state = other
    return state


def without_weak_random(state: State) -> State:
    """Return the state without the random parts that no longer pay, the weakest first.

    Without one of them the sizes of the others change, so these are estimated.
    """
    while state.random:
        weak = [j for j in range(len(state.random)) if _quick(state, j) < 2 * _SURE]
        fewer = max((state.minus([state.random[j]]) for j in weak), key=lambda one: one.score, default=state)
        if fewer.score < state.score or fewer is state:
            break
        state = fewer
    return state


def swapped(state: State) -> State:
    """Return the best state after each random part, and each name, was left out in turn and the search went on without.

    A correlated error of each unit can stand for one cause at one unit, and enters before it.
    """
    for _ in range(_SWAPS):
        better = None
        parts: list[Fixed | Random] = [*state.random, *state.named]
        for one in parts:
            less = state.minus([one])
            own = state.score - less.score
            if own > _CERTAIN or _others_in_turn(less, one) < own / 2:
                continue
            other = forward(less, 3, without=one.key)
            # noise of a place does not say what is wrong there
            noisier = len(other.measurement.noise) > len(state.measurement.noise)
            if other.score > state.score + (_ALIKE if noisier else _GAINED):
                better = other
                break
        if better is None:
            return state
        state = forward(better)
    return state


def _others_in_turn(state: State, but: Fixed | Random) -> float:
    """Return the net gain of the first moves of a state, without those of the part that it has lost.

    What a correlated error of another length or covariate explains instead would change no name.
    """
    found = [one for one in moves(state) if one.net > 0 and but.key not in one.keys]
    if isinstance(but, Random) and but.kind == CORRELATED:
        found = found if any(one.is_cause for one in found[:_TRIED]) else []
    return sum(one.net for one in found[:_TRIED])


def _quick(state: State, number: int) -> float:
    """Return what a random part adds to the score, at the same sizes of the others: at least what it does."""
    logs = state.logs.copy()
    logs[number] = -25.0
    return state.score - replace(state, fit=at_sizes(state, logs), held={}).score - state.random[number].price
