"""Images without a board end in seconds, whatever they show; a large one is sought reduced."""

from __future__ import annotations

import time
from collections.abc import Callable

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from metrocli.targets.chessboard import MOST_PIXELS
from metrocli.targets.find import find
from metrocli.targets.pattern import Pattern

Grey = npt.NDArray[np.uint8]
BOARD = Pattern("chessboard", columns=9, rows=6, pitch=25.0)


def noise() -> Grey:
    return np.random.default_rng(0).integers(0, 256, (1600, 1600), dtype=np.uint8)


def fine_squares() -> Grey:
    return np.asarray((np.indices((1600, 1600)) // 8).sum(axis=0) % 2 * 255, dtype=np.uint8)


def blank() -> Grey:
    return np.full((9000, 9000), 200, np.uint8)


@pytest.mark.alike
@pytest.mark.parametrize("image", [noise, fine_squares, blank])
def test_a_search_in_vain_ends(image: Callable[[], Grey]) -> None:
    """OpenCV's search alone takes 20 to 100 s of CPU for each."""
    picture = image()
    begun = time.process_time()
    assert not len(find(BOARD, picture))
    assert time.process_time() - begun < 5


def test_a_board_in_a_large_image_is_found_where_it_is() -> None:
    """The corners come from the image itself, the reduced one only leads to them."""
    squares = np.kron(np.indices((7, 10)).sum(axis=0) % 2, np.ones((450, 450))) * 200 + 30
    picture = np.full((4500, 6000), 230, np.uint8)
    picture[600:3750, 700:5200] = squares
    picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), 1.5), dtype=np.uint8)
    assert max(picture.shape) > 2000 and picture.size < MOST_PIXELS
    found = find(BOARD, picture)
    expected = np.array([[700 + 450 * (c + 1) - 0.5, 600 + 450 * (r + 1) - 0.5] for r in range(6) for c in range(9)])
    assert len(found) == 54
    assert np.abs(found.uv - expected).max() < 0.05
