"""How much of the image the readings cover."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.model.blocks import Array

_CELLS = 10
_DIRECTIONS = 32


def coverage(uv: Array, image_size: Sequence[int], centre: tuple[float, float]) -> dict[str, float]:
    """Return which share of the image the points (2, n) [px] cover, in three measures.

    `coverage_cells` is the share of a 10 x 10 grid of cells that contain a point. `coverage_hull` is the area of the
    points' convex hull over that of the image. `coverage_radius` is the distance of the farthest point from `centre`,
    the principal point, over that of the farthest corner.
    """
    w, h = image_size
    cx, cy = centre
    inside = (uv[0] >= 0) & (uv[0] < w) & (uv[1] >= 0) & (uv[1] < h)
    cells = np.unique((uv[:, inside] / np.array([[w], [h]]) * _CELLS).astype(int), axis=1)
    corner = max(np.hypot(cx - x, cy - y) for x in (0, w - 1) for y in (0, h - 1))
    return {
        "coverage_cells": cells.shape[1] / _CELLS**2,
        "coverage_hull": hull_area(uv) / (w * h),
        "coverage_radius": float(np.hypot(uv[0] - cx, uv[1] - cy).max() / corner),
    }


def hull_area(uv: Array) -> float:
    """Return the area of the convex hull of image points (2, n), by the monotone chain of Andrew (1979)."""
    points = np.unique(_outer(uv.T), axis=0)
    hull: list[Array] = []
    for ordered in (points, points[::-1]):
        side: list[Array] = []
        for point in ordered:
            while len(side) > 1 and _turn(side[-2], side[-1], point) <= 0:
                side.pop()
            side.append(point)
        hull += side[:-1]
    x, y = np.array(hull).T if hull else np.zeros((2, 1))
    return float(abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) / 2)


def _outer(points: Array) -> Array:
    """Return the points that can be corners of the hull, (m, 2) of (n, 2).

    Points inside the polygon of the farthest points in 32 directions are left out: they are most, and sorting is slow.
    """
    angle = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
    corners = points[(points @ np.stack([np.cos(angle), np.sin(angle)])).argmax(axis=0)]
    inside = np.ones(len(points), dtype=bool)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if (a != b).any():
            inside &= (b[0] - a[0]) * (points[:, 1] - a[1]) > (b[1] - a[1]) * (points[:, 0] - a[0])
    return np.concatenate([corners, points[~inside]])


def _turn(a: Array, b: Array, c: Array) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
