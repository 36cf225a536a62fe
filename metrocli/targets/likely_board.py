"""The board that images show where the pattern of the job is not found in them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import product

import cv2
import numpy as np

from metrocli.arrays import Picture
from metrocli.targets import blobs
from metrocli.targets.aprilgrid import tags_in
from metrocli.targets.charuco import FEWEST, are_among_squares, count_markers, markers_in, other_layout
from metrocli.targets.chessboard import shown_size
from metrocli.targets.circles import shown_grids
from metrocli.targets.find import find
from metrocli.targets.pattern import Pattern

_SIDE = 1000
"""Chessboards are searched in images reduced to about this longer side, in pixels"""
_SHARE = 0.5
"""A board is likely if more than this share of the images shows it"""
_TAGS = 4
"""Fewest tags in an image of an AprilTag grid"""


def likely_board(pattern: Pattern, pictures: Iterable[Picture]) -> str:
    """Return the board that most pictures show and the keys to write for it; empty if none is likely.

    The search for markers takes seconds a picture: one picture decides where there is a chessboard.
    """
    reduced = [_reduced(picture) for picture in pictures]
    if sum(len(tags_in(picture)[0]) >= _TAGS for picture in reduced) > _SHARE * len(reduced):
        own = pattern.type == "aprilgrid"  # its search has named what does not fit
        return "" if own else "AprilTags with a border of two cells: is it type: aprilgrid?"
    circles = pattern.type in ("circles", "asymmetric-circles")
    for place, picture in enumerate(reduced):
        if marked := _marked(pattern, picture, reduced):
            return marked
        # circles first: what is between them looks like corners of a chessboard
        if place == 0 and (grid := _other_circles(pattern, reduced)):
            return grid
        if place == 0 and circles and (size := _likely_circles(pattern, reduced)):
            return _in_words(size, "")
        if place == 0 and (chess := _chessboard(pattern, reduced)):
            return chess
    if circles and (count := _shown_circles(pattern, reduced)):
        return f"{count} circles, and the pattern of the job has {pattern.shape[0] * pattern.shape[1]}"
    return ""


def _chessboard(pattern: Pattern, pictures: Sequence[Picture]) -> str:
    """Return the chessboard that most pictures show, if its corners are found."""
    sizes = [shown_size(picture) for picture in pictures]
    size = max(filter(None, sizes), key=sizes.count, default=None)
    if size is None or sizes.count(size) <= _SHARE * len(pictures):
        return ""
    board = Pattern("chessboard", columns=size[0], rows=size[1], pitch=1.0)
    shown = [picture for picture, seen in zip(pictures, sizes, strict=True) if seen == size]
    if not any(len(find(board, picture)) for picture in shown):
        return ""
    return _in_words(size, "" if pattern.type == "chessboard" else "type: chessboard, ")


def _marked(pattern: Pattern, picture: Picture, pictures: Sequence[Picture]) -> str:
    """Return the board of the markers that a picture shows, if most pictures show markers of their dictionary."""
    name = markers_in(picture)
    if not name or sum(count_markers(other, name) >= FEWEST for other in pictures) <= _SHARE * len(pictures):
        return ""
    if not are_among_squares(picture, name):
        return f"markers of {name} with no squares between them: a grid of markers is not a board of `pattern`"
    if pattern.type == "charuco":
        return other_layout(pattern, picture, name) or f"markers of {name}: check columns and rows"
    return f"markers of {name}: is it type: charuco, dictionary: {name}?"


def _in_words(size: tuple[int, int], kind: str) -> str:
    return f"{size[0]} x {size[1]}: is it {kind}columns: {size[0]}, rows: {size[1]}?"


def _likely_circles(pattern: Pattern, pictures: Sequence[Picture]) -> tuple[int, int] | None:
    """Return columns and rows of the grid that most pictures show; None if none fits.

    Sizes are tried that are at most one off in each, and those with columns and rows exchanged.

    Of sizes that equally many pictures show, the largest counts: a grid contains all smaller ones.
    """
    rows, columns = pattern.shape
    both = ((columns, rows), (rows, columns))
    near = {(n + c, m + r) for n, m in both for c, r in product((-1, 0, 1), repeat=2)}
    sizes = sorted(near - {(columns, rows)})
    counts: dict[tuple[int, int], int] = {}
    for size in sorted((shape for shape in sizes if min(shape) >= 2), key=lambda shape: -shape[0] * shape[1]):
        other = replace(pattern, columns=size[0], rows=size[1])
        counts[size] = sum(len(find(other, picture)) > 0 for picture in pictures)
        if counts[size] == len(pictures):  # no smaller grid can be more likely
            break
    best = max(counts, key=lambda size: (counts[size], size[0] * size[1]))
    return best if pictures and counts[best] > _SHARE * len(pictures) else None


def _other_circles(pattern: Pattern, pictures: Sequence[Picture]) -> str:
    """Return the grid of circles, of whatever kind and size, that most pictures show; empty if none is found there."""
    own = (pattern.type, *pattern.shape)
    for first in pictures[:1]:
        grids = [grid for grid in shown_grids(first) if (grid.type, *grid.shape) != own]
        for grid in sorted(grids, key=lambda grid: -grid.shape[0] * grid.shape[1]):
            if sum(len(find(grid, picture)) > 0 for picture in pictures) > _SHARE * len(pictures):
                kind = "" if grid.type == pattern.type else f"type: {grid.type}, "
                return _in_words((grid.shape[1], grid.shape[0]), kind)
    return ""


def _shown_circles(pattern: Pattern, pictures: Sequence[Picture]) -> int:
    """Return how many circles a picture shows, the middle one of all; 0 if they are few."""
    polarities = ("dark", "bright") if pattern.polarity == "either" else (pattern.polarity,)
    counts = sorted(max(len(blobs.ellipses(picture, sign)) for sign in polarities) for picture in pictures)
    middle = counts[len(counts) // 2] if counts else 0
    return middle if middle >= _SHARE * pattern.shape[0] * pattern.shape[1] else 0


def _reduced(picture: Picture) -> Picture:
    factor = max(picture.shape) // _SIDE
    if factor < 2:
        return picture
    size = (picture.shape[1] // factor, picture.shape[0] // factor)
    smaller = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return smaller.astype(np.uint16) if picture.dtype == np.uint16 else smaller.astype(np.uint8)
