"""Raised supports make the part level: checked with the plane through them, and with drawn poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated.castings import Array, turn

from benchmarks.coverage import PART, alignment_settings, corners, poses_over, true_camera
from metrocli.errors import InputError
from metrocli.simulation import SimulationOptions
from metrocli.table import Table
from metrocli.tasks.align_part import task as align_part
from metrocli.tasks.align_part.fixturing import corrections, must_level, tilt_not_exceeded

PLACES = np.array([[0.0, 0], [1500, 50], [1400, 1000], [-20, 900]])
POSE = np.array([120.0, 80, 35, 2.1e-3, -1.3e-3, 0.4])


def supports(places: Array, height: Array | None = None) -> Table:
    columns = {"support": np.array([f"S{n}" for n in range(len(places))]), "x": places[:, 0], "y": places[:, 1]}
    return Table(columns if height is None else {**columns, "z": height}, {"x": "mm", "y": "mm"})


def heights(angles: Array) -> Array:
    """Height of the part's plane z = 0 over each support, by the line along z that meets it."""
    normal = turn(angles)[:, 2]
    return np.array([-(normal[0] * x + normal[1] * y) / normal[2] for x, y in PLACES])


def test_raised_supports_are_level_and_the_largest_comes_first() -> None:
    found = corrections(POSE, np.zeros((6, 6)), supports(PLACES)).tables["supports"]
    order = [int(name[1:]) for name in found.texts("support")]
    raised = heights(POSE[3:])[order] + found.numbers("raise")
    assert np.ptp(raised) < 1e-9
    assert found.numbers("raise").min() == 0 and (np.diff(found.numbers("raise")) <= 0).all()
    assert found.numbers("raise").max() > 1


def test_their_uncertainty_is_that_of_drawn_poses() -> None:
    covariance = np.diag([0.01, 0.01, 0.01, 2e-5, 3e-5, 1e-5]) ** 2
    found = corrections(POSE, covariance, supports(PLACES)).tables["supports"]
    order = [int(name[1:]) for name in found.texts("support")]
    drawn = np.random.default_rng(1).multivariate_normal(POSE, covariance, 4000)
    each = np.array([heights(one[3:])[order] for one in drawn])
    relative = each[:, -1:] - each  # to the support that stays
    assert np.allclose(relative.std(axis=0), found.numbers("raise_std"), rtol=0.05, atol=1e-12)


def plane(points: Array) -> Array:
    """Normal of the plane of least squares through points (n, 3), upwards."""
    normal = np.linalg.svd(points - points.mean(axis=0))[2][2]
    return np.asarray(normal * np.sign(normal[2]))


def test_the_tilt_that_is_left_after_each_screw() -> None:
    found = corrections(POSE, np.zeros((6, 6)), supports(PLACES)).tables["supports"]
    order = [int(name[1:]) for name in found.texts("support")]
    now = heights(POSE[3:])[order]
    for screw, stated in enumerate(found.numbers("tilt_left")):
        now[screw] += found.numbers("raise")[screw]
        normal = plane(np.column_stack([PLACES[order], now]))
        assert np.hypot(normal[0], normal[1]) == pytest.approx(stated, abs=1e-8)
    assert found.numbers("tilt_left")[-1] < 1e-12 < found.numbers("tilt_left")[0]


def test_the_zero_point_lists_the_pose_as_the_machine_moves_it() -> None:
    covariance = np.diag([0.01, 0.02, 0.03, 1e-5, 2e-5, 3e-5]) ** 2
    table = corrections(POSE, covariance, None).tables["zero_point"]
    assert table.texts("move") == ["shift x", "shift y", "shift z", "turn about z", "turn about y", "turn about x"]
    # shift, then turn about each axis as it stands after the turns before
    here = np.eye(3)
    for size, axis in zip(table.numbers("value")[3:], (2, 1, 0), strict=True):
        angles = np.zeros(3)
        angles[axis] = size
        here = here @ turn(angles)
    assert np.allclose(here, turn(POSE[3:])) and np.allclose(table.numbers("value")[:3], POSE[:3])
    assert np.allclose(table.numbers("std"), [0.01, 0.02, 0.03, 3e-5, 2e-5, 1e-5])


@pytest.mark.parametrize("height", [None, 20.0])
def test_the_zero_point_after_the_screws(height: float | None) -> None:
    """Three points of the part keep their distances, stand over their supports, and are level."""
    covariance = np.diag([0.01, 0.02, 0.03, 1e-5, 2e-5, 3e-5]) ** 2
    table = supports(PLACES) if height is None else supports(PLACES, np.full(len(PLACES), height))
    found = corrections(POSE, covariance, table)
    zero, screws = found.tables["zero_point"], found.tables["supports"]
    x, y, z, gamma, beta, alpha = zero.numbers("levelled")
    assert abs(alpha) < 1e-12 and abs(beta) < 1e-12
    # what was at the contact with the support that stays is still there
    stays = PLACES[int(screws.texts("support")[-1][1:])]
    contact = np.append(stays, heights_at(POSE, stays) if height is None else height)
    in_part = turn(POSE[3:]).T @ (contact - POSE[:3])
    assert np.allclose(turn(np.array([0, 0, gamma])) @ in_part + [x, y, z], contact, atol=1e-9)
    # what is raised at another support is the difference of the heights before and after
    first = int(screws.texts("support")[0][1:])
    there = np.append(PLACES[first], heights_at(POSE, PLACES[first]))
    after = turn(np.array([0, 0, gamma])) @ turn(POSE[3:]).T @ (there - POSE[:3]) + [x, y, z]
    assert after[2] - there[2] == pytest.approx(screws.numbers("raise")[0], abs=1e-4)
    # the tilt that may be left is the uncertainty of the tilt that was measured, about the part's own axes
    assert np.allclose(sorted(zero.numbers("levelled_std")[4:]), [1e-5, 2e-5], rtol=0.2)


@pytest.mark.parametrize("covariance", [[[4.0, 0.0], [0.0, 4.0]], [[4.0, 1.5], [1.5, 1.0]], [[4.0, 2.0], [2.0, 1.0]]])
def test_the_tilt_that_may_be_left_is_exceeded_in_five_percent(covariance: list[list[float]]) -> None:
    spread = 1e-10 * np.array(covariance)
    drawn = np.random.default_rng(3).multivariate_normal(np.zeros(2), spread, 100_000, method="eigh")
    beyond = np.hypot(*drawn.T) > tilt_not_exceeded(spread)
    assert beyond.mean() == pytest.approx(0.05, abs=0.003)


@pytest.mark.parametrize("dof", [1, 4, 9, 60])
def test_the_tilt_of_an_estimated_noise_is_exceeded_in_five_percent(dof: int) -> None:
    """Each measurement states it for the noise that its own few residuals show."""
    rng, spread = np.random.default_rng(5), 1e-10 * np.array([[4.0, 1.5], [1.5, 1.0]])
    drawn = rng.multivariate_normal(np.zeros(2), spread, 100_000)
    found = np.sqrt(rng.chisquare(dof, len(drawn)) / dof)
    beyond = np.hypot(*drawn.T) > found * tilt_not_exceeded(spread, dof)
    assert beyond.mean() == pytest.approx(0.05, abs=0.003)


def heights_at(pose: Array, place: Array) -> float:
    """Height of the part's plane z = 0 over a place of the machine."""
    normal = turn(pose[3:])[:, 2]
    return float(pose[2] - normal[:2] @ (place - pose[:2]) / normal[2])


def test_a_part_that_lies_on_its_side_is_not_levelled() -> None:
    found = corrections(np.array([0.0, 0, 0, 1.2, 0, 0]), np.zeros((6, 6)), supports(PLACES))
    assert set(found.tables) == {"zero_point"} and "the part's z axis is 69 deg off" in found.warnings[0]


@pytest.mark.parametrize(
    ("places", "message"),
    [(PLACES[:2], "number of supports: 2"), (PLACES[:1] + np.outer(range(4), [5, 7]), "one line")],
)
def test_supports_that_cannot_level(places: Array, message: str) -> None:
    with pytest.raises(InputError, match=message):
        must_level(supports(places))


def test_lists_that_no_reading_uses_are_not_controlled() -> None:
    settings, camera, targets = alignment_settings(0.05, 1e-3), true_camera(), corners()
    at = poses_over(targets)
    seen = align_part.simulate(align_part.TASK.job(settings, camera, at, targets), SimulationOptions(1))
    job = align_part.TASK.job(settings, camera, at, targets, observations=seen.files["observations.csv"])
    points = Table({"point": np.array(["G1"]), "x": np.ones(1), "y": np.ones(1), "z": np.ones(1)})
    plain = align_part.run(job).tables["not_controlled"]
    with_lists = replace(job, files=replace(job.files, supports=supports(PLACES), points=points))
    found = align_part.run(with_lists).tables["not_controlled"]
    new = {
        text.partition(",")[0]: hides for text, hides in zip(found.texts("effect"), found.numbers("hides"), strict=True)
    }
    assert len(found) == len(plain) + 2
    assert new["listed places of the supports"] == pytest.approx(np.hypot(PART.alpha, PART.beta), rel=0.05)
    assert new["listed places of `points`"] == 1.0
