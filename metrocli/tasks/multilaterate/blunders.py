"""Gross errors among the lengths of a network: a start that they do not disturb, and the search point by point."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from enum import StrEnum
from itertools import combinations
from random import Random

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.robust import robust_start
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array, Index, Mask
from metrocli.errors import NotConvergedError
from metrocli.frozen import dataclass
from metrocli.instruments import tracer as t
from metrocli.tasks.multilaterate.problem import LENGTHS, TracerNetwork
from metrocli.words import listed

_GROSS = 8.0
"""Misfit, in standard deviations, from which a length cannot be off by chance"""
_MAD = 1.4826
"""Standard deviation of a normal sample over its median absolute deviation"""
_STEPS = 6
"""Gauss-Newton steps from the mover's reading to the intersection of the lengths"""
_TRIED = 3
"""Largest number of wrong lengths that is searched at one point"""
_FEW = 3
"""Wrong lengths are named as the reason if at most one point in so many has some"""
_SAMPLE = 2000
"""Points that a robust start of a large network is found from, if no outliers are removed"""


def most_wrong(lengths: Index) -> Index:
    """Return how many wrong lengths can be identified at a point with n lengths, `(n - 3) / 2` rounded down.

    If more are wrong, the wrong ones may agree among themselves as well as the right ones do. This is the breakdown
    point of every estimate of three unknowns from n readings (Rousseeuw and Leroy 1987).
    """
    return np.maximum(lengths - 3, 0) // 2


class Reason(StrEnum):
    """Why a length is left out, in the words of the result."""

    GROSS = "far off before the adjustment"
    OUTLIER = "outlier"
    ALIKE = "one of the point's lengths is wrong, but cannot be identified"
    UNCHECKED = "too few lengths of the point remain for a check"
    FEW_TRACERS = "fewer than three tracers read the point"
    CONTRADICTED = "the point lost a length, and its other lengths do not meet"


@dataclass(frozen=True)
class Rejected:
    """A length that was left out of the adjustment."""

    row: int
    """Its row among all lengths"""
    test: float
    """|w|, the absolute normalised residual; nan if the length was left out before one was computed"""
    reason: Reason


def far_off(network: TracerNetwork, state: Mapping[str, Block]) -> dict[int, Rejected]:
    """Return the lengths with gross errors, by row, for tracers at the places in `state`.

    At a point whose lengths do not meet in one place, the smallest set is taken without which the others meet. If
    several sets of that size qualify, or no set of up to three does, all lengths of the point are taken.
    """
    observations = network.lengths.observations
    point = observations.index[t.POINT]
    suspicious, bound, _ = _suspicious(network, state)
    tracers = state[t.TRACER].values[observations.index[t.TRACER]]
    out: dict[int, Rejected] = {}
    for i in suspicious:
        rows = np.flatnonzero(point == i)
        sight = _Sight(network.nominal[i], tracers[rows], observations.readings[0, rows], observations.stds[0, rows])
        wrong = _wrong(sight, bound)
        reason = Reason.GROSS if len(wrong) < len(rows) else Reason.ALIKE
        out |= {int(row): Rejected(int(row), float("nan"), reason) for row in rows[wrong]}
    return out


def _suspicious(network: TracerNetwork, state: Mapping[str, Block]) -> tuple[Index, float, float]:
    """Return the points whose lengths do not meet, the bound of their sums of squares, and the median |misfit|."""
    observations = network.lengths.observations
    miss = network.lengths.residuals(state)[0] / observations.stds[0]
    typical = float(np.median(np.abs(miss)))
    # of the sum of squares: below it no single length of a point can be gross
    bound = (_GROSS * max(1.0, _MAD * typical)) ** 2
    squares = np.bincount(observations.index[t.POINT], miss**2, len(network.nominal))
    return np.flatnonzero((squares > bound) & network.unknown), bound, typical


def not_converged(network: TracerNetwork, state: Mapping[str, Block], solution: Solution) -> NotConvergedError:
    """Return the error of an adjustment that did not converge from a robust start.

    It names the points whose lengths do not meet there, if those of most points do.
    """
    outcome = f"{solution.outcome.value} ({solution.iterations} steps)"
    points, _, typical = _suspicious(network, state)
    if not 0 < _FEW * len(points) <= int((network.seen > 0).sum()):
        return NotConvergedError(outcome, solution.misfit)
    names = listed([network.blocks[t.POINT].members[point] for point in points.tolist()])
    return NotConvergedError(
        f"{outcome}: the lengths of {len(points)} points do not meet, those of all others do: {names}; "
        "`outliers: remove` leaves wrong lengths out",
        typical,
    )


@dataclass(frozen=True)
class _Sight:
    """All lengths to one point, from tracers at known places."""

    near: Array
    """Approximate place of the point, (3,)"""
    tracers: Array
    """x0, y0, z0, dead path and scale of the tracer of each length, (m, 5)"""
    lengths: Array
    sigma: Array

    def misfit(self, chosen: list[int]) -> float:
        """Return the weighted sum of squares of the chosen lengths at the point that fits them best."""
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
    """Return the smallest set of lengths without which the others meet within the bound; all if it is not unique."""
    everything = list(range(len(sight.lengths)))
    if sight.misfit(everything) <= bound:
        return []
    for size in range(1, min(_TRIED, int(most_wrong(np.array(len(everything))))) + 1):
        serving = [
            chosen
            for chosen in combinations(everything, size)
            if sight.misfit([i for i in everything if i not in chosen]) <= bound
        ]
        # two sets that serve equally well identify neither, so the whole point is left out
        # (docs/decisions/013-points-that-lost-lengths.md)
        if serving:
            return list(serving[0]) if len(serving) == 1 else everything
    return everything


def undisturbed_start(network: TracerNetwork, always: bool = False) -> dict[str, Block]:
    """Return the values of the blocks near the solution, undisturbed by gross errors (`robust_start`)."""
    groups = [network.lengths, *network.others]
    return robust_start(network.blocks.values(), groups, (LENGTHS,), network.datum, always=always)


def quick_start(network: TracerNetwork) -> dict[str, Block]:
    """Return a start of a network; that of a large one comes from some of its points, which place the tracers.

    Points with a prior, a calibrated distance or a known place stay. With effects, all do: an effect may act on few.
    """
    seen = network.seen > 0
    ours = np.flatnonzero(network.unknown & seen)
    if len(ours) <= 2 * _SAMPLE or network.effects:
        return undisturbed_start(network)
    kept = np.ones(len(seen), dtype=bool)
    kept[ours] = False
    # always the same sample: a job has one result (docs/tasks/multilaterate.md#speed)
    kept[Random(0).sample(ours.tolist(), _SAMPLE)] = True
    if not network.unknown[seen].all():  # other groups use the numbers of the points
        return undisturbed_start(network.only(kept[network.lengths.observations.index[t.POINT]]))
    return _of_some(network, np.flatnonzero(kept & seen))


def _of_some(network: TracerNetwork, chosen: Index) -> dict[str, Block]:
    """Return a start found from the chosen points alone, which only lengths use; the other points stay as they are."""
    block, datum, lengths = network.blocks[t.POINT], network.datum, network.lengths
    number = np.full(len(block.members), -1)
    number[chosen] = np.arange(len(chosen))
    point = number[lengths.observations.index[t.POINT]]
    some = lengths.observations.selected(point >= 0).with_index({t.POINT: point[point >= 0]})
    names = tuple(block.members[i] for i in chosen)
    fewer = replace(block, values=block.values[chosen], members=names, free=block.free[chosen])
    if datum is not None:
        datum = replace(datum, reference=datum.reference[chosen], members=datum.members[chosen])
    groups = [lengths.with_observations(some), *network.others]
    start = robust_start([fewer, *_others(network.blocks)], groups, (LENGTHS,), datum)
    values = block.values.copy()
    values[chosen] = start[t.POINT].values
    return {**start, t.POINT: block.with_values(values)}


def _others(blocks: Mapping[str, Block]) -> list[Block]:
    return [block for name, block in blocks.items() if name != t.POINT]


def brought_back(network: TracerNetwork, state: Mapping[str, Block], gross: Mapping[int, Rejected]) -> dict[str, Block]:
    """Return the start with points that have gross errors moved back to the mover's readings."""
    rows = network.lengths.observations.index[t.POINT][list(gross)]
    block = state[t.POINT]
    values = block.values.copy()
    # a wrong length has moved its point to where the others alone would not find back
    values[rows] = network.nominal[rows]
    return {**state, t.POINT: replace(block, values=values)}


def too_few(network: TracerNetwork) -> dict[int, Rejected]:
    """Return the lengths of points that fewer than three tracers read."""
    few = ((network.seen < 3) & network.unknown)[network.lengths.observations.index[t.POINT]]
    return {int(row): Rejected(int(row), float("nan"), Reason.FEW_TRACERS) for row in np.flatnonzero(few)}


def unchecked(network: TracerNetwork, keep: Mask) -> Mask:
    """Return which lengths belong to points that lost so many that the others cannot be trusted, (n,)."""
    point = network.lengths.observations.index[t.POINT]
    lost = network.seen - np.bincount(point, keep, minlength=len(network.nominal))
    gone = (lost > most_wrong(network.seen)) & network.unknown
    return np.asarray(gone[point])
