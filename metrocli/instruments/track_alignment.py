"""Align a track with a path without synchronisation: find the distance along the path at which each point was taken.

The start assigns points by equal shares of the lengths of track and path (Sanders et al. 1.2.3 use start, end and
centroid instead). Then dynamic programming matches the points to the path in order of time, and the frame is fitted
again. Both are repeated until the matching no longer changes.
"""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments.machine_path import Path

_THINNED, _SAMPLES = 800, 2400
_STILL = 0.1
"""Steps below this share of the usual step count as noise of a machine at rest"""
_JUMP = 10.0
"""Steps above this multiple of the 90 % quantile of all steps are jumps"""
_ROUNDS = 15
_SETTLED = 0.02
"""The frame has converged when a round moves the track by less than this share of the distance of samples"""
_WILD = 4.0
"""Matched points farther from the path than this multiple of the median are not used to fit the frame"""


@dataclass(frozen=True)
class Alignment:
    """A track aligned with a path."""

    pose: Array
    """Pose of the tracker in the machine, (6,)"""
    rows: Index
    """Numbers of the matched points of the track, ascending"""
    way: Array
    """Distance along the path at each matched point"""
    miss: float
    """Median distance of the matched points from the path [mm]"""


def align(track: Array, track_tool: Index | None, path: Path, tools: Array) -> Alignment:
    """Return the alignment of a track (3, n) with a path.

    `tools` holds the tool vectors, (tools, 3), and `track_tool` the tool of each point if the track has it.
    """
    rows = thinned(track)
    points = track[:, rows]
    way, leg, nominal = path.sampled(_SAMPLES)
    nominal = nominal + tools[path.tool[leg]].T
    other = None if track_tool is None else track_tool[rows][:, None] != path.tool[leg]
    spacing = path.length / _SAMPLES
    # by shares of the length: first and last point or the centroid fail on closed paths and at rests
    pose, most = _by_length(points, nominal, way), np.inf
    for _ in range(_ROUNDS):
        aligned = poses.apply(pose, points.T).T
        # in order of time: where chords cross, the nearest leg is often a wrong one
        matched = _in_order(np.minimum(_distances(aligned, nominal, other), most**2))
        off = np.linalg.norm(aligned - nominal[:, matched], axis=0)
        good = off <= _WILD * np.median(off)
        pose = np.asarray(poses.fit_pose(points[:, good].T, nominal[:, matched[good]].T))
        moved = np.abs(poses.apply(pose, points.T).T - aligned).max()
        before, most = most, _most(float(np.median(off)), spacing)
        # not in the round in which the limit comes into force, since that changes the matching
        if moved < _SETTLED * spacing and np.isfinite(before) == np.isfinite(most):
            break
    return Alignment(pose, rows, way[matched], float(np.median(off)))


def _most(usual: float, spacing: float) -> float:
    """Return the distance at which the cost of a match is limited; inf as long as most points are not near the path.

    Without a limit, a wild point would draw the matching to the nearest part of the path, and all later points with it.
    """
    return max(_WILD * usual, spacing) if usual < _WILD * spacing else float("inf")


def thinned(track: Array) -> Index:
    """Return rows of a track (3, n) about equally spaced in length.

    Points at rest, and points where the tracker has lost the reflector, are left out.
    """
    stride = max(1, track.shape[1] // (4 * _THINNED))
    rows = np.arange(0, track.shape[1], stride)
    rows = rows[~_elsewhere(track[:, rows])]
    length = _length(track[:, rows])
    wanted = np.linspace(0, length[-1], _THINNED)
    return np.unique(rows[np.clip(np.searchsorted(length, wanted), 0, len(rows) - 1)])


def _elsewhere(points: Array) -> Mask:
    """Return the points where the tracker has lost the reflector and points at its nest: still pieces between jumps."""
    step = np.linalg.norm(np.diff(points, axis=1), axis=0)
    jumps = np.flatnonzero(step > _JUMP * np.quantile(step, 0.9))
    piece = np.searchsorted(jumps, np.arange(points.shape[1]), side="left")
    step[jumps], leaps = 0.0, step[jumps]
    length = np.bincount(piece[:-1], step, minlength=len(jumps) + 1)
    still = np.zeros(len(length), dtype=bool)
    # a piece between two jumps; the first and the last have only one, and may be the track itself
    still[1:-1] = length[1:-1] < _STILL * np.minimum(leaps[1:], leaps[:-1])
    return np.asarray(still[piece])


def _length(points: Array) -> Array:
    """Return the length of a track up to each point, without the steps of a machine at rest."""
    step = np.linalg.norm(np.diff(points, axis=1), axis=0)
    moving = step > _STILL * np.quantile(step, 0.9)
    return np.concatenate([[0.0], np.cumsum(np.where(moving, step, 0.0))])


def _by_length(points: Array, nominal: Array, way: Array) -> Array:
    length = _length(points)
    share = length / max(length[-1], 1e-300)
    onto = np.searchsorted(way, share * way[-1]).clip(0, len(way) - 1)
    return np.asarray(poses.fit_pose(points.T, nominal[:, onto].T))


def _distances(points: Array, nominal: Array, other: Mask | None) -> Array:
    """Return squared distances, (points, samples), with a large penalty for pairs marked in `other` (another tool)."""
    squares = (points**2).sum(axis=0)[:, None] + (nominal**2).sum(axis=0) - 2 * points.T @ nominal
    return np.asarray(squares if other is None else np.where(other, squares + squares.max(), squares))


def _in_order(cost: Array) -> Index:
    """Return for each row the matched column, by the matching of least total cost that never goes back."""
    rows, columns = cost.shape
    best, choice = cost[0].copy(), np.zeros((rows, columns), dtype=np.int32)
    numbers = np.arange(columns, dtype=np.int32)
    for row in range(1, rows):
        # the best end at or before each column: a row may stay where the one before it is
        least = np.minimum.accumulate(best)
        fresh = np.append(True, best[1:] < least[:-1])
        choice[row] = np.maximum.accumulate(np.where(fresh, numbers, 0))
        best = least + cost[row]
    matched = np.zeros(rows, dtype=np.intp)
    matched[-1] = int(np.argmin(best))
    for row in range(rows - 1, 0, -1):
        matched[row - 1] = choice[row, matched[row]]
    return matched
