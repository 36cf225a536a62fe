"""Corners of the tags of an AprilTag grid as Kalibr prints it.

Dark squares between the tags touch their corners, so each is a crossing of two edges, as on a chessboard. The tags
identify the corners, so a part of the grid is enough.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from metrocli.arrays import Array, Index, Picture
from metrocli.errors import Fault, InputError
from metrocli.targets.blobs import eight_bit
from metrocli.targets.find import FoundTargets, mirrored, nothing, points
from metrocli.targets.homography import determines_homography, homography, projected, seen_by_a_lens
from metrocli.targets.lattice import order_fault
from metrocli.targets.pattern import Pattern, names, pattern_points
from metrocli.targets.saddles import WINDOW, fit_grid

BORDER = 2
"""Width of a tag's dark border, in its cells"""
_CELLS = 6 + 2 * BORDER
"""Cells along a tag with its border"""
_CLEARANCE = 0.9
"""Share of the border, or of a square between tags, from which grey values are taken"""
_FEWEST, _MOST_PIXELS = 4, 6_000_000
"""Fewest tags, and the largest image that is searched in double size"""
_AROUND = np.array([[0, 0], [0, 1], [1, 1], [1, 0]])
"""Row and column of the corners of a tag, in the order of the detector but for a turn of the tag"""


def find(pattern: Pattern, picture: Picture) -> FoundTargets:
    """Return the corners of the tags that are found, fitted to the edges that cross there, or nothing with the reason.

    OpenCV only supplies where the tags are, and their numbers.
    """
    rows, columns = (count // 2 for count in pattern.shape)
    numbers, seen = tags_in(picture, rows * columns)
    mine = numbers < rows * columns
    numbers, seen = numbers[mine], seen[mine]
    # tag 0 is at the lower left
    steps = np.stack([numbers % columns, rows - 1 - numbers // columns], axis=1)
    if not len(numbers) and len(shown := _detected(np.ascontiguousarray(eight_bit(picture)[:, ::-1]))[0]) >= _FEWEST:
        return mirrored("AprilTag grid", len(shown), "tags")
    if len(numbers) < _FEWEST or not determines_homography(steps.astype(float)):
        return nothing(
            f"no AprilTag grid: {len(numbers)} of its tags found, {_FEWEST} that are not on a line are needed"
        )
    if reason := order_fault(steps, seen.mean(axis=1)):
        return nothing(f"no AprilTag grid: {reason}; check columns and rows, which count tags")
    plane = pattern_points(pattern)[1][:, :2].reshape(2 * rows, 2 * columns, 2)
    place = _places(steps, plane, seen)
    everywhere = seen_by_a_lens(plane[place].reshape(-1, 2), seen.reshape(-1, 2), plane.reshape(-1, 2))
    start = everywhere.reshape(plane.shape)
    start[place] = seen
    fitted, sigma = fit_grid(picture, start, _window(pattern))
    good = np.zeros(sigma.shape, dtype=bool)
    good[place] = np.isfinite(sigma[place])
    chosen = np.flatnonzero(good)
    named = names(pattern)
    return points([named[i] for i in chosen], fitted.reshape(-1, 2)[chosen], sigma.ravel()[chosen])


def tags_in(picture: Picture, wanted: int = 0) -> tuple[Index, Array]:
    """Return the numbers (n,) of tags and their corners (n, 4, 2); tags that are seen twice are left out.

    Where fewer than `wanted` tags are found, the picture is searched in double size, too: blur joins small tags with
    the squares at their corners.
    """
    grey = eight_bit(picture)
    numbers, seen = _detected(grey)
    if len(numbers) < wanted and grey.size <= _MOST_PIXELS:
        others, corners = _detected(np.asarray(cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)))
        new = ~np.isin(others, numbers)
        numbers = np.concatenate([numbers, others[new]])
        # the first pixel of the large image has its centre a quarter of a pixel before that of the small one
        seen = np.concatenate([seen, (corners[new] + 0.5) / 2 - 0.5])
    return numbers, seen


def _detected(grey: npt.NDArray[np.uint8]) -> tuple[Index, Array]:
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = BORDER
    corners, ids, _ = cv2.aruco.ArucoDetector(_tags(), parameters).detectMarkers(grey)
    if ids is None or not len(ids):
        return np.zeros(0, dtype=np.intp), np.zeros((0, 4, 2))
    numbers, first, count = np.unique(np.asarray(ids).ravel(), return_index=True, return_counts=True)
    seen = np.asarray(corners, dtype=float).reshape(-1, 4, 2)
    return numbers[count == 1].astype(np.intp), seen[first[count == 1]]


def _tags() -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)


def _places(steps: Index, plane: Array, seen: Array) -> tuple[Index, Index]:
    """Return row and column of the corners (n, 4): of the four turns of the tags the one that fits a homography."""
    turns = []
    for turn in range(4):
        around = 2 * steps[:, None, ::-1] + np.roll(_AROUND, turn, axis=0)
        place = around[..., 0], around[..., 1]
        on_board, at = plane[place].reshape(-1, 2), seen.reshape(-1, 2)
        turns.append((float(np.abs(projected(homography(on_board, at), on_board) - at).mean()), place))
    return min(turns, key=lambda turn: turn[0])[1]


def _window(pattern: Pattern) -> float:
    """Return the half-width of the fit's window as a share of a tag: it reaches neither the code nor another tag."""
    pitch, tag = _sizes(pattern)
    return min(WINDOW, _CLEARANCE * min(BORDER / _CELLS, (pitch - tag) / tag))


def _sizes(pattern: Pattern) -> tuple[float, float]:
    if pattern.pitch is None or pattern.marker_size is None:
        raise ValueError("an AprilTag grid needs pitch and marker_size")
    return pattern.pitch, pattern.marker_size


def artwork(pattern: Pattern) -> tuple[Array, float]:
    """Return the grid with the squares around it as cells, 1 where ink is, and the side of a cell [mm].

    Raises InputError if the squares between the tags are not a whole number of the tags' cells.
    """
    pitch, tag = _sizes(pattern)
    rows, columns = (count // 2 for count in pattern.shape)
    gap = round((pitch - tag) / tag * _CELLS)
    if gap < 1 or abs(gap * tag / _CELLS - (pitch - tag)) > 1e-6 * tag:
        message = "the squares between the tags are not whole cells of a tag, so the grid is not drawn"
        raise InputError([Fault(message, hint=f"expected gaps of {tag / _CELLS:.6g} mm, or twice or thrice that")])
    step = _CELLS + gap
    cells = np.zeros((rows * step + gap, columns * step + gap))
    for row in range(rows + 1):
        for column in range(columns + 1):
            cells[row * step : row * step + gap, column * step : column * step + gap] = 1.0
    for number in range(rows * columns):
        y, x = (rows - 1 - number // columns) * step + gap, number % columns * step + gap
        image = cv2.aruco.generateImageMarker(_tags(), number, _CELLS, borderBits=BORDER)
        cells[y : y + _CELLS, x : x + _CELLS] = np.asarray(image) < 128
    return cells, tag / _CELLS
