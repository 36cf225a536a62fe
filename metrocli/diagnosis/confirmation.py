"""What a state keeps of what it has found: that which held-out readings confirm.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from metrocli.diagnosis.adjusted_job import AdjustedJob, Ordered
from metrocli.diagnosis.evidence.folds import gain_of_parts, gains, least_sure, with_jackknife
from metrocli.diagnosis.evidence.gain import Gain
from metrocli.diagnosis.evidence.identified import IdentifiedEffect, all_identified
from metrocli.diagnosis.evidence.parts import SCATTER, Random
from metrocli.diagnosis.evidence.search import forward
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.explanations import effect_of
from metrocli.diagnosis.findings import Unconfirmed
from metrocli.diagnosis.rounds import searched_from

Spot = tuple[str, tuple[str, ...]]
"""Cause and place of an effect"""


def with_confirmed_effects(
    state: State, ordered: Ordered, quick: bool
) -> tuple[State, tuple[IdentifiedEffect, ...], list[Gain], tuple[Unconfirmed, ...]]:
    """Return the state without what held-out readings speak against, its effects with their gains, and what it lost.

    The log score of held-out readings and the net evidence of all are logarithms of odds: an effect stays while their
    sum, or in a quick diagnosis the score, is positive. Effects whose sizes may be nothing leave one by one. The search
    goes on without what has left: the cause that it stood for may be one that the readings confirm.
    """
    lost, refuted, everywhere = list[Unconfirmed](), set[Spot](), list[Random]()
    left = set[Spot]()
    while True:
        if smooth := [] if quick else not_confirmed(state):
            lost += [what for _, what in smooth]
            everywhere += [part for part, _ in smooth]
            state = forward(state.minus([part for part, _ in smooth]), without=everywhere)
            continue
        names = all_identified(state) if quick else with_jackknife(state, all_identified(state))
        gained = gains(state, names, ordered, nested=not quick) if names else []
        judged = list(zip(state.named, names, gained, strict=False))
        nets = dict(zip((part.key for part in state.fixed), state.without_fixed().tolist(), strict=True))
        against = [effect for effect in judged if effect[2].log_score + (0.0 if quick else nets[effect[0].key]) <= 0]
        unsure = None if against else least_sure(state, names, {e[0].key for e in judged if not e[2].shown})
        leaving = against or [effect for effect in judged if effect[0] is unsure]
        if not leaving:
            return state, names, gained, tuple(lost)
        lost += [
            Unconfirmed(str(name.alternative), gain.log_score, None if unsure is None else name.level_of_size)
            for _, name, gain in leaving
        ]
        left |= {name.alternative.spot for _, name, _ in leaving}
        refuted |= {name.alternative.spot for _, name, _ in against}
        less = _refuting(state.minus([part for part, _, _ in leaving]), left)
        # one whose size may be nothing beside others can still be what one of them stands for: it stays a rival
        state = _refuting(forward(less, without=everywhere), refuted)


def _refuting(state: State, effects: Collection[Spot]) -> State:
    """Return a state in which nothing names some effects any more."""
    return replace(state, measurement=state.measurement.refuting(effects), cache={})


def with_confirmed(job: AdjustedJob, state: State, quick: bool = False) -> tuple[State, list[Unconfirmed]]:
    """Return the state without the effects at all their places that held-out readings do not confirm, and these.

    The search goes on without them: the cause that they stood for may be one that the readings confirm.
    """
    lost, gone = list[Unconfirmed](), list[Random]()
    while against := not_confirmed(state):
        parts = [part for part, _ in against]
        lost, gone = [*lost, *(what for _, what in against)], [*gone, *parts]
        state = searched_from(job, state.minus(parts), quick, gone)
    return state, lost


def not_confirmed(state: State) -> list[tuple[Random, Unconfirmed]]:
    """Return the effects at all their places that held-out readings do not confirm.

    A smooth one fits whatever readings share, so that its gain has to be shown.
    """
    lost: list[tuple[Random, Unconfirmed]] = []
    for part in (part for part in state.random if part.kind == SCATTER):
        gain, effect = gain_of_parts(state, [part]), effect_of(state, part)
        if not (gain.shown if effect.is_smooth else gain.log_score > 0):
            lost.append((part, Unconfirmed(f"{effect.name} {effect.everywhere}", gain.log_score)))
    return lost
