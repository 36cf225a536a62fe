"""`targets: estimate`: a list of the part that is not exact is determined together with the pose of the part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.coverage import PART, Array, alignment_settings, true_camera
from metrocli.geometry import poses
from metrocli.result import Result
from metrocli.simulation import SimulationOptions
from metrocli.table import Table
from metrocli.tasks.align_part import task as align_part

ERROR = 0.1
"""Standard deviation of the listed coordinates [mm]"""


def table(places: Array) -> Table:
    names = np.array([f"M{i}" for i in range(len(places))])
    return Table({"target": names, **dict(zip("xyz", places.T, strict=True))}, dict.fromkeys("xyz", "mm"))


def spindle() -> Table:
    """Poses over the part, the spindle turned by 0, 90, 180 and 270 degrees, from two heights."""
    x, y = np.meshgrid([80.0, 160.0], [60.0, 140.0])
    at = [(a, b, high) for high in (-30.0, 60.0) for a, b in zip(x.ravel(), y.ravel(), strict=True)]
    turns = np.tile(np.arange(4) * np.pi / 2, 2)
    columns = {"image": np.array([f"I{i}" for i in range(8)]), **dict(zip("xyz", np.array(at).T, strict=True))}
    return Table({**columns, "c": turns}, {**dict.fromkeys("xyz", "mm"), "c": "rad"})


def listed() -> Array:
    x, y = np.meshgrid(np.linspace(-60.0, 60.0, 4), np.linspace(-60.0, 60.0, 4))
    return np.column_stack([x.ravel(), y.ravel(), np.where(np.arange(16) % 3, 0.0, 15.0)])


def located(seed: int, **changed: object) -> tuple[Result, Array]:
    """The part located with its list, and the real coordinates of its targets in the machine."""
    real = listed() + np.random.default_rng(seed).normal(0.0, ERROR, (16, 3))
    settings, camera, at = alignment_settings(0.05, 1e-3), true_camera(), spindle()
    seen = align_part.simulate(align_part.TASK.job(settings, camera, at, table(real)), SimulationOptions(seed + 50))
    own = replace(settings, **changed)  # type: ignore[arg-type]
    job = align_part.TASK.job(own, camera, at, table(listed()), observations=seen.files["observations.csv"])
    pose = np.array([getattr(PART, name) for name in poses.EULER])
    return align_part.run(job), poses.apply(poses.pose_from_euler(pose[:3], pose[3:]), real)


def best_pose(points: Array, in_machine: Array) -> Array:
    """The pose that lays listed points onto places in the machine by least squares (Kabsch 1976)."""
    about, there = points - points.mean(axis=0), in_machine - in_machine.mean(axis=0)
    u, _, vt = np.linalg.svd(there.T @ about)
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return poses.euler_form(poses.pose(rotation, in_machine.mean(axis=0) - rotation @ points.mean(axis=0)))


def test_the_pose_is_that_of_the_list_laid_onto_the_real_targets() -> None:
    scores = []
    for seed in range(10):
        result, in_machine = located(seed, targets="estimate")
        truth = best_pose(listed(), in_machine)
        scores += [(e.value - t) / e.std for e, t in zip(result.estimates[:6], truth, strict=True)]
        assert result.statistics["sigma0"] == pytest.approx(1.0, abs=0.2)
    assert np.mean(np.square(scores)) == pytest.approx(1.0, abs=0.55)


def test_as_listed_the_readings_contradict_the_part() -> None:
    result, _ = located(1)
    assert result.statistics["sigma0"] > 3


def test_the_targets_are_where_they_are() -> None:
    result, in_machine = located(2, targets="estimate")
    points = result.tables["targets"]
    pose = np.array([one.value for one in result.estimates[:6]])
    found = poses.apply(poses.pose_from_euler(pose[:3], pose[3:]), points.stacked(("x", "y", "z")))
    assert np.abs(found - in_machine).max() < 0.1
    assert np.sqrt(((found - in_machine) ** 2).mean()) < 0.5 * ERROR
    assert (points.numbers("sx") > 0).all()
    off = points.stacked(("x", "y", "z")) - listed()
    assert off.mean(axis=0) == pytest.approx(0.0, abs=1e-9)


def test_a_list_without_errors_is_located_as_before_with_more_uncertainty() -> None:
    settings, camera, at = alignment_settings(0.05, 1e-3), true_camera(), spindle()
    seen = align_part.simulate(align_part.TASK.job(settings, camera, at, table(listed())), SimulationOptions(4))
    job = align_part.TASK.job(settings, camera, at, table(listed()), observations=seen.files["observations.csv"])
    exact, free = (
        align_part.run(replace(job, settings=replace(settings, targets=own))) for own in ("listed", "estimate")
    )
    for one, other in zip(exact.estimates, free.estimates, strict=True):
        assert abs(one.value - other.value) < 4 * other.std
        assert other.std >= one.std * (1 - 1e-9)


def test_coordinates_can_be_unknown_in_one_plane_only() -> None:
    settings, camera, at, list_ = alignment_settings(0.05, 1e-3), true_camera(), spindle(), table(listed())
    seen = align_part.simulate(align_part.TASK.job(settings, camera, at, list_), SimulationOptions(4))
    unknown = {f"sigma_{axis}": np.full(16, 0.0 if axis == "z" else np.nan) for axis in "xyz"}
    own = Table({**list_.columns, **unknown}, {**list_.units, **dict.fromkeys(unknown, "mm")})
    job = align_part.TASK.job(
        replace(settings, targets="estimate"), camera, at, own, observations=seen.files["observations.csv"]
    )
    result = align_part.run(job)
    truth = [getattr(PART, name) for name in poses.EULER]
    assert all(abs(one.value - true) < 4 * one.std for one, true in zip(result.estimates[:6], truth, strict=True))
    points = result.tables["targets"]
    assert points.stacked(("x", "y", "z"))[:, 2] == pytest.approx(listed()[:, 2], abs=1e-12)
    assert (points.stacked(("x", "y", "z")) - listed()).mean(axis=0) == pytest.approx(0.0, abs=1e-9)
