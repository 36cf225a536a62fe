"""Readings quieter or noisier than declared, beside targets that are as uncertain as their list says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.search import swapped
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.evidence.weights import with_noise
from metrocli.diagnosis.noise import DECLARED_SIGMA
from metrocli.project.diagnosed import adjusted_job_of
from metrocli.project.job import JobOptions, load

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


def write_network(folder: Path, moved: float, seed: int) -> Path:
    """Views of dots of which four have known places, one by one of them wrong, through pixels that are not square."""
    rng = np.random.default_rng(seed)
    true = np.array([(25.0 * i, 25.0 * j, 0.0) for j in range(5) for i in range(7)]) - [75, 50, 0]
    true = true + rng.normal(0, 3, true.shape)
    known = rng.permutation(len(true))[:4]
    listed = true + rng.normal(0, 1, true.shape)
    listed[known] = true[known] + rng.normal(0, SIGMA, (4, 3))
    listed[known[0]] += moved * np.array([0.6, -0.64, 0.48])
    sigma = {int(i): str(SIGMA) for i in known}
    targets = [f"T{i:02d},{x},{y},{z},{sigma.get(i, '')}" for i, (x, y, z) in enumerate(listed.tolist())]
    (folder / "targets.csv").write_text("\n".join(["target,x_mm,y_mm,z_mm,sigma_mm", *targets]) + "\n")
    rows = ["image,target,u_px,v_px"]
    for view in range(12):
        angles = rng.uniform(-0.6, 0.6, 2)
        seen = true @ turn(*angles, rng.uniform(-1.5, 1.5)).T + [*rng.uniform(-15, 15, 2), 450]
        uv = [700, 690] * seen[:, :2] / seen[:, 2:] + [320, 240] + rng.normal(0, DECLARED, (len(seen), 2))
        rows += [f"v{view:02d}.png,T{i:02d},{u},{v}" for i, (u, v) in enumerate(uv.tolist())]
    (folder / "observations.csv").write_text("\n".join(rows) + "\n")
    (folder / "job.yaml").write_text(JOB.replace("rig: board", "rig: network"))
    return folder / "job.yaml"


def test_one_wrong_place_of_a_few_is_no_wrong_sigma_of_all(tmp_path: Path, metrocli: Metrocli) -> None:
    """Five freedoms of four places show little more than that: both are stated."""
    job = write_network(tmp_path, 0.8, 3)
    found = diagnose(adjusted_job_of(load(job, JobOptions())))
    wrong = "moved-target T13"
    assert {str(one): one.instead for one in found.findings} == {
        "aspect-ratio": (),
        wrong: ("the sigma of each target",),
    }
    # as it enters beside a large misfit: later the sigma that the job states is tried again
    m = measurement_of(adjusted_job_of(load(job, JobOptions())))
    given = next(number for number, unit in enumerate(m.units) if unit[0] == DECLARED_SIGMA)
    aspect = next(i for i, family in enumerate(m.families) if str(family.alternatives[0]) == "aspect-ratio")
    state = swapped(State.of(with_noise(m, {given: 5.0}), [m.effect(aspect, 0)]))
    assert wrong in [str(m.alternative(part.key)) for part in state.named] and not state.measurement.noise
