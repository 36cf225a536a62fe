"""Starting values of a network without any coordinates: set-ups are joined one after the other over common points.

The sightings of a set-up (a round of a levelled station) give points in its own frame. A set-up is placed where it
fits the points that are known: levelled ones by a shift and a turn about z, others by a pose. New points then follow.
Method: docs/algorithms/joined-set-ups.md.
"""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array, Index, Mask
from metrocli.errors import UndeterminedError
from metrocli.geometry import poses
from metrocli.instruments.tracker import cartesian
from metrocli.tasks.adjust_network.readings import NetworkReadings
from metrocli.tasks.adjust_network.starts.agreement import (
    NetworkStart,
    disagreement,
    fitted,
    known_turns,
    list_offset,
    must_agree,
    placed_by_lengths,
    upright,
    with_level_beams,
)
from metrocli.tasks.adjust_network.starts.angles import intersected, resected
from metrocli.words import listed

_ENOUGH = 200
"""Shared points that show whether they are on a line"""
_LOOSE = 0.01
"""Share of the extent by which set-ups and list disagree where the list is too wrong to begin with"""
_LINE = 1e-3
"""Thickness of shared points, relative to their extent, below which they are on a line"""


def _whole(places: Array) -> Mask:
    """Return which places (n, 3) are known."""
    return np.asarray(np.isfinite(places).all(axis=1))


class _Search:
    """Points and set-ups that are placed so far."""

    def __init__(self, readings: NetworkReadings, begin: Array) -> None:
        """`begin` (points, 3) are the points that are known at the beginning, nan for others."""
        self.readings, self.levelled = readings, readings.levelled
        seen = readings.sightings
        self.points = begin.copy()
        self.poses = np.full((len(readings.stations.names), 6), np.nan)
        self.gamma, self.turns = np.full(len(seen.rounds), np.nan), known_turns(readings)
        self.whole: Mask = np.asarray(~np.isnan(seen.values).any(axis=0))
        self.local = np.full((len(seen.point), 3), np.nan)
        self.local[self.whole] = readings.local(np.flatnonzero(self.whole), seen.values[:, self.whole])
        order = np.argsort(seen.orientation, kind="stable")
        counts = np.bincount(seen.orientation, minlength=len(seen.rounds))
        self.rows = np.split(order, np.cumsum(counts)[:-1]) if len(counts) else []
        self._place_over()

    def _place_over(self) -> None:
        stations = self.readings.stations
        for number in np.flatnonzero((stations.over >= 0) & np.isnan(self.poses[:, 0])):
            mark = self.points[stations.over[number]]
            if np.isfinite(mark).all():
                self.poses[number] = [*(mark + [0.0, 0.0, stations.height[number]]), 0.0, 0.0, 0.0]

    def _mark_below(self, station: int) -> None:
        """Place the mark under a station that is placed."""
        mark = self.readings.stations.over[station]
        if mark >= 0 and np.isnan(self.points[mark]).any():
            self.points[mark] = self.poses[station, :3] - [0.0, 0.0, self.readings.stations.height[station]]

    def run(self) -> None:
        """Place set-ups until no further one can be placed."""
        while True:
            best = max(self._open(), key=lambda pair: pair[0], default=(0, -1))
            if best[0] > 0:
                self.place(best[1])
            elif not (self._resect() or self._intersect()):
                return

    def _open(self) -> list[tuple[int, int]]:
        """Return how many known points each set-up that can be placed shares, and its number."""
        known = self._known()
        missing = []
        for number, rows in enumerate(self.rows):
            if np.isfinite(self.gamma[number]):
                continue
            usable = self._usable(number, rows, known)
            if self._enough(number, usable):
                missing.append((len(usable) + bool(np.isfinite(self.turns[number])), number))
        return missing

    def _known(self) -> Mask:
        return _whole(self.points)

    def _usable(self, number: int, rows: Index, known: Mask) -> Index:
        seen, station = self.readings.sightings, self.readings.sightings.rounds[number][0]
        # from a known place an azimuth alone gives the turn
        if self.levelled[station] and np.isfinite(self.poses[station, 0]):
            return np.asarray(rows[known[seen.point[rows]] & np.isfinite(seen.values[0, rows])])
        return np.asarray(rows[known[seen.point[rows]] & self.whole[rows]])

    def _enough(self, number: int, rows: Index) -> bool:
        station = self.readings.sightings.rounds[number][0]
        if self.levelled[station] and np.isfinite(self.poses[station, 0]):
            return len(rows) > 0 or bool(np.isfinite(self.turns[number]))
        some = rows[:: max(len(rows) // _ENOUGH, 1)]
        chosen = self.points[np.unique(self.readings.sightings.point[some])]
        if len(chosen) < (2 if self.levelled[station] else 3):
            return False
        spread = np.linalg.svd(chosen - chosen.mean(axis=0), compute_uv=False)
        if self.levelled[station]:
            # points above each other leave the turn about the vertical open
            return bool(np.ptp(chosen[:, :2], axis=0).max() > 1e-6 * max(spread[0], 1e-300))
        return bool(spread[1] > _LINE * spread[0])

    def place(self, number: int) -> None:
        """Place one set-up by the points that it shares, and the new points that it sees."""
        seen, station = self.readings.sightings, self.readings.sightings.rounds[number][0]
        known = self._known()
        rows = self._usable(number, self.rows[number], known)
        if self.levelled[station] and np.isfinite(self.poses[station, 0]):
            away = self.points[seen.point[rows]] - self.poses[station, :3]
            turns = np.arctan2(away[:, 1], away[:, 0]) - seen.values[0, rows]
            known_turn = self.turns[number]
            # by unit vectors: the mean of angles breaks where they begin anew
            self.gamma[number] = np.angle(np.exp(1j * turns).sum()) if np.isnan(known_turn) else known_turn
        else:
            pose = fitted(self.local[rows], self.points[seen.point[rows]], bool(self.levelled[station]))
            self._set(number, station, pose)
        self._see(number)

    def _set(self, number: int, station: int, pose: Array) -> None:
        if self.levelled[station]:
            self.gamma[number] = pose[5]
            self.poses[station] = [*pose[:3], 0.0, 0.0, 0.0]
            self._mark_below(station)
        else:
            self.poses[station], self.gamma[number] = pose, 0.0
            others = [i for i, (of, _) in enumerate(self.readings.sightings.rounds) if of == station]
            self.gamma[others] = 0.0
            for other in others:
                self._see(other)

    def _see(self, number: int) -> None:
        """Place the new points that a placed set-up sees."""
        seen, station = self.readings.sightings, self.readings.sightings.rounds[number][0]
        rows = self.rows[number]
        rows = rows[self.whole[rows] & np.isnan(self.points[seen.point[rows]]).any(axis=1)]
        if rows.size:
            turned = self.poses[station].copy()
            if self.levelled[station]:
                turned[5] = self.gamma[number]
            self.points[seen.point[rows]] = poses.apply(turned, self.local[rows])
        self._place_over()

    def network_start(self) -> NetworkStart:
        """Return what is placed."""
        return NetworkStart(self.points, self.poses, np.nan_to_num(self.gamma))

    def stuck(self) -> bool:
        """Return whether the points at the beginning place no set-up."""
        read = np.isfinite(self.readings.sightings.values[0]).any()
        return bool(len(self.gamma)) and not np.isfinite(self.gamma if read else self.poses[:, 0]).any()

    def begin_with(self, number: int) -> None:
        """Place a set-up at the origin."""
        turn = np.array([0.0, 0.0, 0.0, 0.0, 0.0, np.nan_to_num(self.turns[number])])
        self._set(number, self.readings.sightings.rounds[number][0], turn)
        self._see(number)

    def _resect(self) -> bool:
        """Place a levelled station by angles to known points, if there is one; return whether there is."""
        seen, known = self.readings.sightings, self._known()
        for number, rows in enumerate(self.rows):
            station = seen.rounds[number][0]
            if not self.levelled[station] or np.isfinite(self.poses[station, 0]):
                continue
            rows = rows[known[seen.point[rows]] & np.isfinite(seen.values[0, rows])]
            aims = self.points[seen.point[rows]] + [0.0, 0.0, 1.0] * self.readings.raised(rows)[:, None]
            place = resected(aims, *seen.values[:2, rows])
            if place is not None:
                self._set(number, station, np.array([*place[:3], 0.0, 0.0, place[3]]))
                self._see(number)
                return True
        return False

    def _intersect(self) -> bool:
        """Place points that only angles show, where beams come nearest to each other; return whether there are any."""
        seen, before = self.readings.sightings, self._known().sum()
        angles = np.isfinite(seen.values[:2]).all(axis=0) & np.isnan(self.points[seen.point]).any(axis=1)
        angles &= np.isfinite(self.gamma[seen.orientation])
        for point in np.unique(seen.point[angles]):
            rows = np.flatnonzero(angles & (seen.point == point))
            turned = self.poses[seen.station[rows]].copy()
            level = self.levelled[seen.station[rows]]
            turned[level, 5] = self.gamma[seen.orientation[rows][level]]
            beams = cartesian(np.stack([*seen.values[:2, rows], np.ones(len(rows))]))[0].T
            beams = poses.apply(np.column_stack([np.zeros((len(rows), 3)), turned[:, 3:]]), beams)
            place = intersected(turned[:, :3], beams)
            if place is not None:
                self.points[point] = place
        return bool(self._known().sum() > before)


def start(readings: NetworkReadings) -> NetworkStart:
    """Return rough values of points and stations.

    Set-ups are placed on the list of points, if they agree there, and else on each other. Raises UndeterminedError that
    names set-ups that cannot be joined, and NotConvergedError for set-ups that contradict each other.
    """
    readings, given = with_level_beams(readings), readings.points.listed
    search = _Search(readings, given)
    search.run()
    begun = search.network_start()
    if search.stuck() or max(disagreement(readings, begun)[0], list_offset(readings, begun)) > _LOOSE:
        search = _alone(readings)
        _onto_list(search, given)
    search.run()
    _must_be_joined(search)
    search.points = placed_by_lengths(readings, search.points)
    must_agree(readings, search.network_start())
    return search.network_start()


def _alone(readings: NetworkReadings) -> _Search:
    """Return the points in the frame of a set-up: a levelled one if there is one, that which sees most points."""
    search = _Search(readings, np.full_like(readings.points.listed, np.nan))
    shots = [int(search.whole[rows].sum()) for rows in search.rows]
    level = readings.levelled[readings.sightings.station_of_round].tolist()
    turned = [bool(np.isfinite(readings.stations.gamma[station])) for station, _ in readings.sightings.rounds]
    # a known azimuth is that of the frame, a levelled station has its vertical: both are worth more than many points
    begin = max(range(len(shots)), key=lambda i: (shots[i] > 0 and turned[i], shots[i] > 0 and level[i], shots[i]))
    search.begin_with(begin)
    search.run()
    if not any(level):
        _moved(search, upright(readings.heights, search.points))
    return search


def _onto_list(search: _Search, given: Array) -> None:
    """Move the frame onto the listed points, as far as they determine it."""
    both = np.isfinite(given).all(axis=1) & np.isfinite(search.points).all(axis=1)
    known = both & np.isfinite(search.readings.points.sigma).all(axis=1)
    both = known if known.sum() > 2 else both  # places without a sigma are rough
    if not both.any():
        return
    # two points leave a turn about the line through them open
    upright = bool(search.levelled.any()) or both.sum() < 3
    _moved(search, fitted(search.points[both], given[both], upright))
    search.points = np.where(np.isfinite(search.points), search.points, given)


def _moved(search: _Search, move: Array) -> None:
    """Move all that is placed by a pose; levelled stations turn about z only."""
    search.points = poses.apply(move, search.points)
    level = search.levelled
    placed = np.isfinite(search.poses[:, 0]) & ~level
    moved = poses.compose(move, search.poses[placed])
    search.poses[:, :3] = poses.apply(move, search.poses[:, :3])
    search.poses[placed] = moved
    search.gamma = np.where(level[search.readings.sightings.station_of_round], search.gamma + move[5], search.gamma)


def _must_be_joined(search: _Search) -> None:
    readings = search.readings
    seen = readings.sightings
    placed = np.isfinite(search.poses[:, 0])
    if lost := [i for i in np.unique(seen.station) if not placed[i]]:
        lines = [f"  {readings.stations.names[i]}: {_reason(search, i)}" for i in lost]
        raise UndeterminedError("set-ups cannot be joined to the network:\n" + "\n".join(lines))
    open_points = np.unique(seen.point[np.isnan(search.points[seen.point]).any(axis=1)])
    if open_points.size:
        names = listed([readings.points.names[i] for i in open_points])
        raise UndeterminedError(
            f"points are seen by angles of one station only: {names}.\n  A distance, or angles of another, place them"
        )


def _reason(search: _Search, station: int) -> str:
    seen = search.readings.sightings
    rows = np.flatnonzero(seen.station == station)
    known = _whole(search.points)
    shared = np.unique(seen.point[rows[known[seen.point[rows]] & search.whole[rows]]])
    need = 2 if search.levelled[station] else 3
    if len(shared) >= need:
        return f"the {len(shared)} points that it shares with the rest lie on a line; a point beside the line closes it"
    names = listed([search.readings.points.names[i] for i in shared]) or "no point"
    word = "two points" if need == 2 else "three points that are not on a line"
    aimed = np.setdiff1d(seen.point[rows[known[seen.point[rows]]]], shared)
    of = listed([search.readings.points.names[i] for i in aimed])
    more = f"; to {of} one of them is missing" * bool(of)
    more += "; or azimuths of three points that are not on a circle with it, and an elevation" * (need == 2)
    return f"it shares {names} with the rest; it needs {word} with azimuth, elevation and distance{more}"
