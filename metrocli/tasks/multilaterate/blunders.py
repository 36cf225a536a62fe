"""Gross errors among the lengths of a network, found point by point before the adjustment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.observations import Index
from metrocli.instruments import tracer as t
from metrocli.tasks.multilaterate.problem import Network

_GROSS = 8.0
"""Misfit beyond all chance, in standard deviations"""
_MAD = 1.4826
"""Standard deviation of a normal sample over its median absolute deviation"""
_STEPS = 6
"""Gauss-Newton steps from the mover's reading to the point"""
_TRIED = 3
"""Wrong lengths of one point that are looked for at most"""


def most_wrong(lengths: Index) -> Index:
    """Return how many wrong lengths of a point of so many can be told from right ones, `(n - 3) / 2`.

    With more the wrong ones may agree among themselves as well as the right ones do: the breakdown of every estimate of
    three unknowns from n readings (Rousseeuw and Leroy 1987).
    """
    return np.maximum(lengths - 3, 0) // 2


@dataclass(frozen=True)
class Rejected:
    """A length that was left out."""

    row: int
    test: float
    """|w|, nan where it was left out before there was one"""
    reason: str


def far_off(network: Network, state: Mapping[str, Block]) -> dict[int, Rejected]:
    """Return lengths that are off beyond all chance, by row, with the tracers where `state` has them.

    Of each point whose lengths do not meet in one place the fewest are taken without which the rest do; all of them
    where several choices would serve.
    """
    observations = network.lengths.observations
    point = observations.index[t.POINT]
    miss = network.lengths.residuals(state)[0] / observations.sigma[0]
    bound = (_GROSS * max(1.0, _MAD * float(np.median(np.abs(miss))))) ** 2
    suspicious = np.flatnonzero((np.bincount(point, miss**2, len(network.nominal)) > bound) & network.unknown)
    tracers = state[t.TRACER].values[observations.index[t.TRACER]]
    out: dict[int, Rejected] = {}
    for i in suspicious:
        rows = np.flatnonzero(point == i)
        sight = _Sight(network.nominal[i], tracers[rows], observations.readings[0, rows], observations.sigma[0, rows])
        wrong = _wrong(sight, bound)
        reason = "gross" if len(wrong) < len(rows) else "alike"
        out |= {int(row): Rejected(int(row), float("nan"), reason) for row in rows[wrong]}
    return out


@dataclass(frozen=True)
class _Sight:
    """The lengths to one point from tracers of known place."""

    near: Array
    """Where the point is about, (3,)"""
    tracers: Array
    """(m, 5)"""
    lengths: Array
    sigma: Array

    def misfit(self, chosen: list[int]) -> float:
        """Return the sum of squares of the chosen lengths in the place where they meet best."""
        place, tracers, sigma = self.near, self.tracers[chosen], self.sigma[chosen]
        for _ in range(_STEPS):
            away = place - tracers[:, :3]
            distance = np.linalg.norm(away, axis=1)
            miss = (self.lengths[chosen] + tracers[:, 3] - tracers[:, 4] * distance) / sigma
            towards = away * (tracers[:, 4] / (distance * sigma))[:, None]
            step = np.linalg.lstsq(towards, miss, rcond=None)[0]
            place = place + step
        return float(((miss - towards @ step) ** 2).sum())


def _wrong(sight: _Sight, bound: float) -> list[int]:
    """Return the fewest lengths of a point without which the rest meet within the bound; all if that cannot be told."""
    everything = list(range(len(sight.lengths)))
    if sight.misfit(everything) <= bound:
        return []
    for size in range(1, min(_TRIED, int(most_wrong(np.array(len(everything))))) + 1):
        serving = [
            chosen
            for chosen in combinations(everything, size)
            if sight.misfit([i for i in everything if i not in chosen]) <= bound
        ]
        if serving:
            return list(serving[0]) if len(serving) == 1 else everything
    return everything
