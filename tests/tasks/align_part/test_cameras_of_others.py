"""Cameras that are not results: of other programs, fisheyes, and with uncertainties that the job states."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

Metrocli = Callable[..., Any]
TRUTH = {"x": 10.0, "y": -20.0, "z": 60.0, "alpha": 0.02, "beta": -0.01, "gamma": 0.3, "gamma_s": 1e-3}
JOB = """metrocli: 1
job: align-part
inputs: {camera: cam.yml, poses: poses.csv, targets: targets.csv, observations: s/observations.csv}
noise: 0.1 px
camera: {extrinsics: {x: -2 mm, y: 0.3 mm, z: -320 mm, alpha: -0.003 rad, beta: -0.009 rad, gamma: 0.03 rad}}
simulation: {part: {x: 10 mm, y: -20 mm, z: 60 mm, alpha: 0.02 rad, beta: -0.01 rad, gamma: 0.3 rad}, clamping_angle: 1 mm/m}
output: part.h5
"""
FISHEYE = """%YAML:1.0
---
image_width: 1280
image_height: 960
fisheye_model: 1
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 390., 0., 641., 0., 392., 482., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 4
   cols: 1
   dt: d
   data: [ -0.03, 0.004, -8.0e-04, 5.0e-05 ]
"""


@pytest.fixture
def job(tmp_path: Path, metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A part seen by a fisheye whose file OpenCV wrote, from eight poses."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(1)
    targets = rng.uniform([-200, -200, 0], [200, 200, 80], (20, 3))
    poses = np.column_stack([rng.uniform([-150, -150, 100], [150, 150, 200], (8, 3)), rng.uniform(-170, 170, 8)])
    rows = ["target,x_mm,y_mm,z_mm", *(f"T{i},{x:.1f},{y:.1f},{z:.1f}" for i, (x, y, z) in enumerate(targets))]
    (tmp_path / "targets.csv").write_text("\n".join(rows))
    rows = [
        "image,x_mm,y_mm,z_mm,c_deg",
        *(f"i{i},{x:.1f},{y:.1f},{z:.1f},{c:.0f}" for i, (x, y, z, c) in enumerate(poses)),
    ]
    (tmp_path / "poses.csv").write_text("\n".join(rows))
    (tmp_path / "cam.yml").write_text(FISHEYE)
    path = tmp_path / "job.yaml"
    path.write_text(JOB)
    assert metrocli("simulate", path, "--seed", 4, "--out", "s").code == 0
    return path


def estimates(ran: Any) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = json.loads(ran.out)["estimates"]
    return found


def test_a_fisheye_of_opencv_locates_the_part(job: Path, metrocli: Metrocli) -> None:
    ran = metrocli("align-part", job, "--json")
    assert ran.code == 0 and "the camera file of opencv states no covariance: it counts as exact" in ran.err
    exact = estimates(ran)
    assert all(abs(exact[name]["value"] - value) < 4 * exact[name]["std"] for name, value in TRUTH.items())
    ran = metrocli("align-part", job, "--json", "--set", "camera.uncertainty={fx: 0.5 px, fy: 0.5 px}")
    assert ran.code == 0 and "counts as exact" not in ran.err
    assert estimates(ran)["z"]["std"] > 3 * exact["z"]["std"]
    place = "{x: 0.1 mm, y: 0.1 mm, z: 0.1 mm, alpha: 1e-4 rad, beta: 1e-4 rad, gamma: 1e-4 rad}"
    placed = estimates(metrocli("align-part", job, "--json", "--set", f"camera.uncertainty={place}"))
    assert placed["z"]["std"] == pytest.approx(np.hypot(0.1, exact["z"]["std"]), rel=0.02)


@pytest.mark.parametrize(
    ("uncertainty", "words"),
    [
        ("{f: 1 px}", "the camera file has no f"),
        ("{x: 0.1 mm, y: 0.1 mm}", "of all six or of none: z alpha beta gamma missing"),
        ("{fx: 1}", "has no unit"),
    ],
)
def test_uncertainties_that_do_not_fit(uncertainty: str, words: str, job: Path, metrocli: Metrocli) -> None:
    ran = metrocli("check", job, "--set", f"camera.uncertainty={uncertainty}")
    assert ran.code == 3 and words in ran.err


def test_a_file_without_a_field_names_file_and_field(job: Path, metrocli: Metrocli) -> None:
    (job.parent / "cam.yml").write_text(FISHEYE.replace("image_height: 960\n", ""))
    ran = metrocli("check", job)
    assert ran.code == 3 and "cam.yml: error: the file lacks image_height" in ran.err
