"""The unknowns of a network: points, stations, rounds and set-ups, as blocks with starting values."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.arrays import Index, Mask
from metrocli.errors import UndeterminedError
from metrocli.instruments import stations as s
from metrocli.instruments import tracer as t
from metrocli.instruments.tracer_start import start as place_of
from metrocli.tasks.adjust_network.readings import NetworkReadings
from metrocli.tasks.adjust_network.starts.agreement import NetworkStart
from metrocli.words import listed, suggestion


def kind_of_stations(readings: NetworkReadings) -> list[str]:
    """Return the block to which each station belongs; empty for one without a reading."""
    used = np.zeros(len(readings.stations.names), dtype=bool)
    used[readings.sightings.station] = True
    kinds = []
    for number, over in enumerate(readings.stations.over.tolist()):
        kind = (s.OVER if over >= 0 else s.LEVELLED) if readings.levelled[number] else s.STATION
        kinds.append(kind if used[number] else "")
    if readings.lengths is not None:
        for number in np.unique(readings.lengths.first):
            kinds[number] = t.TRACER
    return kinds


def rows_of_kind(kinds: Sequence[str], kind: str) -> Index:
    return np.array([i for i, name in enumerate(kinds) if name == kind], dtype=np.intp)


def blocks_of(readings: NetworkReadings, start: NetworkStart, extent: float) -> Iterator[Block]:
    stations, points = readings.stations, readings.points
    free = points.sigma != 0
    _must_have_places(readings, start)
    # an exact coordinate is not an unknown: it is that of the list, wherever the set-ups place the point
    begun = np.where(free | np.isnan(points.listed), start.points, points.listed)
    yield t.point_block(begun, points.names, free & seen_points(readings)[:, None], extent)
    kinds = kind_of_stations(readings)
    for kind in (s.STATION, s.LEVELLED, s.OVER, t.TRACER):
        rows = rows_of_kind(kinds, kind)
        own = [stations.names[i] for i in rows]
        if not own:
            continue
        if kind == s.STATION:
            yield s.station_block(start.poses[rows], own, extent)
        elif kind == s.LEVELLED:
            yield s.place_block(kind, start.poses[rows, :3], own, np.array(True), extent)
        elif kind == s.OVER:
            offset = np.zeros((len(rows), 3))
            offset[:, 2] = stations.height[rows]
            open_ones = np.stack([*[stations.centring[rows] > 0] * 2, stations.sigma_height[rows] != 0], axis=1)
            yield s.place_block(kind, offset, own, open_ones, extent)
        else:
            yield _interferometers(readings, rows, start, extent)
    if any(kind in (s.LEVELLED, s.OVER) for kind in kinds):
        yield _orientations(readings, start)
    if readings.sightings.raised.any():
        names, height, sigma = readings.setups
        seen = np.bincount(readings.sightings.setup, minlength=len(names)) > 0
        yield s.setup_block(height, names, (sigma != 0) & seen)


def _must_have_places(readings: NetworkReadings, start: NetworkStart) -> None:
    """Raise UndeterminedError for points of bars, heights or lengths that no sighting and no list places."""
    lost = np.flatnonzero(seen_points(readings) & np.isnan(start.points).any(axis=1))
    if not lost.size:
        return
    names = [readings.points.names[i] for i in lost]
    others = [name for name in readings.points.names if name not in names]
    meant = "".join(suggestion(name, others) for name in names[:1])
    raise UndeterminedError(
        f"points have no place: {listed(names)}. No sighting shows them, and no list has their coordinates.\n"
        f"  Look at their names in bars, heights and lengths{f'; {meant}' if meant else ''}",
        0.0,
    )


def seen_points(readings: NetworkReadings) -> Mask:
    """Return which points some reading concerns, (points,)."""
    seen = np.zeros(readings.points.count, dtype=bool)
    seen[readings.sightings.point] = True
    below = readings.stations.over[np.unique(readings.sightings.station)]
    seen[below[below >= 0]] = True
    for pairs, with_first in ((readings.lengths, False), (readings.bars, True), (readings.heights, True)):
        if pairs is not None:
            seen[pairs.second] = True
            if with_first:
                seen[pairs.first] = True
    return seen


def _interferometers(readings: NetworkReadings, rows: Index, start: NetworkStart, extent: float) -> Block:
    values = np.zeros((len(rows), 5))
    values[:, 4] = 1.0
    free = np.zeros((len(rows), 5), dtype=bool)
    free[:, :3] = True
    lengths = readings.lengths
    for at, number in enumerate(rows.tolist()):
        absolute = readings.of(number).measures == "absolute"
        free[at, 3] = not absolute
        if lengths is not None:
            own = lengths.first == number
            near = readings.stations.listed[number]
            near_place = near if np.isfinite(near).all() else None
            values[at, :4] = place_of(start.points[lengths.second[own]], lengths.values[own], absolute, near_place)
    return t.tracer_block(values, [readings.stations.names[i] for i in rows], free, extent)


def _orientations(readings: NetworkReadings, start: NetworkStart) -> Block:
    """Return the azimuths of the rounds; a round in which no azimuth was read has none."""
    seen = readings.sightings
    read = np.bincount(seen.orientation, np.isfinite(seen.values[0]), len(seen.rounds)) > 0
    level = readings.levelled[seen.station_of_round]
    several = np.bincount(seen.station_of_round, minlength=len(readings.stations.names)) > 1
    names = [
        f"{readings.stations.names[station]} {name}" if several[station] else readings.stations.names[station]
        for station, name in seen.rounds
    ]
    known = readings.stations.gamma[seen.station_of_round]
    free = read & level & np.isnan(known)
    block = s.orientation_block(np.where(level, np.where(np.isnan(known), start.gamma, known), 0.0), names)
    return replace(block, free=free[:, None])
