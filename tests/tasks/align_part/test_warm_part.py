"""A warm part in the machine: targets listed at 20 degC, and points to gauge where it really is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated.castings import Array, turn
from tasks.align_part.test_fitted_targets import fit_result, moved, skew

from benchmarks.coverage import PART, alignment_settings, corners, poses_over, true_camera
from metrocli.errors import InputError
from metrocli.geometry import poses
from metrocli.result import Result
from metrocli.settings import KnownQuantity
from metrocli.simulation import SimulationOptions
from metrocli.table import Table
from metrocli.tasks.align_part import task as align_part
from metrocli.tasks.align_part.fitted_targets import target_list
from metrocli.tasks.shared.part import Part

STEEL = Part(KnownQuantity(25.0, 0.5), KnownQuantity(11.5e-6, 1e-6))
TRUTH = np.array([getattr(PART, name) for name in poses.EULER])
GAUGED = np.array([[0.0, 0, 0], [1500, 1000, 400]])


def run(part: Part, seed: int, noise: float = 0.05, known: Part | None = None) -> tuple[Result, dict[str, float]]:
    """The pose of a warm part, and the truth; `known` is what the job knows of the part in place of the truth."""
    settings, targets = replace(alignment_settings(noise, 0.0, seven=False), part=part), corners()
    at = poses_over(targets)
    seen = align_part.simulate(align_part.TASK.job(settings, true_camera(), at, targets), SimulationOptions(seed))
    columns = {"point": np.array(["G1", "G2"]), **dict(zip("xyz", GAUGED.T, strict=True))}
    job = align_part.TASK.job(
        replace(settings, part=known or part),
        true_camera(),
        at,
        targets,
        points=Table(columns),
        observations=seen.files["observations.csv"],
    )
    return align_part.run(job), dict(seen.truth)


def values(result: Result) -> Array:
    return np.array([one.value for one in result.estimates])


def test_pose_and_growth_have_the_covariance_of_generalised_least_squares() -> None:
    """Images without noise: targets of 20 um each and the growth, known beforehand to u(g), are all that is unsure."""
    found, _ = run(STEEL, 3, noise=1e-4)
    euler, points = values(found)[:6], corners().stacked(("x", "y", "z"))
    part = turn(euler[3:])
    by_motion = [np.hstack([part.T, -part.T @ skew(part @ point), point[:, None]]) for point in points]
    design = np.concatenate(by_motion)
    std = np.sqrt((5 * 1e-6) ** 2 + (11.5e-6 * 0.5) ** 2 + (1e-6 * 0.5) ** 2)
    step = np.linalg.inv(design.T @ design / 0.02**2 + np.diag([0.0] * 6 + [std**-2]))
    change = np.eye(7)
    for k in range(6):
        ahead = poses.euler_form(moved(poses.pose_from_euler(euler[:3], euler[3:]), np.eye(6)[k] * 1e-6))
        change[:6, k] = (ahead - euler) / 1e-6
    expected = change @ step @ change.T
    size = np.sqrt(np.diag(expected))
    assert [one.name for one in found.estimates][6:] == ["part-expansion.scale"]
    assert size[6] < 0.95 * std
    assert np.abs((found.covariance - expected) / np.outer(size, size)).max() < 2e-3


@pytest.mark.slow
def test_what_is_found_scatters_as_stated() -> None:
    """Pose, growth and gauged points of 60 warm parts, whose growth is drawn anew each time."""
    of_pose, of_points = [], []
    for seed in range(60):
        result, truth = run(STEEL, 100 + seed)
        off = values(result) - np.append(TRUTH, truth["part-expansion.scale"])
        of_pose.append(off @ np.linalg.solve(result.covariance, off))
        there = (1 + truth["part-expansion.scale"]) * GAUGED @ turn(TRUTH[3:]).T + TRUTH[:3]
        away = (result.tables["points"].stacked(("x", "y", "z")) - there).ravel()
        common = result.arrays["points_common"].reshape(6, -1)
        of_points.append(away @ np.linalg.solve(common @ result.arrays["points_core"] @ common.T, away))
    assert np.mean(of_pose) == pytest.approx(7, abs=3 * np.sqrt(14 / 60))
    assert np.mean(of_points) == pytest.approx(6, abs=3 * np.sqrt(12 / 60))


def test_a_part_taken_as_cold_is_off() -> None:
    exact = Part(KnownQuantity(25.0), KnownQuantity(11.5e-6))
    unaware, truth = run(exact, 5, known=Part(KnownQuantity(20.0), KnownQuantity(11.5e-6)))
    aware, _ = run(exact, 5)
    there = (1 + truth["part-expansion.scale"]) * GAUGED @ turn(TRUTH[3:]).T + TRUTH[:3]
    far, near = (np.abs(one.tables["points"].stacked(("x", "y", "z")) - there).max() for one in (unaware, aware))
    assert truth["part-expansion.scale"] == pytest.approx(57.5e-6)
    assert far > 0.04 and near < 0.04
    assert len(aware.estimates) == 6
    assert any("grown by 58 um/m" in note for note in aware.notes)


def test_fitted_targets_and_the_part_in_the_machine_are_at_20_degc_both() -> None:
    warm = fit_result()
    cold = replace(warm, statistics={"growth": 57.5e-6, "growth_std": 5e-6})
    with pytest.raises(InputError, match="not at 20 degC"):
        target_list(warm, STEEL)
    assert target_list(cold, STEEL).warnings == target_list(warm).warnings == ()
    assert "without `part:`" in target_list(cold).warnings[0]
