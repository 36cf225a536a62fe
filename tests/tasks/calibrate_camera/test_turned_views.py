"""A board whose targets are unknown is distinguished from the lens by images that are turned about the viewing axis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.halves import board_job
from metrocli.geometry.rotations import rotation_from_vector
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.calibrate_camera import task as calibrate_camera

FOCAL, MIDDLE, NOISE = 900.0, np.array([319.5, 239.5]), 0.1


def calibrated(turns: float, targets: str, axes: str = "xyz", tilts: float = 0.5) -> Result:
    """Calibrate with ten images of a board of 9 x 6 targets, turned about the viewing axis by up to `turns` degrees.

    The board is listed in the plane of the first two `axes`; its tilts about x and y are within `tilts`, small ones about 0.2 rad.
    """
    rng = np.random.default_rng(145)
    x, y = (part.ravel() for part in np.meshgrid(np.arange(9) * 25.0, np.arange(6) * 25.0))
    board = np.stack([x, y, 0 * x], axis=1)
    pixels = []
    for turn in np.radians(np.linspace(0, turns, 10)):
        tilt = rotation_from_vector(np.array([*rng.uniform(-tilts, tilts, 2) + 0.2 * (tilts < 0.5), 0.0]))
        seen = (board - board.mean(axis=0)) @ (tilt @ rotation_from_vector(np.array([0.0, 0.0, turn]))).T
        seen += [*rng.uniform(-20, 20, 2), rng.uniform(420, 520)]
        pixels.append(FOCAL * seen[:, :2] / seen[:, 2:] + MIDDLE + rng.normal(0, NOISE, (len(board), 2)))
    u, v = np.concatenate(pixels).T
    names = np.array([f"T{i:02d}" for i in range(len(board))])
    image = np.repeat([f"i{i:02d}" for i in range(10)], len(board))
    observations = Table({"image": image, "target": np.tile(names, 10), "u": u, "v": v}, {"u": "px", "v": "px"})
    listed = Table({"target": names, **dict(zip(axes, (x, y, 0 * x), strict=True))}, dict.fromkeys("xyz", "mm"))
    job = board_job(observations, listed, (640, 480))
    return calibrate_camera.run(replace(job, settings=replace(job.settings, targets=targets)))


@pytest.mark.parametrize(
    ("turns", "targets", "told"), [(20, "estimate", True), (90, "estimate", False), (20, "listed", False)]
)
def test_images_that_are_not_turned_are_reported_where_the_board_is_unknown(
    turns: float, targets: str, told: bool
) -> None:
    warnings = [line for line in calibrated(turns, targets).warnings if "about its viewing axis" in line]
    assert len(warnings) == told
    assert all("the camera is turned by at most 2" in line for line in warnings)


def test_the_turn_does_not_depend_on_the_plane_of_the_list() -> None:
    """In a list in the plane of y and z the axis x is the normal of the board, whose direction in an image is chance."""
    of = [
        [line for line in calibrated(20, "estimate", axes).warnings if "viewing axis" in line]
        for axes in ("xyz", "yzx")
    ]
    assert of[0] == of[1] != []


def test_turned_images_determine_the_principal_point_better() -> None:
    """This is what the warning promises: with the board as listed the turn hardly matters."""
    std = {
        (turns, targets): next(one.std for one in calibrated(turns, targets).estimates if one.name == "cx")
        for turns in (20, 90)
        for targets in ("listed", "estimate")
    }
    assert std[20, "estimate"] > 2 * std[90, "estimate"]
    assert std[20, "listed"] < 1.5 * std[90, "listed"]


@pytest.mark.parametrize(("tilts", "told"), [(0.05, True), (0.5, False)])
def test_images_of_one_angle_ask_for_tilts(tilts: float, told: bool) -> None:
    warnings = [line for line in calibrated(20, "listed", tilts=tilts).warnings if "at one angle" in line]
    assert len(warnings) == told
    assert all("tilt the board by 20 to 45 degrees about both axes" in line for line in warnings)
