"""Readings that leave a fold nothing, or that have no noise: no search ends with an error, or finds anything there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.hidden import images, launch, lengths
from benchmarks.hidden.scenes import part_scene
from benchmarks.hidden.subjects import KINDS, Planted
from metrocli import units
from metrocli.cli.diagnosis_report import findings
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.findings import Verdict
from metrocli.diagnosis.job_entries import proposed_correlated
from metrocli.diagnosis.next_readings.choice import next_readings
from metrocli.units.table import DIMENSIONS


@pytest.mark.parametrize("seed", [14, 42, 58])
def test_a_fold_may_leave_too_few_readings_for_the_unknowns(seed: int) -> None:
    """Three targets in three images, wrong readings among them: without some of them no pose is determined."""
    rng = np.random.default_rng(seed)
    read, _ = images.spoilt(images.read(part_scene(rng, 3, 3), rng), rng, 0.3)
    for quick in (True, False):
        found = diagnose(read.adjusted(), quick=quick)
        assert np.isfinite([one.gain.log_score for one in found.findings]).all()
        # where an effect takes the last redundant reading, nothing shows the noise
        assert found.noise.ratio > 0.01


@pytest.mark.parametrize("kind", ["multilaterate", "align-part", "calibrate-camera", "selfcal-grid"])
def test_nothing_is_found_in_readings_without_noise(kind: str) -> None:
    """What remains is rounding, and of a grid what its list is off by."""
    name = KINDS[kind].effects[0]
    job = KINDS[kind].subject(np.random.default_rng(6), name)(None, None)
    for quick in (True, False):
        found = diagnose(job, quick=quick)
        assert not found.findings and not found.scatters and not found.outliers and found.left is None
        assert found.noise.ratio < 1e-3
    assert found.verdict == Verdict.CLEAN
    assert "nan" not in findings.of_diagnosis(found, None, True)


def test_encoders_without_noise_have_no_infinite_weight() -> None:
    """Beside the second order of a large tilt three of the encoders are exact."""
    rng = np.random.default_rng(7)
    read = KINDS["locate-launch-unit"].subject(rng, "base-tilt")
    found = diagnose(read(Planted("base-tilt", {"unit": "launch"}, {"tx": 3e-4, "ty": 2e-4}), None))
    assert [one.effect.alternative.effect.name for one in found.findings] == ["base-tilt"]
    assert found.noise.ratio > 0
    assert all(1e-3 <= group.ratio <= 1e6 for group in found.variance_groups)
    assert "base-tilt" in findings.of_diagnosis(found, None, True)


def test_readings_of_a_single_pose_can_be_proposed_again() -> None:
    """All readings then share one beam, and each has its own face."""
    m = launch.measurement(np.random.default_rng(2), distances=True)
    one = replace(m, receivers=m.receivers[:1], psi=m.psi[:1], t=m.t[:1], temp=m.temp[:1], read=m.read[:, :1])
    found = diagnose(one.adjusted())
    assert next_readings(found, 2).readings is not None


def test_a_correlated_error_that_no_job_can_state_is_not_proposed() -> None:
    """Lengths rounded to centimetres, of which 0.1 um are declared: a job takes 1000 times the noise at most."""
    m = lengths.measurement(np.random.default_rng(3), 30)
    found = diagnose(replace(m, length=np.round(m.length + 30 * np.sin(m.t / 200), -1)).adjusted())
    # through its file, a job can state some
    found = replace(found, job=replace(found.job, states_correlated=True))
    assert found.correlated_errors and not proposed_correlated(found)


def test_nothing_has_a_unit_of_its_dimension() -> None:
    for dimension in DIMENSIONS:
        value, symbol = units.readable(0.0, dimension)
        assert value == 0.0 and units.find_unit(symbol, dimension).symbol == symbol
