"""Stated uncertainties of points and tracers are true: many measurements of one network."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated.lengths import network, places, settings

from metrocli.tasks.multilaterate import task as multilaterate


@pytest.mark.parametrize(
    ("m", "scale", "runs"),
    [(4, None, 25), *(pytest.param(*case, 100, marks=pytest.mark.slow) for case in ((4, None), (6, 5e-7)))],
)
def test_intervals_hold_the_truth(m: int, scale: float | None, runs: int) -> None:
    """With inner constraints the truth is the true points moved onto the nominal ones."""
    rng = np.random.default_rng(5)
    truth = network(25, m, seed=m)
    # nominal at the truth: the frame of the constraints is then the frame of the truth
    truth = replace(truth, nominal=truth.points)
    errors, stated, tracers, sigma0, distances = [], [], [], [], []
    for _ in range(runs):
        drawn = replace(truth, scale=1 + rng.normal(0, scale or 0.0, m)).read(rng)
        result = multilaterate.run(
            multilaterate.TASK.job(settings(scale), drawn.lengths(), drawn.point_table(), truth.tracer_table())
        )
        table = result.tables["points"]
        error = places(table) - truth.points
        errors.append(error)
        stated.append(table.stacked(["sx", "sy", "sz"]))
        # the quadratic form of a point with its whole covariance
        distances.append(np.einsum("na,nab,nb->n", error, np.linalg.inv(result.arrays["points_covariance"]), error))
        of = {e.name: (e.value, e.std) for e in result.estimates}
        tracers += [
            abs(of[f"T{j}.{axis}"][0] - truth.tracers[j, k]) <= 1.96 * of[f"T{j}.{axis}"][1]
            for j in range(m)
            for k, axis in enumerate("xyz")
        ]
        sigma0.append(result.statistics["chi2"] / result.statistics["dof"])
    inside = np.abs(errors) <= 1.96 * np.array(stated)
    assert 0.93 <= inside.mean() <= 0.97
    assert 0.93 <= np.mean(tracers) <= 0.97
    # 95 % of a chi-square of three degrees of freedom lie below 7.815
    assert 0.93 <= (np.array(distances) <= 7.815).mean() <= 0.97
    # a chi-square of f degrees of freedom has the variance 2 f
    assert np.mean(sigma0) == pytest.approx(1.0, abs=3.3 * np.sqrt(2 / result.statistics["dof"] / runs))
