"""Noise that depends on what is measured: standard deviations found again from the adjusted model."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.adjustment import Control, adjust
from metrocli.adjust.blocks import Array, Block
from metrocli.adjust.datum import Datum
from metrocli.adjust.groups import Group
from metrocli.adjust.solution import Solution

Noise = Callable[[Group, Mapping[str, Block]], Array]
"""Standard deviations (d, n) of a group's readings at the blocks' values"""

_ROUNDS, _STEPS = 20, 200
_SETTLED = 1e-9
"""Standard deviations are found when another round would change none of them by more than this share"""


def adjust_with_noise(
    blocks: Iterable[Block], groups: Sequence[Group], noise: tuple[str, Noise], datum: Datum | None = None
) -> Solution:
    """Adjust, with the standard deviations of the group `noise[0]` taken from the solution itself, to convergence.

    The weights are constants of each adjustment, so the sum of squares that is least is that of the last weights.
    """
    name, sigma_of = noise
    state = {block.name: block for block in blocks}
    for _ in range(_ROUNDS):
        solution = adjust(state.values(), groups, datum, Control(_STEPS, covariance=False))
        state = dict(solution.blocks)
        found = next(group for group in groups if group.name == name)
        sigma = sigma_of(found, state)
        change = float(np.max(np.abs(sigma / found.observations.sigma - 1), initial=0.0))
        groups = [_with_sigma(group, sigma) if group.name == name else group for group in groups]
        if not solution.outcome.good or change < _SETTLED:
            break
    return adjust(state.values(), groups, datum, Control(_STEPS))


def _with_sigma(group: Group, sigma: Array) -> Group:
    return group.with_observations(replace(group.observations, sigma=sigma))
