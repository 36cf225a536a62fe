"""A law that passes for the noise of one unit, or for a scatter of a kind, is found in the place of these."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.hidden.foreign import planted
from benchmarks.hidden.lengths import Measurement
from metrocli.diagnosis.diagnose import diagnose


@pytest.mark.slow
def test_a_wave_in_one_tracer_is_not_noise_of_it() -> None:
    hidden = planted("multilaterate", 6)
    found = diagnose(hidden.job())
    assert found.law is not None
    assert found.law.terms[0].spot.where == hidden.where
    assert found.noisier_units == ()
    assert found.noise.as_declared


@pytest.mark.slow
def test_a_wave_in_the_image_is_not_a_scatter_of_the_targets() -> None:
    found = diagnose(planted("calibrate-camera", 0).job())
    assert found.law is not None
    assert found.law.terms[0].spot.acting.name == "image"
    assert found.scatters == ()
    assert found.noise.as_declared


@pytest.mark.slow
def test_a_noisier_tracer_stays_beside_a_law_in_another() -> None:
    hidden = planted("multilaterate", 1)
    m = hidden.measured
    assert isinstance(m, Measurement)
    more = 3.0 * m.sigma * np.random.default_rng(3).normal(size=len(m.length))
    found = diagnose(replace(hidden, measured=replace(m, length=m.length + np.where(m.tracer == 0, more, 0.0))).job())
    assert found.law is not None
    assert found.law.terms[0].spot.where == hidden.where == (("tracer", "T2"),)
    assert [unit.name for unit in found.noisier_units] == ["T0"]
