"""Calibrating a camera from 500 and 1000 views: CPU seconds and memory, beside OpenCV, in one run on one thread.

metrocli: from image points to parameters, full covariance, redundancy numbers and w-tests of every reading.
OpenCV: cv2.calibrateCamera from the same points, without covariance.

A second table: `outliers: remove` and `noise: estimated`, with 2 % of the points off by 0.2 to 20 px in any direction.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt

from metrocli.adjust.model.observations import Observations
from metrocli.geometry import poses
from metrocli.instruments.lenses.lens import image_point
from metrocli.tasks.calibrate_camera.build import build
from metrocli.tasks.calibrate_camera.settings import CameraSettings
from metrocli.tasks.shared.images.adjustment import AdjustedImages, Options, adjust_images
from metrocli.tasks.shared.images.sightings import Sighted
from metrocli.tasks.shared.images.target_list import TargetCoordinates

SIZE = (2448, 2048)
TRUTH = {
    "fx": 2800.0,
    "fy": 2803.0,
    "cx": 1230.0,
    "cy": 1015.0,
    "k1": -0.12,
    "k2": 0.09,
    "p1": 3e-4,
    "p2": -2e-4,
    "k3": -0.02,
}
NOISE = 0.02


Projection = Callable[[npt.NDArray[np.float64], npt.NDArray[np.float64]], tuple[object, object]]
"""Takes x/z and y/z of points in the frame of the camera; returns u and v"""


def pinhole(x: npt.NDArray[np.float64], y: npt.NDArray[np.float64]) -> tuple[object, object]:
    """Return the image of points by the true lens."""
    u, v = image_point(TRUTH, x, y)
    return u, v


def scene(views: int, seed: int, project: Projection = pinhole) -> tuple[Sighted, TargetCoordinates]:
    """Return the image points of a 10 x 10 board in `views` random poses, with noise."""
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(10) * 25.0, np.arange(10) * 25.0), axis=-1).reshape(-1, 2)
    points = np.column_stack([grid, np.zeros(100)])
    targets = TargetCoordinates(
        tuple(f"T{i:03d}" for i in range(100)), points, np.zeros((100, 3)), np.full(100, np.nan)
    )
    angles = np.column_stack([rng.uniform(-0.6, 0.6, (views, 2)), rng.uniform(-3.1, 3.1, views)])
    aim = np.column_stack([rng.uniform(-40, 40, (views, 2)), rng.uniform(480, 700, views)])
    board = poses.pose_from_euler(np.zeros((views, 3)), angles)
    centred = poses.apply(board[:, None], points - points.mean(axis=0)) + aim[:, None]
    u, v = map(np.asarray, project(centred[..., 0] / centred[..., 2], centred[..., 1] / centred[..., 2]))
    uv = np.stack([u.ravel(), v.ravel()]) + rng.normal(0, NOISE, (2, views * 100))
    view, target = np.repeat(np.arange(views), 100), np.tile(np.arange(100), views)
    names = tuple(f"I{i:04d}" for i in range(views))
    observations = Observations(
        uv, np.array(NOISE), {"view": view, "target": target},
        keys={"image": tuple(names[i] for i in view), "target": tuple(targets.names[i] for i in target)},
        components=("u", "v"), unit="px",
    )  # fmt: skip
    return Sighted(names, targets, observations), targets


def ours(sighted: Sighted) -> tuple[float, float]:
    """Return f and its standard uncertainty."""
    problem = build("board", CameraSettings(image_size=SIZE, estimate=tuple(TRUTH)), sighted)
    adjusted = adjust_images(problem.blocks, problem.images, problem.others, None, Options(started=True))
    adjusted.known_residuals()
    adjusted.solution.std("view")
    return float(adjusted.solution.blocks["lens"].values[0, 0]), float(adjusted.solution.std("lens")[0, 0])


def spoilt(sighted: Sighted, share: float, seed: int) -> tuple[Sighted, set[int]]:
    """Return the sightings with a share of wrong points, and which these are."""
    rng = np.random.default_rng(seed)
    observations = sighted.observations
    wrong = rng.choice(observations.count, round(share * observations.count), replace=False)
    turn, size = rng.uniform(0, 2 * np.pi, wrong.size), np.exp(rng.uniform(np.log(0.2), np.log(20), wrong.size))
    readings = observations.readings.copy()
    readings[:, wrong] += size * np.stack([np.cos(turn), np.sin(turn)])
    return replace(sighted, observations=observations.with_readings(readings)), set(wrong.tolist())


def cleaned(sighted: Sighted) -> AdjustedImages:
    """Return the adjustment without the points that it finds wrong."""
    problem = build("board", CameraSettings(image_size=SIZE, estimate=tuple(TRUTH)), sighted)
    return adjust_images(problem.blocks, problem.images, problem.others, None, Options(True, True, SIZE, started=True))


def left_out(sighted: Sighted, adjusted: AdjustedImages) -> set[int]:
    """Return the numbers of the points that were left out."""
    keys, rejected = sighted.observations.keys, adjusted.rejected
    numbers = {key: i for i, key in enumerate(zip(keys["image"], keys["target"], strict=True))}
    return {numbers[key] for key in zip(rejected.texts("image"), rejected.texts("target"), strict=True)}


def opencv(sighted: Sighted, targets: TargetCoordinates) -> float:
    """Return f."""
    import cv2

    cv2.setNumThreads(1)
    views = len(sighted.images)
    objects = [targets.points.astype(np.float32)] * views
    images = [part.astype(np.float32) for part in np.split(sighted.observations.readings.T, views)]
    _, matrix, *_ = cv2.calibrateCamera(objects, images, SIZE, None, None)
    return float(matrix[0, 0])


def best(task: Callable[[], object], runs: int) -> float:
    """Return the least CPU seconds of several runs."""
    seconds = []
    for _ in range(runs):
        before = time.process_time()
        task()
        seconds.append(time.process_time() - before)
    return min(seconds)


def main() -> None:
    """Print the tables."""
    print(
        f"{'views':>6} {'metrocli CPU s':>15} {'OpenCV CPU s':>13} {'ratio':>6} {'peak MB':>8} {'f error / s(f)':>15}"
    )
    for views in (100, 200, 500, 1000):
        sighted, targets = scene(views, views)
        seconds = best(partial(ours, sighted), 3)
        other = best(partial(opencv, sighted, targets), 3)
        f, std = ours(sighted)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(
            f"{views:>6} {seconds:>15.3f} {other:>13.3f} {seconds / other:>6.2f} {peak:>8.0f} "
            f"{(f - TRUTH['fx']) / std:>15.2f}"
        )

    print(f"\n{'points':>6} {'wrong':>6} {'metrocli CPU s':>15} {'found':>6} {'good lost':>10}")
    for views in (93, 186):
        sighted, wrong = spoilt(scene(views, views)[0], 0.02, views)
        seconds = best(partial(cleaned, sighted), 3)
        found = left_out(sighted, cleaned(sighted))
        print(f"{views * 100:>6} {len(wrong):>6} {seconds:>15.2f} {len(wrong & found):>6} {len(found - wrong):>10}")


if __name__ == "__main__":
    main()
