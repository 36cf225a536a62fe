"""The uncertainty of an effect grows to what leaving out units shows, and by the factor of independent solutions."""

from __future__ import annotations

import numpy as np
import pytest

from metrocli.diagnosis.evidence.folds import least_sure, with_jackknife
from metrocli.diagnosis.evidence.identified import all_identified
from metrocli.diagnosis.evidence.parts import READINGS
from metrocli.diagnosis.evidence.state import State
from tests.diagnosis.evidence.test_dense import (
    BOARD,
    NETWORK,
    Array,
    covariance,
    measurement,
    number_of_effect,
    parts,
    unknowns,
    with_residual,
)


@pytest.mark.parametrize("kind", [BOARD, NETWORK])
def test_the_factor_is_that_of_solutions_without_each_unit(kind: str) -> None:
    rng = np.random.default_rng(8)
    m, (fixed, random, logs) = measurement(kind), parts(kind)
    effect = fixed[1]
    # sizes that differ between the held-out parts, so that the factor is not held at 1
    folds = m.folds
    mixed = rng.normal(size=m.system.rows) + effect.columns @ (60 * rng.normal(size=effect.rank)) * np.cos(folds * 2.0)
    m = with_residual(m, mixed)
    state = State.of(m, [effect], random, logs, 0)
    (before,) = all_identified(state, with_rivals=False)
    (after,) = with_jackknife(state, [before])
    v, x = covariance(m, random, logs), np.concatenate([unknowns(m), effect.columns], axis=1)

    def solved(kept: Array) -> tuple[Array, Array]:
        weight = np.linalg.inv(v[np.ix_(kept, kept)])
        gram = np.linalg.pinv(x[kept].T @ weight @ x[kept], 1e-10, hermitian=True)
        return (gram @ x[kept].T @ weight @ m.system.residual[kept])[-effect.rank :], gram[
            -effect.rank :, -effect.rank :
        ]

    every, own = solved(np.arange(m.system.rows))
    numbers = sorted({*folds.tolist()} - {-1})
    without = [solved(np.flatnonzero(folds != number)) for number in numbers]
    lengths = [float((one - every) @ np.linalg.solve(own * state.variance, one - every)) for one, _ in without]
    more = [float(np.trace(np.linalg.solve(own, other))) / effect.rank - 1 for _, other in without]
    share = (len(numbers) - 1) / len(numbers)
    expected = share * float(np.minimum(more, 1).sum())
    factor = share * float(np.sum(lengths / np.maximum(more, 1))) / effect.rank / max(1, expected / 2)
    assert factor > 1.5
    np.testing.assert_allclose(after.covariance, before.covariance * factor, rtol=1e-5)


def test_what_differs_between_images_is_in_the_uncertainty() -> None:
    rng = np.random.default_rng(21)
    m = measurement(BOARD)
    effect = m.effect(number_of_effect(m, "axis-skew"), 0)
    images = m.folds
    sizes, white, stated = [], [], []
    for _ in range(150):
        # each image has a skew of its own, in a model that has one for all of them: ten times what the noise gives
        own = 10 * rng.normal(size=images.max() + 1)[images]
        drawn = with_residual(m, rng.normal(size=m.system.rows) + effect.columns[:, 0] * own)
        state = State.of(drawn, [effect], [], [], 0)
        found = all_identified(state, with_rivals=False)
        white.append(found[0].covariance[0, 0])
        stated.append(with_jackknife(state, found)[0].covariance[0, 0])
        sizes.append(found[0].values[0])
    variance = float(np.mean(np.square(sizes)))
    assert np.mean(white) < variance / 2
    # not smaller than what it scatters by, but for the 12 % of a mean of 150 squares; a jackknife is rather too large
    assert 0.8 * variance < np.mean(stated) < 3 * variance


def test_a_size_that_hinges_on_images_stays_only_if_held_out_readings_show_it() -> None:
    """Nothing else can stand for it; a name of 2.3 +- 1.5 mm/m had headed the report of a real board."""
    rng = np.random.default_rng(23)
    m = measurement(BOARD)
    effect = m.effect(number_of_effect(m, "axis-skew"), 0)
    images = m.folds
    alike = 30 * np.ones(images.max() + 1)
    for own, sure in ((alike, True), (np.where(np.arange(len(alike)) % 2, 3, -1) * alike / 6, False)):
        drawn = with_residual(m, rng.normal(size=m.system.rows) + effect.columns[:, 0] * own[images])
        state = State.of(drawn, [effect], [], [], 0)
        found = with_jackknife(state, all_identified(state, with_rivals=False))
        assert least_sure(state, found) is None
        assert (least_sure(state, found, {effect.key}) is None) == sure


@pytest.mark.slow
def test_independent_readings_leave_it_nearly_as_it_is() -> None:
    rng = np.random.default_rng(22)
    m = measurement(NETWORK)
    effect = m.effect(0, 0)
    grown = []
    for _ in range(60):
        state = State.of(with_residual(m, rng.normal(size=m.system.rows)), [effect], [], [], 0)
        found = all_identified(state, with_rivals=False)
        grown.append(float(np.sqrt(with_jackknife(state, found)[0].covariance[0, 0] / found[0].covariance[0, 0])))
    assert min(grown) == pytest.approx(1.0)
    # a jackknife is rather too large, because without a unit the rest determines less (here 24 % in the mean)
    assert np.mean(grown) < 1.4


def test_an_effect_beside_a_wrong_reading_has_a_factor() -> None:
    m = measurement(NETWORK)
    # parts without whole points are held out by columns of their own, which stand behind those of the effects
    state = State.of(m, [m.reading(7), m.effect(0, 0), m.effect(1, 0)], [], [], 0)
    assert state.fixed[0].family == READINGS
    found = with_jackknife(state, all_identified(state, with_rivals=False))
    assert [effect.key for effect in found] == [(0, 0), (1, 0)]
    assert all(np.isfinite(effect.covariance).all() for effect in found)
