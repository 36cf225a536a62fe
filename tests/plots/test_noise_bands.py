"""What pure noise may do: bounds against simulations with draws of their own, and against worked numbers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import beta

from metrocli.plots.noise_bands import largest_of, local_level, normal_plot, trend

TRIALS = 1500


def share_within(rate: float, wanted: float = 0.95) -> bool:
    """Whether a share of TRIALS agrees with the wanted one within four standard deviations."""
    return abs(rate - wanted) < 4 * np.sqrt(wanted * (1 - wanted) / TRIALS)


@pytest.mark.parametrize("count", [1, 7, 400])
def test_the_largest_of_pure_noise_exceeds_its_bound_once_in_twenty(count: int) -> None:
    w = np.random.default_rng(861).normal(size=(TRIALS, count))
    assert share_within((np.abs(w).max(axis=1) <= largest_of(count)).mean())
    assert (2 * ndtr(largest_of(count)) - 1) ** count == pytest.approx(0.95)


@pytest.mark.parametrize("count", [12, 300])
def test_all_means_of_pure_noise_stay_in_the_envelope(count: int) -> None:
    rng = np.random.default_rng(862)
    covariate = rng.random(count)
    inside = [not len(trend(covariate, rng.normal(size=count)).beyond) for _ in range(TRIALS)]
    assert share_within(float(np.mean(inside)))


def test_a_drift_leaves_the_envelope() -> None:
    rng = np.random.default_rng(863)
    time = np.sort(rng.random(500)) * 3600
    found = trend(time, rng.normal(size=500) + 3 * (time / 3600 - 0.5))
    assert {0, len(found.means) - 1} <= set(found.beyond.tolist())


def test_means_of_bins_by_hand() -> None:
    """Ten readings of two values of the covariate make two bins, whatever their order."""
    covariate = np.array([2.0, 1.0, 2.0, 1.0, 1.0, 2.0, 2.0, 1.0, 2.0, 1.0])
    w = np.array([1.0, -1.0, 2.0, -2.0, 0.0, 3.0, 0.0, 0.0, -1.0, 1.0])
    found = trend(covariate, w)
    assert found.middles.tolist() == [1.0, 2.0]
    assert found.means.tolist() == [-0.4, 1.0]
    assert found.bounds == pytest.approx(largest_of(2) / np.sqrt(5))


def test_equal_values_of_a_covariate_stay_together() -> None:
    rng = np.random.default_rng(864)
    covariate = np.repeat(np.arange(7.0), [50, 3, 1, 90, 2, 40, 14])
    found = trend(covariate, rng.normal(size=200))
    assert set(found.middles) <= set(np.arange(7.0)) or len(found.middles) < 7
    edges = found.bounds**-2 * largest_of(len(found.means)) ** 2
    assert edges.sum() == pytest.approx(200)


@pytest.mark.parametrize("count", [8, 60, 700])
def test_all_of_pure_noise_stay_in_the_band_of_the_normal_plot(count: int) -> None:
    rng = np.random.default_rng(865)
    band = normal_plot(rng.normal(size=count))
    w = np.sort(rng.normal(size=(TRIALS, count)), axis=1)
    inside = float(((w >= band.low) & (w <= band.high)).all(axis=1).mean())
    # the simulated level has an uncertainty of its own: 95 % within 1.5 %
    assert abs(inside - 0.95) < 0.015 + 3 * np.sqrt(0.05 * 0.95 / TRIALS)


def test_bounds_of_the_normal_plot_are_those_of_order_statistics() -> None:
    found = normal_plot(np.random.default_rng(866).normal(size=25))
    rank, half = np.arange(1, 26), local_level(25) / 2
    assert ndtr(found.low) == pytest.approx(beta.ppf(half, rank, 26 - rank))
    assert ndtr(found.high) == pytest.approx(beta.isf(half, rank, 26 - rank))
    assert (np.diff(found.ordered) >= 0).all() and (np.diff(found.expected) > 0).all()


def test_interpolated_bounds_of_many_readings_are_close_to_the_exact_ones() -> None:
    count = 50_000
    found = normal_plot(np.random.default_rng(867).normal(size=count))
    rank = np.array([1, 2, 17, 900, 20_000, 25_001, 49_000, 49_990, 50_000])
    half = local_level(count) / 2
    assert ndtr(found.low[rank - 1]) == pytest.approx(beta.ppf(half, rank, count + 1 - rank), rel=2e-4)


def test_noise_of_twice_the_size_is_outside() -> None:
    assert normal_plot(2 * np.random.default_rng(868).normal(size=200)).outside > 20
