"""Cameras whose noise follows residuals that are not noise: another lens, turned images, a lens beyond its readings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

Metrocli = Callable[..., Any]
Array = npt.NDArray[np.float64]
SIZE = np.array([1280, 960])
JOB = """metrocli: 1
job: calibrate-camera
rig: board
inputs: {observations: observations.csv, targets: targets.csv}
camera: {image_size: [1280, 960], estimate: [fx, fy, cx, cy, k1, k2, p1, p2]}
noise: estimated
output: r.h5
"""


def rotation(angles: Array) -> Array:
    (a, b, c), (d, e, f) = np.cos(angles), np.sin(angles)
    x, y, z = [[1, 0, 0], [0, a, -d], [0, d, a]], [[b, 0, e], [0, 1, 0], [-e, 0, b]], [[c, -f, 0], [f, c, 0], [0, 0, 1]]
    return np.array(z) @ np.array(y) @ np.array(x)


def pinhole(x: Array, y: Array) -> Array:
    r2 = x**2 + y**2
    return 1100 * np.stack([x, y]) * (1 - 0.2 * r2 + 0.05 * r2**2)


def fisheye(x: Array, y: Array) -> Array:
    """An equidistant lens."""
    r = np.hypot(x, y)
    return 420 * np.stack([x, y]) * np.arctan(r) / r


def board(folder: Path, lens: Callable[[Array, Array], Array], near: float, images: int = 12, turned: int = 0) -> Path:
    """Write a job of a board of 9 x 7 points in random poses from a distance on, the first images turned."""
    rng, rows = np.random.default_rng(2), []
    points = np.stack([*np.meshgrid(np.arange(9) * 30.0 - 120, np.arange(7) * 30.0 - 90), np.zeros((7, 9))])
    points = points.reshape(3, -1)
    while len(rows) < images:
        seen = rotation(np.radians(rng.uniform(-35, 35, 3))) @ points
        seen = seen + np.array([*rng.uniform(-0.3, 0.3, 2) * near, rng.uniform(near, 1.6 * near)])[:, None]
        uv = ((SIZE - 1) / 2 + [12, -6])[:, None] + lens(seen[0] / seen[2], seen[1] / seen[2])
        if (uv > 0).all() and (uv < SIZE[:, None]).all():
            uv = uv + rng.normal(0, 0.1, uv.shape)
            rows.append((SIZE - 1)[:, None] - uv if len(rows) < turned else uv)
    lines = [f"i{i},{k},{u},{v}" for i, uv in enumerate(rows) for k, (u, v) in enumerate(uv.T)]
    (folder / "observations.csv").write_text("\n".join(["image,target,u_px,v_px", *lines, ""]))
    lines = [f"{k},{x},{y},0" for k, (x, y) in enumerate(points[:2].T)]
    (folder / "targets.csv").write_text("\n".join(["target,x_mm,y_mm,z_mm", *lines, ""]))
    (folder / "job.yaml").write_text(JOB)
    return folder / "job.yaml"


def waved(x: Array, y: Array) -> Array:
    """A lens with a shape that no polynomial of its radius has, nor a fisheye."""
    return 420 * np.stack([x + 0.006 * np.sin(9 * y), y - 0.006 * np.sin(8 * x)])


@pytest.mark.slow
def test_a_fisheye_as_pinhole_is_doubtful(tmp_path: Path, metrocli: Metrocli) -> None:
    ran = metrocli("calibrate-camera", board(tmp_path, fisheye, 125.0))
    assert ran.code == 6 and "the lens is a fisheye" in ran.out


def test_a_shape_that_no_lens_model_has_is_doubtful(tmp_path: Path, metrocli: Metrocli) -> None:
    ran = metrocli("calibrate-camera", board(tmp_path, waved, 200.0))
    assert ran.code == 6
    assert "are smooth in each image" in ran.out and "--compare shows" in ran.out


@pytest.mark.parametrize("turned", [1, 6])
def test_images_turned_by_180_degrees_are_named(turned: int, tmp_path: Path, metrocli: Metrocli) -> None:
    ran = metrocli("calibrate-camera", board(tmp_path, pinhole, 450.0, turned=turned))
    names = ", ".join(f"i{i}" for i in range(turned))
    assert ran.code == 6 and f"others are: {names};" in ran.out
    assert "fx = 1100" in ran.out or "fx = 1099" in ran.out


def test_images_as_the_camera_wrote_them_are_done_and_their_coverage_is_stated(
    tmp_path: Path, metrocli: Metrocli
) -> None:
    ran = metrocli("calibrate-camera", board(tmp_path, pinhole, 450.0))
    assert ran.code == 0
    assert "coverage: readings span" in ran.out and "projection into its worst corner" in ran.out


def test_a_lens_beyond_its_readings_is_doubtful_unless_the_job_allows_it(tmp_path: Path, metrocli: Metrocli) -> None:
    job = board(tmp_path, pinhole, 2500.0)
    rational = ("--set", "camera.estimate=[fx, fy, cx, cy, k1, k2, k3, k4]", "--force")
    ran = metrocli("calibrate-camera", job, *rational)
    assert ran.code == 6 and "In a corner the lens is uncertain by" in ran.out
    job.write_text(JOB + 'require: {corner_std: "< 1e9"}\n')
    assert metrocli("calibrate-camera", job, *rational).code == 0


def test_points_in_the_corners_of_a_wide_lens_are_not_called_wrong(tmp_path: Path, metrocli: Metrocli) -> None:
    """What the other points show of a board does not reach there, and the adjustment leaves little of these points."""
    rng, rows = np.random.default_rng(12), []
    points = np.array([(25.0 * i - 87.5, 25.0 * j - 62.5, 0.0) for j in range(6) for i in range(8)]).T
    while len(rows) < 15:
        a, b, c = (*rng.uniform(-0.7, 0.7, 2), rng.uniform(-0.3, 0.3))
        turned = rotation([0, 0, c]) @ rotation([0, b, 0]) @ rotation([a, 0, 0]) @ points
        x, y, z = turned + np.array([*rng.uniform(-120, 120, 2), rng.uniform(70, 140)])[:, None]
        if z.min() < 10:
            continue
        far = np.hypot(x, y)
        # pixels that are not square, which the job does not estimate
        uv = 270 * np.arctan2(far, z) / far * np.stack([0.94 * x, y]) + [[352], [288]]
        uv += rng.normal(0, 0.2, (48, 2)).T
        if (uv > 0).all() and (uv < [[704], [576]]).all():
            rows.append(uv)
    lines = [f"i{i},{k},{u},{v}" for i, uv in enumerate(rows) for k, (u, v) in enumerate(uv.T)]
    job = board(tmp_path, pinhole, 450.0)
    (tmp_path / "observations.csv").write_text("\n".join(["image,target,u_px,v_px", *lines, ""]))
    lines = [f"{k},{x},{y},0" for k, (x, y) in enumerate(points[:2].T)]
    (tmp_path / "targets.csv").write_text("\n".join(["target,x_mm,y_mm,z_mm", *lines, ""]))
    text = (
        "metrocli: 1\njob: calibrate-camera\nrig: board\ninputs: {observations: observations.csv, targets: targets.csv}"
    )
    job.write_text(f"{text}\ncamera: {{image_size: [704, 576], model: fisheye}}\nnoise: structured\noutput: r.h5\n")
    assert "off the view of the board" not in metrocli("calibrate-camera", job).out
