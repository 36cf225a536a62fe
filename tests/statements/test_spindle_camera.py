"""Statements on the sample spindle-camera, drawn at random: camera and part in plain numpy, with readings of its own.

The places of the dot, the poses, the targets and the noise are those of the sample; the readings are simulated here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from statements.plain_adjustment import (
    SAMPLES,
    Array,
    Fit,
    cells,
    derivatives,
    estimate,
    fitted,
    numbers,
    read_columns,
    turned,
)

Metrocli = Callable[..., Any]
SAMPLE = SAMPLES / "spindle-camera"
LENS = np.array([2813.2, 1286.77, 999.02, 0.2372, -0.1213, -1.741e-4, 9.587e-4])
HELD = np.array([-2.139, 0.301, -320.3, -0.003, -0.009, 0.03])
PART = np.array([120.0, 80.0, 35.0, 2.1e-3, -1.3e-3, 12.4e-3, 2.6e-3])
STEPS = np.array([1e-2, 1e-2, 1e-2, 1e-5, 1e-5, 1e-7, 1e-7, 1e-3, 1e-3, 1e-3, 1e-6, 1e-6, 1e-6])
"""f cx cy k1 k2 p1 p2, then x y z alpha beta gamma of the camera in the taper"""
SEEN = {"I01.png": "23", "I02.png": "23", "I03.png": "177", "I04.png": "177"}
SEEN |= {"I05.png": "437", "I06.png": "437", "I07.png": "863", "I08.png": "863"}
NOISE = 0.0015


def pixels(points: Array, lens: Array) -> Array:
    """Brown's lens as OpenCV writes it, (n, 2)."""
    f, cx, cy, k1, k2, p1, p2 = lens
    x, y = (points[:, :2] / points[:, 2:]).T
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return np.stack([f * u + cx, f * v + cy], axis=1)


def of_dots(camera: Array, places: Array) -> Array:
    return pixels((places - camera[7:10]) @ turned(camera[10:]), camera[:7])


def of_part(part: Array, camera: Array, targets: Array, spindle: Array) -> Array:
    """U = R_C' (R_P X + d_P - d_C), d_C = R_S d_cal + d_CNC, R_C = R_S R_cal (an unturned spindle)."""
    c, s = np.cos(part[6]), np.sin(part[6])
    clamp = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    machine = targets @ turned(part[3:6]).T + part[:3]
    return pixels((machine - spindle - clamp @ camera[7:10]) @ (clamp @ turned(camera[10:])), camera[:7])


@dataclass(frozen=True)
class Sample:
    """Readings as files of two jobs, what was written into them, and the reports."""

    calibration: str
    alignment: str
    dots: Array
    places: Array
    read: Array
    targets: Array
    spindle: Array


@pytest.fixture
def sample(tmp_path: Path, metrocli: Metrocli) -> Sample:
    rng = np.random.default_rng(40)
    columns = read_columns(SAMPLE / "cmm/targets.csv")
    places = numbers(columns, "x_mm", "y_mm", "z_mm")
    true = places + rng.normal(0, 1e-3, places.shape)
    dots = of_dots(np.append(LENS, HELD), true)
    dots = dots + rng.normal(0, NOISE, dots.shape)
    rows = [f"{name}.png,{name},{u!r},{v!r}" for name, (u, v) in zip(columns["target"], dots.tolist(), strict=True)]
    (tmp_path / "dots.csv").write_text("\n".join(["image,target,u_px,v_px", *rows]) + "\n")
    listed, poses = read_columns(SAMPLE / "machine/targets.csv"), read_columns(SAMPLE / "machine/poses.csv")
    order = [listed["target"].index(SEEN[image]) for image in poses["image"]]
    targets, spindle = numbers(listed, "x_mm", "y_mm", "z_mm"), numbers(poses, "x_mm", "y_mm", "z_mm")
    moved = targets + rng.normal(0, 5e-3, targets.shape)
    read = of_part(PART, np.append(LENS, HELD), moved[order], spindle) + rng.normal(0, 0.02, (len(order), 2))
    rows = [f"{i},{SEEN[i]},{u!r},{v!r}" for i, (u, v) in zip(poses["image"], read.tolist(), strict=True)]
    (tmp_path / "seen.csv").write_text("\n".join(["image,target,u_px,v_px", *rows]) + "\n")
    (tmp_path / "camera.yaml").write_text(
        "metrocli: 1\njob: calibrate-camera\nrig: cmm\nnoise: estimated\noutput: camera.h5\n"
        f"inputs: {{observations: dots.csv, targets: {SAMPLE / 'cmm/targets.csv'}}}\n"
        "camera: {image_size: [2592, 1944], pixel_size: 2.2 um, estimate: [f, cx, cy, k1, k2, p1, p2]}\n"
    )
    (tmp_path / "part.yaml").write_text(
        "metrocli: 1\njob: align-part\nestimate: [part-pose, clamping-angle]\nnoise: 0.02 px\noutput: part.h5\n"
        f"inputs: {{camera: camera.h5, observations: seen.csv, poses: {SAMPLE / 'machine/poses.csv'}, "
        f"targets: {SAMPLE / 'machine/targets.csv'}}}\n"
    )
    reports = [metrocli(kind, tmp_path / f"{name}.yaml") for kind, name in
               (("calibrate-camera", "camera"), ("align-part", "part"))]  # fmt: skip
    assert [report.code for report in reports] == [0, 0], [report.err for report in reports]
    return Sample(reports[0].out, reports[1].out, dots, places, read, targets[order], spindle)


def camera_of(sample: Sample) -> tuple[Fit, float]:
    """Return the camera by generalised least squares, and the noise of an image coordinate.

    A place known to 1 um spreads by its own 2 x 3 derivatives; the noise is where chi-square equals the degrees of freedom.
    """
    start = np.append(LENS, HELD)
    spread = [
        (of_dots(start, sample.places + step) - of_dots(start, sample.places - step)) / 2e-3
        for step in np.eye(3) * 1e-3
    ]
    by = np.stack(spread, axis=2)
    places = np.einsum("nak,nbk->nab", by, by) * 1e-6
    low, high = 1e-5, 0.1
    for _ in range(30):
        noise = float(np.sqrt(low * high))
        whiten = np.linalg.inv(np.linalg.cholesky(places + noise**2 * np.eye(2)))
        residual = lambda unknowns, w=whiten: np.einsum(  # noqa: E731
            "nab,nb->na", w, sample.dots - of_dots(unknowns, sample.places)
        ).ravel()
        fit = fitted(residual, start, STEPS, rounds=2)
        low, high = (noise, high) if (fit.residual**2).sum() > len(fit.residual) - 13 else (low, noise)
    return fit, noise


def test_camera_and_part(sample: Sample) -> None:
    """Camera gamma ± 0.28 urad; part z ± 6.9 um, gamma_s ± 9.5 urad, residual of one image."""
    camera, noise = camera_of(sample)
    value, std = estimate(sample.calibration, "gamma")
    assert np.isclose(std, camera.std[12], rtol=0.03) and abs(value - camera.unknowns[12]) < 0.05 * std
    assert f"estimated noise of an image coordinate: {noise:.2g}"[:-1] in sample.calibration

    root = np.linalg.inv(np.linalg.cholesky(camera.covariance))
    which, order = np.unique(sample.targets, axis=0, return_inverse=True)

    def residual(unknowns: Array) -> Array:
        part, lens, moved = unknowns[:7], unknowns[7:20], unknowns[20:].reshape(-1, 3)
        off = sample.read - of_part(part, lens, (which + moved)[order], sample.spindle)
        return np.concatenate([off.ravel() / 0.02, root @ (camera.unknowns - lens), -moved.ravel() / 5e-3])

    steps = np.concatenate([[1e-3] * 3, [1e-6] * 4, STEPS, np.full(which.size, 1e-3)])
    fit = fitted(residual, np.concatenate([PART, camera.unknowns, np.zeros(which.size)]), steps, rounds=4)
    for at, name in ((2, "z"), (6, "gamma_s")):
        value, std = estimate(sample.alignment, name)
        assert np.isclose(std, fit.std[at], rtol=0.02) and abs(value - fit.unknowns[at]) < 0.05 * std
    assert derivatives(residual, fit.unknowns, steps).shape == (41, 32)
    row = cells(sample.alignment, "I06.png")
    length = float(np.linalg.norm(fit.residual[10:12] * 0.02))
    assert row[1] == "1" and abs(float(row[2]) - length) < 3e-5 and row[2] == row[3]
