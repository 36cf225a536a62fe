"""The readings of a network as groups: sightings by what was read, lengths, bars, height differences, given points."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group, joint_prior, prior, priors
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array, Index
from metrocli.effects.links.stations import BEGUN, IN_ORDER
from metrocli.instruments.frames import DistanceBetween
from metrocli.instruments.stations import (
    LEVELLED,
    ORIENTATION,
    OVER,
    SETUP,
    STATION,
    TARGET_HEIGHT,
    HeightBetween,
    heights_of,
    listed_exactly,
    sighting,
)
from metrocli.instruments.stations import listed as condition_of_listed
from metrocli.instruments.tracer import POINT, TRACER
from metrocli.instruments.tracer import chain as length_chain
from metrocli.instruments.tracker import AZIMUTH, DISTANCE, ELEVATION, FACE
from metrocli.tasks.adjust_network.noise import GIVEN, parts_of
from metrocli.tasks.adjust_network.readings import Lengths, NetworkReadings
from metrocli.tasks.adjust_network.settings import Settings
from metrocli.tasks.adjust_network.sightings import QUANTITIES
from metrocli.tasks.adjust_network.unknowns import kind_of_stations, rows_of_kind
from metrocli.tasks.shared.lists import distinguished

LENGTHS, BARS, HEIGHTS = "lengths", "bars", "heights"
"""Names of the groups of readings beside those of sightings"""
GIVEN_POINTS = "given points"
"""Names of the groups of given coordinates begin so"""
_MOST_LISTED = 500
"""Most given points whose coordinates are tested one by one"""
_MOST_EXACT = 100
"""Most points whose exact coordinates are tested one by one"""
OF_POINT, OF_STATION, OF_INSTRUMENT, OF_TRACER, OF_BAR, OF_SETUP, OF_LINE = (
    f"number of {name}" for name in ("point", "station", "instrument", "tracer", "bar", "setup", "line")
)
"""Indices of the readings: their places"""
ROW = "row"
"""Index of the readings: their row in the file"""


def is_certified(name: str) -> bool:
    """Return whether a group of this name has what a certificate or a list states: bars and given points.

    The noise of the instruments is not theirs: residuals that show its size do not change them.
    """
    return name.startswith((BARS, GIVEN_POINTS))


def is_sighting(group: Group) -> bool:
    """Return whether a group has sightings of trackers or total stations."""
    return ROW in group.observations.index


def sightings(readings: NetworkReadings, blocks: Mapping[str, Block], bend: float) -> Iterator[Group]:
    """Yield the groups of sightings: distances, azimuths and elevations, by kind of station and of target."""
    seen = readings.sightings
    if not len(seen.point):
        return
    kinds = kind_of_stations(readings)
    numbers = {name: i for i, name in enumerate((STATION, LEVELLED, OVER))}
    member = np.zeros(len(kinds), dtype=np.intp)
    for name in numbers:
        rows = rows_of_kind(kinds, name)
        member[rows] = np.arange(len(rows))
    # kind of station and kind of target in one number
    code = 2 * np.array([numbers.get(kind, 0) for kind in kinds])[seen.station] + seen.raised
    codes = np.unique(code).tolist()
    whole = _observations(readings)
    for component in (DISTANCE, AZIMUTH, ELEVATION):
        read = np.isfinite(seen.values[component])
        for number in codes:
            rows = np.flatnonzero(read & (code == number))
            if not rows.size:
                continue
            block, raised = list(numbers)[number // 2], bool(number % 2)
            chosen = whole.selected(rows)
            index = {block: member[seen.station[rows]], **_of_points(readings, block, rows)}
            if block != STATION:
                index[ORIENTATION] = seen.orientation[rows]
            if raised:
                index[SETUP] = seen.setup[rows]
            variant = f" from {block}" + " to raised targets" * raised
            name = QUANTITIES[component] + variant * (len(codes) > 1)
            observations = replace(
                chosen,
                readings=chosen.readings[[component]],
                sigma=np.ones((1, len(rows))),
                index={**chosen.index, **index},
                keys={**chosen.keys, "quantity": (QUANTITIES[component],) * len(rows)},
                components=(QUANTITIES[component],),
                unit="mm" if component == DISTANCE else "rad",
            )
            yield Group(name, sighting(block, raised, component, bend), observations)


def _of_points(readings: NetworkReadings, block: str, rows: Index) -> dict[str, Index]:
    seen = readings.sightings
    if block != OVER:
        return {POINT: seen.point[rows]}
    return {POINT: np.stack([seen.point[rows], readings.stations.over[seen.station[rows]]])}


def _observations(readings: NetworkReadings) -> Observations:
    """Return all sightings with their keys, places and conditions, (3, n)."""
    seen, stations = readings.sightings, readings.stations
    instrument = stations.instrument[seen.station]
    index = {OF_POINT: seen.point, OF_STATION: seen.station, OF_INSTRUMENT: instrument, OF_SETUP: seen.setup}
    index[ROW] = np.arange(len(seen.point))
    keys = {
        "station": tuple(stations.names[i] for i in seen.station),
        "point": tuple(readings.points.names[i] for i in seen.point),
    }
    if (seen.face < 0).any():
        keys["face"] = tuple("1" if face > 0 else "2" for face in seen.face.tolist())
    if any(name for _, name in seen.rounds):
        keys["round"] = tuple(seen.rounds[i][1] for i in seen.orientation)
    conditions = seen.table.conditions("t", "temp") | parts_of(readings.instruments, instrument)
    conditions |= {FACE: seen.face} | dict(zip(GIVEN, seen.sigma, strict=True))
    conditions |= _begun(conditions, seen.station)
    if seen.raised.any():
        conditions[TARGET_HEIGHT] = seen.height
    # point, station, face and round in one number: only the time distinguishes readings that share all four
    pair = seen.point * len(stations.names) + seen.station
    pair = pair * 2 + (seen.face < 0)
    keys = distinguished(keys, pair * len(seen.rounds) + seen.orientation, conditions.get("t"))
    return Observations(seen.values, np.ones(1), index, keys=keys, conditions=conditions)


def _begun(conditions: Mapping[str, Array], station: Index) -> dict[str, Array]:
    """Return the first time at which the station of each reading read; without times its number."""
    if "t" not in conditions:
        return {IN_ORDER: station.astype(float)}
    first = np.full(int(station.max()) + 1, np.inf)
    np.minimum.at(first, station, conditions["t"])
    return {BEGUN: first[station]}


def lengths(readings: NetworkReadings) -> Iterator[Group]:
    """Yield the group of lengths of interferometers, if there are some."""
    distances = readings.lengths
    if distances is None:
        return
    rows, stations = np.unique(distances.first), readings.stations
    tracer = np.searchsorted(rows, distances.first)
    instrument = stations.instrument[distances.first]
    index = {
        POINT: distances.second, TRACER: tracer, OF_POINT: distances.second, OF_STATION: distances.first,
        OF_INSTRUMENT: instrument, OF_TRACER: tracer,
    }  # fmt: skip
    keys = {
        "station": tuple(stations.names[i] for i in distances.first),
        "point": tuple(readings.points.names[i] for i in distances.second),
    }
    conditions = distances.table.conditions("t", "temp") | parts_of(readings.instruments, instrument)
    conditions |= _begun(conditions, distances.first)
    keys = distinguished(keys, distances.second * len(stations.names) + distances.first, conditions.get("t"))
    observations = Observations(
        distances.values[None], np.ones(1), index, keys=keys, conditions=conditions, components=("length",), unit="mm"
    )
    yield Group(LENGTHS, length_chain(), observations)


def bars(readings: NetworkReadings) -> Iterator[Group]:
    """Yield the group of measured bars, distances between two points, if there are some."""
    measured = readings.bars
    if measured is not None:
        index = {POINT: np.stack([measured.first, measured.second]), OF_BAR: np.arange(len(measured.first))}
        keys = {"bar": tuple(measured.table.texts("bar"))}
        yield _pairs(BARS, Chain((DistanceBetween(POINT),)), measured, index, keys, "length")


def heights(readings: NetworkReadings, settings: Settings) -> Iterator[Group]:
    """Yield the group of height differences, if there are some."""
    measured = readings.heights
    if measured is not None:
        curved = settings.vertical is not None
        keys = {end: tuple(measured.table.texts(end)) for end in ("from", "to")}
        # there and back is one pair: levelled twice, its lines need keys of their own
        pair = np.minimum(measured.first, measured.second) * readings.points.count + np.maximum(
            measured.first, measured.second
        )
        if len(np.unique(pair)) < len(pair):
            keys["line"] = tuple(str(line) for line in measured.table.lines) or tuple(map(str, range(len(pair))))
        index = {POINT: np.stack([measured.first, measured.second]), OF_LINE: np.arange(len(measured.first))}
        group = _pairs(HEIGHTS, Chain((HeightBetween(POINT, curved),)), measured, index, keys, "dh")
        conditions = dict(group.observations.conditions)
        for number in np.unique(np.concatenate([measured.first, measured.second])).tolist():
            sign = (measured.second == number).astype(float) - (measured.first == number)
            conditions[heights_of(readings.points.names[number])] = sign
        if "method" in measured.table:
            names = methods(readings)
            conditions["method"] = np.array([names.index(text) for text in measured.table.texts("method")], dtype=float)
        yield replace(group, observations=replace(group.observations, conditions=conditions))


def methods(readings: NetworkReadings) -> tuple[str, ...]:
    """Return the methods of height differences, in the order of the file."""
    levelled = readings.heights
    return (
        ()
        if levelled is None or "method" not in levelled.table
        else tuple(dict.fromkeys(levelled.table.texts("method")))
    )


def _pairs(
    name: str, chain: Chain, pairs: Lengths, index: Mapping[str, Index], keys: Mapping[str, tuple[str, ...]], what: str
) -> Group:
    conditions = pairs.table.conditions("t", "temp")
    observations = Observations(
        pairs.values[None], pairs.sigma[None], index, keys=keys, conditions=conditions, components=(what,), unit="mm"
    )
    return Group(name, chain, observations)


def given(readings: NetworkReadings, blocks: Mapping[str, Block]) -> Iterator[Group]:
    """Yield what is known of points: coordinates with a joint covariance, and others axis by axis."""
    points, block = readings.points, blocks[POINT]
    listed = block.with_values(np.where(np.isfinite(points.listed), points.listed, block.values))
    sigma = points.sigma.copy()
    if points.covariance is not None:
        member, column = points.given
        free = block.free[member, column]
        if free.any():
            joint = points.covariance[np.ix_(free, free)]
            group = joint_prior([(listed, member[free], column[free])], joint)
            yield _of_list(replace(group, name=GIVEN_POINTS), np.unique(member[free]), block)
        # not a second time axis by axis
        sigma[member, column] = np.nan
    for axis in range(3):
        rows = np.flatnonzero(block.free[:, axis] & (sigma[:, axis] > 0))
        if rows.size:
            group = prior(listed, rows, sigma[rows, axis][:, None], columns=(axis,))
            yield _of_list(replace(group, name=f"{GIVEN_POINTS} {'xyz'[axis]}"), rows, block)


def with_exact_lists(groups: Sequence[Group], readings: NetworkReadings) -> list[Group]:
    """Return groups of readings with a condition for each of their points whose listed coordinates are exact.

    A point that is tested has one in every group that reads it: what is wrong in its list is wrong for all of them.
    """
    of_groups = [np.unique(group.observations.index[POINT]) for group in groups]
    exact = np.flatnonzero((readings.points.sigma == 0).any(axis=1))
    tested = exact[np.isin(exact, np.concatenate([*of_groups, exact[:0]]))][:_MOST_EXACT]
    changed = []
    for group, members in zip(groups, of_groups, strict=True):
        ones = np.ones(group.observations.count)
        named = {listed_exactly(readings.points.names[i]): ones for i in np.intersect1d(members, tested).tolist()}
        observations = group.observations.with_conditions(named) if named else group.observations
        changed.append(replace(group, observations=observations))
    return changed


def _of_list(group: Group, members: Index, block: Block) -> Group:
    """Return a group of given coordinates, with a condition for each of its points."""
    observations = group.observations
    named = {condition_of_listed(block.members[i]): np.ones(observations.count) for i in members[:_MOST_LISTED]}
    keys = {"point": observations.keys["member"]} if "member" in observations.keys else {}
    return replace(group, observations=replace(observations, conditions=named, keys=keys, unit="mm"))


def known(readings: NetworkReadings, blocks: Mapping[str, Block]) -> Iterator[Group]:
    """Yield what is known of heights of instruments and targets, and of their centring."""
    if OVER in blocks:
        rows = rows_of_kind(kind_of_stations(readings), OVER)
        stations, over = readings.stations, blocks[OVER]
        sigmas = np.stack([*[stations.centring[rows]] * 2, stations.sigma_height[rows]], axis=1)
        for number, group in enumerate(priors(over, sigmas, over.free)):
            yield replace(group, name=f"heights of instruments {number + 1}")
    if SETUP in blocks:
        heights = blocks[SETUP]
        rows = np.flatnonzero(heights.free[:, 0] & (readings.setups[2] > 0))
        if rows.size:
            yield prior(heights, rows, readings.setups[2][rows, None])
