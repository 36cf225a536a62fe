"""Images show another kind of board than the job declares: the kind and its size are named, whatever is declared."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from metrocli.arrays import Array, Picture
from metrocli.targets import drawings, render
from metrocli.targets.likely_board import likely_board
from metrocli.targets.pattern import Pattern, pattern_points

BOARDS = {
    "chessboard": Pattern("chessboard", 9, 6, 25.0),
    "circles": Pattern("circles", 8, 6, 25.0, diameter=12.0),
    "asymmetric-circles": Pattern("asymmetric-circles", 4, 9, 20.0, diameter=14.0),
    "charuco": Pattern("charuco", 7, 5, 25.0, marker_size=18.75),
    "aprilgrid": Pattern("aprilgrid", 5, 4, 32.5, marker_size=25.0),
}
NAMED = {
    "circles": "is it type: circles, columns: 8, rows: 6?",
    "asymmetric-circles": "is it type: asymmetric-circles, columns: 4, rows: 9?",
    "chessboard": "is it type: chessboard, columns: 9, rows: 6?",
}


@cache
def pictures(kind: str) -> list[Picture]:
    """A tilted view of a board; that most of several images decide is tested with the jobs."""
    found, middle = [], pattern_points(BOARDS[kind])[1].mean(axis=0)

    def rays(uv: Array) -> Array:
        seen = np.column_stack([(uv - [320, 240]) / 640, np.ones(len(uv))])
        return np.asarray(seen / np.linalg.norm(seen, axis=1, keepdims=True))

    for seed in range(1):
        rng = np.random.default_rng(seed)
        turn = Rotation.from_euler("zxy", [rng.uniform(-0.3, 0.3), *rng.uniform(-0.35, 0.35, 2)]).as_matrix()
        scene = [render.PlacedDrawing(drawings.board(BOARDS[kind]), turn, np.array([0, 0, 420.0]) - turn @ middle)]
        found.append(render.render((640, 480), rays, scene, replace(render.Look(), noise=2.0), rng))
    return found


@pytest.mark.alike
@pytest.mark.parametrize("declared", BOARDS)
@pytest.mark.parametrize("shown", ["circles", "asymmetric-circles"])
def test_circles_are_named_with_their_size(shown: str, declared: str) -> None:
    named = likely_board(BOARDS[declared], pictures(shown))
    assert (NAMED[shown] in named) is (shown != declared), named


@pytest.mark.slow
@pytest.mark.alike
@pytest.mark.parametrize("declared", ["circles", "asymmetric-circles"])
def test_a_chessboard_is_named_where_circles_are_declared(declared: str) -> None:
    assert NAMED["chessboard"] in likely_board(BOARDS[declared], pictures("chessboard"))
