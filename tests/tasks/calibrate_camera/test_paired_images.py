"""Images of two cameras that are given as those of one: `diagnose` names them, where names and poses pair."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from metrocli.tasks.calibrate_camera.multi_camera.paired import paired

Metrocli = Callable[..., Any]
Array = np.ndarray
BOARD = np.array([[25.0 * i, 25.0 * j, 0.0] for j in range(5) for i in range(7)])
LENSES = {"left": (1100.0, 650.0, 470.0, -0.2, 0.05), "right": (1150.0, 630.0, 485.0, -0.15, 0.03)}
TURN, SHIFT = Rotation.from_rotvec([0.02, -0.15, 0.01]), np.array([95.0, -4.0, 12.0])
"""Pose of the right camera in the frame of the left one"""
JOB = """metrocli: 1
job: calibrate-camera
rig: board
inputs: {observations: obs.csv, targets: targets.csv}
noise: estimated
camera: {image_size: [1280, 960], estimate: [f, cx, cy, k1, k2], pixel_size: 3.45 um}
output: one.h5
"""


def image(points: Array, name: str, rng: np.random.Generator) -> Array:
    f, cx, cy, *distortion = LENSES[name]
    square = np.array([[f, 0, cx], [0, f, cy], [0, 0, 1]])
    uv = cv2.projectPoints(points, np.zeros(3), np.zeros(3), square, np.array([*distortion, 0, 0]))[0][:, 0]
    return np.asarray(uv + rng.normal(0, 0.1, uv.shape))


def views(count: int, rng: np.random.Generator) -> list[Array]:
    """The board in the frame of the first camera, at each exposure."""
    turns = [Rotation.from_euler("zxy", [rng.uniform(-2, 2), *rng.uniform(-0.5, 0.5, 2)]) for _ in range(count)]
    middle = BOARD - BOARD.mean(axis=0)
    return [turn.apply(middle) + [*rng.uniform(-30, 60, 2), rng.uniform(280, 420)] for turn in turns]


def job(folder: Path, images: dict[str, Array]) -> Path:
    rows = (f"{name},{j},{float(u)},{float(v)}" for name, uv in images.items() for j, (u, v) in enumerate(uv))
    (folder / "obs.csv").write_text("\n".join(["image,target,u_px,v_px", *rows]))
    listed = (f"{j},{x},{y},{z}" for j, (x, y, z) in enumerate(BOARD))
    (folder / "targets.csv").write_text("\n".join(["target,x_mm,y_mm,z_mm", *listed]))
    (folder / "one.yaml").write_text(JOB)
    return folder / "one.yaml"


@pytest.mark.alike
@pytest.mark.parametrize("seed", [1, 2])
def test_two_cameras_given_as_one_are_named(seed: int, tmp_path: Path, metrocli: Metrocli) -> None:
    rng, images = np.random.default_rng([61, seed]), {}
    for shot, points in enumerate(views(9, rng)):
        images[f"left{shot:02d}.png"] = image(points, "left", rng)
        images[f"right{shot:02d}.png"] = image(TURN.inv().apply(points - SHIFT), "right", rng)
    path = job(tmp_path, images)
    found = json.loads(metrocli("diagnose", path, "--quick", "--json", "--out", tmp_path / "two.yaml").out)
    assert found["verdict"] == "mistaken" and "left*.png and right*.png are of 2 cameras" in found["mistake"]["what"]
    held = yaml.safe_load((tmp_path / "two.yaml").read_text())
    assert "camera" not in held and held["cameras"]["right"] == {
        "images": "right*.png",
        "estimate": ["f", "cx", "cy", "k1", "k2"],
        "image_size": [1280, 960],
        "pixel_size": "0.00345 mm",
    }
    ran = metrocli("calibrate-camera", tmp_path / "two.yaml")
    assert ran.code == 0 and "mm from left" in ran.out, ran.out


@pytest.mark.parametrize(
    "back", [pytest.param(False, id="other places", marks=pytest.mark.slow), pytest.param(True, id="the same places")]
)
@pytest.mark.parametrize("touched", [False, True], ids=["one state", "a lens that was touched"])
def test_two_series_of_one_camera_are_no_two_cameras(
    touched: bool, back: bool, tmp_path: Path, metrocli: Metrocli
) -> None:
    """Also where a robot takes the second series at the places of the first."""
    rng, images = np.random.default_rng([62, touched, back]), {}
    first = views(9, rng)
    second = first if back else views(9, rng)
    for name, series in (("monday", first), ("tuesday", second)):
        lens = "right" if touched and name == "tuesday" else "left"
        images |= {f"{name}{shot:02d}.png": image(points, lens, rng) for shot, points in enumerate(series)}
    found = json.loads(metrocli("diagnose", job(tmp_path, images), "--quick", "--json").out)
    assert found["mistake"] is None
    named = {(one["name"][:6], *one["where"].values()) for one in found["effects"]}
    assert ("series", "tuesday") in named if touched else not named


@pytest.mark.parametrize(
    ("images", "cameras"),
    [
        ([f"cam{c}_{i:03d}.png" for c in (0, 1, 2) for i in range(4)], ["cam0_*.png", "cam1_*.png", "cam2_*.png"]),
        ([f"{i:02d}_camera{c}.jpg" for c in (1, 2) for i in range(4)], ["*_camera1.jpg", "*_camera2.jpg"]),
        ([f"L/{i}.jpg" for i in range(4)] + [f"R/{i}.jpg" for i in range(2, 6)], []),
        ([f"IMG_{i}.JPG" for i in range(8)], []),
        ([*(f"a{i}.png" for i in range(4)), *(f"b{i}.png" for i in range(4)), "extra.png"], []),
    ],
)
def test_names_of_images_pair(images: list[str], cameras: list[str]) -> None:
    assert list(paired(images).values()) == cameras
