"""Fisheyes beyond 90 degrees off their axis, from image points of code that shares nothing with the lens models."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from metrocli.arrays import Array

Metrocli = Callable[..., Any]
SIZE = (1280, 960)
TRUTH = {"f": 390.0, "cx": 641.0, "cy": 482.0, "k1": -0.03, "k2": 4e-3, "k3": -8e-4, "k4": 5e-5}
BOARD = np.array([[30.0 * x, 30.0 * y, 0.0] for y in range(6) for x in range(8)])
JOB = """metrocli: 1
job: calibrate-camera
rig: board
inputs: {{observations: obs.csv, targets: targets.csv}}
camera: {{image_size: [1280, 960], {}}}
noise: 0.1 px
output: camera.h5
"""


def imaged(point: Array) -> Array:
    """The formula of OpenCV's fisheye with the angle by atan2."""
    across = np.hypot(point[:, 0], point[:, 1])
    angle = np.arctan2(across, point[:, 2])
    radius = angle * (1 + sum(TRUTH[f"k{i}"] * angle ** (2 * i) for i in (1, 2, 3, 4)))
    return np.array([TRUTH["cx"], TRUTH["cy"]]) + TRUTH["f"] * radius[:, None] * point[:, :2] / across[:, None]


def boards(folder: Path, widest: float, images: int = 14) -> float:
    """Write a job with boards up to an angle off the axis [rad]; return the largest angle that is seen [deg]."""
    rng = np.random.default_rng(8)
    rows, seen = ["image,target,u_px,v_px"], 0.0
    while rows[-1].split(",")[0] != f"v{images - 1}":
        number = int(rows[-1].split(",")[0][1:]) + 1 if len(rows) > 1 else 0
        turn, off, towards = rng.normal(size=3) * 0.45, rng.uniform(0, widest), rng.uniform(0, 2 * np.pi)
        to = np.array([np.sin(off) * np.cos(towards), np.sin(off) * np.sin(towards), np.cos(off)])
        facing = cv2.Rodrigues(np.cross([0, 0, 1.0], to))[0] @ cv2.Rodrigues(turn)[0]
        points = (BOARD - BOARD.mean(axis=0)) @ facing.T + to * rng.uniform(200, 350)
        uv = imaged(points) + rng.normal(size=(len(points), 2)) * 0.1
        inside = ((uv > 0) & (uv < np.array(SIZE) - 1)).all(axis=1)
        if inside.sum() < 30:
            continue
        seen = max(seen, float(np.degrees(np.arctan2(np.hypot(*points[inside, :2].T), points[inside, 2]).max())))
        rows += [
            f"v{number},{j},{uv[j, 0]!r},{uv[j, 1]!r}".replace("np.float64(", "").replace(")", "")
            for j in np.flatnonzero(inside)
        ]
    (folder / "obs.csv").write_text("\n".join(rows))
    (folder / "targets.csv").write_text(
        "\n".join(["target,x_mm,y_mm,z_mm", *(f"{j},{p[0]},{p[1]},{p[2]}" for j, p in enumerate(BOARD))])
    )
    return seen


def test_a_fisheye_is_recovered_beyond_ninety_degrees(tmp_path: Path, metrocli: Metrocli) -> None:
    assert boards(tmp_path, 1.5) > 95
    (tmp_path / "job.yaml").write_text(JOB.format("model: fisheye"))
    ran = metrocli("calibrate-camera", tmp_path / "job.yaml", "--json")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)
    assert 0.9 < found["statistics"]["sigma0"] < 1.1
    for name, value in TRUTH.items():
        estimate = found["estimates"][name]
        assert abs(estimate["value"] - value) < 4 * estimate["std"], name


def test_a_fisheye_given_as_a_pinhole_is_named(tmp_path: Path, metrocli: Metrocli) -> None:
    boards(tmp_path, 0.8, images=8)
    (tmp_path / "job.yaml").write_text(JOB.format("estimate: [f, cx, cy, k1, k2]"))
    ran = metrocli("calibrate-camera", tmp_path / "job.yaml")
    assert ran.code == 6 and "the lens is a fisheye" in ran.out and "write model: fisheye" in ran.out
    assert "extended.yaml`, the job corrected as stated above" in (
        metrocli("diagnose", tmp_path / "job.yaml", "--quick").out
    )


@pytest.mark.parametrize(
    ("camera", "words"),
    [
        ("model: fisheye, convention: backward", "model fisheye does not go with the convention backward"),
        ("model: fisheye, estimate: [f, k5]", "the model fisheye has no k5"),
        ("model: division, estimate: [f, k1]", "the model division has no k1"),
        ("convention: backward, estimate: [f, tau_x]", "the model backward has no tau_x"),
    ],
)
def test_models_and_parameters_that_do_not_fit(camera: str, words: str, tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "job.yaml").write_text(JOB.format(camera))
    (tmp_path / "obs.csv").write_text("image,target,u_px,v_px\na,1,2,3\n")
    (tmp_path / "targets.csv").write_text("target,x_mm,y_mm,z_mm\n1,2,3,0\n")
    ran = metrocli("check", tmp_path / "job.yaml")
    assert ran.code == 3 and words in ran.err
