"""What a report claims of its own interval is true: coverage of a given k, expansion with an uncertain coefficient."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tasks.report_uncertainty.jobs import carry_out


def covered_by_t3(k: float) -> float:
    """The share of a t distribution of three degrees of freedom within +-k, in closed form."""
    return 2 / math.pi * (math.atan(k / math.sqrt(3)) + k / math.sqrt(3) / (1 + k * k / 3))


def of_three(coverage: Mapping[str, float], **more: Any) -> dict[str, Any]:
    x = {"value": "0 um", "std": "1 um", "dof": 3}
    return {"quantities": {"x": x}, "measurands": {"y": {"model": "x", "unit": "um"}}, "coverage": coverage, **more}


@pytest.mark.parametrize("k", [1, 2, 3])
def test_a_given_k_covers_what_the_t_distribution_gives(k: int, tmp_path: Path) -> None:
    ran = carry_out(tmp_path, of_three({"k": k}, monte_carlo={"trials": 0}))
    assert ran.details("y")["probability"] == pytest.approx(covered_by_t3(k), abs=1e-12)
    assert covered_by_t3(2) == pytest.approx(0.8607, abs=5e-5)
    assert ran.result is not None and any(
        f"k = {k}, {100 * covered_by_t3(k):.4g} %" in note for note in ran.result.notes
    )


def test_the_share_of_trials_within_u_is_that_probability(tmp_path: Path) -> None:
    ran = carry_out(tmp_path, of_three({"k": 2}, monte_carlo={"trials": 100000, "seed": 4}))
    found = ran.details("y")["mc"]["covered"]
    assert found == pytest.approx(covered_by_t3(2), abs=4 * math.sqrt(0.86 * 0.14 / 1e5))
    # 200,000 draws of a scaled t from this test alone
    draws = np.random.default_rng(7).standard_t(3, 200000)
    assert found == pytest.approx((np.abs(draws) <= 2).mean(), abs=0.006)


def test_where_the_law_of_propagation_fails_the_trials_state_what_u_covers(tmp_path: Path) -> None:
    """|x| has no derivative at 0: mean sqrt(2/pi), variance 1 - 2/pi."""
    job = {
        "quantities": {"x": {"value": "0 um", "std": "1 um"}},
        "measurands": {"y": {"model": "abs(x)", "unit": "um"}},
    }
    trials = {"monte_carlo": {"trials": 200000, "seed": 2}}
    mean, std = math.sqrt(2 / math.pi), math.sqrt(1 - 2 / math.pi)
    given = carry_out(tmp_path, {**job, **trials, "coverage": {"k": 2}}).details("y")
    within = math.erf((mean + 2 * std) / math.sqrt(2))
    assert given["k"] == 2 and given["U"] == pytest.approx(2 * std, rel=0.01)
    assert given["probability"] == given["mc"]["covered"] == pytest.approx(within, abs=0.003)
    found = carry_out(tmp_path, {**job, **trials, "coverage": {"probability": 0.9}}).details("y")
    assert found["mc"]["covered"] == pytest.approx(0.9, abs=1e-4)


def test_a_given_probability_gives_its_k(tmp_path: Path) -> None:
    ran = carry_out(tmp_path, of_three({"probability": 0.95}, monte_carlo={"trials": 0}))
    assert covered_by_t3(ran.details("y")["k"]) == pytest.approx(0.95, abs=1e-9)


def test_a_volume_states_the_coverage_of_its_degrees_of_freedom(tmp_path: Path) -> None:
    volume = {"from": ["0 mm"] * 3, "to": ["100 mm"] * 3, "grid": [2, 2, 2]}
    probe = {"name": "probe", "std": "1 um", "dof": 3}
    ran = carry_out(tmp_path, {"volume": volume, "contributors": [probe], "coverage": {"k": 2}})
    assert ran.details("x")["probability"] == pytest.approx(covered_by_t3(2), abs=1e-12)


def test_expansion_has_the_uncertainty_of_its_coefficient(tmp_path: Path) -> None:
    """L sqrt(alpha^2 u(dT)^2 + dT^2 u(alpha)^2), against 400,000 draws of the product."""
    volume = {"from": ["0 mm"] * 3, "to": ["1000 mm"] * 3, "grid": [2, 2, 2]}
    heat = {"alpha": "11e-6 1/K", "alpha_std": "1e-6 1/K", "difference": "4 K", "std": "0.5 K"}
    ran = carry_out(
        tmp_path, {"volume": volume, "contributors": [{"name": "t", "expansion": heat}], "coverage": {"k": 1}}
    )
    assert ran.details("x")["U"] == pytest.approx(1000 * math.hypot(11e-6 * 0.5, 4 * 1e-6), rel=1e-12)
    rng = np.random.default_rng(3)
    product = 1000 * (11e-6 + 1e-6 * rng.normal(size=400000)) * (4 + 0.5 * rng.normal(size=400000))
    # the product of both deviations adds 0.3 %
    assert ran.details("x")["U"] == pytest.approx(product.std(), rel=0.01)


def test_a_difference_without_the_coefficients_uncertainty_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    volume = {"from": ["0 mm"] * 3, "to": ["1000 mm"] * 3, "grid": [2, 2, 2]}
    heat = {"alpha": "11e-6 1/K", "difference": "4 K", "std": "0.5 K"}
    ran = carry_out(tmp_path, {"volume": volume, "contributors": [{"name": "t", "expansion": heat}]})
    assert ran.code == 3 and "give alpha_std" in capsys.readouterr().err


@pytest.mark.filterwarnings("error")
def test_a_variance_that_cancels_but_for_rounding_is_zero(tmp_path: Path) -> None:
    quantities = {name: {"value": "10 mm", "std": "1 um"} for name in "ab"}
    measurands = {"d": {"model": "a - b", "unit": "mm"}, "q": {"model": "a/b"}}
    correlations = [{"between": ["a", "b"], "value": 1}]
    ran = carry_out(tmp_path, {"quantities": quantities, "measurands": measurands, "correlations": correlations})
    assert ran.result is not None and [one.std for one in ran.result.estimates] == [0.0, 0.0]
