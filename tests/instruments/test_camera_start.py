"""Cameras start from nothing but target lists and image points, and every start leads to the solution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from simulated.camera import LENS, SIZE, Array, Seen, board, look

from metrocli.adjust.adjustment import StoppingRule, adjust
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.geometry import poses
from metrocli.instruments import camera
from metrocli.instruments.camera_start import TargetImages, plane_frame, start
from metrocli.instruments.linear_maps import linear_maps

NOISE = 0.1
CENTRE = (np.array(SIZE) - 1) / 2
LAYOUTS = 25


def space(count: int, seed: int, flat: float = 1.0) -> Array:
    return np.random.default_rng(1000 + seed).uniform(-100, 100, (count, 3)) * [1, 1, flat]


def scene(seen: Seen) -> TargetImages:
    return TargetImages(seen.points, seen.uv, seen.target, seen.view, seen.views)


LOOKS: dict[str, tuple[Callable[[int], Seen], tuple[str, ...]]] = {
    "board": (lambda s: look(board(), 6, s, tilt=60, off=0.2), tuple(LENS)),
    "board with a far origin": (lambda s: look(board() + [5000, -3000, 200], 6, s, tilt=60), tuple(LENS)),
    "targets in space": (lambda s: look(space(20, s), 5, s, tilt=60), tuple(LENS)),
    "nearly flat": (lambda s: look(space(20, s, 0.05), 5, s, tilt=60), tuple(LENS)),
    "four targets a view": (lambda s: look(board(2, 2, 150.0), 12, s, tilt=60), ("f",)),
    "eight in space": (lambda s: look(space(8, s), 5, s, tilt=60), ("f",)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LOOKS)
def test_the_start_is_near_and_the_adjustment_gets_there(name: str) -> None:
    make, free = LOOKS[name]
    for seed in range(LAYOUTS):
        seen = make(seed).noisy(NOISE, seed)
        focal, found = start(scene(seen), CENTRE, None, float(SIZE[0]))
        assert abs(focal / LENS["f"] - 1) < 0.2, seed
        values = {name: LENS[name] for name in LENS} if len(free) == 1 else dict.fromkeys(LENS, 0.0)
        values = {**values, "f": focal, "cx": CENTRE[0], "cy": CENTRE[1]}
        names = tuple(map(str, range(seen.views)))
        views = camera.view_block(found, names, 700.0)
        targets = camera.target_block(seen.points, tuple(map(str, range(len(seen.points)))), False, 200.0)
        index = {"view": seen.view, "target": seen.target}
        group = Group("images", camera.chain("board", "forward"), Observations(seen.uv, np.array(NOISE), index))
        solution = adjust(
            [camera.lens_block(values, free, SIZE), views, targets], [group], control=StoppingRule(limit=100)
        )
        assert solution.outcome.good, seed
        turn = poses.difference(solution.blocks["view"].values, seen.poses)[:, 3:]
        assert np.abs(turn).max() < 0.2, seed


def test_a_known_focal_length_is_kept() -> None:
    seen = look(board(), 3, 1)
    focal, found = start(scene(seen), CENTRE, 2600.0, float(SIZE[0]))
    assert focal == 2600.0
    assert np.abs(poses.difference(found, seen.poses)[:, 3:]).max() < 0.05


def test_parallel_views_do_not_tell_a_focal_length() -> None:
    plain = {"f": LENS["f"], "cx": CENTRE[0], "cy": CENTRE[1]}
    seen = look(board(), 4, 2, tilt=0.0, lens=plain).noisy(NOISE, 3)
    focal, found = start(scene(seen), CENTRE, None, 2000.0)
    assert 0.05 * 2000 < focal < 50 * 2000
    assert np.isfinite(found).all()
    assert (found[:, 2] > 0).all()


def test_five_targets_in_space_do_not_tell_a_focal_length() -> None:
    """A projection needs six: the guess is taken rather than a number that means nothing."""
    seen = look(space(5, 1), 6, 1).noisy(NOISE, 2)
    assert start(scene(seen), CENTRE, None, 2000.0)[0] == 2000.0


@pytest.mark.slow
def test_five_targets_in_space_give_poses_where_the_lens_is_known() -> None:
    right = 0
    for seed in range(8):
        seen = look(space(5, seed), 4, seed, lens={**LENS, "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0})
        _, found = start(scene(seen), np.array([LENS["cx"], LENS["cy"]]), LENS["f"], LENS["f"])
        right += int((np.abs(poses.difference(found, seen.poses)[:, 3:]).max(axis=1) < 0.05).sum())
    assert right >= 30  # of 32; the others have a second pose that fits nearly as well


def test_mixed_up_targets_do_not_spoil_the_start() -> None:
    for points in (board(), space(40, 3)):
        seen = look(points, 8, 5).noisy(NOISE, 6)
        rng = np.random.default_rng(7)
        wrong = rng.choice(seen.target.size, seen.target.size // 10, replace=False)
        target = seen.target.copy()
        target[wrong] = (target[wrong] + rng.integers(1, len(points), wrong.size)) % len(points)
        focal, found = start(scene(replace(seen, target=target)), CENTRE, None, float(SIZE[0]))
        assert abs(focal / LENS["f"] - 1) < 0.1
        assert np.abs(poses.difference(found, seen.poses)[:, 3:]).max() < 0.1


def test_exchanged_neighbours_do_not_put_a_board_behind_the_camera() -> None:
    """They are too near for gross errors, and turned the map of the board: its calibration then had no start."""
    points, rng = board(7, 5, 25.0), np.random.default_rng(189)
    seen = look(points, 4, 189, tilt=80).noisy(NOISE, 189)
    target, rows = seen.target.copy(), np.flatnonzero(seen.view == 1)
    at = rows[rng.integers(len(rows) - 1)]
    target[[at, at + 1]] = target[[at + 1, at]]
    _, found = start(scene(replace(seen, target=target)), CENTRE, None, float(SIZE[0]))
    assert (poses.apply(found[seen.view], points[seen.target])[:, 2] > 0).all()


def test_what_does_not_fit_a_map_is_left_out() -> None:
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-1, 1, (30, 2)), np.ones(30)])
    matrix = np.array([[1.0, 0.1, 0.2], [-0.1, 0.9, 0.1], [0.05, -0.1, 2.0]])
    x, y, w = matrix @ points.T
    rays = np.stack([x / w, y / w]) + 1e-4 * rng.normal(size=(2, 30))
    rays[:, [3, 17]] += 0.3
    maps, keep = linear_maps(points, rays, np.zeros(30, dtype=int), 1)
    assert list(np.flatnonzero(~keep)) == [3, 17]
    assert np.allclose(maps[0] / maps[0, 2, 2], matrix / 2.0, atol=1e-3)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_plane_through_few_targets(count: int) -> None:
    pose, planar = plane_frame(np.array([[1.0, 2, 3], [4, 5, 9], [0, 1, 1]])[:count])
    assert planar
    assert np.isfinite(pose).all()


def test_the_best_plane_is_carried_to_zero_height() -> None:
    points = poses.apply(np.array([10.0, 20, 30, 0.3, -0.9, 1.2]), board())
    pose, planar = plane_frame(points)
    assert planar
    assert np.abs(poses.apply(pose, points)[:, 2]).max() < 1e-9
    assert not plane_frame(space(10, 1))[1]


def test_chains_of_the_rigs_end_in_an_image() -> None:
    for rig in ("board", "cmm", "network"):
        for convention in ("forward", "backward"):
            assert isinstance(camera.chain(rig, convention), Chain)
