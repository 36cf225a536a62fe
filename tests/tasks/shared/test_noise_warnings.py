"""Warnings of noise beyond its interval: they recommend what the job does not do already."""

from __future__ import annotations

import numpy as np
import pytest

from metrocli.adjust.outcome import Outcome
from metrocli.adjust.solution import Solution
from metrocli.tasks.shared.statistics import ESTIMATED, REMOVE, noise_warnings


@pytest.mark.parametrize("sigma0", [3.0, 30.0])
def test_a_job_that_left_readings_out_is_not_advised_to(sigma0: float) -> None:
    solution = Solution(Outcome.CONVERGED, {}, (), sigma0**2 * 40, iterations=3, unknowns=2, conditions=42)
    (advised,) = noise_warnings(solution)
    (rest,) = noise_warnings(solution, removed=2)
    assert REMOVE in advised and REMOVE not in rest
    assert (ESTIMATED in rest) == (ESTIMATED in advised)
    assert np.isclose(solution.sigma0, sigma0)
