"""Axes that are behind their command: planted in a track by plain formulas, named and estimated as far as it shows."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from simulated import machine as sim

from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.diagnose import diagnose
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.machine_settings import LateralNoise, MachineNoise

Array = NDArray[np.float64]
STEP = 0.02
"""Time between two readings [s]; they are about 1 mm apart"""


@cache
def travel() -> tuple[Array, Array]:
    """Vertices and commanded positions of a path between random points of the walls, some legs to and fro."""
    rng = np.random.default_rng(91)
    vertices = np.repeat(sim.walls(rng, 30), 2, axis=0)[1:-1]
    way = [point for pair in vertices.reshape(-1, 2, 3) for point in (pair[0], pair[1], pair[0], pair[1])]
    return np.array(way), sim.travel(np.array(way), 1.0, rng)


def job(tau: tuple[float, float, float], times: bool = True) -> AdjustedJob:
    """The measurement of a machine whose axes lag by their speed times tau."""
    rng = np.random.default_rng(92)
    vertices, commanded = travel()
    true = sim.random_machine(rng, knots=(3, 3, 3), size=0.02)
    eye = sim.tracker(rng, constant=5e-3, proportional=0.0)
    tool = np.array([0.0, 0.0, 120.0])
    behind = np.gradient(commanded, STEP, axis=0) * np.array(tau)
    at = commanded - behind
    seen = eye.reads(at + tool + sim.displacements(true, at, tool), rng)
    columns = {"t": STEP * np.arange(len(seen))} if times else {}
    path, track = sim.coordinate_table("path.csv", vertices, {}), sim.coordinate_table("track.csv", seen, columns)
    noise = MachineNoise(beam=1e-3, lateral=LateralNoise(5e-3, 0.0))
    settings = sim.settings("on-the-fly", knots=(3, 3, 3), noise=noise)
    return calibrate_machine.diagnosed(calibrate_machine.TASK.job(settings, path=path, track=track))


@pytest.mark.slow
def test_one_axis_that_lags_is_named() -> None:
    finding, *others = diagnose(job((0.0, 6e-4, 0.0))).findings
    # what held-out readings do not confirm is in no extended job
    assert all(other.gain.log_score < 0 for other in others)
    assert str(finding.effect.alternative) == "servo-lag y"
    (size,) = finding.sizes
    assert abs(size.value - 6e-4) < 4.5 * size.std
    assert size.std < 6e-5


def test_what_all_axes_share_is_along_the_path() -> None:
    assert not diagnose(job((2e-3, 2e-3, 2e-3))).findings


def test_without_times_there_are_no_speeds() -> None:
    told = [
        one for one in diagnose(job((0.0, 0.0, 0.0), times=False)).design.not_tested if one.effect.name == "servo-lag"
    ]
    assert [one.reason for one in told] == ["needs a column t_s in the track of a path"]
