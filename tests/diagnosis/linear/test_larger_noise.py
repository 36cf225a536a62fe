"""One noise of all readings, larger than declared: its likelihood against a maximum that is searched for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from metrocli.diagnosis.linear.fitted_columns import PRIOR, FittedColumns
from metrocli.diagnosis.linear.restricted_likelihood import RestrictedLikelihood, gain_of_larger_noise


@pytest.mark.parametrize(("rows", "times"), [(9, 5.0), (9, 0.5), (40, 1.0), (200, 3.0)])
def test_the_gain_is_the_largest_over_all_factors(rows: int, times: float) -> None:
    residual = times * np.random.default_rng(rows).normal(size=rows)
    squares = float(residual @ residual)
    prior = PRIOR * min(1.0, squares / rows)
    base = FittedColumns(np.zeros((rows, 0)), residual, squares + prior, rows + PRIOR, prior)

    def lost(log_ratio: float) -> float:
        grown = 1 + np.exp(log_ratio)
        return 0.5 * float((rows + PRIOR) * np.log(squares / grown + prior) + rows * np.log(grown))

    best = minimize_scalar(lost, bounds=(-30, 30), method="bounded", options={"xatol": 1e-10})
    none = 0.5 * (rows + PRIOR) * np.log(squares + prior)
    assert gain_of_larger_noise(base) == pytest.approx(none - best.fun, abs=1e-7)


def test_a_scatter_that_every_reading_shows_alike_gains_no_more() -> None:
    """Nine readings, nine sizes of one reading each: that is what larger noise is."""
    residual = np.array([8.0, 0.3, -0.5, 6.0, 0.2, -7.0, 0.9, -0.4, 0.1])
    base = FittedColumns(np.zeros((9, 0)), residual, float(residual @ residual) + PRIOR, 9 + PRIOR, PRIOR)
    scatter = RestrictedLikelihood.beside(base, np.diag(np.full(9, 2.5)))
    assert scatter.gain(scatter.best()) == pytest.approx(gain_of_larger_noise(base), abs=1e-6)


def test_columns_of_which_nothing_is_visible_gain_nothing() -> None:
    residual = np.ones(5)
    base = FittedColumns(np.zeros((5, 0)), residual, 5 + PRIOR, 5 + PRIOR, PRIOR)
    likelihood = RestrictedLikelihood.of(base, np.zeros((2, 2)), np.zeros(2))
    assert likelihood.gain(likelihood.best()) == pytest.approx(0.0, abs=1e-12)
