"""Inner corners of a chessboard.

Method: docs/algorithms/target-detection.md.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from metrocli.arrays import Array, Picture
from metrocli.targets.blobs import eight_bit
from metrocli.targets.find import FoundTargets, nothing, points
from metrocli.targets.lattice import order_fault, ordered, upright
from metrocli.targets.pattern import Pattern, lattice, names
from metrocli.targets.saddles import fit_grid

LEAST_SIDE = 32
"""Images with a shorter side are not searched: OpenCV's search fails on them."""
REDUCED = 2000
"""Longest side of the image in which a board is sought first [px]"""
MOST_PIXELS, QUICK_PIXELS = 40_000_000, 300_000
"""Largest image that is also searched as it is, and largest in which OpenCV's fast search is always quick"""
_CONTINUES = 0.5
"""The board continues if squares farther out alternate with more than this share of its contrast."""
_FEWEST_SQUARES = 4
"""Fewest squares in a row that alternate otherwise than by chance."""


def find(pattern: Pattern, picture: Picture) -> FoundTargets:
    """Return the inner corners of a chessboard, or nothing with the reason.

    Corners that the grey values do not show are left out. With an odd sum of columns and rows the colours fix the
    order: the square outside the first corner is dark. Otherwise the order is the one most upright in the image.
    """
    start = _coarse(pattern, eight_bit(picture))
    if start is None:
        rows, columns = pattern.shape
        return nothing(f"no chessboard of {columns} x {rows} inner corners")
    grid, reason = _in_order(pattern, start, picture)
    if reason:
        return nothing(f"no chessboard: {reason}")
    if _continues(grid, picture):
        rows, columns = pattern.shape
        return nothing(f"no chessboard: the board has more than {columns} x {rows} inner corners")
    corners, sigma = fit_grid(picture, grid)
    flat, spread = corners.reshape(-1, 2), sigma.ravel()
    fitted = np.flatnonzero(np.isfinite(spread))
    if len(fitted) < 4:
        return nothing("no chessboard: the grey values show no corners")
    reason = order_fault(lattice(pattern)[fitted], flat[fitted])
    if reason:
        return nothing(f"no chessboard: {reason}")
    named = names(pattern)
    return points([named[place] for place in fitted], flat[fitted], spread[fitted])


def shown_size(picture: Picture) -> tuple[int, int] | None:
    """Return columns and rows of the chessboard that an image shows, columns the larger; None without one."""
    grey, least, flags = eight_bit(picture), (4, 4), cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE
    if min(grey.shape) < LEAST_SIDE:
        return None
    shown, _, meta = cv2.findChessboardCornersSBWithMeta(grey, least, flags)
    return (max(meta.shape), min(meta.shape)) if shown and meta is not None else None


def _coarse(pattern: Pattern, grey: npt.NDArray[np.uint8]) -> Array | None:
    """Return the corners (n, 2) to about a pixel, from a reduced image or, if that fails, from the image as it is.

    Images beyond MOST_PIXELS are searched reduced only: a search of them takes minutes.
    """
    factor = -(-max(grey.shape) // REDUCED)  # rounded up
    if factor > 1:
        size = (grey.shape[1] // factor, grey.shape[0] // factor)
        smaller = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
        corners = _searched(pattern, np.asarray(smaller, dtype=np.uint8))
        if corners is not None:
            # not `factor`: the sides of the smaller image are rounded down; 0.5, since the centres of pixels are whole
            return np.asarray((corners + 0.5) * np.divide(grey.shape[::-1], size) - 0.5)
    return _searched(pattern, grey) if factor == 1 or grey.size <= MOST_PIXELS else None


def _searched(pattern: Pattern, grey: npt.NDArray[np.uint8]) -> Array | None:
    """Return the corners (n, 2) by OpenCV's fast search or, if it fails, its sector-based one.

    The fast search takes a minute for an image full of noise or of fine squares, so a look comes first at whether the
    image may show a board.
    """
    rows, columns = pattern.shape
    if min(grey.shape) < LEAST_SIDE:
        return None
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    success, corners = False, None
    if grey.size <= QUICK_PIXELS or cv2.checkChessboard(grey, (columns, rows)):
        success, corners = cv2.findChessboardCorners(grey, (columns, rows), flags=flags)
    if not success:
        # exhaustive: without it a board at the edge of an unevenly lit image is missed; it costs a quarter more
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
        success, corners = cv2.findChessboardCornersSB(grey, (columns, rows), flags=flags)
    return np.asarray(corners, dtype=float).reshape(-1, 2) if success else None


def _in_order(pattern: Pattern, corners: Array, picture: Picture) -> tuple[Array, str]:
    """Return the corners (rows, columns, 2) in the pattern's order; without an order, nothing and the reason."""
    rows, columns = pattern.shape
    place = upright((rows, columns), corners)
    if place is None:  # not row by row, as OpenCV lists the corners of most boards
        place, reason = ordered(lattice(pattern), corners)
        if not reason and (place < 0).any():
            reason = "the corners found do not lie on a lattice"
        if reason:
            return np.empty((0, 0, 2)), reason
    grid = corners[place].reshape(rows, columns, 2)
    # turned by half, a board with an odd sum has its colours exchanged, one with an even sum has not
    colours_decide = (rows + columns) % 2 == 1
    if colours_decide and _first_square_is_bright(grid, picture):
        grid = grid[::-1, ::-1]
    return grid, ""


def _first_square_is_bright(grid: Array, picture: Picture) -> bool:
    """Return whether the squares with the colour of the first inner one are brighter than the others."""
    return bool(_contrasts(_squares(grid, picture)).mean() > 0)


def _continues(grid: Array, picture: Picture) -> bool:
    """Return whether squares go on beyond those around the outermost corners: then no corner has a certain name."""
    turned = grid.swapaxes(0, 1)
    return any(_continues_below(side, picture) for side in (grid, grid[::-1], turned, turned[::-1]))


def _continues_below(grid: Array, picture: Picture) -> bool:
    """Return whether the squares go on below the row that ends the board, where the last two rows of corners lead."""
    last, step = grid[-1], grid[-1] - grid[-2]
    # the squares half a step below are on every board, those 1.25 steps below on one that goes on
    squares = _squares(np.concatenate([grid, [last + step, last + 1.5 * step]]), picture)
    if squares.shape[1] < _FEWEST_SQUARES or np.isnan(squares[-1]).any():
        return False
    *inside, _, beyond = _contrasts(squares)
    board = float(np.mean(inside))
    return bool(beyond * np.sign(board) > _CONTINUES * abs(board))


def _squares(grid: Array, picture: Picture) -> Array:
    """Return the grey values in the middle of the squares between corners (rows, columns, 2); NaN beyond the image."""
    middle = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    u, v = np.moveaxis(np.rint(middle).astype(int), -1, 0)
    inside = (u >= 0) & (v >= 0) & (u < picture.shape[1]) & (v < picture.shape[0])
    grey = picture[v.clip(0, picture.shape[0] - 1), u.clip(0, picture.shape[1] - 1)].astype(float)
    return np.where(inside, grey, np.nan)


def _contrasts(squares: Array) -> Array:
    """Return how much brighter the squares with the colour of the first one are than the others, for each row."""
    first = np.indices(squares.shape).sum(0) % 2 == 0
    return np.asarray(squares.mean(axis=1, where=first) - squares.mean(axis=1, where=~first))
