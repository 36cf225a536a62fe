"""The search: the moves that raise the score of a state, until none does.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from metrocli.diagnosis.evidence.functions import process_bases
from metrocli.diagnosis.evidence.likelihood import fit_at
from metrocli.diagnosis.evidence.moves import Move, causes, effects, moves, readings
from metrocli.diagnosis.evidence.parts import CORRELATED, Fixed, Random
from metrocli.diagnosis.evidence.prices import ALIKE
from metrocli.diagnosis.evidence.refined import refined
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.evidence.variances import correlated_errors
from metrocli.diagnosis.evidence.weights import with_noise
from metrocli.diagnosis.noise import AS_OTHERS, DECLARED_SIGMA

_MOST = 60
_GAINED = 0.05
"""Least gain of the score by a move: a smaller one may come from sizes that have not converged"""
_SURE = 2.5
"""Net evidence below which a part is left out on trial"""
_NEAR = 3.0
"""Moves whose quick net gain is so near to the best are tried"""
_MOST_TRIED = 3
_SWAPS, _CERTAIN, _TRIED = 3, 30.0, 3
"""Rounds of swaps, the net evidence beyond which a part is not tried to be replaced, and by how many others"""

_Tried = tuple[float, Callable[[], State], Move]
"""Score of a move, what makes the state after it, and the move"""


def _with_all_readings(state: State) -> State:
    """Return the state with the wrong readings that show at the same sizes of the random parts, step by step."""
    while wrong := readings(state):
        other = state.plus(wrong[0].fixed, steps=0)
        if other.score <= state.score:
            break
        state = other
    return state


def _with_all_effects(state: State) -> State:
    """Return the state with the effects that show beside it: what a correlated error is to be added to.

    A smooth function of the place in the image contains much of a skew. What it adds to the skew is small. Effects at
    single places are not among them: without that error, many would stand for what scatters at all places.
    """
    while entering := [move for move in effects(state, shared=True) if move.net > 0 and move.is_cause]:
        other = without_weak_fixed(refined(entering[0].made(state), [part.key for part in entering[0].fixed]))
        if other.score <= state.score + _GAINED:
            break
        state = other
    return state


def forward(
    state: State,
    most: int = _MOST,
    stop: Callable[[State], bool] | None = None,
    without: Sequence[Fixed | Random] = (),
    least: float = 0.0,
    since: float | None = None,
) -> State:
    """Return the state after the moves that raise its score, each the best of those tried, until none does.

    `least` is the share of all that was gained by which a move must raise it, counted from a score on, `since`, which
    is that of the state itself unless it is given. Nothing like the parts `without` enters.
    """
    quiet: set[int] = set()
    begin = state.score if since is None else since
    for _ in range(most):
        if state.is_exact or state.measurement.job.budget.spent():
            break
        best = _best(state, [move for move in moves(state, quiet) if not any(map(move.is_like, without))])
        if best is None or best.score <= state.score + max(_GAINED, least * (state.score - begin)):
            whole = without_weak_noise(without_weak_random(state))
            if whole is state or whole.score <= state.score + _GAINED:
                break
            best = whole
        new = {part.key for part in best.named} - {part.key for part in state.named}
        # settled first: a weak part may only have lacked the likeliest sizes of the others
        state = without_weak_fixed(refined(best.settled(), new))
        if stop is not None and stop(state):
            break
    return state


def _best(state: State, possible: Sequence[Move]) -> State | None:
    """Return the best of the states after moves; where sizes stay as they are, the quick gains are exact."""
    if not possible or possible[0].net <= 0:
        return None
    first, tried, named = possible[0].net, list[_Tried](), None
    for move in possible[:_MOST_TRIED]:
        if move.net < first - max(_NEAR, 0.3 * first):
            break
        if any(part.is_reading for part in move.fixed):
            tried.append(_kept(_with_all_readings(move.made(state)), move))
        else:
            tried.append((*move.tried(state), move))
        # tried beside effects and against them: one that enters first takes the place of the effects that it resembles
        if move.is_correlated and named is None:
            named = _with_all_effects(state)
            tried += [_kept(named, move)] if named is not state else []
        if move.is_correlated and named is not None and named is not state:
            tried.append(_kept(move.made(named), move))
        # beside fixed parts alone quick gains are exact, so that the second best cannot be better
        if not state.random and move.fixed:
            break
    best = max(tried, key=lambda trial: trial[0])
    chosen = best[2]
    alike = [trial for trial in tried if trial[0] > best[0] - ALIKE]
    # what the job states can be corrected: its sigma stands before an effect at all places that explains as much
    given = [trial for trial in alike if trial[2].given and not chosen.fixed]
    # so can an effect: noise of its place, or a correlated error, does not say what is wrong there
    says_little = chosen.noise is not None or chosen.has_correlated
    names = [trial for trial in alike if trial[2].is_cause] if says_little else []
    return max(given or names or [best], key=lambda trial: trial[0])[1]()


def _kept(state: State, move: Move) -> _Tried:
    return state.score, lambda: state, move


def against_smooth(state: State) -> State:
    """Return a state that was found without correlated errors with those that show beside its effects.

    They take the place of effects that stand for them.
    """
    m = state.measurement
    if m.knots or not (state.named or state.random):
        return state
    state = state.at(replace(m, knots=tuple(process_bases(m.job, m.system))))
    for _ in range(_SWAPS):
        entering = correlated_errors(state, set(), 1)
        if not entering or entering[0].net <= 0 or m.job.budget.spent():
            break
        other = pruned(refined(Move(entering[0].net, entering=entering[0]).made(state)))
        if other.score <= state.score + _GAINED:
            break
        state = other
    return state


def pruned(state: State) -> State:
    """Return the state without the parts that no longer pay, the weakest first."""
    return without_weak_random(without_weak_fixed(state))


def without_weak_fixed(state: State) -> State:
    """Return the state without the effects and wrong readings that no longer pay, the weakest first."""
    while state.fixed:
        nets = state.without_fixed()
        worst = int(np.argmin(nets))
        # beside random parts a net gain at fixed sizes is an upper bound only, so
        # those a little above 0 are tried as well
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
        # twice the bound for fixed parts: sizes of the other random parts take up more of what goes
        weak = [j for j in range(len(state.random)) if _quick(state, j) < 2 * _SURE]
        fewer = max((state.minus([state.random[j]]) for j in weak), key=lambda trial: trial.score, default=state)
        if fewer.score < state.score or fewer is state:
            break
        state = fewer
    return state


def without_weak_noise(state: State) -> State:
    """Return the state without the noise of a group that has come near to that of the others, if it no longer pays."""
    for number, ratio in state.measurement.noise.items():
        if 1 / AS_OTHERS < ratio < AS_OTHERS:
            other = state.at(with_noise(state.measurement, {number: 1 / ratio}))
            if other.score > state.score:
                return without_weak_noise(other)
    return state


def swapped(state: State, without: Sequence[Fixed | Random] = ()) -> State:
    """Return the best state after each random part, and each name, was left out in turn and the search went on without.

    A correlated error of each unit can stand for one cause at one unit, and enters before it.
    """
    for _ in range(_SWAPS):
        better = _without_given(state, without)
        parts: list[Fixed | Random] = [] if better is not None else [*state.random, *state.named]
        for part in parts:
            if state.measurement.job.budget.spent():
                return state
            less = state.minus([part])
            own = state.score - less.score
            # what could enter instead has to promise half of what goes: a search for less is not worth its time
            if own > _CERTAIN or _others_in_turn(less, part) < own / 2:
                continue
            other = forward(less, 3, without=[part, *without])
            if other.score > state.score + _margin(state, other, part):
                better = other
                break
        if better is None:
            return state
        state = forward(better, without=without)
    return state


def _without_given(state: State, without: Sequence[Fixed | Random]) -> State | None:
    """Return a better state in which given values have the sigma that the job states, if there is one.

    It can stand for one value that is wrong, where much else was wrong as it entered.
    """
    m = state.measurement
    for number in (number for number in m.noise if m.units[number][0] == DECLARED_SIGMA):
        declared = state.at(with_noise(m, {number: 1 / m.noise[number]}))
        other = forward(declared, _TRIED, without=without)
        if other.score > state.score + _GAINED:
            return other
    return None


def _margin(state: State, other: State, gone: Fixed | Random) -> float:
    """Return by how much the score of another state, without some part, has to exceed that of a state.

    Noise of a place, or a correlated error, does not say what is wrong: a state with more effects is preferred to one
    that explains the readings alike.
    """
    if len(other.measurement.noise) > len(state.measurement.noise):
        return ALIKE
    more = len(other.named) - len(state.named)
    if more > 0:
        return -ALIKE if isinstance(gone, Random) and gone.kind == CORRELATED else _GAINED
    return ALIKE if more < 0 else _GAINED


def _others_in_turn(state: State, but: Fixed | Random) -> float:
    """Return the net gain of the first moves of a state, without those of the part that it has lost.

    What a correlated error of another length or covariate explains instead would change no name.
    """
    only_causes = isinstance(but, Random) and but.kind == CORRELATED
    # causes are a part of the moves, and take a part of the time
    if only_causes and not any(cause.net > 0 for cause in causes(state)):
        return 0.0
    entering = [move for move in moves(state) if move.net > 0 and not move.is_like(but)][:_TRIED]
    return sum(move.net for move in entering) if not only_causes or any(move.is_cause for move in entering) else 0.0


def _quick(state: State, number: int) -> float:
    """Return what a random part adds to the score, at the same sizes of the others: at least what it does."""
    logs = state.logs.copy()
    # e^-25 of the noise: as good as left out, and the products stay as they are
    logs[number] = -25.0
    less = replace(state, fit=fit_at(state.fit.products, logs), cache={})
    return state.score - less.score - state.random[number].price
