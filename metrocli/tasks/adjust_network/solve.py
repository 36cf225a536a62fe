"""Solution of a network: start, adjustment with weights from its geometry, outliers, and what is undetermined."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.outcome import Outcome
from metrocli.adjust.robust import critical_value, robust_start
from metrocli.adjust.rounds import adjust_with_iterated_weights, in_rounds, undisturbed
from metrocli.adjust.solution import Residuals, Solution, residuals_of
from metrocli.arrays import Index, Mask
from metrocli.doubt import MANY_LEFT_OUT
from metrocli.errors import NotConvergedError, UndeterminedError
from metrocli.frozen import dataclass
from metrocli.instruments import stations as s
from metrocli.instruments import tracer as t
from metrocli.tasks.adjust_network.groups import LENGTHS, ROW, is_certified, is_sighting
from metrocli.tasks.adjust_network.noise import component
from metrocli.tasks.adjust_network.origin import moved, to_origin
from metrocli.tasks.adjust_network.problem import FREEDOMS, Network, must_be_held
from metrocli.tasks.adjust_network.settings import Settings
from metrocli.tasks.adjust_network.starts.contradictions import (
    contradicting,
    decided_places,
    must_agree_with_setups,
    refusal,
    removable,
    sightings_to_blame,
)
from metrocli.tasks.adjust_network.suspects import (
    SuspectedReading,
    contradictions,
    have_one_cause,
    misfitting,
    suspected,
    with_gross,
    worst_of_points,
)
from metrocli.tasks.shared.mirror import Mirrored
from metrocli.words import listed

_POINTS_NEAR = 0.02
"""Plausible deviation of points from their list, as a share of the extent of the network"""
_MOST_NAMED = 8
_NONE = 1e-12
"""Weight of readings that only keep an unknown determined"""


@dataclass(frozen=True)
class AdjustedNetwork:
    """An adjusted network, with the readings that were left out."""

    network: Network
    """The network of the readings used"""
    solution: Solution
    residuals: Mapping[str, Residuals]
    """By group of readings"""
    suspects: tuple[SuspectedReading, ...]
    rejected: tuple[SuspectedReading, ...]
    """Readings left out"""
    critical: float
    second: tuple[Mirrored, ...] = ()
    """Places whose mirror image fits as well; the lists decide"""

    @property
    def read(self) -> tuple[Residuals, ...]:
        """The residuals of all readings that have the noise of the job."""
        return tuple(one for name, one in self.residuals.items() if not is_certified(name))

    @property
    def groups(self) -> tuple[Group, ...]:
        """The groups of readings with their final weights."""
        return tuple(group for group in self.solution.groups if group.name in self.network.model.measured)

    @property
    def list_offset(self) -> float:
        """How far points lie from their lists, relative to the plausible deviation.

        It is the root mean square: inner constraints lay the network onto the list by least squares.
        """
        listed = self.network.readings.points.listed
        known = np.isfinite(listed).all(axis=1) & self.solution.blocks[t.POINT].free.any(axis=1)
        if known.sum() < 2:
            return 0.0
        off = np.linalg.norm(self.solution.blocks[t.POINT].values[known] - listed[known], axis=1)
        extent = float(np.ptp(listed[known], axis=0).max()) or 1.0
        return float(np.sqrt(np.mean(off**2))) / (_POINTS_NEAR * extent)


def solve(settings: Settings, network: Network, remove: bool) -> AdjustedNetwork:
    """Adjust a network; with `remove`, leave outliers out.

    Raises UndeterminedError or NotConvergedError, in words.
    """
    must_be_held(settings, network)
    _must_be_checked(network)
    must_agree_with_setups(network)
    solved = undisturbed(lambda always: _solved(network, True, always)) if remove else _solved(network, False)
    return replace(solved, second=decided_places(solved.network, solved.solution))


def _solved(network: Network, remove: bool, always: bool = False) -> AdjustedNetwork:
    every, wrong = network, removable(network) if remove else {}
    lost = tuple(contradictions(network, wrong, network.blocks))
    network = _without(network, network.blocks, lost) if lost else network
    network = network.with_blocks(_robust(network, always))
    # tested where the others put their points: a point may have started where the wrong one alone puts it
    lost = tuple(contradictions(every, wrong, network.blocks))
    wrong = contradicting(network, network.blocks)
    if wrong and not remove:
        raise refusal(network, wrong)
    if always:
        wrong = with_gross(wrong, network, network.blocks)

    def renewed(used: _Used, solved: AdjustedNetwork) -> tuple[_Used, bool]:
        if not remove or not solved.suspects:
            return used, False
        worst = tuple(worst_of_points(solved.suspects))
        return _Used(_without(solved.network, solved.solution.blocks, worst), (*used.out, *worst)), True

    def without(wrong: Mapping[str, Index]) -> AdjustedNetwork:
        out = tuple(contradictions(network, wrong, network.blocks))
        begun = _Used(_without(network, network.blocks, out) if out else network, (*lost, *out))
        return in_rounds(begun, lambda used: _adjusted(used), renewed)[1]

    solved = without(wrong)
    if not always:
        return solved
    still = misfitting(wrong, network, solved.solution.blocks)
    return without(still) if sum(map(len, still.values())) < sum(map(len, wrong.values())) else solved


@dataclass(frozen=True)
class _Used:
    """The network of the readings in use, and those that were left out."""

    network: Network
    out: tuple[SuspectedReading, ...] = ()


def refitted(network: Network, keep: Mapping[str, Mask]) -> Solution:
    """Adjust a network to some of its readings, from the present values."""
    groups = [group.selected(keep[group.name]) if group.name in keep else group for group in network.model.groups]
    return _weighted(network.with_model(replace(network.model, groups=tuple(groups))))


def _weighted(network: Network) -> Solution:
    model = network.model
    return adjust_with_iterated_weights(
        model.blocks.values(), list(model.groups), network.noise, model.datum, network.aspects
    )


def _robust(network: Network, always: bool) -> dict[str, Block]:
    """Return values that gross errors do not spoil (`robust_start`)."""
    names = [group.name for group in network.model.readings if is_sighting(group)]
    wrong, state = contradicting(network, network.blocks), dict(network.blocks)
    if names:
        # what contradicts the set-ups would pull them: it waits until they are joined
        whole = {name: np.arange(network.model.group(name).observations.count) for name in wrong}
        state = robust_start(state.values(), _waiting(network, whole), names, network.datum, always=always)
    if not wrong:
        return state
    # what contradicts them still is left to be named: one bar of 90 m among two would bend the whole network; lengths
    # take part, since they alone place their interferometers
    still = {name: rows for name, rows in contradicting(network, state).items() if name != LENGTHS}
    again = (name for name in wrong if name not in still)
    return robust_start(state.values(), _waiting(network, still), (*names, *again), network.datum, always=always)


def _waiting(network: Network, rows: Mapping[str, Index]) -> list[Group]:
    """Return the groups of a network, with nearly no weight of some rows."""
    groups = []
    for group in network.model.groups:
        if group.name in rows:
            weights = np.ones(group.observations.count)
            weights[rows[group.name]] = _NONE
            group = replace(group, weights=weights)
        groups.append(group)
    return groups


def _adjusted(used: _Used) -> AdjustedNetwork:
    network, solution = _anchored(used.network, _weighted(used.network))
    _must_be_determined(network, solution, used.out)
    residuals = {
        group.name: residuals_of(solution, group) for group in solution.groups if group.name in network.model.measured
    }
    count = sum(residual.values.size for residual in residuals.values())
    return AdjustedNetwork(
        network, solution, residuals, tuple(suspected(residuals, solution)), used.out, critical_value(count)
    )


def _without(network: Network, blocks: Mapping[str, Block], out: tuple[SuspectedReading, ...]) -> Network:
    """Return the network without some readings, at values of its blocks."""
    groups = {group.name: group for group in network.model.groups}
    components, rows = [], []
    others: dict[str, list[int]] = {}
    for suspect in out:
        if is_sighting(groups[suspect.group]):
            components.append(component(groups[suspect.group]))
            rows.append(int(groups[suspect.group].observations.index[ROW][suspect.row]))
        else:
            others.setdefault(suspect.group, []).append(suspect.row)
    seen = np.array(components, dtype=np.intp), np.array(rows, dtype=np.intp)
    fewer = {name: np.array(at, dtype=np.intp) for name, at in others.items()}
    return network.of(network.readings.without(seen, fewer), blocks)


def _anchored(network: Network, solution: Solution) -> tuple[Network, Solution]:
    """Return the solution with the first station at the origin, where no list of points gives the frame."""
    if network.first < 0 or not solution.outcome.good or network.datum is None:
        return network, solution
    move = to_origin(network, solution)
    blocks = {name: moved(block, move) for name, block in solution.blocks.items()}
    # the conditions are about the moved places: about the old ones they would move the network back
    datum = replace(network.datum, reference=blocks[t.POINT].values)
    there = network.with_model(replace(network.model, blocks=blocks, groups=solution.groups, datum=datum))
    return there, _weighted(there)


def _must_be_checked(network: Network) -> None:
    """Raise UndeterminedError for interferometers with too few lengths, or points in one plane with them."""
    lengths = network.readings.lengths
    if lengths is None:
        return
    lines = []
    for number in np.unique(lengths.first):
        own = np.unique(lengths.second[lengths.first == number])
        absolute = network.readings.of(int(number)).measures == "absolute"
        # one more than the unknowns of its place, to which a dead path adds one: a length without a check could be any
        need, name = (4 if absolute else 5), network.readings.stations.names[number]
        if len(own) < need:
            lines.append(f"  {name} reads {len(own)} points; an interferometer needs {need}")
            continue
        places = network.blocks[t.POINT].values[own]
        member = network.blocks[t.TRACER].members.index(name)
        places = np.concatenate([places, network.blocks[t.TRACER].values[None, member, :3]])
        # to first order no length shows a shift across that plane
        spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
        if np.isfinite(places).all() and spread[2] < 1e-4 * spread[0]:
            lines.append(
                f"  {name} stands in one plane with all points that it reads; a point outside the plane closes it"
            )
    if lines:
        raise UndeterminedError("lengths do not determine where interferometers stand:\n" + "\n".join(lines))


def _must_be_determined(network: Network, solution: Solution, out: Sequence[SuspectedReading]) -> None:
    if solution.outcome in (Outcome.UNDETERMINED, Outcome.TOO_FEW):
        lines = [f"  {combination}" for combination in solution.undetermined[:_MOST_NAMED]]
        gone = [f"  Left out as wrong: {listed([suspect.name for suspect in out])}"] if out else []
        if have_one_cause(network.model.readings, out):
            gone.append("  So many have one cause: `metrocli diagnose` tries other units, signs and names")
        # what is left fits: those that were left out contradict it
        misfit = np.inf if len(out) >= MANY_LEFT_OUT else solution.misfit
        raise UndeterminedError("\n".join([solution.outcome.value, *lines, *gone, *_cures(solution)]), misfit)
    if not solution.outcome.good:
        message = f"{solution.outcome.value} ({solution.iterations} steps)"
        raise NotConvergedError(message + sightings_to_blame(network, bool(out)), solution.misfit)


def _cures(solution: Solution) -> Iterator[str]:
    """Yield what would determine what is open."""
    open_blocks = {part[0] for combination in solution.undetermined for part in combination.parts[:3]}
    if open_blocks & {s.OVER, s.SETUP}:
        yield "  A height of an instrument or target needs a tie: a level line, or another instrument at the mark"
    elif t.POINT in open_blocks:
        yield "  Distances, a second station, or given coordinates of these points determine them"
    elif open_blocks:
        yield f"  More shared points, not on a line, determine a station ({FREEDOMS[0]} to {FREEDOMS[5]})"
