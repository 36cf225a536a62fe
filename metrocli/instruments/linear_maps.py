"""Homographies and projections of many views at once by linear equations, robust against gross errors."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.schur.irregular_normals import grams
from metrocli.arrays import Array, Index, Mask

_SUSPECT = 5.0
"""A view is suspect if its largest misfit exceeds this multiple of its median: more than noise and distortion make"""
_MIXED = 0.3
"""... and also this share of the distance of neighbouring points: distortion is smaller, a wrong name moves more"""
_GROSS = 12.0
"""A reading is left out if its misfit exceeds this multiple of the median misfit of the best map"""
_ROUNDS = 60
"""Samples drawn for each suspect view; with up to a third of wrong readings, one is practically sure to be correct"""


def linear_maps(points: Array, rays: Array, view: Index, views: int) -> tuple[Array, Mask]:
    """Return the maps (views, 3, c) of homogeneous points (n, c) onto image points (2, n), and the readings used, (n,).

    For suspect views, samples of the smallest number of readings that determine a map are drawn. The map with the least
    median of squares (Rousseeuw 1984) decides which readings agree; the final map uses all of these.
    """
    maps = _fitted(points, rays, view, views)
    keep = np.ones(len(points), dtype=bool)
    gap = _misfit(maps, points, rays, view)
    largest = np.zeros(views)
    np.maximum.at(largest, view, gap)
    doubtful = np.flatnonzero(
        (largest > _SUSPECT * _medians(gap, view, views)) & (largest > _MIXED * _spacing(rays, view, views))
    )
    if doubtful.size:
        chosen = np.flatnonzero(np.isin(view, doubtful))
        part = (points[chosen], rays[:, chosen], np.searchsorted(doubtful, view[chosen]))
        gap = _misfit(_sampled(*part, len(doubtful)), *part)
        keep[chosen] = gap <= _GROSS * _medians(gap, part[2], len(doubtful))[part[2]]
        inside = keep[chosen]
        maps[doubtful] = _fitted(part[0][inside], part[1][:, inside], part[2][inside], len(doubtful))
    return maps, keep


def _fitted(points: Array, rays: Array, view: Index, views: int) -> Array:
    """Return the maps that fulfil `u (m3 X) = m1 X`, `v (m3 X) = m2 X` best (algebraic error), (views, 3, c)."""
    n, c = points.shape
    rows = np.zeros((n, 2, 3 * c))
    rows[:, 0, :c] = rows[:, 1, c : 2 * c] = points
    rows[:, 0, 2 * c :] = -rays[0][:, None] * points
    rows[:, 1, 2 * c :] = -rays[1][:, None] * points
    # the eigenvector of the least eigenvalue: the map of unit length with the least algebraic error
    _, vectors = np.linalg.eigh(grams(rows, view, views, 3 * c))
    nulls: Array = np.ascontiguousarray(vectors[:, :, 0]).reshape(views, 3, c)
    return nulls


def _misfit(maps: Array, points: Array, rays: Array, view: Index) -> Array:
    """Return the distance of each reading from its mapped point, (n,)."""
    x, y, w = np.einsum("nac,nc->an", maps[view], points)
    away = np.where(w == 0, 1e-300, w)
    return np.asarray(np.hypot(x / away - rays[0], y / away - rays[1]), dtype=float)


def _spacing(rays: Array, view: Index, views: int) -> Array:
    """Return the typical distance of neighbouring image points of each view, as if they filled a square, (views,)."""
    counts = np.maximum(np.bincount(view, minlength=views), 1)
    middle, square = (np.stack([np.bincount(view, row, views) for row in part]) / counts for part in (rays, rays**2))
    # a uniform square of side a has a variance of a^2/12 along each side
    side = np.sqrt(6 * np.maximum((square - middle**2).sum(axis=0), 0.0))
    return np.asarray(side / np.sqrt(counts), dtype=float)


def _medians(values: Array, view: Index, views: int) -> Array:
    """Return the median of the values of each view, 0 for a view without any."""
    order = np.lexsort((values, view))
    counts = np.bincount(view, minlength=views)
    middle = np.cumsum(counts) - counts + counts // 2
    medians = np.zeros(views)
    medians[counts > 0] = values[order][middle[counts > 0]]
    return medians


def _sampled(points: Array, rays: Array, view: Index, views: int) -> Array:
    """Return for each view the map through a random sample of readings that has the least median misfit."""
    rng = np.random.default_rng(0)
    # 4 points for a homography, 6 for a projection: each gives two equations for 3 c - 1 unknowns
    size = 3 * points.shape[1] // 2
    best, least = np.zeros((views, 3, points.shape[1])), np.full(views, np.inf)
    starts = np.concatenate([[0], np.cumsum(np.bincount(view, minlength=views))])[:-1]
    for _ in range(_ROUNDS):
        # a random order within each view: its first `size` readings are the sample
        order = np.lexsort((rng.uniform(size=len(view)), view))
        taken = order[np.arange(len(view)) - starts[view[order]] < size]
        maps = _fitted(points[taken], rays[:, taken], view[taken], views)
        median = _medians(_misfit(maps, points, rays, view), view, views)
        better = median < least
        best[better], least[better] = maps[better], median[better]
    return best
