"""Inner corners of a ChArUco board.

It is a chessboard with markers in its bright squares. They identify the corners, so a part of the board is enough.

Method: docs/algorithms/target-detection.md.
"""

from __future__ import annotations

import cv2
import numpy as np

from metrocli.arrays import Array, Picture
from metrocli.targets.blobs import eight_bit
from metrocli.targets.find import Sightings, nothing, points
from metrocli.targets.lattice import homography, order_fault, projected
from metrocli.targets.pattern import Pattern, lattice, names
from metrocli.targets.saddles import WINDOW, fit_grid

FEWEST = 6
"""Corners that must be found before their order can be checked."""
CLEARANCE = 0.9
"""Share of the gap between a corner and the next marker from which grey values are taken."""


def find(pattern: Pattern, picture: Picture) -> Sightings:
    """Return the corners that the markers identify, fitted to the edges of the squares, or nothing with the reason.

    OpenCV only supplies the names of the corners, because its image coordinates have moved by half a pixel between
    versions.
    """
    detector = cv2.aruco.CharucoDetector(_board(pattern))
    corners, ids = detector.detectBoard(eight_bit(picture))[:2]
    if ids is None or len(ids) < FEWEST:
        return nothing(f"no ChArUco board: {0 if ids is None else len(ids)} corners found, {FEWEST} are needed")
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
    return points([names(pattern)[place] for place in ids[good]], uv[good], spread[good])


def artwork(pattern: Pattern) -> tuple[Array, int]:
    """Return the board as cells (rows, columns), 1 where ink is, and the number of cells along a square.

    Raises ValueError if a square is not a whole number of the marker's cells.
    """
    rows, columns = pattern.shape
    marker = int(pattern.dictionary[0]) + 2
    _, length = _sizes(pattern)
    count = round(marker / length)
    if abs(count * length - marker) > 1e-6 * marker or (count - marker) % 2:
        raise ValueError("the marker's cells do not fill a square evenly: this board cannot be drawn")
    image = _board(pattern).generateImage(((columns + 1) * count, (rows + 1) * count), marginSize=0)
    return (np.asarray(image) < 128).astype(float), count


def _board(pattern: Pattern) -> cv2.aruco.CharucoBoard:
    rows, columns = pattern.shape
    number = getattr(cv2.aruco, f"DICT_{pattern.dictionary.upper()}")
    square, marker = _sizes(pattern)
    return cv2.aruco.CharucoBoard((columns + 1, rows + 1), square, marker, cv2.aruco.getPredefinedDictionary(number))


def _sizes(pattern: Pattern) -> tuple[float, float]:
    """Return the sides of a square (1) and of a marker, in units of the square."""
    if pattern.pitch is None or pattern.marker_size is None:
        raise ValueError("a ChArUco board needs pitch and marker_size")
    return 1.0, pattern.marker_size / pattern.pitch


def _window(pattern: Pattern) -> float:
    """Return the half-width of the fit's window in squares: it must not reach a marker."""
    square, marker = _sizes(pattern)
    return min(WINDOW, CLEARANCE * (square - marker) / 2)
