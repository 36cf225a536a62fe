"""Starts of a best fit, and what a better one would be: the mirror image, or two names exchanged."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from metrocli.arrays import Array
from metrocli.geometry import poses

_MOST = 60
"""Points up to which exchanged names are sought"""
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
    for one, other in combinations(range(len(points)), 2):
        order = np.arange(len(points))
        order[[one, other]] = other, one
        best = min(best, (rms(points[order], goals, scaled), (one, other)))
    return best[1] if best[0] ** 2 * _BETTER < before**2 else None


def aligned_start(points: Array, nominal: Array, scaled: bool) -> tuple[Array, float]:
    """Return a start for nominal points some of whose coordinates are not used (nan), as in a 3-2-1 alignment.

    Unused coordinates follow the fitted points, round by round; rotations by multiples of 90 degrees are tried.
    """
    from metrocli.instruments.camera_start import cube_rotations

    attempts = []
    for rotation in cube_rotations():
        goals = np.where(np.isfinite(nominal), nominal, points @ rotation.T)
        for _ in range(60):
            pose, scale = similarity(points, goals, scaled)
            moved = poses.apply(pose, scale * points)
            goals = np.where(np.isfinite(nominal), nominal, moved)
        attempts.append((float(((goals - moved) ** 2).sum()), pose, scale))
    _, pose, scale = min(attempts, key=lambda trial: trial[0])
    return pose, scale
