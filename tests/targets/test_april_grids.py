"""AprilTag grids as Kalibr's script prints them, drawn here cell by cell from the codes of the tags."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from metrocli.targets.find import find
from metrocli.targets.likely_board import likely_board
from metrocli.targets.pattern import Pattern, pattern_points

Array = npt.NDArray[np.float64]
CODES = (0xD5D628584, 0xD97F18B49, 0xDD280910E, 0xE479E9C98, 0xEBCBCA822, 0xF31DAB3AC, 0x056A5D085, 0x10652E1D4)
CODES += (0x22B1DFEAD, 0x265AD0472, 0x34FE91B86, 0x3FF962CD5)
"""Family 36h11"""
GRID = Pattern("aprilgrid", 4, 3, 26.0, marker_size=20.0)
"""Three rows of four tags; a cell is 2 mm, the squares between tags are 6 mm"""


def printed() -> Array:
    """Cells of the grid with the squares around it, 1 where ink is; tag 0 is at the lower left."""
    cells = np.zeros((3 * 13 + 3, 4 * 13 + 3))
    for number, code in enumerate(CODES):
        bits = np.array([[not code >> (6 * i + j) & 1 for j in range(6)] for i in range(6)])
        top, left = (2 - number // 4) * 13 + 3, number % 4 * 13 + 3
        cells[top : top + 10, left : left + 10] = np.pad(np.rot90(bits, 2), 2, constant_values=1)
        for row in (top - 3, top + 10):
            for column in (left - 3, left + 10):
                cells[row : row + 3, column : column + 3] = 1
    return cells


def seen(cells: Array, turn: float) -> tuple[npt.NDArray[np.uint8], Array]:
    """Image of the cells on paper, from the side, and the homography from mm on the board to pixels."""
    c, s = np.cos(turn), np.sin(turn)
    middle = np.array([[1, 0, -49.0], [0, 1, -36.0], [0, 0, 1]])
    into = np.array([[4.2 * c, -4.2 * s, 330], [3.9 * s, 3.9 * c, 250], [4e-4, -7e-4, 1.0]]) @ middle
    fine = np.repeat(np.repeat(np.pad(cells, 2), 16, axis=0), 16, axis=1)
    # a fine pixel is 2 / 16 mm; the paper begins 2 cells before the first square, which begins 6 mm before tag 3
    to_board = np.array([[0.125, 0, -10 + 0.0625], [0, 0.125, -10 + 0.0625], [0, 0, 1]])
    larger = np.array([[4, 0, 1.5], [0, 4, 1.5], [0, 0, 1.0]])
    large = cv2.warpPerspective(220 - 180 * fine, larger @ into @ to_board, (2640, 2000), borderValue=220)
    image = cv2.GaussianBlur(large, (0, 0), 2.4).reshape(500, 4, 660, 4).mean(axis=(1, 3))
    return np.rint(image).astype(np.uint8), into


@pytest.mark.parametrize("turn", [2.0, *(pytest.param(turn, marks=pytest.mark.slow) for turn in (0.2, 4.4))])
def test_the_grid_of_kalibr_is_found_however_it_lies(turn: float) -> None:
    image, into = seen(printed(), turn)
    found = find(GRID, image)
    names, board = pattern_points(GRID)
    flat = np.column_stack([board[:, :2], np.ones(len(board))]) @ into.T
    truth = dict(zip(names, flat[:, :2] / flat[:, 2:], strict=True))
    assert set(found.targets) == set(names), found.reason
    assert np.abs(found.uv - [truth[name] for name in found.targets]).max() < 0.03


def test_a_part_of_the_grid_is_enough() -> None:
    cells = printed()
    cells[:, :14] = 0.0
    found = find(GRID, seen(cells, 0.2)[0])
    assert {name[3:] for name in found.targets} == {f"c{column:02d}" for column in range(2, 8)}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pattern", "words"),
    [
        (Pattern("aprilgrid", 3, 4, 26.0, marker_size=20.0), "check columns and rows, which count tags"),
        (Pattern("charuco", 4, 3, 26.0, marker_size=20.0), "no ChArUco board"),
    ],
)
def test_another_board_is_refused(pattern: Pattern, words: str) -> None:
    found = find(pattern, seen(printed(), 0.2)[0])
    assert not len(found) and words in found.reason


def test_a_grid_that_is_no_chessboard_is_named() -> None:
    image = seen(printed(), 0.2)[0]
    assert "type: aprilgrid" in likely_board(Pattern("chessboard", 9, 6, 25.0), [image])
    assert not likely_board(Pattern("aprilgrid", 3, 4, 26.0, marker_size=20.0), [image])
