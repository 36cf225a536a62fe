"""Images that are wrong are named; nothing is written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from places import SAMPLES
from tasks.shared.images import small_jobs

Metrocli = Callable[..., Any]
SAMPLE = SAMPLES / "board-camera"


def picture(path: Path, width: int, height: int) -> None:
    path.parent.mkdir(exist_ok=True)
    grey = 100 + sum(path.name.encode()) % 50  # no image is a copy of another one
    cv2.imwrite(str(path), np.full((height, width), grey, dtype=np.uint8))


@pytest.fixture
def board(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A calibration with four images of the chessboard sample."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "img").mkdir()
    for i in range(1, 5):
        (tmp_path / "img" / f"view{i}.png").write_bytes((SAMPLE / "images" / f"view{i:02d}.png").read_bytes())
    (tmp_path / "job.yaml").write_text(
        "metrocli: 1\njob: calibrate-camera\nrig: board\ninputs: {images: img/*.png}\n"
        "pattern: {type: chessboard, columns: 9, rows: 6, pitch: 25 mm}\n"
        "camera: {estimate: [f, cx, cy, k1]}\nnoise: estimated\noutput: camera.h5\n"
    )
    return tmp_path


def test_an_image_without_the_board_is_named_and_left_out(board: Path, metrocli: Metrocli) -> None:
    picture(board / "img" / "wall.png", 640, 480)
    ran = metrocli("calibrate-camera", "job.yaml", "--json")
    assert ran.code == 0, ran.err
    assert '"images": 4' in ran.out
    assert "wall.png: " in ran.err


def test_no_board_in_any_image(board: Path, metrocli: Metrocli) -> None:
    for path in (board / "img").iterdir():
        picture(path, 640, 480)
    ran = metrocli("calibrate-camera", "job.yaml")
    assert ran.code == 3
    assert "no target found in any of 4 images" in ran.err
    assert not (board / "camera.h5").exists()


def test_images_of_two_sizes(board: Path, metrocli: Metrocli) -> None:
    picture(board / "img" / "view5.png", 480, 640)
    ran = metrocli("calibrate-camera", "job.yaml")
    assert ran.code == 3
    assert "view5.png" in ran.err
    assert "480" in ran.err and "640" in ran.err
    assert not (board / "camera.h5").exists()


def test_images_of_another_size_than_the_job_says(board: Path, metrocli: Metrocli) -> None:
    ran = metrocli("calibrate-camera", "job.yaml", "--set", "camera.image_size=[2592,1944]")
    assert ran.code == 3, ran.err
    assert "640 x 480" in ran.err and "2592 x 1944" in ran.err
    assert not (board / "camera.h5").exists()


def test_an_image_cut_short(board: Path, metrocli: Metrocli) -> None:
    whole = (board / "img" / "view3.png").read_bytes()
    (board / "img" / "view3.png").write_bytes(whole[: len(whole) // 2])
    ran = metrocli("calibrate-camera", "job.yaml")
    assert ran.code == 3, ran.err
    assert "view3.png" in ran.err
    assert "Traceback" not in ran.err
    assert not (board / "camera.h5").exists()


def test_images_of_another_size_than_the_calibrated_camera(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, metrocli: Metrocli
) -> None:
    job = small_jobs.align(tmp_path)
    monkeypatch.chdir(tmp_path)
    for i in range(8):
        picture(tmp_path / "img" / f"image{i + 1}.png", 640, 480)
    told = job.read_text().replace("observations: observations.csv", "images: img/*.png")
    job.write_text(told + "pattern: {type: coded-rings, diameter: 6 mm}\n")
    ran = metrocli("align-part", "job.yaml")
    assert ran.code == 3
    assert "the images are 640 x 480 px, the camera was calibrated with 2592 x 1944 px" in ran.err
    assert not (tmp_path / "part.h5").exists()
