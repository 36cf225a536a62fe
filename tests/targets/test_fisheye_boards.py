"""Boards under a fisheye: a homography is many pixels off, and neither hides the board nor misplaces its corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest
from targets.camera_for_tests import about_x, about_z

from metrocli.targets.drawings import board
from metrocli.targets.find import find
from metrocli.targets.lattice import order_fault
from metrocli.targets.pattern import Pattern, lattice, names, pattern_points
from metrocli.targets.render import Look, PlacedDrawing, render

Array = npt.NDArray[np.float64]
CIRCLES = Pattern("circles", 12, 8, 20.0, diameter=11.0)
APRIL = Pattern("aprilgrid", 6, 5, 39.0, marker_size=30.0)


@dataclass(frozen=True)
class Fisheye:
    """The angle from the axis, times the focal length, is the distance from the middle of the image."""

    f: float
    size: tuple[int, int] = (640, 480)

    def rays(self, uv: Array) -> Array:
        far = (uv - (np.array(self.size) - 1) / 2) / self.f
        angle = np.maximum(np.linalg.norm(far, axis=1, keepdims=True), 1e-12)
        return np.hstack([far * np.sin(angle) / angle, np.cos(angle)])

    def project(self, points: Array) -> Array:
        wide = np.linalg.norm(points[:, :2], axis=1, keepdims=True)
        flat = points[:, :2] / wide * np.arctan2(wide, points[:, 2:])
        return np.asarray(self.f * flat + (np.array(self.size) - 1) / 2)


def seen(camera: Fisheye, pattern: Pattern, distance: float, hidden: str = "") -> tuple[npt.NDArray[np.generic], Array]:
    """Image of a tilted board, a paper over the tag of the corner `hidden`, and the true image points."""
    xyz = pattern_points(pattern)[1]
    turn = about_x(-0.5) @ about_z(0.05)
    origin = np.array([0.2 * distance, 3.0, distance]) - turn @ xyz.mean(axis=0)
    scene = [PlacedDrawing(board(pattern), turn, origin)]
    if hidden:
        middle = xyz[names(pattern).index(hidden)] + [pattern.marker_size / 2, pattern.marker_size / 2, 0]
        scene.append(PlacedDrawing(_Paper(pattern.marker_size / 3), turn, turn @ middle + origin))
    image = render(camera.size, camera.rays, scene, Look(noise=1.0), np.random.default_rng(11))
    return image, camera.project(xyz @ turn.T + origin)


@dataclass(frozen=True)
class _Paper:
    """A blank square."""

    half: float

    @property
    def sheet(self) -> tuple[float, float, float, float]:
        return -self.half, -self.half, self.half, self.half

    def ink(self, x: Array, y: Array) -> Array:
        return np.zeros_like(x) + 0 * y


def test_all_circles_are_found() -> None:
    image, true = seen(Fisheye(240.0), CIRCLES, 135.0)
    found = find(CIRCLES, image)
    assert len(found) == len(true), found.reason


def test_corners_beside_a_hidden_tag_are_as_good_as_others() -> None:
    image, true = seen(Fisheye(260.0), APRIL, 170.0, "r08c00")
    found = find(APRIL, image)
    rows = [names(APRIL).index(name) for name in found.targets]
    assert len(rows) >= len(true) - 6, found.reason
    assert np.abs(found.uv - true[rows]).max() < 0.05


@pytest.mark.parametrize("pattern", [Pattern("chessboard", 14, 10, 20.0), Pattern("chessboard", 5, 4, 40.0)])
def test_a_missing_column_is_noticed_under_a_fisheye(pattern: Pattern) -> None:
    true, steps = seen(Fisheye(240.0), pattern, 130.0)[1], lattice(pattern)
    assert not order_fault(steps, true)
    column = steps[:, 0] != 2
    closed = steps[column] - [1, 0] * (steps[column, :1] > 2)
    assert "not that of a flat board" in order_fault(closed, true[column])
