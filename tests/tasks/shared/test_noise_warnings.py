"""Warnings of noise beyond its interval: they recommend what the job does not do already."""

from __future__ import annotations

from metrocli.adjust.outcome import Outcome
from metrocli.adjust.solution import Solution
from metrocli.tasks.shared.statistics import REMOVE, noise_warnings


def test_a_job_that_left_readings_out_is_not_advised_to() -> None:
    sigma0 = 30.0
    solution = Solution(Outcome.CONVERGED, {}, (), sigma0**2 * 40, iterations=3, unknowns=2, conditions=42)
    (advised,) = noise_warnings(solution)
    (rest,) = noise_warnings(solution, removed=2)
    assert REMOVE in advised and REMOVE not in rest
    assert advised.replace(f" ({REMOVE})", "") == rest and rest.startswith(f"sigma0 = {sigma0}")
