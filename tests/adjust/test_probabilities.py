"""Tails and bounds are those of scipy."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.special

from metrocli.adjust.probabilities import chi_square_bound, chi_square_tail, normal_bound


@pytest.mark.parametrize("tail", [1e-12, 1e-7, 0.025, 0.5, 0.9])
def test_the_normal_bound(tail: float) -> None:
    assert normal_bound(tail) == pytest.approx(-scipy.special.ndtri(tail), rel=1e-13, abs=1e-15)


@pytest.mark.parametrize("dof", [1, 2, 5, 40, 1000, 30_000, 1_000_000])
def test_the_tail_of_chi_square(dof: int) -> None:
    """From far below its mean to far above it."""
    for away in (-8, -3, -0.5, 0, 0.5, 3, 8):
        value = max(dof + away * np.sqrt(2 * dof), 0.01)
        expected = scipy.special.chdtrc(dof, value)
        assert chi_square_tail(dof, value) == pytest.approx(expected, rel=1e-7 if dof > 1e4 else 1e-10, abs=1e-15)


def test_the_tail_at_its_ends() -> None:
    assert chi_square_tail(5, 0.0) == 1.0
    assert chi_square_tail(5, math.inf) == 0.0
    assert chi_square_tail(3, 1e6) == 0.0
    assert math.isnan(chi_square_tail(3, math.nan))


@pytest.mark.parametrize("dof", [1, 2, 7, 100, 30_000, 1_000_000])
@pytest.mark.parametrize("tail", [0.975, 0.5, 0.05, 0.025, 1e-6])
def test_the_bound_of_chi_square(dof: int, tail: float) -> None:
    assert chi_square_bound(dof, tail) == pytest.approx(scipy.special.chdtri(dof, tail), rel=1e-10)
