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
from simulated.castings import turn

from metrocli.errors import InputError
from metrocli.formats import hdf5
from metrocli.geometry import poses
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.align_part.fitted_targets import added_by_fit, target_list

Metrocli = Callable[..., Any]


def fit_result() -> Result:
    """A result with four targets whose frame has an uncertain pose."""
    points = np.array([[0.0, 0, 0], [1500, 0, 10], [1500, 1000, 0], [0, 1000, -20]])
    rng = np.random.default_rng(4)
    motions = np.vstack([rng.normal(size=(3, 6)) * 0.02, rng.normal(size=(3, 6)) * 2e-5])
    shared = motions[:3] + np.stack([np.cross(motions[3:].T, point).T for point in points])
    table = Table({"target": np.array(list("ABCD")), **{axis: points[:, k] for k, axis in enumerate("xyz")}})
    own = np.tile(np.diag([0.01, 0.02, 0.03]) ** 2, (4, 1, 1))
    return Result(
        "fit-part", "", (), np.zeros((0, 0)), {}, {"targets": table}, {"targets_own": own, "targets_common": shared}
    )


def test_the_pose_of_the_fit_adds_what_drawn_frames_add() -> None:
    result = fit_result()
    listed = target_list(result)
    assert listed.common is not None
    assert np.allclose(listed.table.stacked(("sigma_x", "sigma_y", "sigma_z")), [0.01, 0.02, 0.03])
    pose = np.array([120.0, 80, 35, 0.4, -0.3, 1.2])
    points, shared = result.tables["targets"].stacked(("x", "y", "z")), result.arrays["targets_common"]
    in_machine = points @ turn(pose[3:]).T + pose[:3]
    rng = np.random.default_rng(5)
    drawn = []
    for _ in range(4000):
        shifted = points + shared @ rng.normal(size=6)
        drawn.append(poses.euler_form(poses.fit_pose(shifted, in_machine)))
    found = added_by_fit(listed.common, poses.pose_from_euler(pose[:3], pose[3:]))
    expected = np.cov(np.array(drawn).T)
    size = np.sqrt(np.diag(expected))
    assert np.abs((found - expected) / np.outer(size, size)).max() < 0.08


def test_a_shared_scale_counts_for_each_target_and_leaves_the_pose_as_it_is() -> None:
    result = fit_result()
    points, shared = result.tables["targets"].stacked(("x", "y", "z")), result.arrays["targets_common"]
    scaled = 1e-4 * (points - points.mean(axis=0))  # moves neither their middle nor turns them
    arrays = {**result.arrays, "targets_common": np.concatenate([shared, scaled[:, :, None]], axis=2)}
    alone, listed = target_list(result), target_list(replace(result, arrays=arrays))
    assert alone.common is not None and listed.common is not None
    assert np.allclose(listed.common, alone.common, atol=1e-9 * np.abs(alone.common).max())
    own = listed.table.stacked(("sigma_x", "sigma_y", "sigma_z"))
    assert np.allclose(own**2, np.array([0.01, 0.02, 0.03]) ** 2 + scaled**2)


def test_two_targets_are_too_few() -> None:
    result = fit_result()
    table = result.tables["targets"]
    two = replace(table, columns={name: table.columns[name][:2] for name in table})
    with pytest.raises(InputError, match="has 2 targets, and a part needs 3"):
        target_list(replace(result, tables={"targets": two}))


def test_the_sample_finds_its_part_and_a_target_that_moved(tmp_path: Path, metrocli: Metrocli) -> None:
    home = tmp_path / "p"
    shutil.copytree(SAMPLES / "raw-part", home)
    assert metrocli("run", home).code == 0
    result = hdf5.read(home / "results" / "align.h5")[0]
    truth = np.array([120.0, 80.0, 35.0, 2.1e-3, -1.3e-3, 12.4e-3])
    off = np.array([one.value for one in result.estimates[:6]]) - truth
    # the truth was drawn for the fitted frame, so the error of the fit is not in these differences
    listed = target_list(hdf5.read(home / "results" / "fit.h5")[0])
    pose = poses.pose_from_euler(truth[:3], truth[3:])
    assert listed.common is not None
    alone = result.covariance[:6, :6] - added_by_fit(listed.common, pose)
    assert off @ np.linalg.solve(alone, off) < 22.5  # 0.1 % of chi-square with 6
    job = home / "jobs" / "align.yaml"
    planted = "moved-target:target=T23,dx=0.6mm,dy=-0.4mm,dz=0mm"
    made = metrocli("simulate", job, "--seed", "3", "--out", home / "NEW", "--effect", planted)
    assert made.code == 0, made.err
    shutil.copy(home / "NEW" / "observations.csv", home / "machine" / "observations.csv")
    found = metrocli("diagnose", job, "--json")
    assert found.code == 0, found.err
    named = [(one["name"], one["where"]) for one in json.loads(found.out)["effects"]]
    assert named == [("moved-target", {"target": "T23"})]
