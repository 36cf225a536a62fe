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
from metrocli.errors import Fault, InputError
from metrocli.targets.blobs import eight_bit
from metrocli.targets.find import FoundTargets, mirrored, nothing, points
from metrocli.targets.homography import seen_by_a_lens
from metrocli.targets.lattice import order_fault
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
    detector = cv2.aruco.CharucoDetector(_board(pattern))
    corners, ids, _, markers = detector.detectBoard(seen)
    if ids is None or len(ids) < FEWEST:
        other = detector.detectBoard(cv2.flip(seen, 1))[1]
        if other is not None and len(other) >= FEWEST:
            return mirrored("ChArUco board", len(other), "corners")
        count, shown = (0 if array is None else len(array) for array in (ids, markers))
        hint = "check columns, rows and dictionary" if shown else "check the dictionary, or is there no board?"
        message = f"no ChArUco board: {count} corners found, {FEWEST} are needed"
        return nothing(f"{message}; {shown} markers of {pattern.dictionary} are found: {hint}")
    ids, start = np.asarray(ids).ravel(), np.asarray(corners, dtype=float).reshape(-1, 2)
    steps = lattice(pattern)
    reason = order_fault(steps[ids], start)
    if reason:
        return nothing(f"no ChArUco board: {reason}")
    rows, columns = pattern.shape
    everywhere = seen_by_a_lens(steps[ids].astype(float), start, steps.astype(float))
    everywhere[ids] = start
    fitted, sigma = fit_grid(picture, everywhere.reshape(rows, columns, 2), _window(pattern))
    uv, spread = fitted.reshape(-1, 2)[ids], sigma.ravel()[ids]
    good = np.isfinite(spread)
    named = names(pattern)
    return points([named[place] for place in ids[good]], uv[good], spread[good])


def other_layout(pattern: Pattern, picture: Picture, dictionary: str) -> str:
    """Return what to write for the ChArUco board that an image shows, in words; empty if no layout tried is found.

    Its markers are of this dictionary. Columns and rows are tried exchanged, and one more or fewer of each. That with
    most corners is named: another has some of them in common with the board.
    """
    seen = eight_bit(picture)
    own = dictionary == _whole(pattern.dictionary)
    named = "" if own else f"dictionary: {dictionary}"
    same = pattern if own else replace(pattern, dictionary=dictionary)
    best, count = "", FEWEST - 1
    # the markers are the same for each layout, and their search takes thirty times as long as the rest
    corners, numbers, _ = cv2.aruco.ArucoDetector(_dictionary(same.dictionary)).detectMarkers(seen)
    if numbers is None:
        return ""
    for other, write in ((same, ""), *_layouts(same)):
        detector = cv2.aruco.CharucoDetector(_board(other))
        ids = detector.detectBoard(seen, markerCorners=corners, markerIds=numbers)[1]
        if ids is not None and len(ids) > count and (named or write):
            best, count = ", ".join(filter(None, (named, write))), len(ids)
    return f"a ChArUco board: with `{best}` there are {count} corners" if best else ""


def _whole(dictionary: str) -> str:
    """Return the largest dictionary tried that has the markers of a dictionary."""
    bits, _, count = dictionary.rpartition("_")
    return f"{bits}_250" if count in ("50", "100", "1000") else dictionary


def _layouts(pattern: Pattern) -> Iterator[tuple[Pattern, str]]:
    """Yield other boards and what to write for them, smaller ones first: a larger one shows the same corners."""
    rows, columns = pattern.shape
    near = {(n + i, m + j) for n, m in ((rows, columns), (columns, rows)) for i in (-1, 0, 1) for j in (-1, 0, 1)}
    sizes = sorted((size for size in near - {(rows, columns)} if min(size) > 1), key=lambda size: size[0] * size[1])
    for legacy in (pattern.legacy, not pattern.legacy):
        words = f", legacy: {str(legacy).lower()}" if legacy != pattern.legacy else ""
        if words:
            yield replace(pattern, legacy=legacy), words.removeprefix(", ")
        for n, m in sizes:
            yield replace(pattern, rows=n, columns=m, legacy=legacy), f"columns: {m}, rows: {n}{words}"


def artwork(pattern: Pattern) -> tuple[Array, int]:
    """Return the board as cells (rows, columns), 1 where ink is, and the number of cells along a square.

    Raises InputError if a square is not a whole number of the marker's cells, as many on both sides of it.
    """
    rows, columns = pattern.shape
    marker = _dictionary(pattern.dictionary).markerSize + 2
    square, length = _sizes(pattern)
    count = round(marker / length)
    if abs(count * length - marker) > 1e-6 * marker or (count - marker) % 2:
        near = marker + 2 * max(round((marker * square / length - marker) / 2), 1)
        message = "the marker's cells do not fill a square evenly, so the board is not drawn"
        expected = f"drawn is e.g. a marker_size: {float(pattern.pitch or 0.0) * marker / near:.6g} mm"
        raise InputError([Fault(message, hint=expected)])
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


def markers_in(picture: Picture) -> str:
    """Return the dictionary of which an image shows the most markers; empty if no dictionary has FEWEST of them."""
    whole = sorted({_whole(name) for name in DICTIONARIES})
    counts = {name: count_markers(picture, name) for name in whole}
    name = max(counts, key=lambda name: counts[name])
    return name if counts[name] >= FEWEST else ""


def count_markers(picture: Picture, dictionary: str) -> int:
    """Return how many markers of a dictionary an image shows."""
    ids = cv2.aruco.ArucoDetector(_dictionary(dictionary)).detectMarkers(eight_bit(picture))[1]
    return 0 if ids is None else len(ids)


def are_among_squares(picture: Picture, dictionary: str) -> bool:
    """Return whether dark squares lie between neighbouring markers of a dictionary, as on a ChArUco board.

    Half way between two markers two dark squares meet there; on a grid of markers it is white.
    """
    grey = eight_bit(picture)
    corners = cv2.aruco.ArucoDetector(_dictionary(dictionary)).detectMarkers(grey)[0]
    seen = np.asarray(corners, dtype=float).reshape(-1, 4, 2)
    middles = seen.mean(axis=1)
    apart = np.linalg.norm(middles[:, None] - middles, axis=2) + np.diag(np.full(len(seen), np.inf))
    dark = []
    for at, other in enumerate(apart.argmin(axis=1)):
        side = float(np.linalg.norm(np.diff(seen[at], axis=0), axis=1).mean())
        reach = max(int((apart[at, other] - side) / 4), 1)
        between = _patch(grey, (middles[at] + middles[other]) / 2, reach)
        marker = _patch(grey, middles[at], max(int(side / 2), 1))
        if between.size and marker.size:
            dark.append(between.min() < (int(marker.min()) + int(marker.max())) / 2)
    return bool(dark) and bool(np.mean(dark) > 1 / 2)


def _patch(grey: Picture, at: Array, reach: int) -> Picture:
    u, v = np.rint(at).astype(int)
    return grey[max(v - reach, 0) : v + reach + 1, max(u - reach, 0) : u + reach + 1]


def _sizes(pattern: Pattern) -> tuple[float, float]:
    """Return the sides of a square (1) and of a marker, in units of the square."""
    if pattern.pitch is None or pattern.marker_size is None:
        raise ValueError("a ChArUco board needs pitch and marker_size")
    return 1.0, pattern.marker_size / pattern.pitch


def _window(pattern: Pattern) -> float:
    """Return the half-width of the fit's window in squares: it must not reach a marker."""
    square, marker = _sizes(pattern)
    return min(WINDOW, CLEARANCE * (square - marker) / 2)
