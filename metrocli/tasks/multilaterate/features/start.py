"""Starting values of ideal features from their points alone; linear equations for each of many directions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli.tasks.multilaterate.features.ideal import Array, Ideal, Shape, tangents

_DIRECTIONS = 150
"""Directions of an axis, evenly over half the sphere"""
_KEPT = 4
"""Directions from which the fit starts; the best fit counts"""
_SAMPLE = 400
"""Points, at most, that choose the directions"""


def starts(shape: Shape, points: Array) -> Iterator[Ideal]:
    """Yield features near the points (n, 3) from which a fit can start."""
    centre = points.mean(axis=0)
    away = points - centre
    size = float(np.sqrt((away**2).sum(axis=1).mean())) or 1.0
    principal = np.linalg.svd(away, full_matrices=False)[2]
    if shape is Shape.LINE:
        yield Ideal(shape, centre, principal[0], size=size)
    elif shape is Shape.PLANE:
        yield Ideal(shape, centre, principal[2], size=size)
    elif shape is Shape.CIRCLE:
        yield from _round(shape, away / size, centre, size, principal[2:])
    elif shape is Shape.SPHERE:
        scaled = away / size
        *middle, rest = _solved(np.column_stack([2 * scaled, np.ones(len(points))]), (scaled**2).sum(axis=1))[0]
        radius = np.sqrt(max(rest + float(np.square(middle).sum()), 0.0))
        yield Ideal(shape, centre + size * np.array(middle), np.array([0.0, 0.0, 1.0]), size * radius, size=size)
    else:
        every = np.linspace(0, len(points) - 1, min(len(points), _SAMPLE)).astype(int)
        yield from _round(shape, away[every] / size, centre, size, np.concatenate([principal, _directions()]))


def _directions() -> Array:
    """Return unit vectors (_DIRECTIONS, 3) on half a sphere, by the golden angle."""
    height = (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS
    turn = np.arange(_DIRECTIONS) * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - height**2)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), height])


def _round(shape: Shape, scaled: Array, centre: Array, size: float, axes: Array) -> Iterator[Ideal]:
    """Yield the features about those axes whose squared radii fit best.

    About an axis `u^2 + v^2 = 2 (a u + b v) + R^2 - a^2 - b^2`, with `2 R k h + k^2 h^2` more for a cone: linear.
    """
    found = []
    for axis in axes:
        first, second = tangents(axis)
        u, v, h = scaled @ first, scaled @ second, scaled @ axis
        columns = [2 * u, 2 * v, np.ones(len(u))]
        columns += [h, h**2] if shape is Shape.CONE else []
        solved, misfit = _solved(np.column_stack(columns), u**2 + v**2)
        radius = np.sqrt(max(solved[2] + solved[0] ** 2 + solved[1] ** 2, 0.0))
        if radius == 0:
            continue
        slope = solved[3] / (2 * radius) if shape is Shape.CONE else 0.0
        origin = centre + size * (solved[0] * first + solved[1] * second)
        found.append((misfit / radius, Ideal(shape, origin, axis, size * radius, float(np.arctan(slope)), size)))
    found.sort(key=lambda one: one[0])
    yield from (ideal for _, ideal in found[:_KEPT])


def _solved(matrix: Array, wanted: Array) -> tuple[Array, float]:
    solution = np.asarray(np.linalg.lstsq(matrix, wanted, rcond=None)[0], dtype=float)
    return solution, float(np.linalg.norm(matrix @ solution - wanted))
