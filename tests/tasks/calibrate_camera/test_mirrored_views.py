"""A small board far away: the tilt and its mirror image fit alike, and the job says so."""

from __future__ import annotations

import numpy as np
import pytest

from metrocli.adjust.model.observations import Observations
from metrocli.geometry import poses
from metrocli.instruments.lenses.lens import image_point
from metrocli.tasks.calibrate_camera.build import build
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.calibrate_camera.settings import CameraSettings
from metrocli.tasks.shared.images.adjustment import Options, adjust_images
from metrocli.tasks.shared.images.sightings import Sighted
from metrocli.tasks.shared.images.target_list import TargetCoordinates

LENS = {"f": 2800.0, "cx": 1223.5, "cy": 1023.5}
VIEWS = 6


def seen(rng: np.random.Generator, distance: float, noise: float) -> tuple[CameraProblem, np.ndarray]:
    """Return the calibration of poses alone from a 3 x 3 board of 40 mm, and the true poses about its middle."""
    board = np.array([[20.0 * x, 20.0 * y, 0.0] for x in range(3) for y in range(3)])
    angles = np.column_stack([rng.uniform(-0.6, 0.6, (VIEWS, 2)), rng.uniform(-3, 3, VIEWS)])
    truth = poses.pose_from_euler(
        np.column_stack([rng.uniform(-0.1, 0.1, (VIEWS, 2)) * distance, np.full(VIEWS, distance)]), angles
    )
    points = poses.apply(truth[:, None], board - board.mean(axis=0))
    u, v = image_point(LENS, points[..., 0] / points[..., 2], points[..., 1] / points[..., 2])
    uv = np.stack([u.ravel(), v.ravel()])
    view, target = np.repeat(np.arange(VIEWS), 9), np.tile(np.arange(9), VIEWS)
    names, images = tuple(f"T{i}" for i in range(9)), tuple(f"I{i}" for i in range(VIEWS))
    observations = Observations(
        uv + rng.normal(0, noise, uv.shape),
        np.array(noise),
        {"view": view, "target": target},
        keys={"image": tuple(images[i] for i in view), "target": tuple(names[i] for i in target)},
        components=("u", "v"),
        unit="px",
    )
    targets = TargetCoordinates(names, board, np.zeros_like(board), np.full(9, np.nan))
    camera = CameraSettings(image_size=(2448, 2048), estimate=(), **LENS)
    return build("board", camera, Sighted(images, targets, observations)), truth


def wrong_views(problem: CameraProblem, truth: np.ndarray) -> list[str]:
    solution = adjust_images(problem.blocks, problem.images, problem.others, None, Options()).solution
    turn = poses.rotation_of(solution.blocks["view"].values) @ np.swapaxes(poses.rotation_of(truth), 1, 2)
    angle = np.linalg.norm(poses.vector_from_rotation(turn), axis=1)
    return [f"I{i}" for i in np.flatnonzero(angle > 0.4)]


@pytest.mark.slow
def test_views_whose_tilt_may_be_mirrored_are_named() -> None:
    rng = np.random.default_rng(3)
    wrong, told = 0, 0
    for _ in range(25):
        problem, truth = seen(rng, 1200.0, 1.0)
        warning = " ".join(line for line in problem.sighted.warnings if "mirror image" in line)
        found = wrong_views(problem, truth)
        wrong += len(found)
        told += sum(name in warning for name in found)
    assert wrong > 5
    assert told >= 0.8 * wrong


@pytest.mark.parametrize("seed", range(5))
def test_near_boards_are_not_suspected(seed: int) -> None:
    problem, truth = seen(np.random.default_rng(seed), 150.0, 0.1)
    assert not [line for line in problem.sighted.warnings if "mirror image" in line]
    assert wrong_views(problem, truth) == []
