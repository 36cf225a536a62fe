"""Starts of a best fit, and what a better one would be: the mirror image, or two names exchanged."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.geometry import poses

_MOST = 60
"""Points up to which exchanged names are sought"""
_MIRRORED = 10.0
"""A mirror image is refused that makes the deviations so many times smaller"""
RIGID = 6
"""Unknowns of a transformation without a scale"""
_STEPS, _LONGEST = 20, 0.3
"""Newton's steps from each start of an alignment, and the longest [rad]"""
_OF_EACH = 500
"""Points with a coordinate from which about so many are taken for a start"""
_ALIKE, _ROUGH = 2.0, 1e-5
"""Starts fit alike whose deviations are at most so many times the least, and so much of the extent more"""
_BETTER = 100.0
"""An exchange of two names is named if it makes the squared deviations so many times smaller"""


def similarity(points: Array, goals: Array, scaled: bool) -> tuple[Array, float]:
    """Return pose (6,) and scale that lay points (n, 3) nearest to goals (n, 3); the scale is 1 unless `scaled`."""
    return poses.fit_similarity(points, goals) if scaled else (poses.fit_pose(points, goals), 1.0)


def rms(points: Array, goals: Array, scaled: bool) -> float:
    """Return the root mean square distance of points from their goals after the best fit [mm]."""
    pose, scale = similarity(points, goals, scaled)
    return float(np.sqrt(((poses.apply(pose, scale * points) - goals) ** 2).sum(axis=1).mean()))


def mirrored_rms(points: Array, goals: Array, scaled: bool) -> float:
    """Return the root mean square distance after the best fit of the mirror image of the points [mm]."""
    return rms(points * [-1.0, 1.0, 1.0], goals, scaled)


def exchanged(points: Array, goals: Array, scaled: bool) -> tuple[int, int] | None:
    """Return the two points whose names, exchanged, make the squared deviations a hundred times smaller; else None."""
    if not 4 <= len(points) <= _MOST:
        return None
    before, best = rms(points, goals, scaled), (np.inf, (0, 0))
    for first, other in combinations(range(len(points)), 2):
        order = np.arange(len(points))
        order[[first, other]] = other, first
        best = min(best, (rms(points[order], goals, scaled), (first, other)))
    return best[1] if best[0] ** 2 * _BETTER < before**2 else None


def mirrored(points: Array, goals: Array, names: Sequence[str], scaled: bool, station: str = "") -> float:
    """Return the root mean square deviation of the mirror image [mm].

    Raises InputError if it is far smaller than that of the points, or if that is with two names exchanged.
    """
    as_listed, other = rms(points, goals, scaled), mirrored_rms(points, goals, scaled)
    if len(points) > 3 and other * _MIRRORED < as_listed:
        if station:
            raise InputError(
                f"the points of station {station} are a mirror image of the others: mirrored, they fit to "
                f"{other:.3g} mm (root mean square), and to {as_listed:.3g} mm as they are; turn the sign of an axis"
            )
        raise InputError(
            "the measured points are a mirror image of the nominal ones: mirrored, they fit to "
            f"{other:.3g} mm (root mean square), and to {as_listed:.3g} mm as they are; turn the sign of one axis "
            "in one of the lists"
        )
    pair = exchanged(points, goals, scaled)
    if pair is not None:
        first, second = (names[i] for i in pair)
        so = "without that the squared deviations are more than a hundred times smaller"
        if station:
            raise InputError(f"points {first} and {second} are exchanged at station {station}, or before it: {so}")
        raise InputError(f"points {first} and {second} are exchanged in one of the lists: {so}")
    return other


def turned(points: Array, pose: Array, scale: float, unknowns: int) -> tuple[Array, Array]:
    """Return points after the transformation (n, 3), and their derivatives by its steps (n, 3, 6 or 7)."""
    turned = scale * points @ poses.rotation_of(pose).T
    slope = np.zeros((len(turned), 3, unknowns))
    slope[:, :, :3] = np.eye(3)
    x, y, z = turned.T
    slope[:, 0, 4], slope[:, 0, 5], slope[:, 1, 3] = z, -y, -z
    slope[:, 1, 5], slope[:, 2, 3], slope[:, 2, 4] = x, y, -x
    if unknowns > RIGID:
        slope[:, :, RIGID] = turned / scale
    return turned + pose[:3], slope


def aligned_start(points: Array, nominal: Array, scaled: bool) -> tuple[Array, float]:
    """Return a start for nominal points some of whose coordinates are not used (nan), as in a 3-2-1 alignment.

    Unused coordinates follow the fitted points, round by round; rotations by multiples of 90 degrees are tried. A 3-2-1
    alignment is also met with the part turned over: of the starts that fit alike, that with the least turn is taken.
    """
    from metrocli.instruments.camera_start import cube_rotations

    # a start from some points that have each coordinate is as good, and takes no time that grows with the list
    held = [np.flatnonzero(own) for own in np.isfinite(nominal).T]
    some = np.unique(np.concatenate([own[:: max(len(own) // _OF_EACH, 1)] for own in held]))
    points, nominal = points[some], nominal[some]
    attempts, used = [], np.isfinite(nominal)
    for rotation in cube_rotations():
        goals = np.where(np.isfinite(nominal), nominal, points @ rotation.T)
        for _ in range(60):
            pose, scale = similarity(points, goals, scaled)
            moved = poses.apply(pose, scale * points)
            goals = np.where(np.isfinite(nominal), nominal, moved)
        for _ in range(_STEPS):  # rounds alone come nearer and nearer where few coordinates are used
            moved, slope = turned(points, pose, scale, RIGID + scaled)
            step = np.asarray(np.linalg.lstsq(slope[used], (nominal - moved)[used], rcond=None)[0], dtype=np.float64)
            step = step * min(1.0, _LONGEST / max(float(np.abs(step[3:]).max()), 1e-300))
            pose, scale = poses.moved(pose, step[:RIGID]), scale + float(step[RIGID:].sum())
        off = (poses.apply(pose, scale * points) - nominal)[used]
        attempts.append((float(np.sqrt((off**2).mean())), pose, scale))
    bound = _ALIKE * min(off for off, _, _ in attempts) + _ROUGH * float(np.ptp(points, axis=0).max())
    near = [(pose, scale) for off, pose, scale in attempts if off <= bound]
    return max(near, key=lambda start: float(np.trace(poses.rotation_of(start[0]))))
