"""Points of a part predicted in the machine, against drawn poses, and held against measured ones by `verify`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from simulated.castings import Array, turn

from metrocli.formats import hdf5
from metrocli.geometry import poses
from metrocli.record import Record
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.align_part.fixturing import predicted_points

POSE = np.array([120.0, 80, 35, 0.4, -0.3, 1.2])
STD = np.array([0.02, 0.01, 0.03, 2e-5, 3e-5, 1e-5])
PLACES = np.array([[0.0, 0, 0], [1500, 0, 10], [1500, 1000, 0], [0, 1000, -20], [700, 500, 400]])


def listed(sigma: float | None = None) -> Table:
    columns = {"point": np.array([f"G{n}" for n in range(len(PLACES))]), **dict(zip("xyz", PLACES.T, strict=True))}
    return Table(columns if sigma is None else {**columns, "sigma": np.full(len(PLACES), sigma)})


def covariance() -> Array:
    mixed = np.eye(6) + 0.4 * np.eye(6, k=1) + 0.4 * np.eye(6, k=-1)
    return np.asarray(STD[:, None] * mixed * STD)


def test_predicted_points_scatter_as_those_of_drawn_poses() -> None:
    pose = poses.pose_from_euler(POSE[:3], POSE[3:])
    table, arrays = predicted_points(listed(0.04), pose, covariance())
    assert np.allclose(table.stacked(("x", "y", "z")), PLACES @ turn(POSE[3:]).T + POSE[:3])
    rng = np.random.default_rng(3)
    drawn = rng.multivariate_normal(POSE, covariance(), 5000)
    own = rng.normal(size=(5000, *PLACES.shape)) * 0.04
    at = np.array([PLACES @ turn(one[3:]).T + one[:3] for one in drawn]) + own
    expected = np.cov(at.reshape(5000, -1).T)
    common = arrays["points_common"].reshape(15, 6)
    joint = common @ arrays["points_core"] @ common.T + 0.04**2 * np.eye(15)
    size = np.sqrt(np.diag(expected))
    assert np.abs((joint - expected) / np.outer(size, size)).max() < 0.07
    assert np.allclose(table.stacked(("sx", "sy", "sz")).ravel(), np.sqrt(np.diag(joint)))
    assert np.allclose(arrays["points_covariance"][3], joint[9:12, 9:12])


def test_a_part_that_stands_elsewhere_is_not_laid_onto_the_prediction(
    tmp_path: Path, metrocli: Callable[..., Any]
) -> None:
    table, arrays = predicted_points(listed(), poses.pose_from_euler(POSE[:3], POSE[3:]), covariance())
    file = tmp_path / "align.h5"
    hdf5.write(
        file,
        Result("align-part", "", (), np.zeros((0, 0)), {}, {"points": table}, arrays),
        Record("", (), "0", "2026-01-01T00:00:00Z"),
    )
    there = table.stacked(("x", "y", "z"))
    for shift, code in (([0.0, 0, 0.01], 0), ([0.0, 0, 0.5], 6)):
        rows = [f"G{n},{x:.6f},{y:.6f},{z:.6f},0.002" for n, (x, y, z) in enumerate((there + shift).tolist())]
        (tmp_path / "gauged.csv").write_text("\n".join(["point,x_mm,y_mm,z_mm,sigma_mm", *rows, ""]))
        ran = metrocli("verify", file, tmp_path / "gauged.csv", "--require", "max_en < 1")
        assert ran.code == code and "laid onto" not in ran.out
