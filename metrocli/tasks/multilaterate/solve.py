"""Solving a network of lengths: weights from the adjusted paths, gross errors held off, named or left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from metrocli.adjust.adjustment import covariance_at
from metrocli.adjust.iterated_weights import adjust_with_iterated_weights
from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Mask
from metrocli.adjust.robust import critical_value, robust_start
from metrocli.adjust.solution import Residuals, Solution, residuals_of
from metrocli.effects.estimates import absorbed
from metrocli.errors import NotConvergedError, UndeterminedError
from metrocli.instruments import tracer as t
from metrocli.tasks.multilaterate.blunders import Rejected, far_off, most_wrong
from metrocli.tasks.multilaterate.layout_faults import carries, explained
from metrocli.tasks.multilaterate.problem import LENGTHS, Network

_EQUAL = 1e-4
"""Tests of a point that differ by less than this share are the same test"""
_ODDS, _TOSS = 4.0, 0.5
"""Tests whose squares differ by less leave odds below e^2 = 7 to 1, or e^(1/4) = 1.3 to 1, between two lengths"""
_INNOCENT = 3.0
"""A length left out at the start comes back if it misses by less than this many standard deviations"""
_ASTRAY = 0.05
"""Points further from the mover's readings than this share of the volume are a wrong solution"""
_DOUBT = 0.05
"""Level at which the lengths left of a point that lost some must meet"""
_ROUNDS = 30
_SMALL_ENOUGH = 1000
"""Networks of up to so many points are looked at before they are adjusted"""


@dataclass(frozen=True)
class Suspect:
    """A length that is wrong, or a point of which one length is and none can be told."""

    point: str
    tracer: str
    """Empty where it cannot be told"""
    test: float
    """|w|"""
    others: tuple[str, ...]
    """Tracers whose length explains the point nearly as well; all that might be it where it cannot be told"""
    rows: tuple[int, ...]
    """The lengths that it could be"""


@dataclass(frozen=True)
class Solved:
    """An adjusted network with what was left out on the way."""

    network: Network
    """Of the lengths that were used"""
    whole: Network
    solution: Solution
    residuals: Residuals
    rejected: tuple[Rejected, ...]
    suspects: tuple[Suspect, ...]
    critical: float

    @property
    def group(self) -> Group:
        """The lengths that were used, with the weights they were given."""
        return next(group for group in self.solution.groups if group.name == LENGTHS)


def solve(network: Network, remove: bool) -> Solved:
    """Adjust with a robust start; leave outliers out where `remove` says so.

    Raises UndeterminedError where the layout cannot carry the answer, NotConvergedError where no solution was found.
    """
    out = _too_few(network) if remove else {}
    start = network.only(_kept(network, out))
    groups = [start.lengths, *start.others]
    if network.effects:
        _must_see_effects(start, covariance_at(start.blocks.values(), groups, start.datum))
    state = robust_start(start.blocks.values(), groups, LENGTHS, start.datum)
    if len(network.nominal) <= _SMALL_ENOUGH:
        _must_carry(start, covariance_at(state.values(), groups, start.datum))
    gross = far_off(network, state) if remove else {}
    state = _brought_back(network, state, gross)
    out, back = gross | out, bool(gross)
    for _ in range(_ROUNDS):
        solved = _adjusted(network, state, out)
        state = dict(solved.solution.blocks)
        worst = _worst(solved) if remove else {}
        if back and not worst:
            out, back = _without_innocent(solved, out), False
            continue
        more = worst or (_doubtful(solved) if out else {})
        if not more:
            break
        out |= more
    return solved


def _brought_back(network: Network, state: Mapping[str, Block], gross: Mapping[int, Rejected]) -> dict[str, Block]:
    """Return the start with points that gross errors may have carried away where the mover says they are."""
    rows = np.unique(network.lengths.observations.index[t.POINT][list(gross)])
    block = state[t.POINT]
    values = block.values.copy()
    values[rows] = network.nominal[rows]
    return {**state, t.POINT: replace(block, values=values)}


def refitted(network: Network, keep: Mask) -> Solution:
    """Adjust a network from where its blocks are to some of its lengths, with weights from the adjusted paths."""
    used = network.only(keep)
    groups = [used.lengths, *used.others]
    noise = (LENGTHS, network.noise)
    return adjust_with_iterated_weights(used.blocks.values(), groups, noise, used.datum, network.aspects)


def _adjusted(network: Network, state: Mapping[str, Block], out: dict[int, Rejected]) -> Solved:
    keep = _kept(network, out)
    lost = _unchecked(network, keep) & keep
    keep &= ~lost
    used = network.only(keep)
    blocks = {name: replace(block, free=used.blocks[name].free) for name, block in state.items()}
    groups = [used.lengths, *used.others]
    solution = adjust_with_iterated_weights(
        blocks.values(), groups, (LENGTHS, network.noise), used.datum, network.aspects
    )
    _must_carry(used, solution)
    if not solution.outcome.good:
        raise NotConvergedError(f"{solution.outcome.value} ({solution.iterations} steps)")
    _must_be_near(used, solution)
    rejected = [*out.values(), *(Rejected(int(row), float("nan"), "point") for row in np.flatnonzero(lost))]
    group = next(group for group in solution.groups if group.name == LENGTHS)
    residuals, critical = residuals_of(solution, group), critical_value(group.observations.count)
    suspects = _suspects(group, np.abs(residuals.normalised[0]), _units(solution, residuals), critical)
    rows = np.flatnonzero(keep)
    suspects = tuple(replace(one, rows=tuple(rows[list(one.rows)].tolist())) for one in suspects)
    return Solved(used, network, solution, residuals, tuple(rejected), suspects, critical)


def _kept(network: Network, out: Mapping[int, Rejected]) -> Mask:
    keep = np.ones(network.lengths.observations.count, dtype=bool)
    keep[list(out)] = False
    return keep


def _too_few(network: Network) -> dict[int, Rejected]:
    """Return the lengths of points that too few tracers read to locate them."""
    few = ((network.seen < 3) & network.unknown)[network.lengths.observations.index[t.POINT]]
    return {int(row): Rejected(int(row), float("nan"), "few") for row in np.flatnonzero(few)}


def _must_carry(network: Network, solution: Solution) -> None:
    if not carries(network, solution):
        raise UndeterminedError(explained(network, solution))


def _must_see_effects(network: Network, solution: Solution) -> None:
    """Refuse effects that the unknowns absorb where they are small; the adjustment would carry them far away."""
    if solution.undetermined and absorbed(network.effects, solution, network.datum):
        raise UndeterminedError(explained(network, solution))


def _must_be_near(network: Network, solution: Solution) -> None:
    """Refuse a solution far from the mover's readings, such as the mirror image of the layout."""
    seen = network.seen > 0
    away = np.linalg.norm(solution.blocks[t.POINT].values[seen] - network.nominal[seen], axis=1)
    if np.median(away) > _ASTRAY * np.ptp(network.nominal[seen], axis=0).max():
        raise NotConvergedError(
            f"the points found lie {np.median(away):.3g} mm from where their list says (median): the adjustment ended "
            "in a wrong place, such as the mirror image; say about where the tracers stand in `inputs: tracers`"
        )


def _unchecked(network: Network, keep: Mask) -> Mask:
    """Return the lengths of points that lost so many that those left cannot be trusted, (n,)."""
    point = network.lengths.observations.index[t.POINT]
    lost = network.seen - np.bincount(point, keep, minlength=len(network.nominal))
    gone = (lost > most_wrong(network.seen)) & network.unknown
    return np.asarray(gone[point])


def _doubtful(solved: Solved) -> dict[int, Rejected]:
    """Return the lengths of points that lost some, where the rest do not meet at 5 % of each point by itself.

    Where one length is wrong a second is likely, and two may pass for another single one: `v'Pv` of the rest tells.
    """
    from scipy.special import chdtri

    point, left = solved.group.observations.index[t.POINT], solved.network.seen
    lost = (left < solved.whole.seen) & (left > 3) & solved.network.unknown
    unit = max(1.0, np.nan_to_num(solved.solution.sigma0, nan=1.0))
    misfit = np.bincount(point, (solved.residuals.values[0] / solved.residuals.sigma[0] / unit) ** 2, len(left))
    bad = lost & (misfit > chdtri(np.maximum(left - 3, 1), _DOUBT))
    used = np.delete(np.arange(solved.whole.lengths.observations.count), [one.row for one in solved.rejected])
    return {int(row): Rejected(int(row), float("nan"), "doubt") for row in used[bad[point]]}


def _units(solution: Solution, found: Residuals) -> Array:
    """Return what each |w| is held against (n,): sigma0 where it is above 1; for the largest that of all the others."""
    w = np.abs(found.normalised[0])
    units = np.full(len(w), max(1.0, np.nan_to_num(solution.sigma0, nan=1.0)))
    if solution.dof > 1 and len(w):
        worst = w >= (1 - _EQUAL) * w.max()
        units[worst] = max(1.0, np.sqrt(max(solution.cost - w.max() ** 2, 0.0) / (solution.dof - 1)))
    return units


def _suspects(group: Group, w: Array, units: Array, bound: float) -> tuple[Suspect, ...]:
    """Return the worst length of each point that has one beyond the bound, the largest first."""
    point = group.observations.index[t.POINT]
    keys = group.observations.keys
    suspects = []
    for i in np.unique(point[w > bound * units]):
        rows = np.flatnonzero(point == i)
        tests = w[rows] / units[rows].min()
        worst = int(rows[np.argmax(tests)])
        alike = (tests >= (1 - _EQUAL) * tests.max()) | (tests**2 > tests.max() ** 2 - _TOSS)
        told = alike.sum() == 1
        suspects.append(
            Suspect(
                keys["point"][worst],
                keys["tracer"][worst] if told else "",
                float(tests.max()),
                tuple(
                    keys["tracer"][row]
                    for row in rows[alike | (tests**2 > tests.max() ** 2 - _ODDS)]
                    if row != worst or not told
                ),
                (worst,) if told else tuple(rows[alike].tolist()),
            )
        )
    return tuple(sorted(suspects, key=lambda one: -one.test))


def _worst(solved: Solved) -> dict[int, Rejected]:
    """Return the lengths to leave out next: the worst suspects, whose errors hide behind no larger ones."""
    most = max((one.test for one in solved.suspects), default=0.0)
    chosen = [one for one in solved.suspects if one.test >= most / 2]
    return {row: Rejected(row, one.test, "outlier" if one.tracer else "alike") for one in chosen for row in one.rows}


def _without_innocent(solved: Solved, out: dict[int, Rejected]) -> dict[int, Rejected]:
    """Return what stays out: lengths left out at the start that fit the solution come back."""
    observations = solved.whole.lengths.observations
    miss: Array = solved.whole.lengths.residuals(solved.solution.blocks)[0] / observations.sigma[0]
    alive = solved.network.seen[observations.index[t.POINT]] > 0
    return {row: one for row, one in out.items() if not (alive[row] and abs(miss[row]) < _INNOCENT)}
