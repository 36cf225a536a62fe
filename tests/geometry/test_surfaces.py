"""Distances from ideal surfaces against plain formulas, and their derivatives against differences."""

from __future__ import annotations

import numpy as np
import pytest

from metrocli.geometry.surfaces import Surface, Surfaces, cone, cylinder, plane, sphere

POINT, AXIS = np.array([10.0, -20.0, 30.0]), np.array([1.0, 2.0, 2.0])
UNIT = AXIS / 3
MADE = {
    "plane": (plane("s", POINT, AXIS), lambda v: v @ UNIT),
    "bore": (cylinder("s", POINT, AXIS, 7.0, -1.0), lambda v: 7 - np.linalg.norm(np.cross(v, UNIT), axis=1)),
    "ball": (sphere("s", POINT, 7.0, 1.0), lambda v: np.linalg.norm(v, axis=1) - 7),
    "cone": (
        cone("s", POINT, AXIS, np.radians(30), 1.0),
        lambda v: (
            np.sin(np.arctan2(np.linalg.norm(np.cross(v, UNIT), axis=1), v @ UNIT) - np.radians(30))
            * np.linalg.norm(v, axis=1)
        ),
    ),
}


@pytest.mark.parametrize("name", MADE)
def test_distance_and_derivatives(name: str) -> None:
    surface, expected = MADE[name]
    one = Surfaces.of([surface])
    rng = np.random.default_rng(3)
    points = POINT + rng.uniform(-1, 1, (40, 3)) * 30 + 25 * UNIT
    index = np.zeros(40, dtype=np.intp)
    shape = one.shape(points, index)
    assert np.allclose(shape.distance, expected(points - POINT), atol=1e-10)
    step = 1e-4
    for k in range(3):
        move = step * np.eye(3)[k]
        ahead, behind = one.shape(points + move, index), one.shape(points - move, index)
        assert np.allclose(shape.normal[:, k], (ahead.distance - behind.distance) / (2 * step), atol=1e-7)
        assert np.allclose(shape.bend[:, :, k], (ahead.normal - behind.normal) / (2 * step), atol=1e-6)


def test_many_placements_of_points_on_a_surface_each() -> None:
    """The surfaces of the points hold for each placement, whether they are given once or for each."""
    surfaces = Surfaces.of([surface for surface, _ in MADE.values()])
    rng = np.random.default_rng(4)
    placed, index = POINT + rng.uniform(-1, 1, (5, 40, 3)) * 30, rng.integers(len(MADE), size=40)
    distance, normal = surfaces.distances(placed, index)
    repeated = surfaces.distances(placed, np.broadcast_to(index, (5, 40)))
    assert np.array_equal(distance, repeated[0])
    assert np.array_equal(normal, repeated[1])
    for points, own in zip(placed, distance, strict=True):
        expected = [list(MADE.values())[one][1](points[[k]] - POINT)[0] for k, one in enumerate(index.tolist())]
        assert np.allclose(own, expected, atol=1e-10)


def test_the_nearest_surface_depends_on_the_levels() -> None:
    low = plane("low", np.zeros(3), np.array([0.0, 0, 1]))
    high: Surface = plane("high", np.array([0.0, 0, 10]), np.array([0.0, 0, 1]))
    both = Surfaces.of([low, high])
    points = np.array([[0.0, 0.0, 4.0], [0.0, 0.0, 6.0]])
    assert both.nearest(points).tolist() == [0, 1]
    assert both.nearest(points, np.array([0.0, -8.0])).tolist() == [1, 1]
