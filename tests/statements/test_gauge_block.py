"""Statements on the sample gauge-block (JCGM 101:2008, 9.5), drawn at random: propagation in plain numpy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from statements.plain_adjustment import SAMPLES, Array, cells

Metrocli = Callable[..., Any]


@pytest.fixture
def report(metrocli: Metrocli, tmp_path: Path) -> Any:
    job = SAMPLES / "gauge-block/jobs/supplement.yaml"
    return metrocli("report-uncertainty", job, "--output", tmp_path / "r.h5")


def trials(count: int) -> Array:
    """Deviations in nm, by the distributions of JCGM 101, table 10."""
    rng = np.random.default_rng(95)

    def trapezoid(half: float, inexact: float) -> Array:
        # curvilinear: limits that are known within +-inexact themselves (6.4.3.2)
        low = rng.uniform(-half - inexact, -half + inexact, count)
        return np.asarray(low + (-2 * low) * rng.random(count))

    ls = 50.000623e6 + 25 * rng.standard_t(18, count)
    d = 215 + 6 * rng.standard_t(24, count) + 4 * rng.standard_t(5, count) + 7 * rng.standard_t(8, count)
    alpha = rng.uniform(9.5e-6, 13.5e-6, count)
    theta = rng.normal(-0.1, 0.2, count) + 0.5 * np.sin(2 * np.pi * rng.random(count))
    warm = trapezoid(1e-6, 1e-7) * theta + alpha * trapezoid(0.05, 0.025)
    return np.asarray(ls + d - ls * warm - 50e6)


def test_contribution_of_the_comparator(report: Any) -> None:
    """d2 0.0, u = 7.0 nm, sensitivity 1, contribution 7, share 4.7 %, 8 degrees of freedom."""
    row = cells(report.out, "d2")
    assert row[2:6] == ["7.0", "nm", "1", "7"] and row[7] == "8"
    # sensitivities of table 10's model at the best estimates, nm: alpha_s and theta have none
    trapezoid = lambda half, inexact: np.sqrt(half**2 / 3 + inexact**2 / 9)  # noqa: E731
    parts = [25, 6, 4, 7, 50.000623e6 * 0.1 * trapezoid(1e-6, 1e-7), 50.000623e6 * 11.5e-6 * trapezoid(0.05, 0.025)]
    assert abs(float(row[6]) - 100 * 49 / np.square(parts).sum()) <= 0.051


def test_the_interval_of_gum_is_not_validated(report: Any) -> None:
    """Status: done, 1 warning: that Monte Carlo does not validate the interval (86 nm, coverage 98.23 %)."""
    (warning,) = [line for line in report.err.splitlines() if line.startswith("warning: ")]
    assert report.code == 0 and "status: done, 1 warning" in report.out and "does not validate" in warning
    drawn = trials(600_000)
    half = float(cells(report.out, "deviation = 838 nm, U =")[0].partition("U = ")[2].split()[0])
    low, high = np.percentile(drawn, [0.5, 99.5])
    # 8.2: both ends within half a unit of the second digit of u = 32 nm
    assert max(abs(838 - half - low), abs(838 + half - high)) > 0.5
    stated = float(report.out.partition("U covers ")[2].partition(" %")[0])
    # U is rounded to 1 nm in the report
    share = [100 * float(np.mean(np.abs(drawn - 838) < half + off)) for off in (-0.6, 0.6)]
    assert share[0] - 0.06 < stated < share[1] + 0.06
    # Welch and Satterthwaite: 48.26 degrees of freedom
    dof = 32.0**4 / (25**4 / 18 + 6**4 / 24 + 4**4 / 5 + 7**4 / 8)
    assert abs(half - stats.t.ppf(0.995, dof) * 32.0) < 2.0
