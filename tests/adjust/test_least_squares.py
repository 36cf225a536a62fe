"""The adjustment against plain dense least squares: values, covariance, and what the residuals say."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import scipy.special
from adjust import dense
from adjust.dense import Array, Dense
from adjust.problems import NOISE, PROBLEMS, Problem, a_covariance, board_camera

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.outcome import Outcome
from metrocli.adjust.schur.covariance import Covariance
from metrocli.adjust.solution import Solution, residuals_of

MAKES = pytest.mark.parametrize("make", PROBLEMS)
CLOSE = 1e-8


@cache
def solved(make: str) -> tuple[Problem, Solution]:
    problem = PROBLEMS[make]()
    solution = adjust(problem.blocks.values(), problem.groups)
    assert solution.outcome is Outcome.CONVERGED, solution.undetermined
    return problem, solution


@cache
def both(make: str) -> tuple[Problem, Solution, Dense]:
    """A problem, its solution, and dense matrices at that."""
    problem, solution = solved(make)
    return problem, solution, dense.at_solution(solution.blocks, problem.groups)


def whole(covariance: Covariance, blocks: list[str]) -> Array:
    return np.block([[covariance.between(a, b) for b in blocks] for a in blocks])


def apart(found: Array, expected: Array) -> float:
    """Largest difference of two covariances, in units of the standard deviations."""
    std = np.sqrt(np.diag(expected))
    unit = np.where(std > 0, std, 1.0)
    return float(np.abs((found - expected) / unit[:, None] / unit).max())


@pytest.mark.alike
@MAKES
def test_values_are_those_of_the_dense_solution(make: str) -> None:
    """From there a plain step of all unknowns goes nowhere."""
    problem, solution, plain = both(make)
    scale = np.linalg.norm(plain.jacobian, axis=0)
    step = np.linalg.lstsq(plain.jacobian / scale, plain.residual, rcond=None)[0] / scale
    assert np.abs(step / np.sqrt(np.diag(plain.noise))).max() < 2e-6
    for name, block in problem.blocks.items():
        if not block.free.all() and block.space.name == "FLAT":
            assert np.array_equal(solution.blocks[name].values[~block.free], block.values[~block.free])
    assert solution.cost == pytest.approx(plain.residual @ plain.residual, rel=1e-11)


def test_plain_steps_from_the_same_start_end_there() -> None:
    problem, solution, plain = both("views eliminated")
    found = dense.solve(problem.blocks, problem.groups)
    std = np.sqrt(np.diag(dense.spread(plain.noise, plain.places, problem.blocks)))
    apart = [
        block.space.difference(solution.blocks[name].values, found[name].values).ravel()
        for name, block in problem.blocks.items()
    ]
    step = np.concatenate(apart)
    assert np.abs(step[std > 0] / std[std > 0]).max() < 2e-6


def test_the_eliminated_blocks_are_those_meant() -> None:
    eliminated = {make: solved(make)[1].covariance_or_raise().layout.eliminated for make in PROBLEMS}
    assert eliminated["views eliminated"] == "view"
    assert eliminated["targets eliminated, in part fixed"] == "target"
    assert eliminated["scale bars"] == "target"
    assert eliminated["joint prior"] == "target"
    assert eliminated["nothing eliminated"] is None


@MAKES
def test_covariance_is_the_dense_inverse(make: str) -> None:
    problem, solution, plain = both(make)
    covariance = solution.covariance_or_raise()
    blocks = list(problem.blocks)
    found, expected = whole(covariance, blocks), plain.covariance(problem.blocks)
    assert apart(found, expected) < CLOSE
    at = 0
    for name in blocks:
        block = problem.blocks[name]
        m, s = block.values.shape
        own = found[at : at + m * s, at : at + m * s]
        assert np.array_equal(covariance.of(name), covariance.between(name, name))
        each = np.array([own[i * s : (i + 1) * s, i * s : (i + 1) * s] for i in range(m)])
        assert np.allclose(covariance.members(name), each, rtol=1e-9, atol=1e-9 * np.abs(each).max(initial=0))
        assert np.allclose(solution.std(name) ** 2, np.einsum("mii->mi", each))
        at += m * s


@MAKES
def test_pairs_are_taken_from_the_whole(make: str) -> None:
    problem, solution, _ = both(make)
    covariance = solution.covariance_or_raise()
    rng = np.random.default_rng(0)
    for name, block in problem.blocks.items():
        for other, second in problem.blocks.items():
            one = rng.integers(len(block.members), size=7)
            two = one if name == other == covariance.layout.eliminated else rng.integers(len(second.members), size=7)
            full = covariance.between(name, other).reshape(*block.values.shape, *second.values.shape)
            expected = np.moveaxis(full[one, :, two, :], 0, -1)
            found = covariance.pairs(name, one, other, two)
            assert np.allclose(
                np.broadcast_to(found, expected.shape), expected, rtol=1e-9, atol=1e-9 * np.abs(full).max()
            )


@MAKES
def test_members_of_one_block_apart_are_taken_from_the_whole(make: str) -> None:
    problem, solution, _ = both(make)
    covariance = solution.covariance_or_raise()
    for name, block in problem.blocks.items():
        m, s = block.values.shape
        one = np.arange(m - 1)
        full = covariance.of(name).reshape(m, s, m, s)
        found = covariance.apart(name, one, one + 1)
        assert np.allclose(found, full[one, :, one + 1, :], rtol=1e-9, atol=1e-9 * np.abs(full).max(initial=0))


@MAKES
def test_covariance_scales(make: str) -> None:
    problem, solution, _ = both(make)
    blocks = list(problem.blocks)
    scaled = solution.covariance_or_raise().scaled(4.0)
    assert np.allclose(whole(scaled, blocks), 4 * whole(solution.covariance_or_raise(), blocks), rtol=1e-12)
    for name in blocks:
        assert np.allclose(scaled.members(name), 4 * solution.covariance_or_raise().members(name), rtol=1e-12)
    first, index = blocks[0], np.zeros(3, dtype=int)
    assert np.allclose(
        scaled.pairs(first, index, first, index), 4 * solution.covariance_or_raise().pairs(first, index, first, index)
    )


@MAKES
def test_redundancy_numbers_and_w(make: str) -> None:
    problem, solution, plain = both(make)
    at, total = 0, 0.0
    for group in problem.groups:
        residuals = residuals_of(solution, group)
        size = group.observations.readings.size
        expected = plain.redundancy[at : at + size].reshape(-1, len(group.observations.readings)).T
        assert np.allclose(residuals.redundancy, expected, rtol=0, atol=1e-7)
        values = plain.residual[at : at + size].reshape(expected.shape[::-1]).T
        root = np.ones(group.observations.count) if group.weights is None else np.sqrt(group.weights)
        controlled = expected > 1e-5
        w = values / root / np.sqrt(np.where(controlled, expected, 1.0))
        assert np.allclose(residuals.normalised[controlled], w[controlled], rtol=1e-4, atol=1e-4)
        total += residuals.redundancy.sum()
        at += size
    assert total == pytest.approx(solution.dof, rel=1e-6)


@MAKES
def test_statistics(make: str) -> None:
    _, solution, plain = both(make)
    assert solution.observations == len(plain.residual)
    assert solution.unknowns == len(plain.places)
    assert solution.dof == len(plain.residual) - len(plain.places)
    assert solution.sigma0 == pytest.approx(np.sqrt(plain.residual @ plain.residual / solution.dof))
    chi_square = scipy.special.gammaincc(solution.dof / 2, plain.residual @ plain.residual / 2)
    assert solution.p_value == pytest.approx(chi_square, rel=1e-6)
    assert solution.conditions == 0


@pytest.mark.slow
def test_scatter_of_repeated_measurements_is_the_covariance() -> None:
    """Chi-square of the errors of 60 repeats against the claimed covariance, lens and one view together."""
    from simulated.camera import LENS

    total, count = 0.0, 0
    for seed in range(60):
        problem = board_camera(views=6, seed=1000 + 7 * seed)
        solution = adjust(problem.blocks.values(), problem.groups)
        error = solution.blocks["lens"].values[0] - list(LENS.values())
        total += error @ np.linalg.solve(solution.covariance_or_raise().of("lens"), error)
        count += error.size
        assert problem.groups[0].observations.sigma[0, 0] == NOISE
    assert abs(total - count) < 3.3 * np.sqrt(2 * count)


def test_covariance_of_readings_is_whitened_away() -> None:
    covariance = a_covariance(np.array([0.1, 3.0]), 5)[:, :, None]
    from metrocli.adjust.model.observations import Observations

    whitening = Observations(np.zeros((2, 1)), np.ones(1), covariance=covariance).whitened(np.eye(2)[:, :, None])[
        :, :, 0
    ]
    assert np.allclose(whitening @ covariance[:, :, 0] @ whitening.T, np.eye(2))
