"""Readings quieter or noisier than declared, beside targets that are as uncertain as their list says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

Metrocli = Callable[..., Any]
SIGMA, DECLARED = 0.05, 0.05
"""Of the targets [mm], and of an image coordinate [px]"""
VIEWS = 6
JOB = """metrocli: 1
job: calibrate-camera
rig: board
inputs: {observations: observations.csv, targets: targets.csv}
camera: {image_size: [640, 480], pixel_size: 5 um, estimate: [f, cx, cy]}
noise: 0.05 px
output: camera.h5
"""


def turn(a: float, b: float, c: float) -> np.ndarray:
    x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    return np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]]) @ y @ x


def write(folder: Path, noise: float, scatter: float) -> Path:
    """Views of a board whose targets scatter about their list, through a lens without distortion."""
    rng = np.random.default_rng(31)
    listed = np.array([(25.0 * i, 25.0 * j, 0.0) for j in range(5) for i in range(7)])
    targets = [f"T{i:02d},{x},{y},{z},{SIGMA}" for i, (x, y, z) in enumerate(listed.tolist())]
    (folder / "targets.csv").write_text("\n".join(["target,x_mm,y_mm,z_mm,sigma_mm", *targets]) + "\n")
    true, rows = listed + rng.normal(0, scatter, listed.shape) - [75, 50, 0], ["image,target,u_px,v_px"]
    for view in range(VIEWS):
        seen = true @ turn(*rng.uniform(-0.5, 0.5, 2), rng.uniform(-1.5, 1.5)).T + [*rng.uniform(-15, 15, 2), 450]
        uv = 690 * seen[:, :2] / seen[:, 2:] + [320, 240] + rng.normal(0, noise, (len(seen), 2))
        rows += [f"v{view}.png,T{i:02d},{u},{v}" for i, (u, v) in enumerate(uv.tolist())]
    (folder / "observations.csv").write_text("\n".join(rows) + "\n")
    (folder / "job.yaml").write_text(JOB)
    return folder / "job.yaml"


@pytest.mark.parametrize("noise", [0.6, pytest.param(2.0, marks=pytest.mark.slow)])
def test_a_right_sigma_of_targets_is_not_called_wrong(noise: float, tmp_path: Path, metrocli: Metrocli) -> None:
    out = metrocli("diagnose", write(tmp_path, noise * DECLARED, SIGMA)).out
    (line,) = [one for one in out.splitlines() if one.startswith("noise: ")]
    ratio = float(line.split()[1])
    assert abs(ratio / noise - 1) < 0.1
    assert "correct the sigma" not in out
    assert "The given values of each target agree with their sigma" in out


def test_a_wrong_sigma_of_targets_is_named_with_its_factor(tmp_path: Path, metrocli: Metrocli) -> None:
    out = metrocli("diagnose", write(tmp_path, DECLARED, 3 * SIGMA)).out
    (line,) = [one for one in out.splitlines() if "times their sigma: correct the sigma" in one]
    assert line.strip().removesuffix(": correct the sigma.")[1:] in out.splitlines()[0]
    assert 2.4 < float(line.partition("off by ")[2].split()[0]) < 3.6
