"""Where the set-ups of a rough start put their points, by lengths too, and whether they agree."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from math import comb
from random import Random

import numpy as np

from metrocli import units
from metrocli.adjust.medians import medians_of
from metrocli.arrays import Array, Index
from metrocli.errors import NotConvergedError, UndeterminedError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.geometry.rotations import nearest_rotation
from metrocli.instruments.tracer_start import start as place_of
from metrocli.instruments.tracker import cartesian
from metrocli.tasks.adjust_network.readings import Lengths, NetworkReadings
from metrocli.words import listed

CONTRADICTORY = 0.03
"""Share of the extent of a network, by which set-ups of readings that are understood rightly do not disagree"""


@dataclass(frozen=True)
class NetworkStart:
    """Rough values of all unknowns."""

    points: Array
    """(points, 3), nan where nothing is known"""
    poses: Array
    """(stations, 6), nan where nothing is known"""
    gamma: Array
    """Azimuth of each round of a levelled station, (rounds,)"""

    @property
    def extent(self) -> float:
        """Largest extent of the known points along an axis [mm]; 0 without any."""
        known = self.points[np.isfinite(self.points).all(axis=1)]
        return float(np.ptp(known, axis=0).max()) if len(known) else 0.0


def placed(readings: NetworkReadings, rough: NetworkStart) -> tuple[Index, Array]:
    """Return the whole sightings, and where each puts its point."""
    seen = readings.sightings
    rows = np.flatnonzero(np.isfinite(seen.values).all(axis=0) & np.isfinite(rough.poses[seen.station, 0]))
    pose = rough.poses[seen.station[rows]].copy()
    level = readings.levelled[seen.station[rows]]
    pose[level, 5] = rough.gamma[seen.orientation[rows][level]]
    places = poses.apply(pose, cartesian(seen.values[:, rows])[0].T)
    # along the vertical of the network, also where the instrument is not levelled
    places[:, 2] -= seen.height[rows] + readings.setups[1][seen.setup[rows]]
    return rows, places


def known_turns(readings: NetworkReadings) -> Array:
    """Return the azimuth of the x axis of each round, (rounds,), where it is listed; nan for others.

    A round has it too if it shares a direction with a listed one over the same point.
    """
    seen, stations = readings.sightings, readings.stations
    turns, over = stations.gamma[seen.station_of_round], stations.over[seen.station]
    key = over * readings.points.count + seen.point
    bearing = turns[seen.orientation] + seen.values[0]
    known = np.isfinite(bearing) & (over >= 0)
    keys, first = np.unique(key[known], return_index=True)
    shared = np.isnan(turns[seen.orientation]) & np.isfinite(seen.values[0]) & np.isin(key, keys)
    at = np.searchsorted(keys, key[shared])
    turns[seen.orientation[shared]] = bearing[known][first[at]] - seen.values[0, shared]
    return turns


def medians(places: Array, point: Index, count: int) -> Array:
    """Return the median place of each point, nan where it has none, (count, 3)."""
    return np.stack([medians_of(coordinate, point, count) for coordinate in places.T], axis=1)


def disagreement(readings: NetworkReadings, rough: NetworkStart) -> tuple[float, str]:
    """Return how far set-ups put the same points apart, as a share of the extent, and which ones do so most, in words.

    It is the median over the sightings of points that several set-ups see; 0 without any.
    """
    seen = readings.sightings
    rows, places = placed(readings, rough)
    middle = medians(places, seen.point[rows], readings.points.count)
    # several sightings in one round agree whatever its place is: only rounds are counted
    pairs = np.unique(np.stack([seen.orientation[rows], seen.point[rows]]), axis=1)
    shared = np.bincount(pairs[1], minlength=readings.points.count)[seen.point[rows]] > 1
    if not shared.any():
        return 0.0, ""
    off = np.linalg.norm(places - middle[seen.point[rows]], axis=1)[shared]
    extent = _extent(places)
    station = seen.station[rows][shared]
    of = {int(number): float(np.median(off[station == number])) for number in np.unique(station)}
    worst = sorted(of, key=lambda number: -of[number])[:3]
    words = listed([f"{readings.stations.names[number]} by {units.sized(of[number], 'length')}" for number in worst])
    return float(np.median(off)) / extent, words


def list_offset(readings: NetworkReadings, rough: NetworkStart) -> float:
    """Return how far sightings put points from their list, as a share of the extent: the median over the points."""
    rows, places = placed(readings, rough)
    middle = medians(places, readings.sightings.point[rows], readings.points.count)
    off = np.linalg.norm(middle - readings.points.listed, axis=1)
    known = np.isfinite(off)
    return float(np.median(off[known])) / _extent(places) if known.any() else 0.0


def _extent(places: Array) -> float:
    return float(np.ptp(places, axis=0).max()) or 1.0


def must_agree(readings: NetworkReadings, rough: NetworkStart) -> None:
    """Raise NotConvergedError for set-ups that contradict each other, as no noise and no effect makes them do."""
    share, words = disagreement(readings, rough)
    if share > CONTRADICTORY:
        raise NotConvergedError(
            f"set-ups contradict each other: they put the points that they share beside each other ({words}).\n"
            "  Look at units and senses of the angles (az counter-clockwise, hz clockwise; el from the level plane, zd "
            "from the vertical), at face 2, and at the names of stations and points",
            inputs=("readings", "setups") if _differ_in_shape(readings) else (),
        )


def _differ_in_shape(readings: NetworkReadings) -> bool:
    """Return whether set-ups contradict each other wherever they stand: no list of stations or points mends that.

    They do if most distances between points that two set-ups see differ by more than a part of the network.
    """
    seen = readings.sightings
    rows = np.flatnonzero(np.isfinite(seen.values).all(axis=0))
    local = readings.local(rows, seen.values[:, rows])
    place = np.full((len(seen.rounds), readings.points.count, 3), np.nan)
    place[seen.orientation[rows], seen.point[rows]] = local
    off = []
    for one, other in combinations(place, 2):
        shared = np.isfinite(one + other).all(axis=1)
        lengths = [np.linalg.norm(np.diff(each[shared], axis=0), axis=1) for each in (one, other)]
        off.append(np.abs(lengths[0] - lengths[1]))
    apart = np.concatenate([*off, np.zeros(0)])
    return bool(apart.size) and float(np.median(apart)) > CONTRADICTORY * _extent(local)


_REWEIGHTED = 8
"""Rounds of a fit that gross errors do not spoil"""
_TRIED = 100
"""Sets of points from which a motion is tried: half of the points wrong, one set without is missed in 2e-6 of cases"""


def fitted(local: Array, goal: Array, levelled: bool) -> Array:
    """Return the pose that brings local points to their places; gross errors get low weights."""
    move = _turned if levelled else _pose
    weights = np.ones(len(local))
    first = move(local, goal, weights)
    miss = np.linalg.norm(poses.apply(first, local) - goal, axis=1)
    if miss.max() > CONTRADICTORY * np.ptp(goal, axis=0).max():
        weights = _agreeing(local, goal, move, 2 if levelled else 3)
    pose = first
    for _ in range(_REWEIGHTED):
        pose = move(local, goal, weights)
        miss = np.linalg.norm(poses.apply(pose, local) - goal, axis=1)
        scale = max(float(np.median(miss)), 1e-9)
        # of fewer than five no reading stands out
        if miss.max() <= 8 * scale or len(local) < 5:
            break
        weights = 1 / np.maximum(miss / scale, 1.0)
    return pose


def _agreeing(local: Array, goal: Array, move: Callable[[Array, Array, Array], Array], few: int) -> Array:
    """Return weights 1 for the half of the points that agree best (least median), 0 for the others.

    A point under another's name turns the whole of a set-up in least squares, and then stands out no more.
    """
    best, half = np.inf, max(len(local) // 2 + 1, few + 1)
    chosen = np.ones(len(local))
    if half > len(local):
        return chosen
    rng = Random(0)  # always the same: a job has one result
    every = combinations(range(len(local)), few)
    tried = every if comb(len(local), few) <= _TRIED else (rng.sample(range(len(local)), few) for _ in range(_TRIED))
    for some in map(list, tried):
        pose = move(local[some], goal[some], np.ones(few))
        miss = np.linalg.norm(poses.apply(pose, local) - goal, axis=1)
        nearest = np.argsort(miss)[:half]
        if miss[nearest[-1]] < best:
            best = float(miss[nearest[-1]])
            chosen = np.bincount(nearest, minlength=len(local)).astype(float)
    return chosen


def _turned(local: Array, goal: Array, weights: Array) -> Array:
    """Return the pose with a turn about z alone, in least squares."""
    w = weights / weights.sum()
    a, b = local - w @ local, goal - w @ goal
    gamma = np.arctan2(
        (w * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])).sum(), (w * (a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1])).sum()
    )
    turn = np.array([0.0, 0.0, 0.0, 0.0, 0.0, gamma])
    return np.concatenate([w @ goal - poses.apply(turn, w @ local), turn[3:]])


def _pose(local: Array, goal: Array, weights: Array) -> Array:
    w = weights / weights.sum()
    centre, target = w @ local, w @ goal
    rotation = nearest_rotation(((goal - target) * w[:, None]).T @ (local - centre))
    return poses.pose(rotation, target - rotation @ centre)


def with_level_beams(readings: NetworkReadings) -> NetworkReadings:
    """Return the readings of a plane network, where nothing reads an elevation, with elevations of 0."""
    seen = readings.sightings
    if np.isfinite(seen.values[1]).any():
        return readings
    values = np.stack([seen.values[0], np.zeros_like(seen.values[1]), seen.values[2]])
    return replace(readings, sightings=replace(seen, values=values))


def upright(heights: Lengths | None, points: Array) -> Array:
    """Return the motion (6,) that turns height differences along z, if there are some."""
    turn = np.zeros(6)
    if heights is None:
        return turn
    away = points[heights.second] - points[heights.first]
    good = np.isfinite(away).all(axis=1)
    # height differences in one plane do not show their common direction
    if good.sum() < 3 or np.linalg.matrix_rank(away[good], tol=1e-3 * np.abs(away[good]).max()) < 3:
        return turn
    up = np.linalg.lstsq(away[good], heights.values[good], rcond=None)[0]
    up = up / np.linalg.norm(up)
    axis = np.cross(up, [0.0, 0.0, 1.0])
    size = np.linalg.norm(axis)
    # with z up it stays, with z down any axis across it turns it over
    turn[3:] = axis / size * np.arctan2(size, up[2]) if size > 1e-12 else [np.pi if up[2] < 0 else 0.0, 0.0, 0.0]
    return turn


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
