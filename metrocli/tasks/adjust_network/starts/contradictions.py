"""Sightings, lengths, bars, height differences and given points that contradict the joined set-ups, as no effect does.

They are found before they can spoil an adjustment: by a wrong unit, sign or name they are off by a part of the network.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from metrocli import units
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array, Index, Mask
from metrocli.errors import NotConvergedError
from metrocli.instruments import tracer as t
from metrocli.tasks.adjust_network.groups import BARS, GIVEN_POINTS, HEIGHTS, LENGTHS, ROW, is_sighting
from metrocli.tasks.adjust_network.problem import Network
from metrocli.tasks.adjust_network.starts.agreement import CONTRADICTORY, medians, placed
from metrocli.tasks.shared.mirror import Mirrored, mirrored, must_be_decided, of_points, of_tracers
from metrocli.words import listed

_WORDS = {LENGTHS: "lengths of interferometers", BARS: "bars", HEIGHTS: "height differences"}
_ONE = {LENGTHS: "length", BARS: "bar", HEIGHTS: "height difference"}
_FEW = 2
"""Fewest readings of a group that can be wrong as a whole"""
_NAMED = 5
_UNDECIDED = ".\n  Nothing else shows which sighting of a point is wrong: correct its name or values, or delete its row"


def must_agree_with_setups(network: Network) -> None:
    """Raise NotConvergedError for groups of which most contradict the set-ups; a network without set-ups has none."""
    for group in _others(network):
        off = np.sort(_off(group, network.blocks))
        # the lower of two middle ones: more than half are off by so much
        most = off[(off.size - 1) // 2]
        if off.size >= _FEW and most > _limit(network):
            what = next((words for name, words in _WORDS.items() if name == group.name), "given points")
            raise NotConvergedError(
                f"{what} contradict the set-ups: most of them are off by {units.sized(most, 'length')} or more.\n"
                "  Look at their units, signs and axes, and at the names of their points"
            )


def contradicting(network: Network, blocks: Mapping[str, Block]) -> dict[str, Index]:
    """Return the lengths, bars and height differences that contradict the set-ups, by group."""
    groups = (group for group in _others(network) if group.name in _WORDS)
    rows = {group.name: np.flatnonzero(_off(group, blocks) > _limit(network)) for group in groups}
    return {name: wrong for name, wrong in rows.items() if wrong.size}


def _astray(network: Network) -> tuple[Index, Array]:
    """Return the sightings that contradict the set-ups, and how far each puts its point from where others do [mm].

    Those that agree with more than half of the sightings of a point, and of its listed place, are right; where there is
    no such half, all are given.
    """
    seen, listed_at = network.readings.sightings, network.readings.points.listed
    rows, places = placed(network.readings, network.start)
    point, limit = seen.point[rows], _limit(network)
    middle = medians(places, point, len(listed_at))[point]
    astray, off = [np.zeros(0, dtype=np.intp)], [np.zeros(0)]
    for number in np.unique(point[np.linalg.norm(places - middle, axis=1) > limit / 2]).tolist():
        own = np.flatnonzero(point == number)
        votes = np.concatenate([places[own], listed_at[[number]]])
        votes = votes[np.isfinite(votes).all(axis=1)]
        apart = np.linalg.norm(places[own][:, None] - votes, axis=2)
        wrong = 2 * (apart <= limit).sum(axis=1) <= len(votes)
        astray.append(rows[own[wrong]])
        off.append(apart[wrong].max(axis=1))
    return np.concatenate(astray), np.concatenate(off)


def _in_words(network: Network, sightings: Index, off: Array) -> str:
    """Return sightings with their line, and how far each puts its point from where others do."""
    seen, readings = network.readings.sightings, network.readings
    stations, points = (readings.stations.names, seen.station), (readings.points.names, seen.point)
    texts = []
    for row, away in zip(sightings.tolist(), off.tolist(), strict=True):
        name = "/".join(names[of[row]] for names, of in (stations, points))
        texts.append(
            f"{name} (line {seen.table.lines[row]}) by {units.sized(away, 'length')}" if seen.table.lines else name
        )
    return listed(texts, _NAMED)


def sightings_to_blame(network: Network, removes: bool) -> str:
    """Return the sightings that contradict the set-ups, why an adjustment does not converge; nothing without any.

    A job that `removes` outliers has done so already.
    """
    rows, off = _astray(network)
    if not rows.size:
        return ""
    alone = _alone(network, rows).any()
    cure = _UNDECIDED if alone else "" if removes else "; `outliers: remove` leaves them out"
    return f".\n  Sightings contradict the set-ups: {_in_words(network, rows, off)}{cure}"


def removable(network: Network) -> dict[str, Index]:
    """Return the readings of the sightings that contradict the set-ups, by group.

    Raises NotConvergedError for points that would lose all sightings.
    """
    rows, off = _astray(network)
    alone = _alone(network, rows)
    if alone.any():
        named = _in_words(network, rows[alone], off[alone])
        raise NotConvergedError(f"sightings contradict the set-ups: {named}{_UNDECIDED}")
    return {
        group.name: np.flatnonzero(np.isin(group.observations.index[ROW], rows))
        for group in network.model.readings
        if is_sighting(group) and rows.size
    }


def _alone(network: Network, rows: Index) -> Mask:
    """Return which sightings belong to points that have no further ones, (n,)."""
    point = network.readings.sightings.point
    return np.asarray(~np.isin(point[rows], np.delete(point, rows)))


def refusal(network: Network, rows: Mapping[str, Index]) -> NotConvergedError:
    """Return the error that names readings which contradict the set-ups."""
    texts = []
    for name, wrong in rows.items():
        group = network.model.group(name)
        off, keys = _off(group, network.blocks), group.observations.keys
        texts += [
            f"{_ONE[name]} {'/'.join(text[i] for text in keys.values())} by {units.sized(off[i], 'length')}"
            for i in wrong
        ]
    return NotConvergedError(
        f"readings contradict the set-ups: {listed(texts[:_NAMED])}.\n"
        "  Look at their values, signs and names; `outliers: remove` leaves them out"
    )


def _others(network: Network) -> list[Group]:
    """Return the groups beside those of sightings, if there are sightings."""
    groups = network.model.readings
    # the points of a single set-up are where it puts them, right or wrong
    several = len(np.unique(network.readings.sightings.station)) > 1
    given = [group for group in groups if group.name.startswith(GIVEN_POINTS)]
    own = [*given, *(group for group in groups if group.name in _WORDS)]
    return own if several and any(is_sighting(group) for group in groups) else []


def _off(group: Group, blocks: Mapping[str, Block]) -> Array:
    """Return how far each reading is off [mm], (n,)."""
    return np.asarray(np.abs(group.residuals(blocks)).max(axis=0))


def _limit(network: Network) -> float:
    return CONTRADICTORY * network.start.extent


def decided_places(network: Network, solution: Solution) -> tuple[Mirrored, ...]:
    """Return stations and points with a second place that fits alike, where listed places decide between both.

    Raises UndeterminedError where no list decides.
    """
    group = next((group for group in solution.groups if group.name == LENGTHS), None)
    if group is None or t.TRACER not in solution.blocks:
        return ()
    stations, points = network.readings.stations, network.readings.points
    noise = max(1.0, float(np.nan_to_num(solution.sigma0, nan=1.0)))
    listed = stations.listed[[stations.names.index(name) for name in solution.blocks[t.TRACER].members]]
    places = mirrored(of_tracers(solution, group, listed), noise)
    alone = np.ones(points.count, dtype=bool)
    # other readings of a point show on which side it is
    for other in solution.groups:
        if other is not group and t.POINT in other.observations.index:
            alone[other.observations.index[t.POINT]] = False
    if alone.any():
        places += mirrored(of_points(solution, group, points.listed).selected(alone), noise)
    must_be_decided(places, solution.sigma0)
    return tuple(places)
