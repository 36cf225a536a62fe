"""The eliminated formulas of a state are those of the dense covariance: generalised least squares, restricted likelihood, folds."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import lgamma

import numpy as np
import numpy.typing as npt
import pytest

from benchmarks.hidden import images, lengths
from benchmarks.hidden.scenes import board_scene
from metrocli.diagnosis.evidence.gain import FoldPrediction, gain_of
from metrocli.diagnosis.evidence.held_out import Fold, Others
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.measurement import Measurement
from metrocli.diagnosis.evidence.parts import Fixed, Random
from metrocli.diagnosis.evidence.prices import gain_of_columns
from metrocli.diagnosis.evidence.products import local_columns
from metrocli.diagnosis.evidence.refined import _with_alternative
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.evidence.weights import tried_noise, with_noise
from metrocli.diagnosis.extended_fit import with_random_effect
from metrocli.diagnosis.noise import DECLARED_SIGMA

Array = npt.NDArray[np.float64]
BOARD, NETWORK = "board", "network"


@cache
def measurement(kind: str) -> Measurement:
    """Return a board in five images, whose poses are local, or a network of six tracers, whose points are."""
    rng = np.random.default_rng(3)
    if kind == BOARD:
        return measurement_of(images.read(board_scene(rng, 5, (5, 4)), rng).adjusted())
    return measurement_of(lengths.measurement(rng, 30).adjusted())


def number_of(m: Measurement, name: str, by: str) -> int:
    return next(i for i, one in enumerate(m.knots) if (one.name, one.by) == (name, by))


def number_of_effect(m: Measurement, name: str) -> int:
    return next(i for i, family in enumerate(m.families) if family.name == name)


def with_residual(m: Measurement, errors: Array) -> Measurement:
    """Return a measurement with what the unknowns leave of some errors as its residual."""
    return replace(m, system=replace(m.system, residual=m.system.seen(errors)), cache={})


def parts(kind: str) -> tuple[list[Fixed], list[Random], list[float]]:
    """Return some fixed and random parts of each sort, with ln of variances."""
    m = measurement(kind)
    fixed = [m.reading(7), m.effect(0, 0)]
    if kind == BOARD:
        each, one = number_of(m, "place in the image", "image"), number_of(m, "image radius", "image")
        random = [m.correlated(each, 1 / 4, -1), m.scatter(0), m.correlated(one, m.lengths(one)[-1], 2)]
        return fixed, random, [0.3, 1.2, -0.5]
    each = number_of(m, "t_s", "tracer")
    return fixed, [m.correlated(each, 1 / 4, -1), m.correlated(each, 1 / 8, 1)], [0.4, 1.0]


def covariance(m: Measurement, random: list[Random], logs: list[float]) -> Array:
    """Return the dense covariance of the readings."""
    found = np.eye(m.system.rows)
    member = m.system.basis.member
    for one, log in zip(random, logs, strict=True):
        product = one.columns @ one.columns.T
        found += np.exp(log) * (product * (member[:, None] == member) if one.local else product)
    return found


def unknowns(m: Measurement) -> Array:
    """Return an orthonormal basis of the columns of all unknowns, (rows, k)."""
    basis = m.system.basis.rows(np.arange(m.system.rows))
    return basis[:, (basis**2).sum(axis=0) > 0.5]


def projected(v: Array, columns: Array) -> Array:
    """Return `V^-1 - V^-1 X (X'V^-1 X)^-1 X'V^-1`."""
    weighted = np.linalg.solve(v, columns)
    return np.linalg.inv(v) - weighted @ np.linalg.solve(columns.T @ weighted, weighted.T)


@pytest.mark.parametrize("kind", [BOARD, NETWORK])
def test_what_a_state_leaves_is_that_of_generalised_least_squares(kind: str) -> None:
    m, (fixed, random, logs) = measurement(kind), parts(kind)
    state = State.of(m, fixed, random, logs, 0)
    columns = np.concatenate([unknowns(m), *(one.columns for one in fixed)], axis=1)
    p = projected(covariance(m, random, logs), columns)
    r = m.system.residual
    np.testing.assert_allclose(state.residual, p @ r, atol=1e-9)
    for number, family in enumerate(m.families):
        gram, right = state.left(number)
        whole = family.columns.whole(range(family.columns.count), m.system.rows)
        atol = 1e-8 * float(family.raw.max()) ** 2
        np.testing.assert_allclose(gram, np.einsum("rkp,rs,skq->kpq", whole, p, whole, optimize=True), atol=atol)
        np.testing.assert_allclose(right, np.einsum("rkp,r->kp", whole, p @ r), atol=1e-8 * float(family.raw.max()))


@pytest.mark.parametrize("kind", [BOARD, NETWORK])
def test_the_likelihood_is_the_restricted_one(kind: str) -> None:
    m, (fixed, random, logs) = measurement(kind), parts(kind)
    state = State.of(m, fixed, random, logs, 0)
    v, j = covariance(m, random, logs), unknowns(m)
    bare = float(m.system.residual @ projected(v, j) @ m.system.residual)
    full = projected(v, np.concatenate([j, *(one.columns for one in fixed)], axis=1))
    prior = m.squares - float(m.system.residual @ m.system.residual)
    assert state.bare_squares == pytest.approx(bare + prior, rel=1e-9)
    assert state.fit.squares == pytest.approx(float(m.system.residual @ full @ m.system.residual) + prior, rel=1e-9)
    log_det = np.linalg.slogdet(v)[1] + np.linalg.slogdet(j.T @ np.linalg.solve(v, j))[1]
    assert state.fit.log_det == pytest.approx(log_det, rel=1e-9)


@pytest.mark.parametrize("kind", [BOARD, NETWORK])
def test_slopes_are_the_derivatives_of_the_likelihood(kind: str) -> None:
    m, (fixed, random, logs) = measurement(kind), parts(kind)
    found, expected, _ = State.of(m, fixed, random, logs, 0).fit.slopes
    for number in range(len(random)):
        ends = [list(logs), list(logs)]
        ends[0][number] += 1e-4
        ends[1][number] -= 1e-4
        high, low = (State.of(m, fixed, random, one, 0).fit.likelihood for one in ends)
        assert (high - low) / 2e-4 == pytest.approx((found[number] - expected[number]) / 2, rel=1e-4, abs=1e-5)


@pytest.mark.parametrize("kind", [BOARD, NETWORK])
def test_noise_of_a_group_has_the_likelihood_of_its_covariance(kind: str) -> None:
    m = measurement(kind)
    ratios = {0: 1.7, 2: 0.6}
    weighted = with_noise(m, ratios)
    sigma = np.ones(m.system.rows)
    for number, ratio in ratios.items():
        sigma[m.units[number][2]] *= ratio
    v, j, r = np.diag(sigma**2), unknowns(m), m.system.residual
    squares = float(r @ projected(v, j) @ r)
    log_det = np.linalg.slogdet(v)[1] + np.linalg.slogdet(j.T @ np.linalg.solve(v, j))[1]
    prior = weighted.squares - float(weighted.system.residual @ weighted.system.residual)
    expected = -(m.dof * np.log(squares + prior) + log_det) / 2
    assert State.of(weighted).score + len(ratios) * m.price_of_noise == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("kind", [BOARD, NETWORK])
@pytest.mark.parametrize("count", [1, 3])
def test_noise_on_trial_is_that_of_the_measurement_with_it(kind: str, count: int) -> None:
    """Computed from the rows of the groups alone, with an error of each image and without."""
    m, (fixed, random, logs) = measurement(kind), parts(kind)
    state = State.of(m, fixed, random[:count], logs[:count])
    trial = tried_noise(state, {0: 1.7, 2: 0.6}, [1])
    weighted = state.at(with_noise(m, {0: 1.7, 2: 0.6}))
    assert trial.score == pytest.approx(weighted.score, abs=1e-6)
    assert trial.ratios[0] == pytest.approx(1.7 * weighted.ratio_of(0), rel=1e-6)
    assert trial.ratios[2] == pytest.approx(0.6 * weighted.ratio_of(2), rel=1e-6)
    assert not trial.others
    spoilt = replace(m, system=replace(m.system, residual=m.system.seen(m.system.residual * (1 + 3 * m.units[1][2]))))
    assert set(tried_noise(State.of(spoilt, fixed), {0: 1.1}, [1, 3]).others) == {1}


def test_noise_of_prior_values_beside_errors_of_each_image() -> None:
    """Rows of priors belong to no image."""
    m = measurement(BOARD)
    kept = {group.name: np.ones(group.observations.count, dtype=bool) for group in m.job.model.readings}
    effects = [families[0].alternatives[0].effect for families in m.scatters]
    job = with_random_effect(m.job, next(one for one in effects if one.is_smooth), 0.05, kept)
    assert job is not None
    m = measurement_of(job)
    number = next(i for i, (kind, _, _) in enumerate(m.units) if kind == DECLARED_SIGMA)
    assert (m.system.basis.member[m.units[number][2]] < 0).all()
    state = State.of(m, [], [m.correlated(number_of(m, "place in the image", "image"), 1 / 4, -1)], [0.3])
    weighted = state.at(with_noise(m, {number: 1.7, 0: 1.4}))
    trial = tried_noise(state, {number: 1.7, 0: 1.4})
    assert trial.score == pytest.approx(weighted.score, abs=1e-6)
    assert trial.ratios[number] == pytest.approx(1.7 * weighted.ratio_of(number), rel=1e-6)


def test_a_refined_value_is_known_without_the_weights_too() -> None:
    """A jump that is refined beside a noisier view is judged once more in white noise."""
    m = with_noise(measurement(BOARD), {0: 1.7, 2: 0.6})
    grown = _with_alternative(m, 0, m.families[0].alternatives[0], 1.5 * m.whole(0, 0))
    number = len(grown.families[0].alternatives) - 1
    state = State.of(grown, [grown.effect(0, number)])
    assert grown.unweighted is not None
    assert grown.unweighted.whole(0, number) == pytest.approx(1.5 * measurement(BOARD).whole(0, 0))
    assert state.at(grown.unweighted, random=False).fixed[0].key == (0, number)


@pytest.mark.parametrize("kind", [BOARD, NETWORK])
def test_held_out_readings_have_the_density_of_the_others(kind: str) -> None:
    m, (fixed, random, logs) = measurement(kind), parts(kind)
    rows = np.flatnonzero(m.folds == 1)
    fold = Fold(m, rows)
    names = tuple(one for one in fixed if not one.is_reading)
    held = Others.of(fold, State.of(m, names, random, logs, 0)).predicted()
    v = covariance(m, random, logs)
    others = np.setdiff1d(np.arange(m.system.rows), rows)
    columns = np.concatenate([unknowns(m), *(one.columns for one in names)], axis=1)
    scores = []
    for kept, prior in ((np.arange(m.system.rows), True), (others, True)):
        own = columns[kept]
        turn, s, _ = np.linalg.svd(own, full_matrices=False)
        rank = int((s > 1e-9).sum())
        p = projected(v[np.ix_(kept, kept)], turn[:, :rank])
        extra = m.squares - float(m.system.residual @ m.system.residual)
        squares = float(m.system.residual[kept] @ p @ m.system.residual[kept]) + extra * prior
        dof = len(kept) - rank + 2.0
        det = np.linalg.slogdet(v[np.ix_(kept, kept)])[1]
        seen = own @ np.linalg.svd(own)[2][:rank].T
        det += np.linalg.slogdet(seen.T @ np.linalg.solve(v[np.ix_(kept, kept)], seen))[1]
        scores.append(lgamma(dof / 2) - dof / 2 * np.log(np.pi * squares) - det / 2)
    assert held.score == pytest.approx(scores[0] - scores[1], abs=1e-6)


@pytest.mark.parametrize("kind", [BOARD, NETWORK])
def test_single_readings_are_predicted_with_the_variance_of_a_deleted_residual(kind: str) -> None:
    m, (fixed, random, logs) = measurement(kind), parts(kind)
    fold = Fold(m, np.arange(3, m.system.rows, 17))
    names = tuple(one for one in fixed if not one.is_reading)
    held = Others.of(fold, State.of(m, names, random, logs, 0)).predicted()
    columns = np.concatenate([unknowns(m), *(one.columns for one in names)], axis=1)
    turn, s, _ = np.linalg.svd(columns, full_matrices=False)
    p = projected(covariance(m, random, logs), turn[:, : int((s > 1e-9).sum())])
    own = np.linalg.inv(p[np.ix_(fold.rows, fold.rows)])
    assert held.variances == pytest.approx(np.diag(own), rel=1e-6)
    assert held.errors == pytest.approx(own @ (p @ m.system.residual)[fold.rows], rel=1e-6, abs=1e-6)


def test_readings_that_the_others_hardly_determine_show_no_gain() -> None:
    one, far = np.ones(2), np.array([1.0, 1e10])
    pair = [FoldPrediction(0.0, np.array([size, 1e6]), np.array([0.1, 0.1]), one, far) for size in (2.0, 1.0)]
    found = gain_of([(pair[0], pair[1])])
    assert (found.before, found.after, found.ratio) == pytest.approx((0.2, 0.1, 0.5))
    assert found.explained == pytest.approx(0.75)


def test_readings_of_another_unit_count_in_the_reduction_alone() -> None:
    scale, one = np.array([0.1, np.nan]), np.ones(2)
    pair = [FoldPrediction(0.0, np.array([1.0, size]), scale, one, one) for size in (3.0, 1.0)]
    found = gain_of([(pair[0], pair[1])])
    assert found.before == found.after == pytest.approx(0.1)
    assert found.reduction == pytest.approx(1 - np.sqrt(2 / 10))


def test_the_gain_of_columns_is_that_of_the_likeliest_size() -> None:
    squares, dof, rank, explained = 180.0, 120.0, 3, 25.0
    g = np.geomspace(1e-3, 1e6, 200_000)
    evidence = -(dof * np.log(1 - explained / squares * g / (1 + g)) + rank * np.log1p(g)) / 2
    found = gain_of_columns(np.array(explained), np.array(rank), squares, dof)
    assert float(found) == pytest.approx(float(evidence.max()), rel=1e-6)


def test_errors_of_single_members_stand_in_their_own_rows() -> None:
    m, (_, random, _) = measurement(BOARD), parts(BOARD)
    assert [one.local for one in random] == [True, False, False]
    assert local_columns(m, random).shape[1] == random[0].columns.shape[1]


def test_a_reading_of_fewer_components_is_held_out_with_its_own_rows_only() -> None:
    m = measurement(NETWORK)
    padded = replace(m, places=np.pad(m.places, ((0, 0), (0, 1)), constant_values=-1))
    last = Fold(padded, np.array([m.system.rows - 1]))
    assert not last.holds(padded.reading(7))
    assert Fold(padded, padded.places[7][:1]).holds(padded.reading(7))
