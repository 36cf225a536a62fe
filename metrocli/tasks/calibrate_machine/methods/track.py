"""The track of an on-the-fly measurement, the pose of its tracker, and why points do not match."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from metrocli import units
from metrocli.arrays import Array, Index, Mask
from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments.machine_path import Path
from metrocli.instruments.track_alignment import Alignment, align
from metrocli.table import Table
from metrocli.words import listed

_FAR = 0.02
"""Largest median misfit as a share of the extent of the points; errors of machines are far smaller"""
_UNITS = (1e3, 1e-3, 25.4, 1 / 25.4)
"""Factors of a wrong unit: m or mm, inch or mm"""
_NEAR = 0.05
"""Relative difference of extents up to which a unit explains them"""
_WILD = 1.0
"""Points farther from the path than three times the median distance plus this [mm] are wild"""
_DWELL = 0.2
"""Below this share of the leg's usual speed the machine counts as standing still"""
_FAST = 3.0
"""Speeds above this multiple of their 90 % quantile are jumps of the beam and are limited to it"""
_BREAK = 20.0
"""A step longer than this many median steps is a break of the beam ..."""
_LEAST_BREAK = 3.0
"""... if it is also longer than this [mm]"""
_SETTLE = 2.0
"""Points within this distance of either end of a break are removed [mm]"""
_REACH = 1000
"""Number of points examined on either side of a break"""
_FEW = 50
"""Points of a track below which its speeds and steps show nothing"""
MIRRORED = "the tracker's frame is left-handed: two of mx, my, mz are swapped, or one of them has the wrong sign"
"""Hint for measured points that are a mirror image; both causes look the same, since the frame is estimated"""


def tracker_pose(measured: Array, nominal: Array, file: str, tried: bool = False, far: float = _FAR) -> Array:
    """Return the pose of the tracker in the machine, (6,), from points (3, n).

    `far` is the largest median misfit as a share of the extent: positions that are estimated may be degrees off.
    Raises InputError if the points do not match. Where settings are to be `tried`, such as those of rotary axes or of
    several tools, its hint is in its text, so that a task tries what may be wrong in them.
    """
    pose = np.asarray(poses.fit_pose(measured.T, nominal.T))
    if matches(pose, measured, nominal, far):
        return pose
    fault = mismatch(measured, nominal, file)
    raise InputError([replace(fault, message=f"{fault.message}; {fault.hint}", hint=None) if tried else fault])


def matches(pose: Array, measured: Array, nominal: Array, far: float = _FAR) -> bool:
    """Return whether most of the aligned points are as close to their nominal places as machine errors allow."""
    return miss(pose, measured, nominal) < far * extent(nominal)


def miss(pose: Array, measured: Array, nominal: Array) -> float:
    """Return the median distance of the aligned points from their nominal places."""
    return float(np.median(np.linalg.norm(poses.apply(pose, measured.T) - nominal.T, axis=1)))


def extent(points: Array) -> float:
    """Return the root mean square distance of points (3, n) from their centre."""
    return float(np.sqrt(((points - points.mean(axis=1, keepdims=True)) ** 2).sum(axis=0).mean()))


def wrong_unit(measured: Array, nominal: Array) -> float | None:
    """Return the factor that corrects measured lengths if their unit is clearly wrong (m, inch), else None."""
    ratio = extent(nominal) / max(extent(measured), 1e-300)
    return next((unit for unit in _UNITS if abs(ratio / unit - 1) < _NEAR), None)


def mismatch(measured: Array, nominal: Array, file: str) -> Fault:
    """Return why measured points (3, n) do not match their nominal places: unit, mirror image or shape."""
    unit = wrong_unit(measured, nominal)
    if unit is not None:
        text = f"the measured coordinates are {1 / unit:.4g} times as large as the commanded ones"
        return Fault(text, file, hint="is their unit right? a column mx_m or x_m is in metres")
    # one axis is enough: a mirror image in another one is this one, turned
    mirrored = measured * [[1.0], [1.0], [-1.0]]
    if matches(poses.fit_pose(mirrored.T, nominal.T), mirrored, nominal):
        text = "the measured points are a mirror image of the commanded ones"
        return Fault(text, file, hint=MIRRORED)
    off = miss(poses.fit_pose(measured.T, nominal.T), measured, nominal)
    away = units.sized(off, "length")
    text = f"the measured points do not have the shape of the commanded ones: {away} off after the best alignment"
    return Fault(text, file, hint="is this the measurement of another path or list, or are rows missing or reordered?")


@dataclass(frozen=True)
class Track:
    """Points of the tracker on the legs of a path, in order of time."""

    points: Array
    """(3, n), in the tracker's frame"""
    leg: Index
    conditions: Mapping[str, Array]
    """Times if given, and further columns, each (n,)"""
    pose: Array
    """Approximate pose of the tracker in the machine, (6,)"""
    warnings: tuple[str, ...]
    facts: dict[str, float]

    def selected(self, keep: Mask) -> Track:
        """Return the track with some of its points."""
        conditions = {name: values[keep] for name, values in self.conditions.items()}
        return Track(self.points[:, keep], self.leg[keep], conditions, self.pose, self.warnings, self.facts)


def cut(table: Table, path: Path, tools: Array, track_tool: Index | None, corner: float) -> Track:
    """Return the points on straight legs at speed, without corners, rests, breaks of the beam and wild points.

    Raises InputError if the track does not match the path.
    """
    points = table.stacked("xyz").T
    if points.shape[1] < _FEW:
        raise InputError([Fault(f"{points.shape[1]} points are too few for a track along a path", table.file)])
    alignment = _aligned(points, track_tool, path, tools, table.file)
    leg, along, off = _on_legs(points, alignment, path, tools)
    usual = float(np.median(off))
    wild = off > usual * 3 + _WILD
    near_corner = (along < corner) | (along > path.lengths[leg] - corner)
    still = np.zeros(len(leg), dtype=bool)
    # wild points are jumps, which would make the machine fast around them
    still[~wild] = _standing(points[:, ~wild], leg[~wild])
    broken, breaks = _breaks(points, wild, path.tool[leg])
    kept = ~(wild | near_corner | still | broken)
    conditions = {name: values[kept] for name, values in table.conditions("t").items()}
    facts = {
        "track_points": points.shape[1],
        "points_used": int(kept.sum()),
        "cut_at_corners": int(near_corner.sum()),
        "cut_standing": int((still & ~near_corner).sum()),
        "cut_wild": int(wild.sum()),
        "beam_breaks": len(breaks),
        "path_length": path.length,
    }
    seen = np.bincount(leg[kept], minlength=len(path.lengths)) > 0
    warnings = _warnings_on_cuts(breaks, leg, along, wild) + _unseen(seen, path)
    return Track(points[:, kept], leg[kept], conditions, alignment.pose, tuple(warnings), facts)


def _aligned(points: Array, tool: Index | None, path: Path, tools: Array, file: str) -> Alignment:
    alignment = align(points, tool, path, tools)
    _, leg, nominal = path.sampled(3000)
    nominal = nominal + tools[path.tool[leg]].T
    used, limit = points[:, alignment.rows], _FAR * extent(nominal)
    if wrong_unit(used, nominal) is not None:
        raise InputError([mismatch(used, nominal, file)])
    if alignment.miss <= limit:
        return alignment
    mirrored = align(points * [[1.0], [1.0], [-1.0]], tool, path, tools)
    if mirrored.miss <= limit:
        text = "the track is a mirror image of the path"
        raise InputError([Fault(text, file, hint=MIRRORED)])
    away = units.sized(alignment.miss, "length")
    text = f"the track does not have the shape of the path: {away} off after the best alignment"
    hint = "is this the track of another path, or are vertices missing or in another order?"
    raise InputError([Fault(text, file, hint=hint)])


def _on_legs(points: Array, alignment: Alignment, path: Path, tools: Array) -> tuple[Index, Array, Array]:
    """Return the leg of each point, the distance along it, and the distance from it, each (n,)."""
    aligned = poses.apply(alignment.pose, points.T)
    numbers = np.arange(points.shape[1])
    # the alignment has some of the points: one between two of them is on the leg of either
    after = np.clip(np.searchsorted(alignment.rows, numbers), 0, len(alignment.rows) - 1)
    legs = path.leg_of(alignment.way)
    candidates = (legs[np.maximum(after - 1, 0)], legs[after])
    (along, off), (along_after, off_after) = (_to_leg(aligned, leg, path, tools) for leg in candidates)
    nearer = off_after < off
    leg = np.where(nearer, candidates[1], candidates[0])
    return leg, np.where(nearer, along_after, along), np.where(nearer, off_after, off)


def _to_leg(aligned: Array, leg: Index, path: Path, tools: Array) -> tuple[Array, Array]:
    """Return the distance of points along their leg, and their distance from the leg as a segment."""
    from_start = aligned - (path.start + tools[path.tool])[leg]
    along = np.einsum("na,na->n", from_start, path.direction[leg])
    foot = path.direction[leg] * np.clip(along, 0.0, path.lengths[leg])[:, None]
    return along, np.linalg.norm(from_start - foot, axis=1)


def _standing(points: Array, leg: Index) -> Mask:
    """Return the points at which the machine hardly moves compared with the usual speed of the leg."""
    n = points.shape[1]
    step = np.linalg.norm(np.diff(points, axis=1), axis=0)
    # 0.75 mm of usual way on either side: over less, noise would be a speed, and over more, rests would be none
    window = int(np.clip(np.ceil(_LEAST_BREAK / max(float(np.median(step)), 1e-9) / 4), 1, max(1, n // 100)))
    left, right = np.maximum(np.arange(n) - window, 0), np.minimum(np.arange(n) + window, n - 1)
    speed = np.linalg.norm(points[:, right] - points[:, left], axis=0) / (right - left)
    moving = np.minimum(speed, _FAST * np.quantile(speed, 0.9))
    return np.asarray(speed < _DWELL * _usual(moving, leg)[leg])


def _usual(speed: Array, leg: Index) -> Array:
    """Return for each leg the speed below which half of its length was travelled.

    Rests at the vertices take time but no length, so they do not lower this speed as they would lower a median.
    """
    order = np.lexsort((speed, leg))
    way = np.cumsum(speed[order])
    ends = np.cumsum(np.bincount(leg))
    total = np.concatenate([[0.0], way])[ends]
    before = np.concatenate([[0.0], total[:-1]])
    return np.asarray(speed[order][np.searchsorted(way, (before + total) / 2).clip(0, len(way) - 1)])


def _breaks(points: Array, wild: Mask, tool: Index) -> tuple[Mask, Index]:
    """Return the points near a break of the beam, and the last point before each break.

    A jump at a change of the tool is not a break.
    """
    rows = np.flatnonzero(~wild)
    step = np.linalg.norm(np.diff(points[:, rows], axis=1), axis=0)
    # of steps above 0: a long rest would make the median 0, and each step a break
    limit = max(_LEAST_BREAK, _BREAK * float(np.median(step[step > 0])) if (step > 0).any() else 0.0)
    at = np.flatnonzero((step > limit) & (np.diff(tool[rows]) == 0))
    near = np.zeros(points.shape[1], dtype=bool)
    for k in at.tolist():
        for end, side in (
            (rows[k], slice(max(rows[k] - _REACH, 0), rows[k] + 1)),
            (rows[k + 1], slice(rows[k + 1], rows[k + 1] + _REACH)),
        ):
            near[side] |= np.linalg.norm(points[:, side] - points[:, end, None], axis=0) < _SETTLE
    return near, rows[at]


def _warnings_on_cuts(breaks: Index, leg: Index, along: Array, wild: Mask) -> list[str]:
    lines = []
    if len(breaks):
        places = listed([f"leg {leg[k] + 1} at {max(along[k], 0.0):.0f} mm" for k in breaks.tolist()], 5)
        times = "once" if len(breaks) == 1 else f"{len(breaks)} times"
        lines.append(f"the beam broke {times}, on {places}: points within {_SETTLE:g} mm of it are removed")
    if wild.any():
        lines.append(
            f"{int(wild.sum())} points of the track are farther from the path than a machine error can explain, and "
            "are removed"
        )
    return lines


def _unseen(seen: Mask, path: Path) -> list[str]:
    missing = np.flatnonzero(~seen)
    if not missing.size:
        return []
    return [f"legs without points, of {len(path.lengths)}: {listed([str(i + 1) for i in missing])}"]
