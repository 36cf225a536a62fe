"""Tails and bounds are those of scipy."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.special

from metrocli.adjust.probabilities import (
    chi_square_bound,
    chi_square_tail,
    f_tail,
    normal_bound,
    student_bound,
    student_tail,
)


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


def test_the_tail_of_a_thousand_million_degrees() -> None:
    """A series that ends after 10,000 terms had lost 0.7 % of it."""
    for away in (-2, 0, 2, 5):
        value = 1e9 + away * np.sqrt(2e9)
        assert chi_square_tail(1e9, value) == pytest.approx(scipy.special.chdtrc(1e9, value), rel=1e-7)


def test_the_tail_at_its_ends() -> None:
    assert chi_square_tail(5, 0.0) == 1.0
    assert chi_square_tail(5, math.inf) == 0.0
    assert chi_square_tail(3, 1e6) == 0.0
    assert math.isnan(chi_square_tail(3, math.nan))


@pytest.mark.parametrize("dof", [1, 2, 7, 100, 30_000, 1_000_000])
@pytest.mark.parametrize("tail", [0.975, 0.5, 0.05, 0.025, 1e-6])
def test_the_bound_of_chi_square(dof: int, tail: float) -> None:
    assert chi_square_bound(dof, tail) == pytest.approx(scipy.special.chdtri(dof, tail), rel=1e-10)


@pytest.mark.parametrize("dof", [1, 2, 3.5, 10, 691, 30_000, 1_000_000, 2e7, 1e13, 1e20])
@pytest.mark.parametrize("tail", [0.3, 0.025, 1e-5, 1e-9])
def test_the_bound_and_the_tail_of_student(dof: float, tail: float) -> None:
    bound = -scipy.special.stdtrit(dof, tail)
    assert student_bound(dof, tail) == pytest.approx(bound, rel=3e-9)
    assert student_tail(dof, bound) == pytest.approx(tail, rel=1e-8)
    assert student_tail(dof, -bound) == pytest.approx(1 - tail, rel=1e-8)


@pytest.mark.parametrize("dof", [(1, 1), (5, 7), (3, 400), (1000, 1000), (100_000, 100_000)])
@pytest.mark.parametrize("value", [1e-3, 0.5, 1.0, 1.02, 3.0, 1e4])
def test_the_tail_of_f(dof: tuple[int, int], value: float) -> None:
    expected = scipy.special.fdtrc(*dof, value)
    assert f_tail(*dof, value) == pytest.approx(expected, rel=1e-8, abs=1e-300)


def test_without_degrees_of_freedom_f_has_no_tail() -> None:
    assert math.isnan(f_tail(0, 0, 2.0))


def test_nothing_exceeds_an_infinite_bound() -> None:
    assert normal_bound(0.0) == student_bound(5, 0.0) == chi_square_bound(3, 0.0) == math.inf
    assert normal_bound(1.0) == -math.inf
