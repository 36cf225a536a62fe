"""Points and levelled stations that angles alone place.

Method: docs/algorithms/joined-set-ups.md.
"""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array

_CIRCLE = 1e-4
"""Singular value of the directions, relative to the largest, below which station and points are on one circle"""
_PARALLEL = 1e-6


def intersected(places: Array, beams: Array) -> Array | None:
    """Return the point nearest to beams (n, 3) of unit length from places (n, 3); None for parallel ones."""
    across = np.eye(3) - beams[:, :, None] * beams[:, None]
    matrix = across.sum(axis=0)
    if np.linalg.eigvalsh(matrix)[0] <= _PARALLEL:
        return None
    return np.asarray(np.linalg.solve(matrix, np.einsum("nab,nb->a", across, places)))


def resected(points: Array, azimuth: Array, elevation: Array) -> Array | None:
    """Return place and turn about z (4,) of a levelled station from its angles to three or more points (n, 3).

    An elevation may be missing (nan). None for fewer points, and for points on one circle or line with the station.
    """
    if len(points) < 3 or np.isnan(elevation).all():
        return None
    centre = points.mean(axis=0)
    size = float(np.abs(points[:, :2] - centre[:2]).max()) or 1.0
    x, y = (points[:, :2] - centre[:2]).T / size
    a, b = np.cos(azimuth), np.sin(azimuth)
    # each point is where its azimuth points: (a, b) x (R(-gamma) X - T) = 0, linear in cos, sin and T up to their scale
    rows = np.stack([a * y - b * x, -a * x - b * y, b, -a], axis=1)
    values, vectors = np.linalg.svd(rows)[1:]
    if values[2] < _CIRCLE * values[0]:
        return None
    cos, sin, *to = vectors[3] / np.hypot(*vectors[3, :2])
    ahead = a * (cos * x + sin * y - to[0]) + b * (cos * y - sin * x - to[1])
    # both signs fit the lines; the points are ahead, not behind
    cos, sin, u, v = np.sign(ahead.sum()) * np.array([cos, sin, *to])
    away = np.abs(ahead) * size
    z = np.nanmean(points[:, 2] - away * np.tan(elevation))
    return np.array(
        [centre[0] + size * (cos * u - sin * v), centre[1] + size * (sin * u + cos * v), z, np.arctan2(sin, cos)]
    )
