"""Cameras of other programs: written so that they read them, and read back with the same digits."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from tasks.shared.images import small_jobs

from metrocli.instruments.lens import image_point

Metrocli = Callable[..., Any]


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from metrocli.cli.commands import run

    folder = tmp_path_factory.mktemp("camera")
    job = small_jobs.board(folder)
    assert run(["calibrate-camera", str(job), "--set", "camera.estimate=[fx, fy, cx, cy, k1, k2]", "--quiet"]) in (0, 6)
    return folder / "camera.h5"


def numbers(text: str) -> list[float]:
    return [float(one) for one in re.findall(r"-?[0-9]+\.?[0-9]*(?:e-?[0-9]+)?", text)]


def test_opencv_projects_as_the_result_does(calibrated: Path, tmp_path: Path, metrocli: Metrocli) -> None:
    assert metrocli("export", calibrated, "--to", "opencv", "--out", tmp_path, "--accept-doubtful").code == 0
    stored = cv2.FileStorage(str(tmp_path / "opencv.yml"), cv2.FILE_STORAGE_READ)
    matrix, shift = stored.getNode("camera_matrix").mat(), stored.getNode("distortion_coefficients").mat()
    x, y = np.array([0.1, -0.2, 0.05]), np.array([-0.1, 0.15, 0.2])
    theirs = cv2.projectPoints(np.stack([x, y, np.ones(3)], axis=1), np.zeros(3), np.zeros(3), matrix, shift)[0][:, 0]
    assert metrocli("import", tmp_path / "opencv.yml", "--from", "opencv", "--out", tmp_path).code == 0
    rows = [line.split(": ") for line in (tmp_path / "camera.yaml").read_text().splitlines() if line[0] in "fckp"]
    ours = image_point({name: float(value.split()[0]) for name, value in rows}, x, y)
    assert np.abs(np.stack(ours, axis=1) - theirs).max() < 1e-9


@pytest.mark.parametrize(("form", "name"), [("ros", "ros.yaml"), ("colmap", "cameras.txt")])
def test_what_is_written_is_read_back(
    form: str, name: str, calibrated: Path, tmp_path: Path, metrocli: Metrocli
) -> None:
    read = {}
    for one, file in ((form, name), ("opencv", "opencv.yml")):
        assert metrocli("export", calibrated, "--to", one, "--out", tmp_path / one, "--accept-doubtful").code == 0
        assert metrocli("import", tmp_path / one / file, "--from", one, "--out", tmp_path / one).code == 0
        read[one] = numbers((tmp_path / one / "camera.yaml").read_text().partition("\n")[2])
    shortest = min(map(len, read.values()))
    assert read[form][:shortest] == pytest.approx(read["opencv"][:shortest], abs=1e-9)


def test_colmap_has_its_pixel_centres_half_a_pixel_on(calibrated: Path, tmp_path: Path, metrocli: Metrocli) -> None:
    for form in ("colmap", "mrcal", "kalibr"):
        assert metrocli("export", calibrated, "--to", form, "--out", tmp_path, "--accept-doubtful").code == 0
    of_colmap = numbers((tmp_path / "cameras.txt").read_text().splitlines()[1])
    of_mrcal = numbers((tmp_path / "camera.cameramodel").read_text().partition("intrinsics'")[2])
    assert np.subtract(of_colmap[5:7], of_mrcal[2:4]) == pytest.approx([0.5, 0.5])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1 SIMPLE_RADIAL 640 480 500 320 240 0.1\n", "the model SIMPLE_RADIAL"),
        ("image_width: 640\nimage_height: 480\n", "the file lacks camera_matrix with 9 numbers"),
        (
            "image_width: 640\nimage_height: 480\ncamera_matrix:\n  data: [1, 0, 1, 0, 1, 1, 0, 0, 1]\n"
            "distortion_model: equidistant\ndistortion_coefficients:\n  data: [1, 0, 0, 0]\n",
            "'equidistant' is not OpenCV's",
        ),
    ],
)
def test_other_models_are_refused(text: str, words: str, tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "camera.txt").write_text(text)
    ran = metrocli("import", tmp_path / "camera.txt", "--from", "colmap" if "SIMPLE" in text else "ros")
    assert ran.code == 3 and words in ran.err
