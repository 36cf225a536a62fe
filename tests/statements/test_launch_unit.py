"""Statements on the sample xm60-launch-unit, drawn at random: beams and encoders in plain numpy."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from statements.plain_adjustment import SAMPLES, Array, Fit, cells, estimate, fitted, numbers, read_columns

Metrocli = Callable[..., Any]
ENCODER = 50e-6
JOB = "jobs/errors.yaml"


@pytest.fixture
def unit(tmp_path: Path) -> Path:
    shutil.copytree(SAMPLES / "xm60-launch-unit", tmp_path / "unit")
    return tmp_path / "unit"


def located() -> Fit:
    """x, y, z, gamma from phi1..phi4 of the three poses (Kuprin et al. 2022, fig. 7)."""
    poses = read_columns(SAMPLES / "xm60-launch-unit/data/errors.csv")
    places, psi = numbers(poses, "x_mm", "y_mm", "z_mm"), numbers(poses, "spindle_rad")[:, 0]
    read = numbers(poses, "phi1_rad", "phi2_rad", "phi3_rad", "phi4_rad")

    def residual(unknowns: Array) -> Array:
        out = places - unknowns[:3]
        level = np.hypot(out[:, 0], out[:, 1])
        tilt = np.arctan2(out[:, 2], level)
        phi1, phi4 = np.arctan2(out[:, 1], out[:, 0]) - unknowns[3], np.arctan2(-out[:, 1], -out[:, 0]) - psi
        off = read - np.stack([phi1, tilt, -tilt, phi4], axis=1)
        return np.asarray(((off + np.pi) % (2 * np.pi) - np.pi).ravel() / ENCODER)

    return fitted(residual, np.array([0.0, 1000.0, 1500.0, 0.35]), np.array([1e-3, 1e-3, 1e-3, 1e-6]))


def test_place_and_angle(unit: Path, metrocli: Metrocli) -> None:
    """z 1500.018 ± 0.051 mm, gamma 0.349097 ± 0.000036 rad."""
    report, fit = metrocli("locate-launch-unit", unit / JOB, "--force").out, located()
    for at, name, digit in ((2, "z", 1e-3), (3, "gamma", 1e-6)):
        value, std = estimate(report, name)
        assert abs(value - fit.unknowns[at]) <= 0.51 * digit and abs(std - fit.std[at]) <= 0.51 * digit


def test_probability_along_a_diagonal(unit: Path, metrocli: Metrocli) -> None:
    """xz: 20 points from 301.54 to 1251.5 mm, in range with 0.98975, to 4 m with 0.46591; safe to 1665.1 mm.

    The beam aimed by the encoders at a line misses it by the error of the unit's place, of its angle and of the
    encoders; in range is within 250 um of the line and 500 urad of it, to the end.
    """
    row = cells(metrocli("plan", unit / JOB, "--out", unit / "plan").out, "xz")
    fit = located()
    rng = np.random.default_rng(16)
    count = 60_000
    error = rng.normal(size=(count, 4)) @ np.linalg.cholesky(fit.covariance).T
    # the beam runs from the unit towards the low corner of the face diagonal, 5400 mm along x and 1600 mm along z
    line = -np.array([5400.0, 0.0, 1600.0]) / np.hypot(5400.0, 1600.0)
    azimuth, elevation = np.arctan2(line[1], line[0]), np.arcsin(line[2])
    noise = rng.normal(0, ENCODER, (count, 4))
    base, tilt = azimuth + error[:, 3] + noise[:, 0], elevation + noise[:, 1]
    beam = np.stack([np.cos(tilt) * np.cos(base), np.cos(tilt) * np.sin(base), np.sin(tilt)], axis=1)
    # the receiver looks back along the line, with the errors of its own encoders: pitch and yaw of the beam in it
    up = np.array([0.0, 0.0, 1.0])
    beside = np.cross(up, line) / np.linalg.norm(np.cross(up, line))
    above = np.cross(line, beside)
    yaw = beam @ beside - np.cos(elevation) * noise[:, 3]
    pitch = beam @ above + noise[:, 2]
    turned = (np.abs(yaw) <= 500e-6) & (np.abs(pitch) <= 500e-6)

    def in_range(distance: float) -> Array:
        found = turned.copy()
        for s in np.linspace(float(row[2]), distance, 15):
            at = error[:, :3] + s * beam
            across = at - np.outer(at @ line, line)
            found &= np.linalg.norm(across, axis=1) <= 0.25
        return found

    spread = 4 * 0.5 / np.sqrt(2**15)
    assert np.isclose(float(row[4]), in_range(float(row[3])).mean(), atol=spread)
    assert np.isclose(float(row[5]), in_range(4000.0).mean(), atol=spread)
    assert np.isclose(in_range(float(row[6])).mean(), 0.95, atol=spread)
    far = 1200 / np.cos(np.arcsin(line[2]))
    assert (int(row[1]), row[3]) == (20, f"{far:.1f}") or abs(float(row[3]) - far) < 1.0
