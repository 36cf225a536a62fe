"""A part whose list has one wrong coordinate ends in words, wherever the steps and the datum lead."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tasks.shared.images.small_jobs import turned

from benchmarks.coverage import alignment_settings, corners, poses_over, true_camera
from metrocli.errors import UndeterminedError
from metrocli.simulation import SimulationOptions
from metrocli.table import Table
from metrocli.tasks.align_part import task as align_part


@pytest.mark.parametrize("seed", [1034, 1052])
def test_a_datum_that_puts_targets_behind_a_camera_is_not_taken(seed: int) -> None:
    """The steps converge far from the list, and brought into its datum the readings have no prediction."""
    rng = np.random.default_rng(seed)
    count, every, targets = int(rng.integers(4, 9)), poses_over(corners()), corners()
    rows = np.sort(rng.permutation(8)[:count])
    at = {axis: every.numbers(axis)[rows] + rng.normal(0, 15, count) for axis in "xyz"}
    poses = Table({"image": every.columns["image"][rows], **at}, every.units)
    job = align_part.TASK.job(settings := alignment_settings(0.05, 2e-3), true_camera(), poses, targets)
    seen = align_part.simulate(job, SimulationOptions(5)).files["observations.csv"]
    axis, number = "xyz"[rng.integers(3)], rng.integers(4)
    targets.columns[axis][number] += rng.choice([-1, 1]) * rng.uniform(50, 1000)
    with pytest.raises(UndeterminedError):
        align_part.run(align_part.TASK.job(settings, true_camera(), poses, targets, observations=seen))


def test_exchanged_names_of_targets_are_named(tmp_path: Path, metrocli: Callable[..., Any]) -> None:
    """They were four wrong readings of an alignment that is clean."""
    path = turned(tmp_path)
    rows = (tmp_path / "observations.csv").read_text().splitlines()
    one, other = (next(i for i, row in enumerate(rows) if row.startswith(f"image4,{name},")) for name in ("C2", "C5"))
    rows[one], rows[other] = rows[one].replace("C2", "C5"), rows[other].replace("C5", "C2")
    (tmp_path / "observations.csv").write_text("\n".join(rows))
    ran = metrocli("align-part", path)
    assert ran.code == 3 and "C2 and C5 are exchanged in image image4" in ran.err
    assert "write C5 for C2 and C2 for C5 in the rows of image4" in ran.err
    ran = metrocli("diagnose", path, "--quick")
    assert "verdict: mistaken" in ran.out and "C2 and C5 are exchanged in image image4" in ran.out
