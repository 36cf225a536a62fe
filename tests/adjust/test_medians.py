"""Medians are those of numpy."""

from __future__ import annotations

import numpy as np
import pytest

from metrocli.adjust.medians import median


@pytest.mark.parametrize("shape", [(1,), (2,), (7,), (10,), (3, 8), (3, 9)])
def test_medians_are_those_of_numpy(shape: tuple[int, ...]) -> None:
    values = np.random.default_rng(1).normal(size=shape)
    np.testing.assert_array_equal(median(values), np.median(values, axis=-1))


def test_a_nan_makes_the_median_nan_and_nothing_has_none() -> None:
    np.testing.assert_array_equal(median(np.array([[1.0, np.nan, 3.0], [1.0, 2.0, np.inf]])), [np.nan, 2.0])
    assert np.isnan(median(np.zeros(0)))
