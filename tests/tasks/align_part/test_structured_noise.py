"""`noise: structured` of an alignment: errors of the spindle's positions move all targets of an image together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.coverage import alignment_settings, poses_over, true_camera
from metrocli.errors import UndeterminedError
from metrocli.result import Result
from metrocli.simulation import SimulationOptions
from metrocli.table import Table
from metrocli.tasks.align_part import task as align_part

ERROR = 0.03
"""Standard deviation [mm] of the spindle's positions"""


def groups_of_targets() -> tuple[Table, Table]:
    """Targets in six groups of nine, and the positions from which an image shows one group."""
    x, y = (part.ravel() for part in np.meshgrid([0.0, 400.0, 800.0], [0.0, 500.0]))
    dx, dy = (part.ravel() for part in np.meshgrid([-30.0, 0.0, 30.0], [-25.0, 0.0, 25.0]))
    columns = {"x": np.add.outer(x, dx).ravel(), "y": np.add.outer(y, dy).ravel(), "z": np.tile(3 * dx % 7, len(x))}
    names = np.array([f"T{i}" for i in range(len(columns["x"]))])
    middle = Table({"target": np.array(list("abcdef")), "x": x, "y": y, "z": 0 * x}, dict.fromkeys("xyz", "mm"))
    return Table({"target": names, **columns}, dict.fromkeys("xyz", "mm")), poses_over(middle)


def runs(seed: int, images: int = 12) -> tuple[dict[str, Result], dict[str, float]]:
    """The same readings with both kinds of noise, where the spindle stood a little beside its commanded positions."""
    targets, poses = groups_of_targets()
    poses = Table({name: values[:images] for name, values in poses.columns.items()}, poses.units)
    rng = np.random.default_rng([91, seed])
    stood = Table(
        {k: v if k == "image" else v + rng.normal(0, ERROR, len(poses)) for k, v in poses.columns.items()}, poses.units
    )
    settings = alignment_settings(0.05, 1e-3)
    seen = align_part.simulate(align_part.TASK.job(settings, true_camera(), stood, targets), SimulationOptions(seed))
    job = align_part.TASK.job(settings, true_camera(), poses, targets, observations=seen.files["observations.csv"])
    found = {
        noise: align_part.run(replace(job, settings=replace(settings, noise=noise)))
        for noise in ("estimated", "structured")
    }
    return found, dict(seen.truth)


@pytest.mark.slow
def test_uncertainties_hold_where_white_noise_is_too_small() -> None:
    z: dict[str, list[float]] = {"estimated": [], "structured": []}
    for seed in range(25):
        found, truth = runs(seed)
        for noise, result in found.items():
            z[noise] += [(one.value - truth[one.name]) / one.std for one in result.estimates]
    white, structured = (float(np.sqrt(np.mean(np.square(values)))) for values in z.values())
    assert 0.75 < structured < 1.25 < 2 < white


def test_the_result_states_it() -> None:
    found, _ = runs(1)
    white, result = found["estimated"], found["structured"]
    std, less = (np.array([one.std for one in each.estimates]) for each in (result, white))
    assert [one.value for one in result.estimates] == [one.value for one in white.estimates]
    assert result.statistics["inflation"] == pytest.approx(float(np.sqrt(np.mean((std / less) ** 2))), rel=1e-3)
    assert (result.statistics["clusters"], result.statistics["noise_estimated"]) == (12, True)
    assert {one["dof"] for one in result.details.values()} == {result.details["gamma_s"]["dof"]}
    assert not white.details and any("cluster-robust over 12 images" in line for line in result.notes)


def test_four_images_are_refused() -> None:
    with pytest.raises(UndeterminedError, match="4 images are too few"):
        runs(1, images=4)
