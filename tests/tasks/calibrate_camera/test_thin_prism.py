"""A strong thin prism on nearly parallel views, projected by OpenCV: the principal point goes far off in its place.

Without the prism it is 150 px off, and a small prism of the wrong sign is at a minimum of its own beside that.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

Metrocli = Callable[..., Any]
JOB = """metrocli: 1
job: calibrate-camera
rig: board
inputs: {{observations: seen.csv, targets: board.csv}}
camera: {{image_size: [768, 710], estimate: [fx, fy, cx, cy, k1, k2, p1, p2{more}]}}
noise: 0.12 px
output: camera.h5
"""
S1, S3, CENTRE = 0.073, 0.034, np.array([415.0, 363.0])


def written(folder: Path, seed: int) -> None:
    """Eleven views of a board of 33 dots that fills half of the image."""
    rng = np.random.default_rng(seed)
    xyz = np.array([[2 * column + row % 2, row, 0.0] for row in range(11) for column in range(3)])
    matrix = np.array([[685, 0, CENTRE[0]], [0, 685, CENTRE[1]], [0, 0, 1.0]])
    distortion = np.array([-0.55, 0.45, 0, 0, 0, 0, 0, 0, S1, 0, S3, 0])
    rows = ["image,target,u_px,v_px"]
    for image in range(11):
        uv = np.full((1, 2), np.inf)
        while np.linalg.norm(uv - CENTRE, axis=1).max() > 330:
            turn = np.array([rng.normal(0, 0.1), rng.normal(0, 0.1), rng.uniform(-1.5, 1.5)])
            place = np.array([rng.uniform(-5, 5), rng.uniform(-6, 6), rng.uniform(23, 28)])
            place -= cv2.Rodrigues(turn)[0] @ xyz.mean(axis=0)
            uv = cv2.projectPoints(xyz, turn, place, matrix, distortion)[0].reshape(-1, 2)
        seen = uv + rng.normal(0, 0.12, uv.shape)
        rows += [f"i{image:02d},t{number:02d},{u:.4f},{v:.4f}" for number, (u, v) in enumerate(seen)]
    (folder / "seen.csv").write_text("\n".join(rows) + "\n")
    board = [f"t{number:02d},{x:g},{y:g},{z:g}" for number, (x, y, z) in enumerate(xyz)]
    (folder / "board.csv").write_text("\n".join(["target,x_mm,y_mm,z_mm", *board]) + "\n")


@pytest.mark.parametrize("how", ["estimate", "effects"])
def test_the_lowest_minimum_is_found(how: str, tmp_path: Path, metrocli: Metrocli) -> None:
    written(tmp_path, 3)
    text = JOB.format(more=", s1, s3" if how == "estimate" else "")
    (tmp_path / "job.yaml").write_text(text + ("effects: [{name: thin-prism}]\n" if how == "effects" else ""))
    data = json.loads(metrocli("calibrate-camera", tmp_path / "job.yaml", "--json").out)
    for name, true in {"s1": S1, "s3": S3, "cx": CENTRE[0], "cy": CENTRE[1]}.items():
        found = data["estimates"][name]
        assert abs(found["value"] - true) < 4 * found["std"]


@pytest.mark.parametrize("seed", [3, pytest.param(1, marks=pytest.mark.slow), pytest.param(5, marks=pytest.mark.slow)])
def test_it_is_named_though_to_first_order_a_skew_explains_more(seed: int, tmp_path: Path, metrocli: Metrocli) -> None:
    written(tmp_path, seed)
    (tmp_path / "job.yaml").write_text(JOB.format(more=""))
    data = json.loads(metrocli("diagnose", tmp_path / "job.yaml", "--json").out)
    (effect,) = data["effects"]
    assert (data["verdict"], effect["name"]) == ("explained", "thin-prism")
    for name, true in {"s1": S1, "s3": S3}.items():
        assert abs(effect["parameters"][name]["value"] - true) < 4 * effect["parameters"][name]["std"]
