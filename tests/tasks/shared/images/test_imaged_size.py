"""The imaged size of targets controls their declared diameter."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import SAMPLES, SHARED

from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.errors import InputError
from metrocli.tasks.shared.images.eccentricity import SIZE, check_diameters

Metrocli = Callable[..., Any]
CAMERA = "inputs.camera=../machine/true_camera.yaml"


def group(sizes: list[float], images: list[str], targets: list[str]) -> Group:
    n = len(sizes)
    keys = {"image": tuple(images), "target": tuple(targets)}
    known = {SIZE: np.array(sizes)}
    return Group("images", Chain(()), Observations(np.zeros((2, n)), np.ones((2, n)), {}, keys=keys, conditions=known))


def checked(sizes: list[float], predicted: float = 20.0) -> None:
    """Targets A, B and C in four images, with a declared diameter of 6 mm."""
    images, targets = [f"image{k // 3}" for k in range(12)], ["A", "B", "C"] * 4
    check_diameters(group(sizes, images, targets), np.full(12, predicted), np.full(12, 3.0))


def test_a_size_within_what_an_edge_allows_is_accepted() -> None:
    # 2 % of the print and 0.25 px of 20 px: 3.25 % in all
    for share in (0.97, 1.0, 1.03):
        checked([20 * share] * 12)


@pytest.mark.parametrize("share", [0.1, 0.96, 1.04, 2.0, 10.0])
def test_another_size_is_refused_with_found_and_declared(share: float) -> None:
    with pytest.raises(InputError) as told:
        checked([20 * share] * 12)
    assert f"targets of {6 * share:.3g} mm diameter" in str(told.value)
    assert "where 6 mm is declared" in str(told.value)


def test_small_images_of_targets_say_less() -> None:
    checked([3.2] * 12, predicted=3.0)  # 6.7 % of a radius of 3 px is 0.2 px
    with pytest.raises(InputError):
        checked([32.0] * 12, predicted=30.0)


def test_scattered_sizes_say_less() -> None:
    scattered = [20 * (1.05 + 0.08 * (-1) ** k) for k in range(12)]
    checked(scattered)


def test_sizes_that_fit_no_one_diameter_do_not_blame_it() -> None:
    """As a list with exchanged columns makes them: each pose is wrong by itself."""
    with pytest.raises(InputError) as told:
        checked([20 * (1.6 + 0.9 * (-1) ** k) for k in range(12)])
    assert "fit no one diameter" in str(told.value)
    assert "correct the diameter" not in str(told.value)


@pytest.mark.parametrize(("rows", "where"), [((3, 4, 5), "image image1 (1.5 times)"), ((1, 4, 7, 10), "target B (1.5 times)")])  # fmt: skip
def test_one_image_or_target_of_another_size_is_named(rows: tuple[int, ...], where: str) -> None:
    with pytest.raises(InputError) as told:
        checked([30.0 if k in rows else 20.0 for k in range(12)])
    assert where in str(told.value)


def test_readings_without_a_size_are_not_tested() -> None:
    checked([float("nan")] * 12)


@pytest.fixture(scope="module")
def part(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample with images of four coded rings of 6 mm, and the true camera as a file."""
    folder = tmp_path_factory.mktemp("part")
    shutil.copytree(SAMPLES / "spindle-camera", folder, dirs_exist_ok=True)
    return folder / "jobs" / "align.yaml"


@pytest.mark.slow
def test_a_wrong_diameter_of_the_sample_is_refused(part: Path, metrocli: Metrocli) -> None:
    ran = metrocli("align-part", part, "--set", CAMERA, "--set", "pattern.diameter=6.3 mm")
    assert ran.code == 3
    assert "the images show targets of 5.9" in ran.err
    assert "where 6.3 mm is declared" in ran.err
    assert not (part.parent.parent / "results" / "part.h5").exists()


def test_the_right_diameter_of_the_sample_is_accepted(part: Path, metrocli: Metrocli) -> None:
    ran = metrocli("align-part", part, "--set", CAMERA)
    assert ran.code == 0, ran.err


PRINTED = """metrocli: 1
job: calibrate-camera
rig: board
inputs: {images: "IMAGES"}
pattern: {type: circles, columns: 10, rows: 8, pitch: 2.5 mm, diameter: 1.5 mm}
camera: {estimate: [f, cx, cy, k1, k2, p1, p2]}
noise: estimated
output: out.h5
"""


@pytest.mark.slow
@pytest.mark.parametrize(("diameter", "code"), [("1.5 mm", 0), ("1.65 mm", 3)])
def test_a_real_print_has_the_size_of_its_data_sheet(
    diameter: str, code: int, tmp_path: Path, metrocli: Metrocli
) -> None:
    images = SHARED / "data" / "sony-circles"
    if not images.is_dir():
        pytest.skip(f"{images} is absent")
    job = tmp_path / "job.yaml"
    job.write_text(PRINTED.replace("IMAGES", f"{images}/image0000[0-3].jpg"))
    ran = metrocli("calibrate-camera", job, "--set", f"pattern.diameter={diameter}")
    assert ran.code == code, ran.err
    assert ("where 1.65 mm is declared" in ran.err) == (code == 3)
