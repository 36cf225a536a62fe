"""An encoder behind a belt: planted by a plain formula, named with its width, or a constant that the unit's angle takes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated import launch

from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.diagnose import diagnose, what_can_be_seen
from metrocli.tasks.locate_launch_unit import readings
from metrocli.tasks.locate_launch_unit import task as locate_launch_unit

WIDTH = 60 * launch.ARCSEC


def job(poses: launch.Poses, **more: object) -> AdjustedJob:
    return locate_launch_unit.diagnosed(locate_launch_unit.TASK.job(launch.settings(), poses=poses.table(**more)))


def lagging(exact: launch.Poses, encoder: int, width: float) -> launch.Poses:
    """Readings behind a belt, one pose after the other, each reached by the shorter way; the first as the second."""
    angles = exact.angles.copy()
    for i in range(angles.shape[1]):
        to = max(i, 1)
        way = np.angle(np.exp(1j * (exact.angles[encoder, to] - exact.angles[encoder, to - 1])))
        angles[encoder, i] -= width / 2 if way > 0 else -width / 2
    return replace(exact, angles=angles)


@pytest.mark.parametrize("encoder", [*(pytest.param(one, marks=pytest.mark.slow) for one in range(3)), 3])
def test_the_width_is_found(encoder: int) -> None:
    rng = np.random.default_rng([111, encoder])
    exact = launch.anywhere(40, 112)
    assert not diagnose(job(exact.noisy(rng))).findings
    (finding,) = diagnose(job(lagging(exact, encoder, WIDTH).noisy(rng))).findings
    assert str(finding.effect.alternative) == f"belt-hysteresis phi{encoder + 1}"
    (size,) = finding.sizes
    assert abs(size.value - WIDTH) < 4.5 * size.std
    assert size.std < WIDTH / 10


def test_the_order_is_that_of_the_times() -> None:
    exact = launch.anywhere(12, 113)
    t = np.random.default_rng(114).permutation(12).astype(float)
    first, second = readings.read(exact.table(t=t)).turned, readings.read(exact.table()).turned
    order = np.argsort(t)
    again = replace(exact, angles=exact.angles[:, order], receivers=exact.receivers[order], psi=exact.psi[order])
    assert np.array_equal(first[:, order], readings.read(again.table()).turned)
    assert not np.array_equal(first, second)
    assert (np.abs(second) == 1).all()


def test_an_axis_that_rests_keeps_its_sense() -> None:
    exact = launch.anywhere(4, 115)
    angles = exact.angles.copy()
    angles[0] = [0.1, 0.4, 0.4004, 0.2]
    assert readings.read(replace(exact, angles=angles).table()).turned[0].tolist() == [1, 1, 1, -1]


def test_from_one_side_it_is_a_constant_that_the_angle_of_the_unit_takes() -> None:
    """It is not testable at phi1 then, and changes nothing but gamma. No gap between two poses is half a turn."""
    exact = launch.anywhere(40, 118)
    order = np.argsort(exact.angles[0])
    ring = replace(exact, angles=exact.angles[:, order], receivers=exact.receivers[order], psi=exact.psi[order])
    seen = what_can_be_seen(job(ring.noisy(np.random.default_rng(117)))).candidates
    (one,) = (one for one in seen if str(one.alternative) == "belt-hysteresis phi1")
    assert np.isinf(one.detectable)
    assert "gamma" in " ".join(one.absorbed_by)
    assert one.undetected.size < 1e-6
