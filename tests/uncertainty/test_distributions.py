"""Distributions: draws against their quantiles, moments against the formulas of JCGM 101, correlations as asked for."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import stdtr

from metrocli.uncertainty import distributions as shapes
from metrocli.uncertainty.correlated import UnreachableError, factor
from metrocli.uncertainty.distributions import ziggurat
from metrocli.uncertainty.inputs import CorrelatedBlock, InputQuantity, NotSemiDefiniteError, join

VALUES = tuple(np.sort(np.random.default_rng(0).normal(size=500)).tolist())
ALL = [
    (shapes.Normal(2.0), 2.0), (shapes.StudentT(2.0, 5), 2.0 * math.sqrt(5 / 3)), (shapes.Uniform(3.0), 3 / math.sqrt(3)), (shapes.Trapezoidal(3.0), 3 / math.sqrt(6)),
    (shapes.Trapezoidal(3.0, 0.4), 3 * math.sqrt(1.16 / 6)), (shapes.Trapezoidal(3.0, 1.0), 3 / math.sqrt(3)), (shapes.CurvilinearTrapezoid(3.0, 1.0), math.sqrt(3 + 1 / 9)),
    (shapes.CurvilinearTrapezoid(3.0, 3.0), 2.0), (shapes.Arcsine(3.0), 3 / math.sqrt(2)), (shapes.Exponential(2.0), 2.0), (shapes.Counts(9), math.sqrt(10)),
    (shapes.Sampled(VALUES), float(np.std(VALUES))),
]  # fmt: skip
NAMES = [item[0].words for item in ALL]


@pytest.mark.parametrize(("shape", "std"), ALL, ids=NAMES)
def test_draws_have_the_moments(shape: shapes.Distribution, std: float) -> None:
    drawn = shape.draw(np.random.default_rng(1), 400_000)
    assert drawn.mean() == pytest.approx(0.0, abs=5 * std / math.sqrt(400_000) + abs(np.mean(VALUES)))
    assert drawn.std() == pytest.approx(std, rel=0.02)
    if not isinstance(shape, shapes.StudentT):
        assert shape.std == pytest.approx(std, rel=1e-12)


@pytest.mark.parametrize("shape", [item[0] for item in ALL], ids=NAMES)
def test_quantiles_are_those_of_draws(shape: shapes.Distribution) -> None:
    p = np.array([0.001, 0.05, 0.3, 0.5, 0.7, 0.95, 0.999])
    below = (shape.draw(np.random.default_rng(2), 200_000)[:, None] <= shape.quantile(p) + 1e-12).mean(axis=0)
    assert below == pytest.approx(p, abs=0.005)


def test_finite_degrees_of_freedom_change_what_is_drawn() -> None:
    assert shapes.in_trials(shapes.Normal(1.0), 5) == shapes.StudentT(1.0, 5)
    assert shapes.in_trials(shapes.Uniform(0.05), 2) == shapes.CurvilinearTrapezoid(0.05, 0.025)
    assert shapes.in_trials(shapes.Uniform(1e-6), 50) == shapes.CurvilinearTrapezoid(1e-6, 1e-7)
    assert shapes.in_trials(shapes.Arcsine(1.0), 5) == shapes.Arcsine(1.0)
    assert shapes.in_trials(shapes.Uniform(1.0), math.inf) == shapes.Uniform(1.0)


def drawn(
    quantities: list[InputQuantity],
    correlations: list[tuple[str, str, float]],
    blocks: list[CorrelatedBlock] | None = None,
) -> np.ndarray:
    inputs = join(quantities, correlations, blocks or [])
    rng, values = np.random.default_rng(7), np.zeros((len(quantities), 300_000))
    for source in inputs.sources():
        for index, deviations in source(rng, values.shape[1]):
            values[index] = deviations
    return values


PAIRS = [
    (shapes.Normal(2.0), math.inf, shapes.Normal(3.0), math.inf), (shapes.Normal(2.0), 6.0, shapes.Normal(3.0), 6.0), (shapes.Normal(1.0), 8.0, shapes.Normal(1.0), 5.0),
    (shapes.Uniform(1.0), math.inf, shapes.Normal(1.0), math.inf), (shapes.Uniform(1.0), math.inf, shapes.Uniform(2.0), math.inf), (shapes.Arcsine(1.0), math.inf, shapes.Trapezoidal(1.0), math.inf),
    (shapes.Exponential(1.0), math.inf, shapes.Counts(4), math.inf),
]  # fmt: skip


@pytest.mark.alike
@pytest.mark.parametrize("r", [-0.6, 0.5, 0.9])
@pytest.mark.parametrize("pair", PAIRS, ids=lambda p: f"{p[0].words}-{p[2].words}-{p[1]:g}-{p[3]:g}")
def test_correlations_are_those_asked_for(
    pair: tuple[shapes.Distribution, float, shapes.Distribution, float], r: float
) -> None:
    a, da, b, db = pair
    values = drawn([InputQuantity("a", 0, a, da), InputQuantity("b", 0, b, db)], [("a", "b", r)])
    assert np.corrcoef(values)[0, 1] == pytest.approx(r, abs=0.02)
    heavy = [math.sqrt(d / (d - 2)) if math.isfinite(d) else 1.0 for d in (da, db)]
    assert values.std(axis=1) == pytest.approx([a.std * heavy[0], b.std * heavy[1]], rel=0.03)


def test_shapes_that_cannot_be_so_correlated_are_refused() -> None:
    with pytest.raises(UnreachableError):
        drawn(
            [InputQuantity("a", 0, shapes.Exponential(1.0)), InputQuantity("b", 0, shapes.Exponential(1.0))],
            [("a", "b", -0.95)],
        )


def test_correlation_of_one_is_exact() -> None:
    values = drawn(
        [InputQuantity("a", 0, shapes.Normal(2.0)), InputQuantity("b", 0, shapes.Normal(3.0))], [("a", "b", 1.0)]
    )
    np.testing.assert_allclose(values[1], 1.5 * values[0], rtol=1e-9)


def test_a_matrix_that_contradicts_itself_names_its_entries() -> None:
    quantities = [InputQuantity(name, 0, shapes.Normal(1.0)) for name in "abcd"]
    with pytest.raises(NotSemiDefiniteError) as caught:
        join(quantities, [("a", "b", 0.9), ("b", "c", 0.9), ("a", "c", -0.9)])
    assert caught.value.names == ("a", "b", "c")


def test_a_rank_deficient_covariance_is_taken_as_it_stands() -> None:
    slopes = np.array([[1.0, 0.0], [2.0, 1.0], [3.0, 1.0]])
    covariance = slopes @ slopes.T
    block = CorrelatedBlock(("a", "b", "c"), covariance)
    values = drawn(
        [InputQuantity(n, 0, shapes.Normal(math.sqrt(v))) for n, v in zip("abc", np.diag(covariance), strict=True)],
        [],
        [block],
    )
    assert np.cov(values) == pytest.approx(covariance, rel=0.02, abs=0.02)
    np.testing.assert_allclose(values[0] + values[1] - values[2], 0.0, atol=1e-9)
    assert factor(covariance).shape == (3, 2)


def test_a_zero_variance_within_a_block_stays_zero() -> None:
    covariance = np.diag([1.0, 0.0])
    values = drawn(
        [InputQuantity("a", 0, shapes.Normal(1.0)), InputQuantity("b", 0, shapes.Normal(0.0))],
        [],
        [CorrelatedBlock(("a", "b"), covariance)],
    )
    assert not values[1].any()
    assert values[0].std() == pytest.approx(1.0, rel=0.01)


@pytest.mark.parametrize(
    "dof", [0.4, 1.0, 5, 1e9, *(pytest.param(dof, marks=pytest.mark.slow) for dof in (1.7, 24, 300.0))]
)
def test_draws_of_t_have_its_distribution_also_in_the_tails(dof: float) -> None:
    count, rng = 1_000_000, np.random.Generator(np.random.SFC64(3))
    p = np.sort(stdtr(dof, shapes.StudentT(1.0, dof).draw(rng, count)))
    steps = np.arange(count + 1) / count
    apart = max((steps[1:] - p).max(), (p - steps[:-1]).max())
    # Kolmogorov and Smirnov: beyond 1.95/sqrt(n) with probability 1e-3
    assert apart < 1.95 / math.sqrt(count)
    for share in (1e-2, 1e-3, 1e-4, 1e-5):
        expected = share * count
        for beyond in (np.searchsorted(p, share), count - np.searchsorted(p, 1 - share)):
            assert abs(beyond - expected) < 4 * math.sqrt(expected) + 1


def test_layers_cover_the_density_of_t_and_have_equal_areas() -> None:
    for dof in (*(1 + 10 ** np.linspace(-3, 7, 31)).tolist(), 1.0, 1e300):
        layers = ziggurat.layers_of(dof)
        there = layers.widths > 0
        tops = layers.bottoms[there] + layers.area / layers.widths[there]
        assert there.sum() > 0.97 * ziggurat.LAYERS
        assert tops[:-1] == pytest.approx(layers.bottoms[there][1:], rel=1e-12)
        assert tops[-1] >= 1
        # a place up to `inner` is below the density at the top of its layer
        inner = layers.inner[there][:-1]
        assert np.exp(-(dof + 1) / 2 * np.log1p(inner**2 / dof)) == pytest.approx(tops[:-1], rel=1e-9)


def test_the_same_seed_draws_the_same_numbers() -> None:
    once, again = (shapes.StudentT(2.0, 7).draw(np.random.default_rng(5), 1000) for _ in range(2))
    assert np.array_equal(once, again)
    assert not np.array_equal(once, shapes.StudentT(2.0, 7).draw(np.random.default_rng(6), 1000))


def test_the_sine_of_the_arcsine_distribution_is_exact() -> None:
    class Places:
        def random(self, count: int) -> np.ndarray:
            return np.linspace(0, 1, count)

    v = 2 * np.linspace(0, 1, 10_001) - 1
    drawn = shapes.Arcsine(1.0).draw(Places(), len(v))  # type: ignore[arg-type]
    assert np.abs(drawn - np.sin(math.pi / 2 * v)).max() < 5e-16
