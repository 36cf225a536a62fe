"""A flat part seen from afar has two poses that fit alike: it is refused; images from further apart decide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.coverage import PART, TRUE_MOUNTING, alignment_settings, true_camera
from metrocli.errors import UndeterminedError
from metrocli.result import Result
from metrocli.simulation import SimulationOptions
from metrocli.table import Table
from metrocli.tasks.align_part import task as align_part

TILTED = replace(PART, alpha=0.25, beta=-0.15, gamma=0.1)


def located(side: float, apart: float, noise: float = 0.1) -> Result:
    """Four coplanar targets in a square, seen at 900 mm from two places."""
    x, y = side * np.array([0.0, 1, 1, 0]), side * np.array([0.0, 0, 1, 1])
    columns = {"x": x, "y": y, "z": np.zeros(4), "sigma": np.zeros(4)}
    targets = Table({"target": np.array(list("abcd")), **columns}, dict.fromkeys(columns, "mm"))
    centre = np.array([PART.x, PART.y, PART.z]) - [TRUE_MOUNTING.x, TRUE_MOUNTING.y, TRUE_MOUNTING.z]
    at = centre + [[-apart, -apart / 2, -900.0], [apart, apart / 2, -900.0]]
    poses = Table({"image": np.array(["1", "2"]), **dict(zip("xyz", at.T, strict=True))}, dict.fromkeys("xyz", "mm"))
    settings = alignment_settings(noise, 0.0, False)
    assert settings.simulation is not None
    settings = replace(settings, simulation=replace(settings.simulation, part=TILTED))
    job = align_part.TASK.job(settings, true_camera(), poses, targets)
    seen = align_part.simulate(job, SimulationOptions(3)).files["observations.csv"]
    return align_part.run(align_part.TASK.job(settings, true_camera(), poses, targets, observations=seen))


def test_a_small_flat_part_seen_from_one_place_is_refused() -> None:
    with pytest.raises(
        UndeterminedError, match=r"two poses of the part alike(.|\n)*images from positions further apart"
    ):
        located(15.0, 5.0, 0.3)


def test_images_from_further_apart_decide() -> None:
    values = {one.name: one.value for one in located(120.0, 220.0).estimates}
    assert [values[name] for name in ("alpha", "beta", "gamma")] == pytest.approx([0.25, -0.15, 0.1], abs=0.01)
