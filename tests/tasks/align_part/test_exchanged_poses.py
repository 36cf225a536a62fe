"""Two rows of the poses exchanged: both images are named; images in their order, with a wrong pose, are not."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from benchmarks.coverage import alignment_settings, corners, poses_over, true_camera
from metrocli.errors import InputError, MetrocliError
from metrocli.simulation import SimulationOptions
from metrocli.table import Table
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
    assert "are exchanged: read so" not in str(failed.value)


def test_right_poses_are_aligned() -> None:
    poses = poses_over(corners())
    aligned(poses, poses, 33)
