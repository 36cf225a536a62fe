"""Small convex programmes against a general solver, with their dual values."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog, minimize

from metrocli.adjust.small_programmes import highest, quadratic


@pytest.mark.parametrize("seed", range(6))
def test_a_quadratic_programme_meets_the_conditions_of_an_optimum(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 6))
    hessian, gradient = root @ root.T + 0.1 * np.eye(6), rng.normal(size=6)
    rows = rng.normal(size=(500, 6))
    bounds = rows @ rng.normal(size=6) - rng.uniform(0, 0.5, 500)
    found = quadratic(hessian, gradient, rows, bounds)
    assert found is not None
    assert (rows @ found.x - bounds).min() > -1e-9
    assert (found.duals >= 0).all() and 1 <= (found.duals > 0).sum() <= 6
    assert np.allclose(hessian @ found.x + gradient, rows.T @ found.duals, atol=1e-8)
    assert np.abs(found.duals * (rows @ found.x - bounds)).max() < 1e-8
    other = minimize(
        lambda x: x @ hessian @ x / 2 + gradient @ x,
        found.x + 0.01,
        jac=lambda x: hessian @ x + gradient,
        method="SLSQP",
        constraints={"type": "ineq", "fun": lambda x: rows @ x - bounds, "jac": lambda x: rows},
        options={"ftol": 1e-13},
    )
    assert np.allclose(found.x, other.x, atol=1e-5)


def test_without_active_inequality_it_is_the_free_minimum() -> None:
    found = quadratic(2 * np.eye(2), np.array([-2.0, 4.0]), np.array([[1.0, 0.0]]), np.array([0.5]))
    assert found is not None and np.allclose(found.x, [1, -2]) and not found.duals.any()


def test_contradicting_inequalities_have_no_solution() -> None:
    assert quadratic(np.eye(1), np.zeros(1), np.array([[1.0], [-1.0]]), np.array([1.0, 0.5])) is None


@pytest.mark.alike
@pytest.mark.parametrize("seed", range(4))
def test_the_highest_least_value_is_that_of_the_whole_programme(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, values = rng.normal(size=(3000, 6)), rng.normal(size=3000)
    found, least = highest(rows, values, 10.0)
    whole = linprog(
        np.append(np.zeros(6), -1.0),
        np.column_stack([-rows, np.ones(3000)]),
        values,
        bounds=[(-10, 10)] * 6 + [(None, None)],
    )
    assert least == pytest.approx(-whole.fun, abs=1e-7)
    assert found.duals.sum() == pytest.approx(1.0) and np.allclose(rows.T @ found.duals, 0, atol=1e-7)
