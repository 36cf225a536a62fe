"""Sizes are excluded to first order only where the change by an effect is linear up to them."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.hidden import images
from benchmarks.hidden.scenes import board_scene
from metrocli.diagnosis.detectability import BENT
from metrocli.diagnosis.diagnose import what_can_be_seen
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.linear.signatures import nonlinearity
from metrocli.diagnosis.status import Status, reason, status


@pytest.mark.parametrize("seed", [2, 3])
def test_a_tilted_sensor_beside_decentring_is_not_excluded(seed: int) -> None:
    """p1 and p2 take up nearly all of its first order, so that its second order shows first."""
    rng = np.random.default_rng(seed)
    job = images.read(board_scene(rng, 13, (9, 6)), rng).adjusted()
    design = what_can_be_seen(job)
    bent = [candidate for candidate in design.candidates if candidate.nonlinear]
    assert [candidate.alternative.effect.name for candidate in bent] == ["sensor-tilt"]
    assert status(bent[0]) == Status.CANNOT_SEE
    assert reason(bent[0], Status.CANNOT_SEE).startswith("not linear at sizes such as")
    others = [one for one in design.candidates if one.testable and not one.alternative.instance and one not in bent]
    system = measurement_of(job).system
    for alternative, size in [(one.alternative, min(one.detectable, one.plausible)) for one in others]:
        assert nonlinearity(system, alternative.effect, dict(alternative.scanned), size) < BENT / 2
    linear = {candidate.alternative.effect.name: status(candidate) for candidate in design.candidates}
    assert linear["stretched-targets"] == linear["target-plane-bend"] == Status.EXCLUDED
