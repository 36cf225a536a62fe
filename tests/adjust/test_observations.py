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


def test_readings_are_in_the_order_of_their_times_or_of_their_numbers() -> None:
    without = Observations(np.zeros((1, 3)), np.ones(1), conditions={"temp": np.full(3, 20.0)})
    assert without.order.tolist() == [0.0, 1.0, 2.0]
    timed = without.with_conditions({"t": np.array([5.0, 1.0, 3.0])}).with_index({"point": np.array([0, 1, 0])})
    assert timed.order.tolist() == [5.0, 1.0, 3.0]
    assert (timed.conditions.keys(), timed.index.keys()) == ({"temp", "t"}, {"point"})
