"""A ChArUco board that is not the one of the job is named, with what to write."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from metrocli.targets.aprilgrid import artwork
from metrocli.targets.charuco import _board, other_layout
from metrocli.targets.find import find
from metrocli.targets.likely_board import likely_board
from metrocli.targets.pattern import Pattern

BOARD = Pattern("charuco", columns=7, rows=5, pitch=35.0, marker_size=24.0, dictionary="4x4_50")


def picture(pattern: Pattern) -> np.ndarray[tuple[int, int], np.dtype[np.uint8]]:
    rows, columns = pattern.shape
    image = _board(pattern).generateImage(((columns + 1) * 50, (rows + 1) * 50), marginSize=30)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 1.0), dtype=np.uint8)


@pytest.mark.parametrize(
    ("changed", "write"),
    [
        ({"columns": 5, "rows": 7}, "columns: 7, rows: 5"),
        pytest.param({"columns": 8, "rows": 6}, "columns: 7, rows: 5", marks=pytest.mark.slow),
        ({"columns": 8, "rows": 5}, "columns: 7, rows: 5"),
        pytest.param({"legacy": True}, "legacy: false", marks=pytest.mark.slow),
        ({"dictionary": "5x5_50"}, "dictionary: 4x4_250"),
    ],
)
def test_what_to_write(changed: dict[str, object], write: str) -> None:
    assert len(find(BOARD, picture(BOARD))) == 35
    other = replace(BOARD, **changed)  # type: ignore[arg-type]
    assert not len(find(other, picture(BOARD)))
    assert likely_board(other, [picture(BOARD)]) == f"a ChArUco board: with `{write}` there are 35 corners"


def test_markers_are_sought_once_for_all_layouts(monkeypatch: pytest.MonkeyPatch) -> None:
    sought = []

    whole = cv2.aruco.CharucoDetector

    class Counted:
        def __init__(self, board: Any) -> None:
            self.whole = whole(board)

        def detectBoard(self, *args: Any, **named: Any) -> Any:
            sought.append("markerCorners" in named)
            return self.whole.detectBoard(*args, **named)

    monkeypatch.setattr(cv2.aruco, "CharucoDetector", Counted)
    assert "columns: 7, rows: 5" in other_layout(replace(BOARD, columns=5, rows=7), picture(BOARD), "4x4_250")
    assert len(sought) > 30 and all(sought)


def test_an_image_without_markers_is_not_a_matter_of_layout() -> None:
    found = find(BOARD, np.full((480, 640), 128, np.uint8))
    assert "0 markers of 4x4_50 are found" in found.reason and "legacy" not in found.reason


def test_its_inner_corners_are_not_called_a_chessboard() -> None:
    legacy = replace(BOARD, legacy=True)
    assert "type: charuco" in likely_board(Pattern("chessboard", 9, 6, 25.0), [picture(BOARD)])
    chess = np.kron(np.indices((7, 10)).sum(axis=0) % 2, np.full((40, 40), 255)).astype(np.uint8)
    chess = cv2.copyMakeBorder(chess, 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=255)
    assert "type: chessboard" in likely_board(legacy, [np.asarray(chess, dtype=np.uint8)])


def test_a_grid_of_markers_is_no_charuco_board() -> None:
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    grid = cv2.aruco.GridBoard((5, 4), 30.0, 6.0, markers).generateImage((600, 510), marginSize=30)
    board = cv2.aruco.CharucoBoard((6, 5), 30.0, 22.0, markers).generateImage((600, 510), marginSize=30)
    told = [likely_board(Pattern("chessboard", columns=9, rows=6, pitch=10.0), [seen] * 2) for seen in (grid, board)]
    assert told[0] == "markers of 5x5_250 with no squares between them: a grid of markers is not a board of `pattern`"
    assert "type: charuco" in told[1]


def test_a_mirrored_image_is_named() -> None:
    grid = Pattern("aprilgrid", 4, 3, 26.0, marker_size=20.0)
    cells, _ = artwork(grid)
    tags = np.kron(np.pad(1 - cells, 4, constant_values=1), np.full((9, 9), 255)).astype(np.uint8)
    for pattern, image in ((BOARD, picture(BOARD)), (grid, tags)):
        assert len(find(pattern, image)) > 20
        assert "the image is mirrored" in find(pattern, np.ascontiguousarray(image[:, ::-1])).reason
        assert "mirrored" not in find(pattern, np.full_like(image, 128)).reason
