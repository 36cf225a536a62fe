"""How adjustments end: what the data leave open is named, and no data bring an exception."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from adjust.problems import (
    CUBE,
    NOISE,
    PROBLEMS,
    Problem,
    board_camera,
    images,
    lens,
    names,
    network,
    off,
    targets,
    with_control,
)
from simulated.camera import LENS, SIZE, board, look

from metrocli.adjust.adjustment import StoppingRule, adjust, covariance_at
from metrocli.adjust.outcome import Combination, Outcome
from metrocli.adjust.solution import Solution
from metrocli.instruments import camera


def solved(problem: Problem, control: StoppingRule | None = None) -> Solution:
    return adjust(problem.blocks.values(), problem.groups, problem.datum, control)


def tilted(degrees: float, free: tuple[str, ...], noise: float = NOISE) -> Problem:
    lens = {name: LENS[name] for name in ("f", "cx", "cy")}  # a known distortion would tell the distance
    seen = look(board(5, 4), 6, 3, tilt=degrees, lens=lens).noisy(noise, 4)
    views = camera.view_block(seen.poses, names("view", 6), 700.0)
    blocks = [off(camera.lens_block(lens, free, SIZE), 3, 1e-3), off(views, 4, 1e-3), targets(seen)]
    return Problem({b.name: b for b in blocks}, (images(seen, camera.chain("board", "forward")),))


def parts(solution: Solution) -> list[set[tuple[str, str]]]:
    return [{(block, column) for block, column, _, _ in found.parts} for found in solution.undetermined]


@pytest.mark.parametrize("degrees", [0.0, 0.001, 0.02])
def test_parallel_views_leave_the_focal_length_open(degrees: float) -> None:
    solution = solved(tilted(degrees, ("f",)))
    assert solution.outcome is Outcome.UNDETERMINED
    assert parts(solution) == [{("lens", "f"), ("view", "z")}]
    assert str(solution.undetermined[0]) in ("f of lens, z of view all images", "z of view all images, f of lens")
    assert solution.covariance is None
    with pytest.raises(RuntimeError, match="cannot determine"):
        solution.covariance_or_raise()


def test_parallel_views_leave_the_principal_point_open() -> None:
    solution = solved(tilted(0.0, ("f", "cx", "cy"), noise=0.0))
    assert solution.outcome is Outcome.UNDETERMINED
    named = set.union(*parts(solution))
    assert {("lens", "f"), ("lens", "cx"), ("lens", "cy"), ("view", "x"), ("view", "y"), ("view", "z")} <= named
    assert len(solution.undetermined) == 3


def test_views_tilted_enough_determine_it() -> None:
    solution = solved(tilted(30.0, ("f", "cx", "cy")))
    assert solution.outcome is Outcome.CONVERGED
    assert solution.std("lens")[0, 0] < 60


def without(problem: Problem, drop: np.ndarray) -> Problem:
    group = problem.groups[0]
    return replace(problem, groups=(group.selected(~drop), *problem.groups[1:]))


@pytest.mark.parametrize("left", [0, 1, 2])
def test_an_image_with_too_few_targets_is_named(left: int) -> None:
    problem = board_camera()
    index = problem.groups[0].observations.index
    drop = (index["view"] == 4) & (index["view"] * 0 + np.arange(index["view"].size) % 20 >= left)
    solution = solved(without(problem, drop))
    assert solution.outcome is Outcome.UNDETERMINED
    assert {members for found in solution.undetermined for _, _, members, _ in found.parts} == {"image view5"}
    assert {block for found in solution.undetermined for block, _, _, _ in found.parts} == {"view"}


def test_targets_in_a_row_leave_a_turn_open() -> None:
    problem = board_camera()
    index = problem.groups[0].observations.index
    drop = (index["view"] == 2) & (index["target"] >= 5)
    solution = solved(without(problem, drop))
    assert solution.outcome is Outcome.UNDETERMINED
    assert {members for found in solution.undetermined for _, _, members, _ in found.parts} == {"image view3"}


def test_a_target_that_nobody_sees_is_named() -> None:
    problem = with_control()
    drop = problem.groups[0].observations.index["target"] == 10
    solution = solved(without(problem, drop))
    assert solution.outcome is Outcome.UNDETERMINED
    assert {members for found in solution.undetermined for _, _, members, _ in found.parts} == {"target T11"}


def test_a_target_seen_once_is_named() -> None:
    problem = with_control()
    index = problem.groups[0].observations.index
    drop = (index["target"] == 10) & (index["view"] != 2)
    solution = solved(without(problem, drop))
    assert solution.outcome is Outcome.UNDETERMINED
    assert {members for found in solution.undetermined for _, _, members, _ in found.parts} == {"target T11"}


def test_parameters_that_act_alike_are_named() -> None:
    """Targets on a circle about the optical axis: k1 and k2 do the same."""
    turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    seen = look(np.column_stack([80 * np.cos(turn), 80 * np.sin(turn), 0 * turn]), 1, 3, tilt=0.0, off=0.0)
    views = camera.view_block(seen.poses, ("",), 700.0).fixed()
    blocks = [camera.lens_block(LENS, ("k1", "k2"), SIZE), views, targets(seen)]
    solution = adjust(blocks, [images(seen.noisy(NOISE, 1), camera.chain("board", "forward"))])
    assert solution.outcome is Outcome.UNDETERMINED
    assert {part for found in parts(solution) for part in found} <= {("lens", "k1"), ("lens", "k2")}
    assert ("lens", "k2") in parts(solution)[0]


def test_fewer_readings_than_unknowns() -> None:
    problem = board_camera(views=2)
    drop = problem.groups[0].observations.index["target"] > 2
    solution = solved(without(problem, drop))
    assert solution.outcome is Outcome.TOO_FEW
    assert solution.dof < 0
    assert np.isnan(solution.sigma0)
    assert np.isnan(solution.p_value)
    assert solution.covariance is None


def test_no_readings_at_all() -> None:
    problem = board_camera(views=2)
    solution = solved(without(problem, np.ones(problem.groups[0].observations.count, dtype=bool)))
    assert solution.outcome is Outcome.TOO_FEW


def test_as_many_readings_as_unknowns() -> None:
    """No redundancy: values and covariance, but no sigma0."""
    problem = tilted(40.0, ())
    drop = problem.groups[0].observations.index["target"] > 2
    assert drop.any()
    index = problem.groups[0].observations.index["target"]
    solution = solved(without(problem, ~np.isin(index, [0, 4, 19])))
    assert solution.dof == 0
    assert solution.outcome is Outcome.CONVERGED
    assert solution.cost < 1e-6
    assert np.isnan(solution.sigma0)


def test_a_start_behind_the_camera() -> None:
    problem = board_camera()
    views = problem.blocks["view"]
    values = views.values.copy()
    values[3, 2] *= -1
    solution = solved(problem.with_blocks(views.with_values(values)))
    assert solution.outcome is Outcome.NO_START
    assert solution.covariance is None


def test_a_reading_that_is_no_number() -> None:
    problem = board_camera()
    group = problem.groups[0]
    readings = group.observations.readings.copy()
    readings[0, 5] = np.nan
    broken = replace(problem, groups=(group.with_observations(group.observations.with_readings(readings)),))
    assert solved(broken).outcome is Outcome.NO_START


def test_too_few_steps() -> None:
    assert solved(board_camera(), StoppingRule(limit=1)).outcome is Outcome.ITERATION_LIMIT


def test_nothing_free() -> None:
    problem = board_camera()
    fixed = replace(problem, blocks={name: block.fixed() for name, block in problem.blocks.items()})
    solution = solved(fixed)
    assert solution.outcome is Outcome.CONVERGED
    assert solution.unknowns == 0
    assert all(np.array_equal(solution.blocks[name].values, block.values) for name, block in problem.blocks.items())
    assert not solution.covariance_or_raise().of("view").any()


@pytest.mark.alike
@pytest.mark.parametrize("make", PROBLEMS)
def test_no_selection_of_readings_brings_an_exception(make: str) -> None:
    rng = np.random.default_rng(1)
    problem = PROBLEMS[make]()
    for share in (0.5, 0.2, 0.1, 0.05, 0.02, 0.0):
        keep = rng.uniform(size=problem.groups[0].observations.count) < share
        solution = solved(without(problem, ~keep), StoppingRule(limit=60))
        assert solution.outcome.good == (solution.covariance is not None)
        assert (solution.outcome in (Outcome.UNDETERMINED,)) <= bool(solution.undetermined)
        for block in solution.blocks.values():
            assert np.isfinite(block.values).all()
        if solution.outcome.good:
            for name in solution.blocks:
                assert np.isfinite(solution.std(name)).all()


@pytest.mark.alike
@pytest.mark.parametrize(
    "make", ["views eliminated", "control points", "targets eliminated, in part fixed", "scale bars"]
)
@pytest.mark.parametrize("seed", range(4))
def test_the_sum_of_squares_never_rises(make: str, seed: int) -> None:
    """From starts far off, step by step."""
    problem = PROBLEMS[make]()
    blocks = {name: off(block, 100 + seed, 0.25) for name, block in problem.blocks.items()}
    costs = []
    for limit in range(0, 30):
        solution = adjust(blocks.values(), problem.groups, control=StoppingRule(limit=limit, covariance=False))
        costs.append(solution.cost)
        if limit and solution.outcome is not Outcome.ITERATION_LIMIT:
            break
    assert all(after <= before * (1 + 1e-12) for before, after in pairwise(costs))


@pytest.mark.alike
@pytest.mark.parametrize("seed", range(6))
def test_starts_far_off_end_in_the_same_place(seed: int) -> None:
    problem = board_camera()
    best = solved(problem)
    views = problem.blocks["view"]
    far = problem.with_blocks(off(lens(), seed, 0.2), off(views.with_values(look(board(5, 4), 8, 1).poses), seed, 0.15))
    solution = solved(far)
    assert solution.outcome is Outcome.CONVERGED
    assert solution.cost == pytest.approx(best.cost, rel=1e-9)


def scaled(problem: Problem, factor: float) -> Problem:
    """The same in another unit of length."""
    views, points = problem.blocks["view"], problem.blocks["target"]
    stretch = np.array([factor] * 3 + [1.0] * 3)
    return problem.with_blocks(
        replace(views, values=views.values * stretch, reach=views.reach * stretch),
        replace(points, values=points.values * factor, reach=points.reach * factor),
    )


@pytest.mark.alike
@pytest.mark.parametrize("factor", [1e-3, 1e3, 1e6])
def test_units_change_nothing(factor: float) -> None:
    problem = board_camera()
    one, other = solved(problem), solved(scaled(problem, factor))
    assert other.outcome is Outcome.CONVERGED
    assert other.iterations == one.iterations
    assert np.abs((one.blocks["lens"].values - other.blocks["lens"].values) / one.std("lens")).max() < 1e-6
    stretch = np.array([factor] * 3 + [1.0] * 3)
    assert np.allclose(other.std("view"), one.std("view") * stretch, rtol=1e-6)
    parallel = tilted(0.0, ("f",))
    assert parts(solved(scaled(parallel, factor))) == [{("lens", "f"), ("view", "z")}]


@pytest.mark.alike
@pytest.mark.parametrize("factor", [1e-4, 1e-2, 10, 30])
def test_a_wrong_noise_moves_no_value(factor: float) -> None:
    """The sigma that a job declares (1 where the noise is estimated) must not decide how far the steps go."""
    problem = board_camera(noise=0.05)
    group = problem.groups[0]
    other = replace(
        problem, groups=(group.with_observations(replace(group.observations, sigma=np.array(NOISE * factor))),)
    )
    one, two = solved(problem, StoppingRule(limit=200)), solved(other, StoppingRule(limit=200))
    assert two.outcome is Outcome.CONVERGED
    assert np.abs((one.blocks["lens"].values - two.blocks["lens"].values) / one.std("lens")).max() < 1e-4
    assert two.sigma0 * factor == pytest.approx(one.sigma0, rel=1e-6)


def test_exact_readings_converge() -> None:
    problem = board_camera(noise=0.0)
    solution = solved(problem)
    assert solution.outcome is Outcome.CONVERGED
    assert solution.iterations < 15
    assert np.allclose(solution.blocks["lens"].values[0], list(LENS.values()), rtol=1e-7, atol=1e-9)


LADDER = (
    ("f",),
    ("f", "k1"),
    ("f", "cx", "cy", "k1"),
    ("f", "cx", "cy", "k1", "k2"),
    ("f", "cx", "cy", "k1", "k2", "p1", "p2"),
    ("f", "cx", "cy", "k1", "k2", "p1", "p2", "k3"),
    ("f", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    ("f", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4"),
)


@pytest.mark.alike
@pytest.mark.parametrize("seed", range(3))
def test_a_richer_model_never_ends_higher(seed: int) -> None:
    seen = look(board(8, 6), 9, seed, distance=450, tilt=50, inside=True).noisy(0.2, seed)
    values = {**LENS, **dict.fromkeys(("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4"), 0.0)}
    state = {
        "lens": camera.lens_block(values, LADDER[0], SIZE),
        "view": camera.view_block(seen.poses, names("view", 9), 450.0),
        "target": targets(seen),
    }
    group = images(seen, camera.chain("board", "forward"), 0.2)
    last = np.inf
    for free in LADDER:
        block = camera.lens_block(dict(zip(state["lens"].columns, state["lens"].values[0], strict=True)), free, SIZE)
        solution = adjust({**state, "lens": block}.values(), [group], control=StoppingRule(limit=100))
        assert solution.cost <= last * (1 + 1e-12), free
        if "k4" not in free:
            assert solution.outcome is Outcome.CONVERGED, free
        last, state = solution.cost, dict(solution.blocks)


def test_blocks_must_have_the_shape_they_claim() -> None:
    with pytest.raises(ValueError, match="block lens"):
        replace(lens(), values=np.zeros((2, 7)))


def test_planning_needs_no_readings_that_fit() -> None:
    problem = board_camera()
    planned = covariance_at(problem.blocks.values(), problem.groups)
    assert planned.outcome is Outcome.CONVERGED
    assert np.allclose(planned.std("lens"), solved(problem).std("lens"), rtol=0.3)


def test_a_plane_of_targets_in_a_network_view_from_one_side() -> None:
    """Targets free, all views from one place: depths of the targets are open."""
    problem = network(views=4)
    stations = problem.blocks["view"]
    same = np.broadcast_to(stations.values[:1], stations.values.shape)
    group = problem.groups[0]
    at_one = {**problem.blocks, "view": stations.with_values(same)}
    exact = group.observations.with_readings(group.chain.predict(at_one, group.observations))
    datum = camera.network_datum(problem.blocks["target"], np.ones(len(CUBE)))
    solution = adjust(at_one.values(), [group.with_observations(exact)], datum)
    assert solution.outcome is Outcome.UNDETERMINED
    assert solution.undetermined


@pytest.mark.parametrize(
    ("block", "members", "words"),
    [
        ("tracer", "tracer LT1", "x of tracer LT1"),
        ("tracer", "all tracers", "x of all tracers"),
        ("levelled station", "station S2", "x of station S2"),
        ("station over a point", "all stations", "x of all stations"),
        ("lens", "camera left", "x of lens camera left"),
        ("coupling", "", "x of coupling"),
    ],
)
def test_a_noun_in_the_name_of_a_block_is_not_repeated(block: str, members: str, words: str) -> None:
    assert str(Combination(((block, "x", members, 1.0),), 1.0)) == words
