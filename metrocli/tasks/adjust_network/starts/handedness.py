"""Stations that see the points as in a mirror: their azimuths count the other way, or their elevations do."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from metrocli.arrays import Array
from metrocli.instruments.tracker import cartesian
from metrocli.tasks.adjust_network.readings import NetworkReadings
from metrocli.tasks.adjust_network.starts.agreement import medians

_FEWEST = 5
"""Points that two stations share, at least: among fewer a single wrong reading decides"""
_FAR_BETTER = 0.05
"""Share of what the worse of both leaves, up to which congruence, or that with the mirror image, is decided"""
_IN_SPACE = 1e-4
"""Share of the squared distances that the worse of both leaves, at least: points in a plane are their mirror image"""


def mirrored_groups(readings: NetworkReadings) -> tuple[tuple[int, ...], ...]:
    """Return the stations that see the points mirrored: the smaller group, or both groups if they are equal.

    Two stations see n shared points at x and y, (n, 3), from their middle. With `x'y = U diag(s) V'` a motion leaves
    `|x|^2 + |y|^2 - 2 (s_1 + s_2 + d s_3)` and one with a reflection the same with -d, `d = det(U V')` (Arun, Huang,
    Blostein 1987). No group is returned where pairs contradict each other, or decide nothing.
    """
    relations = _relations(readings)
    sides = {next(iter(relations))[0]: 1} if relations else {}
    changed = True
    while changed:
        changed = False
        for (one, other), side in relations.items():
            for a, b in ((one, other), (other, one)):
                if a in sides and b not in sides:
                    sides[b], changed = sides[a] * side, True
    if any(a in sides and b in sides and sides[a] * sides[b] != side for (a, b), side in relations.items()):
        return ()
    groups = [tuple(sorted(station for station, own in sides.items() if own == side)) for side in (1, -1)]
    if not all(groups):
        return ()
    few = min(map(len, groups))
    return tuple(group for group in groups if len(group) == few)


def _relations(readings: NetworkReadings) -> dict[tuple[int, int], int]:
    """Return for pairs of stations whether they see their points alike (1) or mirrored (-1), where that is decided."""
    seen, count = readings.sightings, readings.points.count
    rows = np.flatnonzero(np.isfinite(seen.values).all(axis=0))
    local = cartesian(seen.values[:, rows])[0].T
    stations = len(readings.stations.names)
    places = medians(local, seen.station[rows] * count + seen.point[rows], stations * count)
    of_stations = places.reshape(stations, count, 3)
    pairs = combinations(range(stations), 2)
    sides = {pair: _side(*of_stations[list(pair)]) for pair in pairs}
    return {pair: side for pair, side in sides.items() if side}


def _side(one: Array, other: Array) -> int:
    """Return 1 if the places of points (n, 3) are congruent, -1 if they are so with a mirror image, else 0."""
    shared = np.isfinite(one).all(axis=1) & np.isfinite(other).all(axis=1)
    if shared.sum() < _FEWEST:
        return 0
    x, y = one[shared] - one[shared].mean(axis=0), other[shared] - other[shared].mean(axis=0)
    u, s, vt = np.linalg.svd(x.T @ y)
    side = float(np.sign(np.linalg.det(u @ vt)))
    squares = float((x**2).sum() + (y**2).sum())
    by_motion, mirrored = (squares - 2 * (s[0] + s[1] + sign * side * s[2]) for sign in (1, -1))
    least, most = sorted((by_motion, mirrored))
    if least > _FAR_BETTER * most or most < _IN_SPACE * squares:
        return 0
    return 1 if by_motion < mirrored else -1
