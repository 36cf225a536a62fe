"""What depends on the solution itself, standard deviations and directions of view: found again from each solution."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.adjustment import Control, adjust
from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.solution import Solution

Noise = Callable[[Group, Mapping[str, Block]], Array]
"""Standard deviations (d, n) of a group's readings at the blocks' values"""

Aspect = Callable[[Mapping[str, Block], Observations], Array]
"""A condition of the readings (n,) that follows from where things are, such as the azimuth of a beam"""

_ROUNDS, _STEPS = 20, 200
_SETTLED = 1e-9
"""Standard deviations are found when another round would change none of them by more than this share"""
_STILL = 1e-7
"""Aspects, which are numbers of the order of 1, are found when another round would change none by more than this"""


def adjust_with_iterated_weights(
    blocks: Iterable[Block],
    groups: Sequence[Group],
    noise: tuple[str, Noise],
    datum: Datum | None = None,
    aspects: Mapping[str, Aspect] | None = None,
) -> Solution:
    """Adjust, with the standard deviations of the group `noise[0]` taken from the solution itself, to convergence.

    The weights are constants of each adjustment, so the sum of squares that is least is that of the last weights.
    So are the aspects among the conditions of the group: an effect that depends on them then fixes no frame.
    """
    name, sigma_of = noise
    state = {block.name: block for block in blocks}
    for _ in range(_ROUNDS):
        solution = adjust(state.values(), groups, datum, Control(_STEPS, covariance=False))
        state = dict(solution.blocks)
        found = next(group for group in groups if group.name == name)
        sigma = sigma_of(found, state)
        change = float(np.max(np.abs(sigma / found.observations.sigma - 1), initial=0.0))
        renewed, turned = with_aspects(found, aspects or {}, state)
        groups = [_with_sigma(renewed, sigma) if group.name == name else group for group in groups]
        if not solution.outcome.good or (change < _SETTLED and turned < _STILL):
            break
    return adjust(state.values(), groups, datum, Control(_STEPS))


def with_aspects(group: Group, aspects: Mapping[str, Aspect], blocks: Mapping[str, Block]) -> tuple[Group, float]:
    """Return the group with its aspects as the blocks' values say, and the largest change of one it had before."""
    observations = group.observations
    found = {name: aspect(blocks, observations) for name, aspect in aspects.items()}
    before = observations.conditions
    known = [name for name in found if name in before]
    changes = [float(np.abs(found[name] - before[name]).max(initial=0.0)) for name in known]
    return replace(group, observations=replace(observations, conditions={**before, **found})), max(changes, default=0.0)


def _with_sigma(group: Group, sigma: Array) -> Group:
    return group.with_observations(replace(group.observations, sigma=sigma))
