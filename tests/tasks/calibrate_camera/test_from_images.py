"""A calibration without a job file: images and a board on the command line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from metrocli.errors import UsageError
from metrocli.tasks.calibrate_camera.settings import job_of

Metrocli = Callable[..., Any]
SIZE = (640, 480)
MATRIX = np.array([[700.0, 0, 320], [0, 700, 235], [0, 0, 1]])


@pytest.fixture
def images(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Six images of a chessboard with 7 x 5 inner corners, by homographies of a drawing."""
    monkeypatch.chdir(tmp_path)
    # where another board is sought: markers of all dictionaries take seconds an image
    monkeypatch.setattr("metrocli.targets.charuco.DICTIONARIES", ("4x4_250",))
    (tmp_path / "img").mkdir()
    cell, margin = 40, 40
    board = np.full((6 * cell + 2 * margin, 8 * cell + 2 * margin), 230, np.uint8)
    for row, column in np.argwhere(np.indices((6, 8)).sum(0) % 2 == 0):
        y, x = margin + row * cell, margin + column * cell
        board[y : y + cell, x : x + cell] = 30
    to_mm = np.array([[25 / cell, 0, -100 - 25 * margin / cell], [0, 25 / cell, -75 - 25 * margin / cell], [0, 0, 1]])
    for i, (a, b) in enumerate([(0.0, 0.1), (0.5, 0.1), (-0.5, 0.0), (0.1, 0.5), (0.0, -0.5), (0.4, 0.4)]):
        turn = cv2.Rodrigues(np.array([a, b, 0.2 * i]))[0]
        pose = np.column_stack([turn[:, 0], turn[:, 1], [5.0 * i - 10, 5, 420]])
        picture = cv2.warpPerspective(board, MATRIX @ pose @ to_mm, SIZE, flags=cv2.INTER_AREA, borderValue=(200,))
        cv2.imwrite(str(tmp_path / f"img/{i}.png"), cv2.GaussianBlur(picture, (0, 0), 0.8))
    return tmp_path


def test_one_line_calibrates_and_leaves_the_job(images: Path, metrocli: Metrocli) -> None:
    ran = metrocli("calibrate-camera", "--images", "img/*.png", "--board", "chessboard 7x5 25 mm")
    assert ran.code == 0, ran.err
    assert 'images: "img/*.png"' in (images / "camera.yaml").read_text() and (images / "camera.h5").exists()
    assert "noise: structured" in (images / "camera.yaml").read_text() and "cluster-robust over 6 images" in ran.out
    again = metrocli("check", "camera.yaml")
    assert again.code == 0, again.err
    other = metrocli(
        "calibrate-camera", "--images", "img/*.png", "--board", "chessboard 9x6 25 mm", "--output", "a/b.h5"
    )
    assert other.code == 3 and "they show 7 x 5: is it columns: 7, rows: 5?" in other.err
    assert 'images: "../img/*.png"' in (images / "a/b.yaml").read_text() and not (images / "a/b.h5").exists()


def test_few_images_have_white_noise(images: Path, metrocli: Metrocli) -> None:
    (images / "img/4.png").unlink(), (images / "img/5.png").unlink()
    ran = metrocli("calibrate-camera", "--images", "img/*.png", "--board", "chessboard 7x5 25 mm")
    assert ran.code == 0 and "noise: estimated" in (images / "camera.yaml").read_text(), ran.err


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--images", "*.jpg", "--board", "chessboard 7x5 25 mm"], 3, "no file matches '*.jpg'"),
        (["--images", "*.jpg"], 2, "name a job file, or describe the job by --images and --board"),
        (["a.jpg", "--images", "b.jpg"], 2, "put a pattern of file names in quotes"),
        (["--images", "*.jpg", "--board", "chesboard 7x5 25 mm"], 2, "did you mean 'chessboard'?"),
        (["--images", "*.jpg", "--board", "chessboard 7x5"], 2, "is not type, columns x rows, pitch"),
    ],
)
def test_words_that_describe_no_job(
    arguments: list[str], code: int, words: str, tmp_path: Path, metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    ran = metrocli("calibrate-camera", *arguments)
    assert ran.code == code and words in ran.err


def test_boards_in_words() -> None:
    text = job_of("a.png", "charuco 11x8 15 mm 11.2mm apriltag_36h11", "r.h5", 9)
    assert (
        "{type: charuco, columns: 11, rows: 8, pitch: 15 mm, marker_size: 11.2 mm, dictionary: apriltag_36h11}" in text
    )
    assert "pitch: 25 mm, diameter: 15 mm}" in job_of("a.png", "circles 10x8 25 mm 15 mm", "r.h5", 9)
    with pytest.raises(UsageError, match="is not type"):
        job_of("a.png", "chessboard 9x6 25 mm 3 mm", "r.h5", 9)
