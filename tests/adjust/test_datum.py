"""A free network: the frame is a choice that no residual sees, and its covariance is the dense one in that frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from adjust import dense
from adjust.dense import Array
from adjust.problems import CUBE, Problem, network, scale_bars, with_control

from metrocli.adjust.adjustment import StoppingRule, adjust, covariance_at
from metrocli.adjust.model.groups import prior
from metrocli.adjust.outcome import Outcome
from metrocli.adjust.solution import Solution, residuals_of
from metrocli.geometry.rotations import rotation_from_vector, vector_from_rotation
from metrocli.instruments import camera

ALL = np.ones(len(CUBE))


def solved(problem: Problem, reference: Array | None = None, takes_part: Array = ALL) -> Solution:
    targets = problem.blocks[camera.TARGET]
    block = targets if reference is None else targets.with_values(reference)
    return adjust(problem.blocks.values(), problem.groups, camera.network_datum(block, takes_part))


@pytest.fixture(scope="module")
def free() -> tuple[Problem, Solution]:
    problem = network(views=5)
    return problem, solved(problem)


def movements(points: Array) -> Array:
    """Shifts, turns and scale of points (n, 3), written out: (3n, 7)."""
    x, y, z = points.T
    zero, one = np.zeros_like(x), np.ones_like(x)
    columns = [
        (one, zero, zero),
        (zero, one, zero),
        (zero, zero, one),
        (zero, -z, y),
        (z, zero, -x),
        (-y, x, zero),
        (x, y, z),
    ]
    return np.stack([np.stack(column, axis=1).ravel() for column in columns], axis=1)


def test_seven_conditions_and_none_too_many(free: tuple[Problem, Solution]) -> None:
    problem, solution = free
    assert solution.outcome is Outcome.CONVERGED
    assert solution.conditions == 7
    readings = problem.groups[0].observations.readings.size
    assert solution.dof == readings - (7 + 5 * 6 + len(CUBE) * 3) + 7
    assert 0.8 < solution.sigma0 < 1.2
    assert residuals_of(solution, problem.groups[0]).redundancy.sum() == pytest.approx(solution.dof, rel=1e-6)


def test_a_solution_in_another_frame_is_brought_into_the_datum(free: tuple[Problem, Solution]) -> None:
    """Its readings fit already, so no step is needed for them: the datum is a tenth, 17 degrees and 5 mm away."""
    problem, solution = free
    blocks, turn = dict(solution.blocks), rotation_from_vector(np.array([0.1, 0.2, -0.2]))
    for name in (camera.TARGET, camera.VIEW):
        values = blocks[name].values.copy()
        values[:, :3] = 1.1 * values[:, :3] @ turn.T + [5.0, -3.0, 2.0]
        values[:, 3:] = vector_from_rotation(turn @ rotation_from_vector(values[:, 3:])) if name == camera.VIEW else 0.0
        blocks[name] = blocks[name].with_values(values)
    datum = camera.network_datum(problem.blocks[camera.TARGET], ALL)
    moved = adjust(blocks.values(), problem.groups, datum)
    assert moved.outcome is Outcome.CONVERGED
    assert moved.cost == pytest.approx(solution.cost, rel=1e-9)
    for name in (camera.TARGET, camera.VIEW, camera.LENS):
        assert moved.blocks[name].values == pytest.approx(solution.blocks[name].values, rel=1e-6, abs=1e-5), name


def test_the_condition_holds(free: tuple[Problem, Solution]) -> None:
    problem, solution = free
    reference = problem.blocks[camera.TARGET].values
    off = movements(reference).T @ (solution.blocks[camera.TARGET].values - reference).ravel()
    assert np.abs(off / np.linalg.norm(movements(reference), axis=0)).max() < 1e-6


OTHER = [3, 5, 8, 11, 20]


@pytest.mark.alike
@pytest.mark.parametrize(
    ("members", "turn", "shift", "scale"),
    [
        ([0, 1, 2, 3], 0.0, 0.0, 1.0),
        (OTHER, 0.0, 0.0, 1.0),
        (range(24), 0.1, 50.0, 1.0),
        (range(24), -0.05, -20.0, 1.3),
    ],
    ids=["four members", "other members", "turned and shifted", "larger"],
)
def test_residuals_do_not_see_the_frame(
    free: tuple[Problem, Solution], members: list[int], turn: float, shift: float, scale: float
) -> None:
    problem, solution = free
    takes_part = np.isin(np.arange(len(CUBE)), list(members)).astype(float)
    start = problem.blocks[camera.TARGET].values
    reference = scale * start @ rotation_from_vector(np.array([0.0, turn, turn])).T + shift
    other = solved(problem, reference, takes_part)
    assert other.outcome is Outcome.CONVERGED
    assert other.conditions == 7
    assert other.cost == pytest.approx(solution.cost, rel=1e-10)
    for name in ("values", "redundancy", "normalised"):
        one, two = (getattr(residuals_of(s, problem.groups[0]), name) for s in (solution, other))
        assert np.allclose(one, two, rtol=0, atol=1e-5), name
    assert np.allclose(
        other.covariance_or_raise().of(camera.LENS),
        solution.covariance_or_raise().of(camera.LENS),
        rtol=1e-5,
        atol=1e-12,
    )
    chosen = list(members)
    gap = (other.blocks[camera.TARGET].values - reference)[chosen]
    g = movements(reference[chosen])
    assert np.abs(g.T @ gap.ravel() / np.linalg.norm(g, axis=0)).max() < 1e-5


@pytest.mark.alike
@pytest.mark.parametrize("bars", [0, 4], ids=["no bar", "bars"])
@pytest.mark.parametrize("members", [list(range(24)), OTHER], ids=["all", "some"])
def test_covariance_is_the_dense_one_in_the_frame(
    free: tuple[Problem, Solution], members: list[int], bars: int
) -> None:
    """Any generalised inverse of the full normal matrix, brought into the frame by `I - E (G'E)^-1 G'`; E is the null space found by numpy.

    Ends of bars stay in the reduced system, while the other targets are eliminated.
    """
    problem, _ = free
    problem, open_ = (problem.with_groups(scale_bars(problem, bars)), 6) if bars else (problem, 7)
    takes_part = np.isin(np.arange(len(CUBE)), members).astype(float)
    solution = solved(problem, takes_part=takes_part)
    plain = dense.at_solution(solution.blocks, problem.groups)
    normal = plain.jacobian.T @ plain.jacobian
    scale = 1 / np.sqrt(np.diag(normal))
    values, vectors = np.linalg.eigh(normal * scale[:, None] * scale)
    assert values[open_ - 1] < 1e-9 < 1e-7 < values[open_]
    null = scale[:, None] * vectors[:, :open_]
    ginverse = (vectors[:, open_:] / values[open_:]) @ vectors[:, open_:].T * scale[:, None] * scale
    lens, targets = 7, 3 * len(CUBE)
    g = np.zeros((len(normal), open_))
    reference = problem.blocks[camera.TARGET].values
    place = {name: i for i, (name, _, _) in reversed(list(enumerate(plain.places)))}[camera.TARGET]
    g[place : place + targets] = movements(reference)[:, :open_] * np.repeat(takes_part, 3)[:, None]
    transform = np.eye(len(normal)) - null @ np.linalg.solve(g.T @ null, g.T)
    expected = transform @ ginverse @ transform.T
    names = list(problem.blocks)
    assert names[0] == camera.LENS
    assert problem.blocks[camera.LENS].values.size == lens
    known = solution.covariance_or_raise()
    assert len(known.layout.tied) == 2 * bars
    found = np.block([[known.between(a, b) for b in names] for a in names])
    std = np.sqrt(np.diag(expected))
    assert np.abs((found - expected) / std[:, None] / std).max() < 1e-6


def test_the_frame_of_all_targets_has_the_least_trace(free: tuple[Problem, Solution]) -> None:
    problem, solution = free
    some = solved(problem, takes_part=np.isin(np.arange(len(CUBE)), OTHER).astype(float))
    assert np.trace(solution.covariance_or_raise().of(camera.TARGET)) < 0.9 * np.trace(
        some.covariance_or_raise().of(camera.TARGET)
    )


def test_a_scale_bar_fixes_the_scale(free: tuple[Problem, Solution]) -> None:
    problem, solution = free
    bars = scale_bars(problem)
    barred = solved(problem.with_groups(bars))
    assert barred.outcome is Outcome.CONVERGED
    assert barred.conditions == 6
    assert np.abs(residuals_of(barred, bars).normalised).max() < 4
    one = solved(problem.with_groups(scale_bars(problem, bars=1)))
    assert one.conditions == 6
    assert one.cost == pytest.approx(solution.cost, rel=1e-9)
    assert residuals_of(one, one.groups[1]).redundancy.max() < 1e-6
    length = np.linalg.norm(one.blocks[camera.TARGET].values[0] - one.blocks[camera.TARGET].values[1])
    assert length == pytest.approx(one.groups[1].observations.readings[0, 0], abs=1e-6)


def test_a_short_tight_bar_fixes_no_more_than_the_scale(free: tuple[Problem, Solution]) -> None:
    problem, _ = free
    for sigma in (1e-4, 10.0):
        assert solved(problem.with_groups(scale_bars(problem, bars=1, sigma=sigma))).conditions == 6


def test_known_targets_fix_everything() -> None:
    problem = with_control()
    takes_part = problem.blocks[camera.TARGET].free.all(axis=1).astype(float)
    solution, plain = solved(problem, takes_part=takes_part), adjust(problem.blocks.values(), problem.groups)
    assert solution.conditions == 0
    for name in problem.blocks:
        step = problem.blocks[name].space.difference(solution.blocks[name].values, plain.blocks[name].values)
        assert np.abs(step / np.maximum(plain.std(name), 1e-12)).max() < 1e-4
    assert np.allclose(solution.covariance_or_raise().of("lens"), plain.covariance_or_raise().of("lens"), rtol=1e-6)


def test_measured_targets_fix_everything(free: tuple[Problem, Solution]) -> None:
    problem, solution = free
    truth = problem.blocks[camera.TARGET].with_values(CUBE)
    held = solved(problem.with_groups(prior(truth, np.arange(3), sigma=np.full((3, 3), 0.01))))
    assert held.outcome is Outcome.CONVERGED
    assert held.conditions == 0
    assert held.dof == solution.dof - 7 + 9


def test_one_known_target_leaves_turns_and_scale_open() -> None:
    """A single known place fixes the shifts only: four freedoms are left, and the known target stays where it is."""
    problem = with_control(1)
    takes_part = problem.blocks[camera.TARGET].free.all(axis=1).astype(float)
    solution = solved(problem, takes_part=takes_part)
    assert solution.outcome in (Outcome.CONVERGED, Outcome.UNDETERMINED)
    assert np.array_equal(solution.blocks[camera.TARGET].values[0], problem.blocks[camera.TARGET].values[0])


@pytest.mark.parametrize("members", [[], [0], [0, 1]], ids=["none", "one", "two"])
def test_too_few_members_for_a_frame_end_with_an_outcome(free: tuple[Problem, Solution], members: list[int]) -> None:
    problem, _ = free
    solution = solved(problem, takes_part=np.isin(np.arange(len(CUBE)), members).astype(float))
    assert not solution.outcome.good
    assert solution.covariance is None


def test_without_a_datum_the_frame_is_named_as_open(free: tuple[Problem, Solution]) -> None:
    problem, _ = free
    solution = adjust(problem.blocks.values(), problem.groups)
    assert solution.outcome is Outcome.UNDETERMINED
    assert len(solution.undetermined) == 7
    text = "; ".join(map(str, solution.undetermined))
    assert "x of target" in text
    assert "of view" in text


def test_planning_gives_the_covariance_without_moving(free: tuple[Problem, Solution]) -> None:
    problem, solution = free
    datum = camera.network_datum(problem.blocks[camera.TARGET], ALL)
    planned = covariance_at(solution.blocks.values(), problem.groups, datum)
    assert planned.outcome is Outcome.CONVERGED
    assert all(planned.blocks[name] is solution.blocks[name] for name in problem.blocks)
    assert np.allclose(
        planned.covariance_or_raise().of(camera.VIEW),
        solution.covariance_or_raise().of(camera.VIEW),
        rtol=1e-9,
        atol=1e-15,
    )


def test_a_solution_stays_where_it_is_and_moves_into_another_datum(free: tuple[Problem, Solution]) -> None:
    problem, solution = free
    block = problem.blocks[camera.TARGET]
    finer = solution
    for _ in range(2):
        finer = adjust(
            finer.blocks.values(), problem.groups, camera.network_datum(block, ALL), StoppingRule(tolerance=1e-9)
        )
    again = adjust(finer.blocks.values(), problem.groups, camera.network_datum(block, ALL))
    assert again.outcome is Outcome.CONVERGED
    assert all(again.blocks[name] is finer.blocks[name] for name in problem.blocks)
    there = camera.network_datum(replace(block, values=block.values + [0.5, 0, 0]), ALL)
    moved = adjust(finer.blocks.values(), problem.groups, there)
    shift = moved.blocks[camera.TARGET].values - finer.blocks[camera.TARGET].values
    assert shift.mean(axis=0) == pytest.approx([0.5, 0, 0], abs=1e-9)
