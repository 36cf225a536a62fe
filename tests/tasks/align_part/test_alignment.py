"""The 7D job removes the error of clamping (Mendikute's tables 2 and 3)."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import alignment
from benchmarks.coverage import alignment_settings, corners, poses_over, true_camera
from metrocli.simulation import SimulationOptions
from metrocli.tasks.align_part import task as align_part


@pytest.fixture(scope="module")
def found() -> dict[str, alignment.Array]:
    return alignment.repeatability(60)


@pytest.mark.slow
def test_every_coordinate_improves_by_the_published_factor_or_reaches_the_image_noise(
    found: dict[str, alignment.Array],
) -> None:
    factor = found["6D"] / found["7D"][:6]
    at_limit = found["7D"][:6] < 1.02 * found["limit 7D"][:6]
    for name, is_at_limit, value, published in zip(
        alignment.NAMES, at_limit, factor, alignment.PAPER_FACTOR, strict=False
    ):
        assert is_at_limit or value >= published, name


@pytest.mark.slow
def test_the_clamping_error_is_there_without_it(found: dict[str, alignment.Array]) -> None:
    """X, Y and gamma suffer as in the paper: the scene is not one that hides the clamping angle."""
    factor = dict(zip(alignment.NAMES, found["6D"] / found["7D"][:6], strict=False))
    assert factor["x"] > 4.2
    assert factor["y"] > 1.9
    assert factor["gamma"] > 7.0 * 0.8


@pytest.mark.slow
def test_the_clamping_angle_is_found(found: dict[str, alignment.Array]) -> None:
    """2 s of a uniform distribution of +-3.1 mm/m is 3.58 mm/m."""
    assert found["7D"][6] == pytest.approx(2 * 3.1 / np.sqrt(3), rel=0.15)
    assert found["limit 7D"][6] < 0.1


@pytest.mark.slow
def test_not_knowing_the_angle_costs_little(found: dict[str, alignment.Array]) -> None:
    assert np.all(found["7D"][:6] < 1.15 * found["limit 6D"])


def test_a_start_is_found_for_any_clamping_angle() -> None:
    """Twelve angles are tried from 25 turns of the part each."""
    targets = corners()
    poses = poses_over(targets)
    settings = alignment_settings(0.05, np.radians(40.0))
    seen = align_part.simulate(align_part.TASK.job(settings, true_camera(), poses, targets), SimulationOptions(7))
    result = align_part.run(
        align_part.TASK.job(settings, true_camera(), poses, targets, observations=seen.files["observations.csv"])
    )
    assert {e.name: e.value for e in result.estimates}["gamma_s"] == pytest.approx(np.radians(40.0), abs=1e-3)
