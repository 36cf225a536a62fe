"""Stated uncertainties are true: 95 % intervals hold the truth in 95 % of simulated measurements."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import coverage

RUNS = 50
ONE_PARAMETER = 3.29 * np.sqrt(0.95 * 0.05 / RUNS)
"""How far the coverage of one parameter may be off in 300 runs: exceeded by chance once in 1000"""
KOLMOGOROV = 1.95
"""sqrt(n) D that uniform p-values exceed once in 1000"""


@pytest.mark.slow
@pytest.mark.parametrize("job", coverage.JOBS)
def test_intervals_hold_the_truth(job: str) -> None:
    found = coverage.covered(coverage.JOBS[job](RUNS))
    assert 0.93 <= found.inside.mean() <= 0.97
    for name, share, scatter in zip(found.names, found.share, found.scatter, strict=True):
        assert abs(share - 0.95) < ONE_PARAMETER, name
        assert scatter == pytest.approx(1.0, abs=3.29 / np.sqrt(2 * RUNS)), name
    assert found.distance < KOLMOGOROV


@pytest.mark.slow
def test_an_interval_that_is_too_short_is_noticed() -> None:
    """The same runs with a third less uncertainty stated fail, so that the test above can."""

    def shortened(runs: int):  # type: ignore[no-untyped-def]
        for run in coverage.board_runs(runs):
            yield coverage.Drawn(run.names, run.values, run.std * 0.67, run.truth, run.p_value)

    assert coverage.covered(shortened(40)).inside.mean() < 0.9


def test_the_calibration_of_the_camera_is_part_of_the_uncertainty_of_the_part() -> None:
    """With the camera taken as exact, the part would seem better known than it is."""
    from metrocli.simulation import SimulationOptions
    from metrocli.tasks.align_part import task as align_part

    camera, _ = coverage.calibrated("cmm", 1, coverage.planes())
    targets = coverage.corners(0.0)
    poses, settings = coverage.poses_over(targets), coverage.alignment_settings(0.05, 1e-3)
    true = coverage.true_camera()
    seen = align_part.simulate(align_part.TASK.job(settings, true, poses, targets), SimulationOptions(1)).files[
        "observations.csv"
    ]
    with_camera = align_part.run(align_part.TASK.job(settings, camera, poses, targets, observations=seen))
    exact = align_part.run(align_part.TASK.job(settings, true, poses, targets, observations=seen))
    assert all(a.std > b.std for a, b in zip(with_camera.estimates, exact.estimates, strict=True))
    z, exact_z = with_camera.estimates[2].std, exact.estimates[2].std
    assert z > 1.1 * exact_z
    assert any("taken as exact" in line for line in exact.warnings)
    assert not any("taken as exact" in line for line in with_camera.warnings)
