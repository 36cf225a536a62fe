"""align-part with the targets of a fit-part result: what the fit adds to the pose, and a target that moved since."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import SAMPLES
from scipy.linalg import block_diag
from simulated.castings import Array, turn

from benchmarks.coverage import PART, alignment_settings, poses_over, true_camera
from metrocli.errors import InputError
from metrocli.formats import hdf5
from metrocli.geometry import poses
from metrocli.result import Result
from metrocli.simulation import SimulationOptions
from metrocli.table import Table
from metrocli.tasks.align_part import task as align_part
from metrocli.tasks.align_part.fitted_targets import target_list
from metrocli.tasks.shared.images.target_list import read_targets

Metrocli = Callable[..., Any]


def skew(v: Array) -> Array:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def moved(pose: Array, step: Array) -> Array:
    """The pose after a small motion: u of its origin, and a turn w about that."""
    turned = poses.rotation_of(pose)
    return poses.pose(turned + skew(step[3:]) @ turned, pose[:3] + step[:3])


def fit_result() -> Result:
    """A result with four targets: an uncertain pose of their frame, a shared scale and more, and errors of their own."""
    points = np.array([[0.0, 0, 0], [1500, 0, 10], [1500, 1000, 0], [0, 1000, -20]])
    rng = np.random.default_rng(4)
    motions = np.vstack([rng.normal(size=(3, 6)) * 0.02, rng.normal(size=(3, 6)) * 2e-5])
    shared = motions[:3] + np.stack([np.cross(motions[3:].T, point).T for point in points])
    scale = 1e-4 * (points - points.mean(axis=0))
    shared = np.concatenate([shared, scale[:, :, None], rng.normal(size=(4, 3, 2)) * 0.03], axis=2)
    table = Table({"target": np.array(list("ABCD")), **{axis: points[:, k] for k, axis in enumerate("xyz")}})
    mixed = rng.normal(size=(4, 3, 3)) * 0.02
    own = mixed @ np.swapaxes(mixed, 1, 2) + 1e-4 * np.eye(3)
    return Result(
        "fit-part", "", (), np.zeros((0, 0)), {}, {"targets": table}, {"targets_own": own, "targets_common": shared}
    )


def covariance_of(result: Result) -> Array:
    """The joint covariance (3 m, 3 m) of the targets, written out."""
    own, shared = result.arrays["targets_own"], result.arrays["targets_common"]
    flat = shared.reshape(3 * len(own), -1)
    return block_diag(*own) + flat @ flat.T


def aligned(targets: Result | Table, drawn: Table) -> Result:
    """The pose of a part whose drawn targets are measured nearly without noise, from these targets."""
    settings, at = alignment_settings(1e-4, 0.0, seven=False), poses_over(drawn)
    seen = align_part.simulate(align_part.TASK.job(settings, true_camera(), at, drawn), SimulationOptions(7))
    found = seen.files["observations.csv"]
    return align_part.run(align_part.TASK.job(settings, true_camera(), at, targets, observations=found))


def table_of(points: Array) -> Table:
    return Table({"target": np.array(list("ABCD")), **dict(zip("xyz", points.T, strict=True))})


def test_the_pose_has_the_covariance_of_generalised_least_squares() -> None:
    result = fit_result()
    points, joint = result.tables["targets"].stacked(("x", "y", "z")), covariance_of(result)
    found = aligned(result, table_of(points))
    euler = np.array([one.value for one in found.estimates])
    part = turn(euler[3:])
    # R X + d stays where it is measured, so a motion (u, w) of the part in the machine moves X by -R'(u + w x R X)
    by_motion = [np.hstack([part.T, -part.T @ skew(part @ point)]) for point in points]
    design = np.concatenate(by_motion)
    step = np.linalg.inv(design.T @ np.linalg.solve(joint, design))
    change = np.eye(6)
    for k in range(6):
        ahead = poses.euler_form(moved(poses.pose_from_euler(euler[:3], euler[3:]), np.eye(6)[k] * 1e-6))
        change[:, k] = (ahead - euler) / 1e-6
    expected = change @ step @ change.T
    size = np.sqrt(np.diag(expected))
    assert np.abs((found.covariance - expected) / np.outer(size, size)).max() < 1e-3
    # targets taken as independent have another pose
    alone = block_diag(*(joint[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(4)))
    wrong = np.linalg.inv(design.T @ np.linalg.solve(alone, design))
    assert np.abs(np.sqrt(np.diag(wrong) / np.diag(step)) - 1).max() > 0.2


def test_what_the_pose_owes_to_its_targets_is_how_they_move_it() -> None:
    result, rng = fit_result(), np.random.default_rng(6)
    points, joint = result.tables["targets"].stacked(("x", "y", "z")), covariance_of(result)
    z = rng.normal(size=12)
    moved_by = (np.linalg.cholesky(joint) @ z).reshape(4, 3)
    drawn = table_of(points)

    def pose(shift: Array) -> tuple[Array, Result]:
        table = Table({**result.tables["targets"].columns, **dict(zip("xyz", (points + shift).T, strict=True))})
        found = aligned(replace(result, tables={"targets": table}), drawn)
        return np.array([one.value for one in found.estimates]), found

    (at, found), (other, _) = pose(np.zeros((4, 3))), pose(moved_by * 1e-2)
    size = np.sqrt(np.diag(found.covariance))
    assert np.allclose((other - at) / size, 1e-2 * found.arrays["owed_to_targets"] @ z / size, atol=2e-5)
    assert found.tables["shared"].texts("input") == ["targets"]


@pytest.mark.slow
def test_poses_from_drawn_targets_scatter_as_stated() -> None:
    result = fit_result()
    points, shared = result.tables["targets"].stacked(("x", "y", "z")), result.arrays["targets_common"]
    root, rng = np.linalg.cholesky(result.arrays["targets_own"]), np.random.default_rng(5)
    truth, off = np.array([getattr(PART, name) for name in poses.EULER]), []
    for _ in range(40):
        own = (root @ rng.normal(size=(4, 3, 1)))[:, :, 0]
        found = aligned(result, table_of(points + shared @ rng.normal(size=shared.shape[2]) + own))
        off.append(np.array([one.value for one in found.estimates]) - truth)
    squares = [one @ np.linalg.solve(found.covariance, one) for one in off]
    assert np.mean(squares) == pytest.approx(6, abs=3 * np.sqrt(12 / 40))


def test_simulated_targets_have_the_joint_covariance() -> None:
    result = fit_result()
    listed, rng = target_list(result), np.random.default_rng(8)
    known = read_targets(listed.table)
    drawn = np.array([listed.drawn(known, rng).points.ravel() for _ in range(3000)])
    expected = covariance_of(result)
    size = np.sqrt(np.diag(expected))
    assert np.allclose(listed.table.stacked(("sigma_x", "sigma_y", "sigma_z")).ravel(), size)
    assert np.abs((np.cov(drawn.T) - expected) / np.outer(size, size)).max() < 0.1


def test_targets_whose_errors_are_all_shared_locate_the_part() -> None:
    result = fit_result()
    without = replace(result, arrays={**result.arrays, "targets_own": np.zeros((4, 3, 3))})
    points = result.tables["targets"].stacked(("x", "y", "z"))
    found = aligned(without, table_of(points))
    truth = np.array([getattr(PART, name) for name in poses.EULER])
    assert np.abs([one.value for one in found.estimates] - truth).max() < 1e-3


def test_two_targets_are_too_few() -> None:
    result = fit_result()
    table = result.tables["targets"]
    two = replace(table, columns={name: table.columns[name][:2] for name in table})
    with pytest.raises(InputError, match="has 2 targets, and a part needs 3"):
        target_list(replace(result, tables={"targets": two}))


@pytest.mark.slow
def test_the_sample_finds_its_part_and_a_target_that_moved(tmp_path: Path, metrocli: Metrocli) -> None:
    home = tmp_path / "p"
    shutil.copytree(SAMPLES / "raw-part", home)
    assert metrocli("run", home).code == 0
    result = hdf5.read(home / "results" / "align.h5")[0]
    truth = np.array([120.0, 80.0, 35.0, 2.1e-3, -1.3e-3, 12.4e-3])
    off = np.array([one.value for one in result.estimates[:6]]) - truth
    # the truth was drawn for the fitted frame, so the error of the fit is not in these differences, and they are small
    assert off @ np.linalg.solve(result.covariance[:6, :6], off) < 12.6  # 5 % of chi-square with 6
    job = home / "jobs" / "align.yaml"
    planted = "moved-target:target=T23,dx=0.6mm,dy=-0.4mm,dz=0mm"
    made = metrocli("simulate", job, "--seed", "3", "--out", home / "NEW", "--effect", planted)
    assert made.code == 0, made.err
    shutil.copy(home / "NEW" / "observations.csv", home / "machine" / "observations.csv")
    found = metrocli("diagnose", job, "--json")
    assert found.code == 0, found.err
    named = [(one["name"], one["where"]) for one in json.loads(found.out)["effects"]]
    assert named == [("moved-target", {"target": "T23"})]


def test_a_foreign_image_takes_few_readings_of_others_with_it(tmp_path: Path, metrocli: Metrocli) -> None:
    """Eighteen readings of other images were left out, which its image points had spoilt before it left."""
    home = tmp_path / "p"
    shutil.copytree(SAMPLES / "raw-part", home)
    assert metrocli("run", home).code == 0
    seen = home / "machine" / "observations.csv"
    rows = [line.split(",") for line in seen.read_text().splitlines()]
    off = [[*row[:2], f"{float(row[2]) + 37}", f"{float(row[3]) - 25}"] if row[0] == "I09.png" else row for row in rows]
    seen.write_text("\n".join(map(",".join, off)) + "\n")
    ran = metrocli("align-part", home / "jobs" / "align.yaml", "--set", "outliers=remove")
    assert ran.code == 6 and "8 of 8 readings of image I09.png are left out" in ran.out
    image = hdf5.read(home / "results" / "align.h5")[0].tables["rejected"].texts("image")
    assert image.count("I09.png") == 8 and len(image) <= 10
