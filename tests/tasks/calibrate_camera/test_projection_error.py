"""What of an uncertain lens shows in images of fixed points, and the poses of the images of several cameras."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from metrocli.geometry import poses
from metrocli.instruments import camera
from metrocli.tasks.calibrate_camera.multi_camera.alone import views_of
from metrocli.tasks.calibrate_camera.projection_error import _LensDerivatives, _Projection

COLUMNS, VALUES = ("f", "cx", "cy", "k1"), np.array([1000.0, 500.0, 400.0, -0.1])
READINGS = np.stack([part.ravel() for part in np.meshgrid(np.linspace(200, 800, 9), np.linspace(150, 650, 7))])
CORNER = np.array([[0.0], [0.0]])


def std(name: str, spread: float, depth: float, at: Any = CORNER, convention: str = "forward") -> float:
    lens = _LensDerivatives(convention, COLUMNS, VALUES)
    free = np.array([COLUMNS.index(name)])
    return float(_Projection(lens, free, np.array([[spread**2]]), READINGS, None).std(at, depth).max())


def test_a_focal_length_is_a_distance_but_not_for_far_points() -> None:
    """Without distortion a longer focal length and a farther camera give the same images of a plane."""
    assert std("f", 1.0, 600.0) < 0.1 * std("f", 1.0, np.inf)
    # far points: the corner is 640 px from the centre, and no rotation takes a change of scale
    assert std("f", 1.0, np.inf) == pytest.approx(0.64, rel=0.1)


def test_a_principal_point_is_a_rotation() -> None:
    assert std("cx", 1.0, np.inf, np.array([[500.0], [400.0]])) < 0.1
    assert std("cx", 1.0, 600.0) < 0.2


def test_a_distortion_shows_where_no_reading_is() -> None:
    inside, corner = (std("k1", 0.01, 600.0, at) for at in (np.array([[520.0], [420.0]]), CORNER))
    assert corner > 20 * inside
    assert corner < 0.01 * 1000 * 0.64**3 * 1.2


def test_the_order_of_the_readings_does_not_matter() -> None:
    rng = np.random.default_rng(1)
    lens, covariance = _LensDerivatives("forward", COLUMNS, VALUES), np.diag([0.5, 0.4, 0.4, 0.004]) ** 2
    readings = rng.uniform(150, 800, (2, 900))
    one, other = (
        _Projection(lens, np.arange(4), covariance, each, None).std(CORNER)
        for each in (readings, readings[:, rng.permutation(900)])
    )
    assert other == pytest.approx(one, rel=1e-9)


def test_a_distorted_lens_moves_as_with_the_derivatives_of_opencv() -> None:
    columns, values = ("f", "cx", "cy", "k1", "k2"), np.array([900.0, 640.0, 480.0, -0.25, 0.06])
    square, distortion = np.array([[900.0, 0, 640], [0, 900, 480], [0, 0, 1]]), np.array([-0.25, 0.06, 0, 0])
    at = np.array([[639.0, 900, 1200, 5], [479.0, 300, 900, 10]])

    def derivatives(uv: Any) -> tuple[Any, Any]:
        flat = cv2.undistortPoints(uv.T[:, None].copy(), square, distortion, criteria=(3, 200, 1e-14))[:, 0]
        points = 400.0 * np.c_[flat, np.ones(len(flat))]
        by = cv2.projectPoints(points, np.zeros(3), np.zeros(3), square, distortion)[1]
        return by[:, :6], np.c_[by[:, 6] + by[:, 7], by[:, 8:12]]

    (by_move, by_lens), (near_move, near_lens) = derivatives(at), derivatives(READINGS)
    change = by_lens - by_move @ np.linalg.lstsq(near_move, near_lens, rcond=None)[0]
    covariance = np.diag([0.5, 0.4, 0.4, 0.004, 0.02]) ** 2
    wanted = np.sqrt(np.einsum("ia,ab,ib->i", change, covariance, change).reshape(-1, 2).sum(axis=1))
    lens = _LensDerivatives("forward", columns, values)
    found = _Projection(lens, np.arange(5), covariance, READINGS, None).std(at, 400.0)
    assert found == pytest.approx(wanted, rel=0.01)


@pytest.mark.alike
@pytest.mark.parametrize("rig", ["board", "network"])
def test_poses_of_images_have_the_covariance_of_both_poses(rig: str) -> None:
    """Derivatives by differences: two exposures, two cameras, a covariance at random."""
    rng = np.random.default_rng(4)
    view, mount = (rng.normal(0, [100, 100, 100, 0.5, 0.5, 0.5], (2, 6)) for _ in range(2))
    root = rng.normal(0, 1, (24, 24)) * np.tile([0.1, 0.1, 0.1, 1e-3, 1e-3, 1e-3], 4)[:, None]
    whole = root @ root.T
    blocks = {camera.VIEW: SimpleNamespace(values=view), camera.MOUNT: SimpleNamespace(values=mount)}
    parts = {camera.VIEW: slice(0, 12), camera.MOUNT: slice(12, 24)}
    covariance = SimpleNamespace(
        members=lambda name: np.stack([whole[parts[name], parts[name]][i : i + 6, i : i + 6] for i in (0, 6)]),
        between=lambda one, other: whole[parts[one], parts[other]],
    )
    solution: Any = SimpleNamespace(blocks=blocks, covariance_or_raise=lambda: covariance)
    at, of = np.array([0, 1, 1]), np.array([0, 0, 1])
    values, found = views_of(SimpleNamespace(rig=rig, exposed=SimpleNamespace(exposure=at, camera=of)), solution)  # type: ignore[arg-type]

    def image(k: int, step: Any) -> Any:
        own = poses.moved(view[at[k]], step[6 * at[k] : 6 * at[k] + 6])
        held = poses.moved(mount[of[k]], step[12 + 6 * of[k] : 18 + 6 * of[k]])
        return poses.compose(poses.inverse(held), own) if rig == "board" else poses.compose(own, held)

    for k in range(3):
        assert values[k] == pytest.approx(image(k, np.zeros(24)))
        ahead = np.array([poses.difference(image(k, step), values[k]) for step in np.eye(24) * 1e-6])
        back = np.array([poses.difference(image(k, -step), values[k]) for step in np.eye(24) * 1e-6])
        change = ((ahead - back) / 2e-6).T
        wanted = change @ whole @ change.T
        assert found[k] == pytest.approx(wanted, rel=1e-5, abs=1e-7 * np.abs(wanted).max())
