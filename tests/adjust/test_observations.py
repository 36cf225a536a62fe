"""Readings side by side, with correlated components and without."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.observations import Observations


def test_readings_without_a_covariance_follow_those_that_have_one() -> None:
    rng = np.random.default_rng(5)
    root = rng.normal(size=(2, 2))
    correlated = Observations(
        rng.normal(size=(2, 3)), np.ones((2, 1)), covariance=np.stack([root @ root.T] * 3, axis=2)
    )
    plain = Observations(rng.normal(size=(2, 4)), rng.uniform(0.1, 2.0, (2, 4)))
    values = rng.normal(size=(2, 7))
    for first, second in ((correlated, plain), (plain, correlated)):
        both, n = first.followed_by(second), first.count
        apart = [first.whitened(values[:, :n]), second.whitened(values[:, n:])]
        np.testing.assert_allclose(both.whitened(values), np.concatenate(apart, axis=1), rtol=1e-12)
