"""Adjustments in rounds: each starts from what the one before shows of weights, noise or wrong readings.

Method: docs/algorithms/iterated-weights.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Protocol, TypeVar

import numpy as np

from metrocli.adjust.adjustment import StoppingRule, adjust
from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.outcome import Outcome
from metrocli.adjust.robust import Suspects
from metrocli.adjust.solution import Residuals, Solution
from metrocli.arrays import Array, Index, Mask
from metrocli.errors import NoSolutionError, UndeterminedError
from metrocli.frozen import dataclass

Noise = Callable[[Group, Mapping[str, Block]], Array]
"""Function that returns standard deviations (d, n) of a group's readings at the blocks' values"""

Aspect = Callable[[Mapping[str, Block], Observations], Array]
"""Function that returns a condition of the readings (n,) at the present values, e.g. the azimuth of a beam"""

_ROUNDS, _STEPS = 100, 200
"""Most rounds of one step each, and most steps of the adjustment with the weights that they end with"""
_SETTLED = 1e-9
"""The standard deviations have converged when a round changes none of them by more than this fraction"""
_STILL = 1e-7
"""The aspects, numbers of the order of 1, have converged when a round changes none of them by more than this"""


def adjust_with_iterated_weights(
    blocks: Iterable[Block],
    groups: Sequence[Group],
    noise: Mapping[str, Noise],
    datum: Datum | None = None,
    aspects: Mapping[str, Aspect] | None = None,
) -> Solution:
    """Adjust with standard deviations of some groups that are computed from the solution, until they converge.

    The standard deviations are computed again after each step: they change far less than what a step moves. Within the
    last adjustment the weights are constants, so the result is the least-squares solution for the last weights.
    The aspects among the conditions of these groups are constants too: otherwise an effect that depends on a direction
    would fix the orientation of a free network.
    """
    state = {block.name: block for block in blocks}
    for _ in range(_ROUNDS):
        solution = adjust(state.values(), groups, datum, StoppingRule(1, covariance=False))
        state = dict(solution.blocks)
        change = turned = 0.0
        renewed = []
        for group in groups:
            if group.name in noise:
                sigma = noise[group.name](group, state)
                change = max(change, float(np.max(np.abs(sigma / group.observations.sigma - 1), initial=0.0)))
                group, turn = with_aspects(group, aspects or {}, state)
                group = group.with_observations(replace(group.observations, sigma=sigma))
                turned = max(turned, turn)
            renewed.append(group)
        groups = renewed
        failed = solution.outcome not in (Outcome.CONVERGED, Outcome.ITERATION_LIMIT)
        if failed or (change < _SETTLED and turned < _STILL):
            break
    # also after a failure: this adjustment has the covariance and the rank, by which the failure is named
    return adjust(state.values(), groups, datum, StoppingRule(_STEPS))


def with_aspects(group: Group, aspects: Mapping[str, Aspect], blocks: Mapping[str, Block]) -> tuple[Group, float]:
    """Return the group with its aspects at the blocks' values, and the largest change of those it had before."""
    observations = group.observations
    conditions = {name: aspect(blocks, observations) for name, aspect in aspects.items()}
    before = observations.conditions
    # in the first round a group has no aspects yet: then nothing has changed
    known = conditions.keys() & before.keys()
    changes = [float(np.abs(conditions[name] - before[name]).max(initial=0.0)) for name in known]
    group = replace(group, observations=observations.with_conditions(conditions))
    return group, max(changes, default=0.0)


P = TypeVar("P")
S = TypeVar("S")
MOST = 30
"""Rounds after which an iteration that has not ended is left as it is"""
_CHANCE = 1e-2
"""Probability of residuals as large by chance below which they contradict the declared noise"""
_RAISED = 1.1
"""sigma0 from which a raised bound of the tests can hide errors: of many readings, chance exceeds less already"""
_CONTROLLED = 1e-6
"""Redundancy of all readings below which they show nothing of their noise"""


def in_rounds(
    begun: P, solve: Callable[[P], S], renewed: Callable[[P, S], tuple[P, bool]], most: int = MOST
) -> tuple[P, S]:
    """Return the last state of an iteration and its solution.

    `renewed` returns the next state, and whether it has to be solved: readings without the outliers that were found,
    a noise that agrees with the residuals, a new place of linearisation.
    """
    state, solved = begun, solve(begun)
    for _ in range(most):
        state, again = renewed(state, solved)
        if not again:
            break
        solved = solve(state)
    return state, solved


class Adjusted(Protocol):
    """What rounds of removal end with."""

    @property
    def solution(self) -> Solution:
        """The last adjustment."""


A = TypeVar("A", bound=Adjusted)


def undisturbed(solved: Callable[[bool], A]) -> A:
    """Return what rounds of removal end with: from a reweighted start where only this agrees with the declared noise.

    Several gross errors raise sigma0, and with it the bound of each other's tests. `solved` runs the rounds; its
    argument is whether the start is reweighted even if no residual stands out there.
    """
    plain = solved(False)
    if not _contradicts(plain.solution):
        return plain
    try:
        other = solved(True)
    except NoSolutionError:
        return plain
    return plain if _contradicts(other.solution) else other


def _contradicts(solution: Solution) -> bool:
    return solution.p_value < _CHANCE and solution.sigma0 > _RAISED


@dataclass(frozen=True)
class Used:
    """Which of n readings an adjustment uses."""

    tests: Array
    """|w| of each reading that was left out, 0 for those in use, (n,)"""

    @property
    def kept(self) -> Mask:
        """The readings in use, (n,)."""
        return np.asarray(self.tests == 0)

    @property
    def rejected(self) -> Index:
        """The rows of the readings that were left out."""
        return np.flatnonzero(self.tests)

    def without(self, suspects: Suspects, chosen: Index) -> Used:
        """Leave out some of the suspects (places among them), which are numbered by the readings in use."""
        tests = self.tests.copy()
        tests[np.flatnonzero(self.kept)[suspects.rows[chosen]]] = suspects.tests[chosen]
        return replace(self, tests=tests)


def worst_of(suspects: Suspects) -> Index:
    """Return the suspects (places among them) with a test of at least half the largest one.

    A gross error also raises the tests of good readings, but less: these are tested again without it.
    """
    return np.flatnonzero(suspects.tests >= suspects.tests.max(initial=0.0) / 2)


def variance_component(
    groups: Sequence[Residuals], instead: str = "leave out `model`, so that the noise is as declared"
) -> float:
    """Return how many times the declared noise readings have, `sqrt(v'Pv / sum r)` with their redundancy numbers r.

    Raises UndeterminedError if there are no more readings than unknowns; `instead` is what to do then.
    """
    redundancy = np.concatenate([np.zeros(0), *(residuals.redundancy.ravel() for residuals in groups)])
    w = np.concatenate([np.zeros(0), *(residuals.normalised.ravel() for residuals in groups)])
    if not redundancy.sum() > _CONTROLLED:
        raise UndeterminedError(
            "noise: the residuals do not show its size: there are no more readings than unknowns; "
            f"measure more, or {instead}"
        )
    size = float(np.sqrt((redundancy * w**2).sum() / redundancy.sum()))
    # residuals without any noise, as of simulated readings, show no size: the declared noise stays
    return size if size > 0 else 1.0
