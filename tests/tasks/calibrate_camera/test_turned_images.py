"""Images taken with the camera turned by 90 degrees have another principal point: found, and estimated."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from metrocli.tasks.calibrate_camera import image_groups

Metrocli = Callable[..., Any]
SHIFT = np.array([2.5, -1.5])
"""Of the principal point in the turned images [px]"""
NOISE = 0.05
JOB = """metrocli: 1
job: calibrate-camera
rig: board
inputs: {observations: observations.csv, targets: targets.csv}
camera: {image_size: [640, 480], estimate: [f, cx, cy]}
noise: 0.05 px
output: camera.h5
"""


def turn(a: float, b: float, c: float) -> np.ndarray:
    x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    return np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]]) @ y @ x


def write(
    folder: Path,
    rolls: list[float],
    shift: np.ndarray,
    focal: float = 690,
    name: Callable[[int], str] = "v{}".format,
    stretch: float = 0.0,
) -> Path:
    """Tilted views of a flat board through a lens without distortion; every second one is turned and shifted.

    The last five views have a focal length of their own [px].
    """
    rng = np.random.default_rng(77)
    listed = np.array([(25.0 * i, 25.0 * j, 0.0) for j in range(6) for i in range(8)])
    targets = [f"T{i:02d},{x},{y},{z}" for i, (x, y, z) in enumerate(listed.tolist())]
    (folder / "targets.csv").write_text("\n".join(["target,x_mm,y_mm,z_mm", *targets]) + "\n")
    rows = ["image,target,u_px,v_px"]
    for view in range(12):
        roll = rolls[view % len(rolls)]
        # the tilt is in the camera's frame, so that the turned images are tilted in all directions too
        rotation = turn(*rng.uniform(-0.6, 0.6, 2), 0.0) @ turn(0.0, 0.0, roll + rng.normal(0, 0.03))
        seen = (listed - [87.5, 62.5, 0]) * [1 + stretch, 1, 1] @ rotation.T + [*rng.uniform(-15, 15, 2), 420]
        uv = (690 if view < 7 else focal) * seen[:, :2] / seen[:, 2:] + [320, 240] + (shift if roll else 0.0)
        uv += rng.normal(0, NOISE, uv.shape)
        rows += [f"{name(view)}.png,T{i:02d},{u},{v}" for i, (u, v) in enumerate(uv.tolist())]
    (folder / "observations.csv").write_text("\n".join(rows) + "\n")
    (folder / "job.yaml").write_text(JOB)
    return folder / "job.yaml"


@pytest.mark.slow
def test_the_principal_point_of_turned_images_is_found_and_estimated(tmp_path: Path, metrocli: Metrocli) -> None:
    job = write(tmp_path, [0.0, np.pi / 2], SHIFT)
    data = json.loads(metrocli("diagnose", job, "--json").out)
    (effect,) = data["effects"]
    assert (data["verdict"], effect["name"]) == ("explained", "turned-principal-point")
    assert effect["where"]["turn"] in ("90", "270")
    extended = tmp_path / "job.extended.yaml"
    assert metrocli("calibrate-camera", extended).code == 0
    with h5py.File(tmp_path / "camera.extended.h5") as result:
        (group,) = result["effects"].values()
        found = {str(name, "utf8"): (value, std) for name, value, std, *_ in group["parameters"][:].tolist()}
    # of as many images in both directions either can be the reference
    sign = 1 if effect["where"]["turn"] == "90" else -1
    for name, true in zip(("cx", "cy"), sign * SHIFT, strict=True):
        value, std = found[name]
        assert std < 0.5 and abs(value - true) < 4 * std
    assert json.loads(metrocli("diagnose", extended, "--json").out)["verdict"] == "clean"


@pytest.mark.parametrize("rolls", [pytest.param([0.0], marks=pytest.mark.slow), [0.0, 0.7, 1.3, 2.4, 3.3, 4.6, 5.5]])
def test_where_no_image_is_turned_in_steps_of_90_degrees_the_effect_has_no_place(
    rolls: list[float], tmp_path: Path, metrocli: Metrocli
) -> None:
    data = json.loads(metrocli("diagnose", write(tmp_path, rolls, np.zeros(2)), "--json").out)
    assert data["verdict"] == "clean"
    assert not [one for one in data["candidates"] if one["name"] == "turned-principal-point" and one["where"]]


@pytest.mark.slow
def test_a_lens_that_was_focused_anew_between_two_series_is_found(tmp_path: Path, metrocli: Metrocli) -> None:
    def name(view: int) -> str:
        return f"monday_{view}" if view < 7 else f"tuesday_{view}"

    data = json.loads(metrocli("diagnose", write(tmp_path, [0.0], np.zeros(2), 700, name), "--json").out)
    (effect,) = data["effects"]
    assert (effect["name"], effect["where"]) == ("series-focal-length", {"series": "tuesday_"})
    (size,) = effect["parameters"].values()
    assert abs(size["value"] - 10 / 690) < 4 * size["std"] < 0.01


def test_pauses_part_images_into_series() -> None:
    times = np.array([0.0, 10, 20, 30, 3600, 3610, 3620])
    names, number = image_groups._by_pauses(times)
    assert names == ("from 0 s", "from 3600 s") and number.tolist() == [0, 0, 0, 0, 1, 1, 1]
    assert len(image_groups._by_pauses(times[:4])[0]) == 1


@pytest.mark.parametrize("begin", [0.0, 1764190000.0])
def test_the_times_of_series_may_be_those_of_a_clock(begin: float) -> None:
    names, _ = image_groups._by_pauses(begin + np.array([0.0, 10, 20, 3600, 3610]))
    assert names == (f"from {begin:.10g} s", f"from {begin + 3600:.10g} s")


def test_series_have_names_whatever_the_files_are_called() -> None:
    names, number = image_groups._by_name(["left_1.jp2", "left_2.jp2", "left_3.jp2", "04.jp2", "05.jp2", "extra.jp2"])
    assert names == ("left_", "numbers only") and number.tolist() == [0, 0, 0, 1, 1, 0]
    assert image_groups._by_name(["a.png", "b.png", "c.png"])[0] == ("a",)


@pytest.mark.parametrize("stretch", [0.002, 0.004])
def test_views_of_a_stretched_board_are_not_called_turned(stretch: float, tmp_path: Path, metrocli: Metrocli) -> None:
    """Each view has a principal point of its own then: they scatter about the middle and do not stand at two places."""
    rolls = np.random.default_rng(5).uniform(0, 2 * np.pi, 12).tolist()
    ran = metrocli("calibrate-camera", write(tmp_path, rolls, np.zeros(2), stretch=stretch))
    assert "turned by 180 degrees" not in ran.out + ran.err


def test_an_image_that_fits_worst_without_the_aspect_ratio_is_not_called_turned(
    tmp_path: Path, metrocli: Metrocli
) -> None:
    """An estimated noise hides that the lens model lacks something, which turning one of 40 images hides a little of."""
    rng = np.random.default_rng(118)
    listed = np.array([(25.0 * i, 25.0 * j, 0.0) for j in range(6) for i in range(8)])
    rows = ["image,target,u_px,v_px"]
    for view in range(40):
        rotation = turn(*rng.uniform(-0.6, 0.6, 2), rng.uniform(0, 6.28))
        seen = (listed - [87.5, 62.5, 0]) @ rotation.T + [*rng.uniform(-60, 60, 2), 420]
        uv = 690 * seen[:, :2] / seen[:, 2:] * [1.03, 1] + [340, 226] + rng.normal(0, 0.1, (48, 2))
        rows += [f"v{view}.png,T{i:02d},{u},{v}" for i, (u, v) in enumerate(uv.tolist())]
    job = write(tmp_path, [0.0], np.zeros(2))
    (tmp_path / "observations.csv").write_text("\n".join(rows) + "\n")
    job.write_text(JOB.replace(", estimate: [f, cx, cy]", "").replace("0.05 px", "structured"))
    ran = metrocli("calibrate-camera", job)
    assert "turned by 180 degrees" not in ran.out + ran.err
