"""Solution of a network of lengths: robust start, weights from the adjusted paths, and treatment of outliers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np

from metrocli.adjust.adjustment import covariance_at
from metrocli.adjust.medians import median
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.robust import as_likely, critical_value
from metrocli.adjust.rounds import adjust_with_iterated_weights, in_rounds, undisturbed
from metrocli.adjust.solution import Residuals, Solution, residuals_of
from metrocli.arrays import Array, Mask, extents
from metrocli.effects.estimates import absorbed
from metrocli.errors import NotConvergedError, UndeterminedError
from metrocli.frozen import dataclass
from metrocli.instruments import tracer as t
from metrocli.tasks.multilaterate.blunders import (
    Reason,
    Rejected,
    brought_back,
    far_off,
    not_converged,
    quick_start,
    too_few,
    unchecked,
    undisturbed_start,
)
from metrocli.tasks.multilaterate.layout_faults import APART, explained, must_carry
from metrocli.tasks.multilaterate.problem import LENGTHS, TracerNetwork
from metrocli.tasks.multilaterate.uncontrolled import EQUAL, at_others, noise_of_tests, second_places, units_of_tests
from metrocli.tasks.shared.lengths import with_repeatability
from metrocli.tasks.shared.lists import name_of
from metrocli.tasks.shared.mirror import Mirrored, must_be_decided

_TOSS = 0.5
"""Difference of squared tests of two lengths below which the odds are under e^(1/4) = 1.3 to 1"""
_INNOCENT = 3.0
"""A length left out at the start is used again if its residual is less than this many standard deviations"""
_ASTRAY = 0.05
"""A solution is wrong if the median point is farther from the mover's reading than this share of the volume"""
_DOUBT = 0.05
"""Level of significance of the test of the remaining lengths at a point that lost some"""
_NO_PLACES = "the adjustment ended in a wrong place: give approximate places of the tracers in `inputs: tracers`"
_DELAY = ", or all lengths share a large error, such as a delay: `effects: [{name: length-offset}]` estimates it"
"""Why points are far from their list: with and without listed places of all tracers, and if lengths are absolute"""
_POINTS_NEAR, _TRACERS_NEAR = 0.02, 0.5
"""Plausible deviations of points and tracers from their lists, as shares of the measured volume"""
_NOISY = 3.0
"""Standard deviations of a length by which points may lie farther from their list"""
_SMALL_ENOUGH = 1000
"""Networks of up to so many points are checked for determinacy before they are adjusted"""


@dataclass(frozen=True)
class SuspectedLength:
    """A wrong length, or a point with a wrong length that cannot be identified."""

    point: str
    tracer: str
    """Empty if the length cannot be identified"""
    test: float
    """|w|"""
    others: tuple[str, ...]
    """Other tracers whose length explains the misfit nearly as well; all candidates if `tracer` is empty"""
    rows: tuple[int, ...]
    """Rows of the candidates for the wrong length"""


@dataclass(frozen=True)
class AdjustedTracers:
    """An adjusted network, with the lengths that were left out."""

    network: TracerNetwork
    """The network of the lengths used"""
    whole: TracerNetwork
    """The network of all lengths"""
    solution: Solution
    residuals: Residuals
    rejected: tuple[Rejected, ...]
    suspects: tuple[SuspectedLength, ...]
    critical: float
    """Bound of |w| for an outlier"""

    @property
    def group(self) -> Group:
        """The lengths used, with their final weights."""
        return self.solution.group(LENGTHS)

    @property
    def read(self) -> tuple[Residuals, ...]:
        """The residuals of all readings."""
        return (self.residuals,)

    @cached_property
    def second(self) -> list[Mirrored]:
        """Points and tracers with a second place that fits as well."""
        return second_places(self.network, self.solution, noise_of_tests(self.solution))

    @property
    def list_offset(self) -> float:
        """How far points and tracers lie from their lists, relative to the plausible deviation.

        The points have a root mean square, the tracers a median; the larger ratio counts. 0 where tracers are known.
        """
        network, blocks = self.whole, self.solution.blocks
        if network.surveyed:
            return 0.0
        seen = network.seen > 0
        extent = float(extents(network.nominal[seen]).max()) or 1.0
        off = network.nominal[seen] - blocks[t.POINT].values[seen]
        points = float(np.sqrt((off**2).sum(axis=1).mean()))
        apart = np.linalg.norm(network.listed_at - blocks[t.TRACER].values[:, :3], axis=1)
        finite = apart[np.isfinite(apart)]
        tracers = float(median(finite)) / extent if finite.size else 0.0
        return max(points / (_POINTS_NEAR * extent + _noise_of(network)), tracers / _TRACERS_NEAR)


def solve(network: TracerNetwork, remove: bool, tested: bool = True) -> AdjustedTracers:
    """Adjust the network from a robust start; with `remove`, leave outliers out.

    If not `tested`, only lengths that are identified as far off there: an unknown cause makes many other outliers.

    Raises UndeterminedError if the layout does not determine the points, NotConvergedError if the adjustment does not
    converge or converges far from the mover's readings.
    """
    if remove and tested:
        return undisturbed(lambda always: _solved(network, True, True, always))
    return _solved(network, remove, tested)


def _solved(network: TracerNetwork, remove: bool, tested: bool, always: bool = False) -> AdjustedTracers:
    out = too_few(network) if remove else {}
    start = network.only(_kept(network, out))
    groups = [start.lengths, *start.others]
    if network.effects:
        # before the start: an absorbed effect could become very large there
        _must_see_effects(start, covariance_at(start.blocks.values(), groups, start.datum))
    state = undisturbed_start(start, always) if remove else quick_start(start)
    # of a large network only the adjustment is checked: this costs nearly as much as it does
    if len(network.nominal) <= _SMALL_ENOUGH:
        must_carry(start, covariance_at(state.values(), groups, start.datum), network)
    gross = far_off(network, state) if remove else {}
    gross = gross if tested else {row: each for row, each in gross.items() if each.reason is Reason.GROSS}
    begun = _KeptLengths(brought_back(network, state, gross), gross | out, bool(gross))

    def fewer(used: _KeptLengths, solved: AdjustedTracers) -> tuple[_KeptLengths, bool]:
        state, worst = solved.solution.blocks, _worst(solved) if remove and tested else {}
        # once, and when nothing else is wrong: else lengths could go and come back for ever
        if used.back and not worst:
            return _KeptLengths(state, _with_reinstated(solved, used.out), False), True
        more = worst or (_doubtful(solved) if used.out and tested else {})
        return _KeptLengths(state, used.out | more, used.back), bool(more)

    used, solved = in_rounds(begun, lambda used: _adjusted(network, used.state, used.out), fewer)
    better = [mirrored for mirrored in solved.second if mirrored.better and not mirrored.decided]
    solved = _adjusted(network, at_others(solved.solution.blocks, better), used.out) if better else solved
    must_be_decided(solved.second, solved.solution.sigma0)
    return solved


@dataclass(frozen=True)
class _KeptLengths:
    """Values to start from, the lengths to leave out, and whether some of these may fit and come back."""

    state: Mapping[str, Block]
    out: dict[int, Rejected]
    back: bool


def refitted(network: TracerNetwork, keep: Mask) -> Solution:
    """Adjust a network to some of its lengths, from the present values, with weights from the adjusted paths."""
    return _weighted(network.only(keep))


def _adjusted(network: TracerNetwork, state: Mapping[str, Block], out: dict[int, Rejected]) -> AdjustedTracers:
    keep = _kept(network, out)
    lost = unchecked(network, keep) & keep
    keep &= ~lost
    used = network.only(keep)
    blocks = {name: replace(block, free=used.blocks[name].free) for name, block in state.items()}
    used, solution = with_repeatability(used.with_blocks(blocks), _weighted, LENGTHS)
    network = replace(network, noise=used.noise)
    must_carry(used, solution, network)
    if not solution.outcome.good:
        raise not_converged(used, state, solution)
    _must_be_near(used, solution)
    rejected = [*out.values(), *(Rejected(int(row), float("nan"), Reason.UNCHECKED) for row in np.flatnonzero(lost))]
    group = solution.group(LENGTHS)
    residuals, critical = residuals_of(solution, group), critical_value(group.observations.count)
    suspects = _suspects(group, np.abs(residuals.normalised[0]), units_of_tests(solution, residuals), critical)
    rows = np.flatnonzero(keep)
    suspects = tuple(replace(suspect, rows=tuple(rows[list(suspect.rows)].tolist())) for suspect in suspects)
    return AdjustedTracers(used, network, solution, residuals, tuple(rejected), suspects, critical)


def _weighted(network: TracerNetwork) -> Solution:
    """Return the adjustment from the present values, with weights from the adjusted paths."""
    groups, noise = [network.lengths, *network.others], {LENGTHS: network.noise}
    return adjust_with_iterated_weights(network.blocks.values(), groups, noise, network.datum, network.aspects)


def _kept(network: TracerNetwork, out: Mapping[int, Rejected]) -> Mask:
    keep = np.ones(network.lengths.observations.count, dtype=bool)
    keep[list(out)] = False
    return keep


def _must_see_effects(network: TracerNetwork, solution: Solution) -> None:
    """Raise UndeterminedError if the other unknowns absorb an effect; the adjustment could make it very large."""
    if solution.undetermined and absorbed(network.effects, solution, network.datum):
        raise UndeterminedError(explained(network, solution), solution.misfit)


def _must_be_near(network: TracerNetwork, solution: Solution) -> None:
    """Raise NotConvergedError if the solution is far from the mover's readings, such as the mirror image."""
    if network.surveyed:
        return
    seen = network.seen > 0
    away = np.linalg.norm(solution.blocks[t.POINT].values[seen] - network.nominal[seen], axis=1)
    middle = float(median(away))
    if middle > _ASTRAY * extents(network.nominal[seen]).max() + _noise_of(network):
        spreads = (places[seen].var(axis=0).sum() for places in (solution.blocks[t.POINT].values, network.nominal))
        size = np.sqrt(np.divide(*spreads))
        scaled = f"the points found are {size:.2g} times as far apart as those of the list: check units and scales"
        placed = APART + _DELAY * network.absolute if np.isfinite(network.listed_at).all() else _NO_PLACES
        why = scaled if abs(size - 1) > _ASTRAY else placed
        raise NotConvergedError(f"the points found lie {middle:.4g} mm from their listed places (median): {why}")


def _noise_of(network: TracerNetwork) -> float:
    """Return how far noise alone may move points of a network [mm]."""
    return _NOISY * float(median(network.lengths.observations.deviations.ravel()))


def _doubtful(solved: AdjustedTracers) -> dict[int, Rejected]:
    """Return the lengths of points that lost some and whose others fail a chi-square test at 5 %, each point by itself.

    Where one length is wrong, a second is likely, and two wrong ones may look like a single other one. `v'Pv` of the
    remaining lengths reveals this.
    """
    from scipy.special import chdtri

    point, left = solved.group.observations.index[t.POINT], solved.network.seen
    # only points that lost some: a test at 5 % of all others would leave out right ones
    lost = (left < solved.whole.seen) & (left > 3) & solved.network.unknown
    sigma = solved.residuals.sigma[0] * noise_of_tests(solved.solution)
    misfit = np.bincount(point, (solved.residuals.values[0] / sigma) ** 2, len(left))
    bad = lost & (misfit > chdtri(np.maximum(left - 3, 1), _DOUBT))
    used = np.delete(np.arange(solved.whole.lengths.observations.count), [rejected.row for rejected in solved.rejected])
    return {int(row): Rejected(int(row), float("nan"), Reason.CONTRADICTED) for row in used[bad[point]]}


def _suspects(group: Group, w: Array, units: Array, bound: float) -> tuple[SuspectedLength, ...]:
    """Return the worst length of each point that has a test beyond the bound, the largest first."""
    point = group.observations.index[t.POINT]
    keys = group.observations.keys
    suspects = []
    for i in sorted(set(point[w > bound * units].tolist())):
        rows = np.flatnonzero(point == i)
        tests = w[rows] / units[rows].min()
        worst = int(rows[np.argmax(tests)])
        alike = (tests >= (1 - EQUAL) * tests.max()) | (tests**2 > tests.max() ** 2 - _TOSS)
        decided = alike.sum() == 1
        suspects.append(
            SuspectedLength(
                keys["point"][worst],
                keys["tracer"][worst] if decided else "",
                float(tests.max()),
                tuple(name_of(keys, "tracer", row) for row in rows[as_likely(tests**2)] if row != worst or not decided),
                (worst,) if decided else tuple(rows[alike].tolist()),
            )
        )
    return tuple(sorted(suspects, key=lambda suspect: -suspect.test))


def _worst(solved: AdjustedTracers) -> dict[int, Rejected]:
    """Return the lengths to leave out next: suspects with at least half of the largest test.

    Smaller ones may only be the effect of larger errors and are tested again in the next adjustment.
    """
    most = max((suspect.test for suspect in solved.suspects), default=0.0)
    chosen = [suspect for suspect in solved.suspects if suspect.test >= most / 2]
    reason = {True: Reason.OUTLIER, False: Reason.ALIKE}
    return {
        row: Rejected(row, suspect.test, reason[bool(suspect.tracer)]) for suspect in chosen for row in suspect.rows
    }


def _with_reinstated(solved: AdjustedTracers, out: dict[int, Rejected]) -> dict[int, Rejected]:
    """Return the lengths that stay out; those left out at the start that fit the solution are used again."""
    observations = solved.whole.lengths.observations
    miss: Array = solved.whole.lengths.residuals(solved.solution.blocks)[0] / observations.stds[0]
    alive = solved.network.seen[observations.index[t.POINT]] > 0
    return {row: rejected for row, rejected in out.items() if not (alive[row] and abs(miss[row]) < _INNOCENT)}
