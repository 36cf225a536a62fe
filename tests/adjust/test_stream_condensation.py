"""Condensed readings give the normal equations of all readings, for parabolas in every cell."""

from __future__ import annotations

import numpy as np
import pytest

from metrocli.adjust.stream_condensation import condense


def parabolas(x: np.ndarray, cell: np.ndarray, cells: int) -> np.ndarray:  # type: ignore[type-arg]
    return np.stack([np.where(cell == k, x**power, 0.0) for k in range(cells) for power in range(3)], axis=1)


@pytest.mark.parametrize("n", [60, 600, 6000])
def test_nothing_is_lost(n: int) -> None:
    rng = np.random.default_rng(n)
    x = rng.uniform(0, 10, n)
    cell = x.astype(int) + 3
    y = np.stack([np.sin(3 * x) + rng.normal(size=n), rng.normal(size=n)])
    few = condense(x, y, cell)
    full, part = parabolas(x, cell - 3, 10), parabolas(few.x, few.cell - 3, 10)
    weight = few.weight[:, None]
    assert np.allclose(full.T @ full, part.T @ (part * weight), rtol=1e-10, atol=1e-9)
    for channel in range(2):
        assert np.allclose(full.T @ y[channel], part.T @ (few.values[channel] * few.weight), rtol=1e-9, atol=1e-9)
        fit, *_ = np.linalg.lstsq(full, y[channel], rcond=None)
        left = ((y[channel] - full @ fit) ** 2).sum()
        again, *_ = np.linalg.lstsq(part * np.sqrt(weight), few.values[channel] * np.sqrt(few.weight), rcond=None)
        rest = ((few.values[channel] - part @ again) ** 2 * few.weight).sum()
        assert few.misfit[channel] + rest == pytest.approx(left, rel=1e-9)
    assert few.weight.sum() == pytest.approx(n)
    assert few.dof == n - len(few.x)
    assert len(few.x) <= 30


@pytest.mark.slow
def test_the_values_are_uncorrelated_with_the_weights_given() -> None:
    rng = np.random.default_rng(1)
    x = np.sort(rng.beta(0.5, 2.0, 200))
    draws = np.stack([condense(x, rng.normal(size=(1, 200)), np.zeros(200, dtype=int)).values[0] for _ in range(4000)])
    weight = condense(x, rng.normal(size=(1, 200)), np.zeros(200, dtype=int)).weight
    covariance = np.cov(draws.T) * np.sqrt(np.outer(weight, weight))
    assert np.allclose(covariance, np.eye(3), atol=0.08)


def test_few_and_clumped_readings() -> None:
    """Up to three are kept as they are; many at one place have one mean."""
    x = np.array([0.1, 0.9, 5.0, 5.0, 5.0, 5.0, 7.0, 7.5, 8.0])
    cell = np.array([0, 0, 1, 1, 1, 1, 2, 2, 2])
    few = condense(x, x[None] * 2, cell)
    assert few.cell.tolist() == [0, 0, 1, 2, 2, 2]
    assert few.x == pytest.approx([0.1, 0.9, 5.0, 7.0, 7.5, 8.0])
    assert few.values[0] == pytest.approx(few.x * 2)
    assert few.weight.tolist() == [1, 1, 4, 1, 1, 1]
    assert few.dof == 3
