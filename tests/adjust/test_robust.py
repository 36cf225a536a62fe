"""Gross errors are found and leave no trace; clean readings are left alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.special
from adjust.problems import NOISE, PARAMETERS, Array, Problem, images, lens, names, targets
from simulated.camera import LENS, SIZE, Seen, board, look

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.outcome import Outcome
from metrocli.adjust.robust import FitQuality, critical_value, gross, robust_start, suspects
from metrocli.adjust.solution import Residuals, Solution, residuals_of
from metrocli.instruments import camera
from metrocli.instruments.camera_start import TargetImages, start

VIEWS = 12
CENTRE = (np.array(SIZE) - 1) / 2


def problem(seen: Seen) -> Problem:
    """A calibration from nothing but target list and image points."""
    focal, found = start(
        TargetImages(seen.points, seen.uv, seen.target, seen.view, seen.views), CENTRE, None, float(SIZE[0])
    )
    values = {**dict.fromkeys(PARAMETERS, 0.0), "f": focal, "cx": CENTRE[0], "cy": CENTRE[1]}
    views = camera.view_block(found, names("view", seen.views), 700.0)
    blocks = [camera.lens_block(values, PARAMETERS, SIZE), views, targets(seen)]
    return Problem({b.name: b for b in blocks}, (images(seen, camera.chain("board", "forward")),))


@dataclass(frozen=True)
class Cleaned:
    solution: Solution
    rejected: Array
    """(n,) True for readings left out"""


def cleaned(seen: Seen) -> Cleaned:
    """As the jobs do: a robust start, what is gross out, then one after another what the test rejects."""
    made = problem(seen)
    group = made.groups[0]
    blocks = robust_start(made.blocks.values(), made.groups, ("images",))
    left = np.flatnonzero(gross(group, blocks) == 0)
    for _ in range(30):
        now = group.selected(left)
        solution = adjust(blocks.values(), [now])
        assert solution.outcome is Outcome.CONVERGED
        found = suspects(residuals_of(solution, now), FitQuality(solution.cost, solution.dof, True))
        if not found.rows.size:
            break
        left, blocks = np.delete(left, found.rows[found.tests > 0.7 * found.tests.max()]), dict(solution.blocks)
    rejected = np.ones(group.observations.count, dtype=bool)
    rejected[left] = False
    return Cleaned(solution, rejected)


@pytest.mark.alike
@pytest.mark.parametrize("seed", range(5))
def test_mixed_up_targets_are_all_found(seed: int) -> None:
    """5 % of the readings carry the name of another target."""
    clean = look(board(9, 7), VIEWS, 100 + seed).noisy(NOISE, 200 + seed)
    rng = np.random.default_rng(300 + seed)
    wrong = rng.choice(clean.target.size, clean.target.size // 20, replace=False)
    names_of = clean.target.copy()
    names_of[wrong] = (names_of[wrong] + rng.integers(1, 63, wrong.size)) % 63
    spoilt = cleaned(replace(clean, target=names_of))
    assert spoilt.rejected[wrong].all()
    assert spoilt.rejected.sum() <= wrong.size + 2
    best = adjust(problem(clean).blocks.values(), problem(clean).groups)
    f, std = spoilt.solution.blocks["lens"].values[0, 0], spoilt.solution.std("lens")[0, 0]
    assert abs(f - LENS["f"]) < 3 * std
    assert abs(f - best.blocks["lens"].values[0, 0]) < 0.5 * std


@pytest.mark.alike
@pytest.mark.parametrize("size", [1.0, 3.0, 30.0])
def test_small_and_large_errors_are_found(size: float) -> None:
    """Errors of 10, 30 and 300 standard deviations, in one direction."""
    clean = look(board(9, 7), VIEWS, 17).noisy(NOISE, 18)
    wrong = np.random.default_rng(19).choice(clean.target.size, 38, replace=False)
    uv = clean.uv.copy()
    uv[0, wrong] += size
    found = cleaned(replace(clean, uv=uv))
    assert found.rejected[wrong].all()
    assert found.rejected.sum() <= wrong.size + 1


def test_clean_readings_are_left_alone() -> None:
    """At 5 % for all readings together, 12 sets of 756 readings lose hardly any."""
    rejected = total = 0
    for seed in range(12):
        result = cleaned(look(board(9, 7), VIEWS, 400 + seed).noisy(NOISE, 500 + seed))
        rejected += int(result.rejected.sum())
        total += result.rejected.size
    assert rejected <= total / 2000


def test_a_robust_start_leaves_a_clean_problem_as_it_is() -> None:
    made = problem(look(board(9, 7), VIEWS, 21).noisy(NOISE, 22))
    blocks = robust_start(made.blocks.values(), made.groups, ("images",))
    best = adjust(made.blocks.values(), made.groups)
    assert np.abs((blocks["lens"].values - best.blocks["lens"].values) / best.std("lens")).max() < 1e-3
    assert not gross(made.groups[0], blocks).any()


def test_the_critical_value_is_that_of_the_largest_of_many() -> None:
    for tests in (1, 100, 3000):
        alone = scipy.special.erfc(critical_value(tests) / np.sqrt(2))
        assert alone * tests == pytest.approx(0.05)
    largest = np.abs(np.random.default_rng(1).normal(size=(2000, 100))).max(axis=1)
    assert 0.03 < (largest > critical_value(100)).mean() < 0.07


def test_w_is_in_units_of_the_noise_found() -> None:
    made = problem(look(board(9, 7), VIEWS, 31).noisy(3 * NOISE, 32))
    solution = adjust(made.blocks.values(), made.groups)
    assert solution.sigma0 == pytest.approx(3, rel=0.1)
    found = residuals_of(solution, made.groups[0])
    assert (np.abs(found.normalised) > critical_value(found.values.size)).sum() > 10
    for noise_known in (True, False):
        assert suspects(found, FitQuality(solution.cost, solution.dof, noise_known)).rows.size <= 1


def test_one_gross_error_does_not_hide_in_the_sigma0_that_it_makes() -> None:
    # Nine degrees of freedom: w over sigma0 can never exceed 3, which is below its bound.
    rng = np.random.default_rng(7)
    w = rng.normal(size=(2, 8))
    w[:, 3] = 200.0, -150.0
    found = Residuals(w, np.ones_like(w), np.full_like(w, 9 / 16), w)
    for noise_known in (True, False):
        assert suspects(found, FitQuality(float((w**2).sum()), 9, noise_known)).rows.tolist() == [3]


def test_the_lens_of_the_tests_is_the_true_one() -> None:
    assert lens().columns == tuple(LENS)
