"""Two rows of the poses exchanged: both images are named; images in their order, with a wrong pose, are not."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from benchmarks.coverage import PART, TRUE_MOUNTING, Array, alignment_settings, corners, poses_over, true_camera
from metrocli.adjust.adjustment import adjust
from metrocli.adjust.solution import Solution
from metrocli.errors import InputError, MetrocliError
from metrocli.instruments.spindle_camera import Rays, start_pose
from metrocli.simulation import SimulationOptions
from metrocli.table import Table
from metrocli.tasks.align_part import exchanged
from metrocli.tasks.align_part import task as align_part


def aligned(poses: Table, stated: Table, seed: int) -> None:
    """Align a part seen from some poses, of which the file states others."""
    targets, settings = corners(), alignment_settings(0.05, 2e-3)
    seen = align_part.simulate(align_part.TASK.job(settings, true_camera(), poses, targets), SimulationOptions(seed))
    job = align_part.TASK.job(settings, true_camera(), stated, targets, observations=seen.files["observations.csv"])
    align_part.run(job)


def order(poses: Table, rows: list[int]) -> Table:
    """Poses whose images have the positions of other rows."""
    moved = {name: values if name == "image" else values[rows] for name, values in poses.columns.items()}
    return Table(moved, poses.units)


@pytest.mark.parametrize("pair", [(0, 5), (2, 3)])
def test_both_images_are_named(pair: tuple[int, int]) -> None:
    poses = poses_over(corners())
    rows = list(range(len(poses)))
    rows[pair[0]], rows[pair[1]] = pair[1], pair[0]
    names = poses.texts("image")
    with pytest.raises(InputError, match=f"the poses of images {names[pair[0]]} and {names[pair[1]]} are exchanged"):
        aligned(poses, order(poses, rows), 31)


def test_no_exchange_is_offered_where_none_mends_the_poses() -> None:
    poses = poses_over(corners())
    rows = np.roll(np.arange(len(poses)), 1).tolist()
    assert sum(a != b for a, b in pairwise(rows)) > 2
    with pytest.raises(MetrocliError) as failed:
        aligned(poses, order(poses, rows), 32)
    assert "are exchanged: with this corrected" not in str(failed.value)


def test_poses_that_fit_nothing_end_after_few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """An adjustment whose readings are lost at its start and forty steps later would wander on for hundreds."""
    steps = []

    def counted(*args: Any) -> Solution:
        solution = adjust(*args)
        steps.append(solution.iterations)
        return solution

    monkeypatch.setattr("metrocli.tasks.shared.images.adjustment.adjust", counted)
    poses, rng = poses_over(corners()), np.random.default_rng(35)
    targets, settings = corners(), alignment_settings(0.05, 2e-3)
    seen = align_part.simulate(align_part.TASK.job(settings, true_camera(), poses, targets), SimulationOptions(35))
    table = seen.files["observations.csv"]
    anywhere = replace(table, columns={**table.columns, "u": rng.uniform(0, 2591, len(table))})
    with pytest.raises(MetrocliError):
        align_part.run(align_part.TASK.job(settings, true_camera(), poses, targets, observations=anywhere))
    assert steps and max(steps) <= 40


def test_right_poses_are_aligned() -> None:
    poses = poses_over(corners())
    aligned(poses, poses, 33)


def test_many_readings_do_not_take_minutes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hundreds of pairs are ranked by a few readings of each image; few are tried with all."""
    rng, count = np.random.default_rng(34), 14
    at = np.column_stack([rng.uniform(0, 300, 30), rng.uniform(0, 200, 30), rng.uniform(0, 30, 30)])
    names = np.array([f"T{i:02d}" for i in range(len(at))])
    targets = Table({"target": names, **dict(zip("xyz", at.T, strict=True))}, dict.fromkeys("xyz", "mm"))
    above = at.mean(axis=0) + [PART.x, PART.y, PART.z - 600.0] + rng.uniform(-150, 150, (count, 3)) * [1, 1, 0.3]
    place = (above - [TRUE_MOUNTING.x, TRUE_MOUNTING.y, TRUE_MOUNTING.z]).T
    images = np.array([f"I{i:02d}" for i in range(count)])
    poses = Table({"image": images, **dict(zip("xyz", place, strict=True))}, dict.fromkeys("xyz", "mm"))
    settings = alignment_settings(0.05, 2e-3)
    seen = align_part.simulate(align_part.TASK.job(settings, true_camera(), poses, targets), SimulationOptions(34))
    lines = 0

    def counted(rays: Rays, *settings: Any, **further: Any) -> tuple[Array, float]:
        nonlocal lines
        lines += len(rays.point)
        return start_pose(rays, *settings, **further)

    monkeypatch.setattr(exchanged, "start_pose", counted)
    read = seen.files["observations.csv"]
    stated = order(poses, [0, 9, *range(2, 9), 1, *range(10, count)])
    with pytest.raises(InputError, match="the poses of images I01 and I09 are exchanged"):
        align_part.run(align_part.TASK.job(settings, true_camera(), stated, targets, observations=read))
    assert lines < 40 * len(read)
