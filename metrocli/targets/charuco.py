"""Inner corners of a ChArUco board.

It is a chessboard with markers in its bright squares. They identify the corners, so a part of the board is enough.

Method: docs/algorithms/target-detection.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np

from metrocli.arrays import Array, Picture
from metrocli.targets.blobs import eight_bit
from metrocli.targets.find import FoundTargets, nothing, points
from metrocli.targets.lattice import homography, order_fault, projected
from metrocli.targets.pattern import DICTIONARIES, Pattern, lattice, names
from metrocli.targets.saddles import WINDOW, fit_grid

FEWEST = 6
"""Corners that must be found before their order can be checked."""
CLEARANCE = 0.9
"""Share of the gap between a corner and the next marker from which grey values are taken."""


def find(pattern: Pattern, picture: Picture) -> FoundTargets:
    """Return the corners that the markers identify, fitted to the edges of the squares, or nothing with the reason.

    OpenCV only supplies the names of the corners, because its image coordinates have moved by half a pixel between
    versions.
    """
    seen = eight_bit(picture)
    corners, ids, _, markers = cv2.aruco.CharucoDetector(_board(pattern)).detectBoard(seen)
    if ids is None or len(ids) < FEWEST:
        message = f"no ChArUco board: {0 if ids is None else len(ids)} corners found, {FEWEST} are needed"
        other = _other_board(pattern, seen, 0 if markers is None else len(markers))
        return nothing(f"{message}; {other}" if other else message)
    ids, start = np.asarray(ids).ravel(), np.asarray(corners, dtype=float).reshape(-1, 2)
    steps = lattice(pattern)
    reason = order_fault(steps[ids], start)
    if reason:
        return nothing(f"no ChArUco board: {reason}")
    rows, columns = pattern.shape
    everywhere = projected(homography(steps[ids].astype(float), start), steps.astype(float))
    everywhere[ids] = start
    fitted, sigma = fit_grid(picture, everywhere.reshape(rows, columns, 2), _window(pattern))
    uv, spread = fitted.reshape(-1, 2)[ids], sigma.ravel()[ids]
    good = np.isfinite(spread)
    named = names(pattern)
    return points([named[place] for place in ids[good]], uv[good], spread[good])


def _other_board(pattern: Pattern, seen: Picture, markers: int) -> str:
    """Return which other board the image shows, and what to write; empty if none of those tried.

    Where markers are found, their layout is another one; else they are of another dictionary.
    """
    count = 0
    for other, write in _layouts(pattern) if markers >= FEWEST else _dictionaries(pattern):
        ids = cv2.aruco.CharucoDetector(_board(other)).detectBoard(seen)[1]
        count = 0 if ids is None else len(ids)
        if count >= FEWEST:
            return f"with `{write}` there are {count}"
    hint = "check columns, rows and dictionary" if markers else "check the dictionary, or is there no board?"
    return f"{markers} markers of {pattern.dictionary} are found: {hint}"


def _layouts(pattern: Pattern) -> Iterator[tuple[Pattern, str]]:
    rows, columns = pattern.shape
    for legacy in (pattern.legacy, not pattern.legacy):
        words = f", legacy: {str(legacy).lower()}" if legacy != pattern.legacy else ""
        if words:
            yield replace(pattern, legacy=legacy), words.removeprefix(", ")
        for n, m in ((columns, rows), (rows - 1, columns - 1), (columns - 1, rows - 1)):
            if n > 1 and m > 1 and (n, m) != (rows, columns):
                yield replace(pattern, rows=n, columns=m, legacy=legacy), f"columns: {m}, rows: {n}{words}"


def _dictionaries(pattern: Pattern) -> Iterator[tuple[Pattern, str]]:
    for name in DICTIONARIES:
        other = name[0] != pattern.dictionary[0] or not name[0].isdigit()
        if other and name != pattern.dictionary and not name.endswith(("_50", "_100", "_1000")):
            for legacy in (pattern.legacy, not pattern.legacy):
                words = f", legacy: {str(legacy).lower()}" if legacy != pattern.legacy else ""
                yield replace(pattern, dictionary=name, legacy=legacy), f"dictionary: {name}{words}"


def artwork(pattern: Pattern) -> tuple[Array, int]:
    """Return the board as cells (rows, columns), 1 where ink is, and the number of cells along a square.

    Raises ValueError if a square is not a whole number of the marker's cells.
    """
    rows, columns = pattern.shape
    marker = _dictionary(pattern.dictionary).markerSize + 2
    _, length = _sizes(pattern)
    count = round(marker / length)
    if abs(count * length - marker) > 1e-6 * marker or (count - marker) % 2:
        raise ValueError("the marker's cells do not fill a square evenly: this board cannot be drawn")
    image = _board(pattern).generateImage(((columns + 1) * count, (rows + 1) * count), marginSize=0)
    return (np.asarray(image) < 128).astype(float), count


def _board(pattern: Pattern) -> cv2.aruco.CharucoBoard:
    rows, columns = pattern.shape
    square, marker = _sizes(pattern)
    board = cv2.aruco.CharucoBoard((columns + 1, rows + 1), square, marker, _dictionary(pattern.dictionary))
    board.setLegacyPattern(pattern.legacy)
    return board


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name.upper()}"))


def markers_in(picture: Picture) -> tuple[str, int]:
    """Return the dictionary of which an image shows the most markers, and their number."""
    seen, counts = eight_bit(picture), dict[str, int]()
    for name in DICTIONARIES:
        if not name.endswith(("_50", "_100", "_1000")):
            ids = cv2.aruco.ArucoDetector(_dictionary(name)).detectMarkers(seen)[1]
            counts[name] = 0 if ids is None else len(ids)
    return max(counts.items(), key=lambda count: count[1])


def _sizes(pattern: Pattern) -> tuple[float, float]:
    """Return the sides of a square (1) and of a marker, in units of the square."""
    if pattern.pitch is None or pattern.marker_size is None:
        raise ValueError("a ChArUco board needs pitch and marker_size")
    return 1.0, pattern.marker_size / pattern.pitch


def _window(pattern: Pattern) -> float:
    """Return the half-width of the fit's window in squares: it must not reach a marker."""
    square, marker = _sizes(pattern)
    return min(WINDOW, CLEARANCE * (square - marker) / 2)
