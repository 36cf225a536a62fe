"""Repeated calibrations: drift, pooled standard deviation and E_n, by hand and by simulation."""

from __future__ import annotations

import numpy as np
import pytest

from metrocli.errors import InputError
from metrocli.result import Estimate, Result
from metrocli.uncertainty.repeated import repeated


def result(values: dict[str, float], std: float = 0.1, dof: float | None = None) -> Result:
    estimates = tuple(Estimate(name, value, std, "mm") for name, value in values.items())
    statistics = {} if dof is None else {"noise_estimated": True, "dof": dof}
    return Result("multilaterate", "", estimates, std**2 * np.eye(len(values)), statistics)


def test_figures_by_hand() -> None:
    """Times 0, 1, 3: the slope of 1.0, 1.2, 1.6 is 0.2; squares about the mean time 4/3 are 14/3."""
    rows = [result({"a": a, "b": b}) for a, b in ((1.0, 2.0), (1.2, 2.3), (1.6, 2.0))]
    found = repeated(rows, [0.0, 1.0, 3.0])
    a, b = found.drifts
    assert a.rate == pytest.approx(0.2) and a.std == pytest.approx(0.1 / np.sqrt(14 / 3))
    assert a.en == pytest.approx(0.2 / (2 * a.std))
    assert b.rate == pytest.approx((-4 / 3 * 2.0 - 1 / 3 * 2.3 + 5 / 3 * 2.0) / (14 / 3))
    (pooled,) = found.pooled
    squares = np.var([1.0, 1.2, 1.6], ddof=1) * 2 + np.var([2.0, 2.3, 2.0], ddof=1) * 2
    assert pooled.std == pytest.approx(np.sqrt(squares / 4)) and pooled.dof == 4
    assert pooled.expected == pytest.approx(0.1)
    u = 2 * 0.1 * np.sqrt(2)
    assert found.against_first == (pytest.approx(0.3 / u), pytest.approx(0.6 / u))
    assert found.max_en == pytest.approx(0.6 / u)


def test_a_drift_is_found_and_none_is_not() -> None:
    """150 series of five calibrations, 8 degrees of freedom each: 95.45 % of the true drifts are inside U."""
    rng = np.random.default_rng(9)
    days = [0.0, 90.0, 181.0, 270.0, 365.0]
    inside, ratios = [], []
    for _ in range(150):
        made = []
        for day in days:
            spread = 0.1 * np.sqrt(rng.chisquare(8) / 8)
            values = {"a": 1 + 0.001 * day + 0.1 * rng.normal(), "b": 0.1 * rng.normal()}
            made.append(result(values, spread, 8))
        found = repeated(made, days)
        a, b = found.drifts
        inside += [abs(a.rate - 0.001) <= a.expanded, b.en <= 1]
        ratios.append(found.pooled[0].std)
    # noise of the weights widens it by little: 99.9 % of 300
    assert 0.905 < np.mean(inside) < 0.99
    assert np.sqrt(np.mean(np.square(ratios))) > 0.1


def test_weights_that_noise_estimates_make_no_drift_surer_than_it_is() -> None:
    """300 series of five calibrations of 20 quantities, 5 degrees of freedom each: U leaves out 4.55 % of the drifts."""
    rng = np.random.default_rng(3)
    outside = []
    for _ in range(300):
        spreads = 0.1 * np.sqrt(rng.chisquare(5, 5) / 5)
        made = [result({f"q{i}": 0.1 * rng.normal() for i in range(20)}, spread, 5) for spread in spreads.tolist()]
        outside += [drift.en > 1 for drift in repeated(made, range(5)).drifts]
    assert 0.03 < np.mean(outside) < 0.065


def test_the_same_calibration_again_has_no_drift() -> None:
    one = result({"a": 1.0})
    found = repeated([one, one, one], [0.0, 1.0, 2.0])
    assert (found.max_en, found.max_drift_en, found.pooled[0].std) == (0.0, 0.0, 0.0)


def test_one_time_has_no_drift() -> None:
    with pytest.raises(InputError, match="the calibrations have one time"):
        repeated([result({"a": 1.0})] * 3, [5.0, 5.0, 5.0])


def test_results_without_a_quantity_in_all_of_them_are_refused() -> None:
    one, other = result({"a": 1.0}), result({"b": 1.0})
    with pytest.raises(InputError, match="no estimate, table or point is in all of the results"):
        repeated([result({"a": 1.0, "b": 1.0}), one, other], [0.0, 1.0, 2.0])


def test_quantities_without_uncertainty_that_stay_have_no_drift() -> None:
    one = result({"a": 1.0}, 0.0)
    wide = result({"a": 1.0, "b": 2.0}, 0.0)
    found = repeated([one, wide, one], [0.0, 1.0, 2.0])
    assert (found.drifts, found.max_drift_en) == ((), 0.0)
