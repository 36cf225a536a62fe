"""The size from which an effect is distinguished from another, against draws of noise and least squares."""

from __future__ import annotations

import numpy as np
import pytest

from metrocli.diagnosis.power.average_power import size_separated


@pytest.mark.parametrize("parameters", [1, 2, 3])
def test_an_effect_of_the_size_is_taken_for_itself_in_95_of_100_cases(parameters: int) -> None:
    """The right one is chosen if it leaves a smaller sum of squares than the other, with as many parameters."""
    rng = np.random.default_rng(parameters)
    visible = rng.normal(size=(40, parameters)) * np.array([3.0, 1.0, 0.3])[:parameters]
    like = visible / np.linalg.norm(visible, axis=0) + 0.07 * rng.normal(size=visible.shape)
    own, other = np.linalg.qr(visible)[0], np.linalg.qr(like)[0]
    size = size_separated(visible.T @ visible, other.T @ visible, 0.95)
    count = 20_000
    towards = rng.normal(size=(parameters, count))
    readings = size * visible @ (towards / np.linalg.norm(towards, axis=0)) + rng.normal(size=(40, count))
    explained = [((basis.T @ readings) ** 2).sum(axis=0) for basis in (own, other)]
    # 0.95 +- 0.005 by chance; the projections of several parameters have more than one difference
    assert np.mean(explained[0] > explained[1]) == pytest.approx(0.95, abs=0.02)


def test_what_another_imitates_entirely_is_never_distinguished() -> None:
    column = np.arange(1.0, 9.0)[:, None]
    assert size_separated(column.T @ column, column.T @ column / np.linalg.norm(column), 0.95) > 1e4
