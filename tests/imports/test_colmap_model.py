"""A sparse model of COLMAP becomes a network whose camera is found; what its files lack is named with the line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

Metrocli = Callable[..., Any]
JOB = """metrocli: 1
job: calibrate-camera
rig: network
inputs: {observations: observations.csv, targets: targets.csv}
camera: {image_size: [1000, 800], estimate: [f, cx, cy, k1]}
noise: 0.02 px
output: camera.h5
"""
IMAGES = """# Image list with two lines of data per image:
1 1 0 0 0 0 0 0 1 a b.jpg
10.5 20.25 7 3 4 -1
2 1 0 0 0 0 0 0 2 c.jpg

3 1 0 0 0 0 0 0 1 d.jpg
1 2 7 3 4 8 5 6 8
"""


def model(folder: Path) -> None:
    """Forty points seen by ten images; the principal point is (512, 390) where the first pixel's centre is (0.5, 0.5)."""
    rng = np.random.default_rng(2)
    points = rng.uniform(-100, 100, (40, 3))
    lines = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", "#   POINTS2D[] as (X, Y, POINT3D_ID)"]
    for number in range(10):
        turn = Rotation.from_euler("zyx", [number * 1.57 + rng.normal() * 0.1, *rng.uniform(-0.6, 0.6, 2)])
        shift = np.array([*rng.uniform(-20, 20, 2), 420.0])
        seen = turn.apply(points) + shift
        flat = seen[:, :2] / seen[:, 2:]
        uv = 900 * flat * (1 - 0.1 * (flat**2).sum(axis=1, keepdims=True)) + [512, 390] + rng.normal(0, 0.02, (40, 2))
        w, x, y, z = np.roll(turn.as_quat(), 1)
        lines.append(f"{number + 1} {w} {x} {y} {z} {shift[0]} {shift[1]} {shift[2]} 1 view{number}.jpg")
        lines.append("12.5 13.5 -1 " + " ".join(f"{u} {v} {i + 100}" for i, (u, v) in enumerate(uv.tolist())))
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    rows = [f"{i + 100} {x} {y} {z} 9 9 9 0.5 1 2 3 4" for i, (x, y, z) in enumerate(points.tolist())]
    (folder / "points3D.txt").write_text("\n".join(["# 3D point list", *rows]) + "\n")
    (folder / "job.yaml").write_text(JOB)


def test_the_camera_of_a_model_is_found(tmp_path: Path, metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    model(tmp_path)
    ran = metrocli("import", "images.txt", "--from", "colmap-model")
    assert ran.code == 0 and "10 image points show no point of the model" in ran.err
    assert metrocli("import", "points3D.txt", "--from", "colmap-model", "--unit", "mm").code == 0
    ran = metrocli("calibrate-camera", "job.yaml", "--json")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)["estimates"]
    for name, value in {"f": 900.0, "cx": 511.5, "cy": 389.5, "k1": -0.1}.items():
        assert abs(found[name]["value"] - value) < 4 * found[name]["std"] and found["cx"]["std"] < 0.1, name


def test_cameras_names_and_points_seen_twice(tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "images.txt").write_text(IMAGES)
    assert metrocli("import", tmp_path / "images.txt", "--from", "colmap-model").code == 0
    written = (tmp_path / "observations-1.csv").read_text().splitlines()
    assert [line for line in written if not line.startswith("#")] == [
        "image,target,u_px,v_px", "a b.jpg,7,10.0,19.75", "d.jpg,7,0.5,1.5",
    ]  # fmt: skip
    assert any("2 image points show a point that their image shows again" in line for line in written)
    assert (tmp_path / "observations-2.csv").read_text().splitlines()[-1] == "image,target,u_px,v_px"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (IMAGES.replace("1 a b.jpg", ""), "images.txt:2:1: error: expected IMAGE_ID"),
        (IMAGES.replace("20.25 7", "20.25"), "images.txt:3:1: error: expected X Y POINT3D_ID of each image point of a b.jpg"),
        ("1 PINHOLE 640 480 500 500 320 240\n", "images.txt:1:1: error: expected IMAGE_ID"),
        ("7 1 2 3 9 9 9 0.5 1 2 3 4\n", "give it by --unit"),
        ("# nothing\n", "no image point shows a point of the model"),
    ],
)  # fmt: skip
def test_what_is_no_model_is_refused(text: str, told: str, tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "images.txt").write_text(text)
    ran = metrocli("import", tmp_path / "images.txt", "--from", "colmap-model")
    assert ran.code in (2, 3) and told in ran.err, ran.err
