"""Rough places of points that only lengths read, from interferometers that other points place."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import UndeterminedError
from metrocli.instruments.tracer_start import start as place_of
from metrocli.tasks.adjust_network.readings import Lengths, NetworkReadings
from metrocli.words import listed

_FEWEST = 3
"""Lengths that place a point, up to a mirror image"""


def placed_by_lengths(readings: NetworkReadings, points: Array) -> Array:
    """Return the points (n, 3) with those that lengths alone place; raise UndeterminedError for any left open."""
    lengths = readings.lengths
    if lengths is None or np.isfinite(points[lengths.second]).all():
        return points
    points, before = points.copy(), -1
    # points place stations, and stations further points, until a round places none
    while before != (before := int(np.isfinite(points).sum())):
        stations = {n: _station(readings, lengths, n, points) for n in np.unique(lengths.first).tolist()}
        for number in np.unique(lengths.second[np.isnan(points[lengths.second]).any(axis=1)]).tolist():
            rows = [
                i for i in np.flatnonzero(lengths.second == number) if np.isfinite(stations[lengths.first[i]]).all()
            ]
            if len({int(lengths.first[i]) for i in rows}) >= _FEWEST:
                ends = np.array([stations[lengths.first[i]] for i in rows])
                points[number] = place_of(ends[:, :3], lengths.values[rows] + ends[:, 3], True)[:3]
    read = np.unique(lengths.second)
    if len(still := read[np.isnan(points[read]).any(axis=1)]):
        names = listed([readings.points.names[i] for i in still])
        raise UndeterminedError(
            f"nothing places the points {names}, which only lengths read\n"
            "  what would determine them: their rough places in `inputs: points`, or lengths from three stations that "
            "other points place",
            0.0,
        )
    return points


def _station(readings: NetworkReadings, lengths: Lengths, number: int, points: Array) -> Array:
    """Return place and dead path (4,) of an interferometer, nan where the points placed so far do not determine it."""
    rows = np.flatnonzero((lengths.first == number) & np.isfinite(points[lengths.second]).all(axis=1))
    if not len(rows):
        return np.full(4, np.nan)
    near, absolute = readings.stations.listed[number], readings.of(number).measures == "absolute"
    return place_of(
        points[lengths.second[rows]], lengths.values[rows], absolute, near if np.isfinite(near).all() else None
    )
