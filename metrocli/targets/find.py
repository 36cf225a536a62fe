"""Finding the targets of a pattern in an image, and the size that a board probably has."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from importlib import import_module
from itertools import product

import numpy as np

from metrocli.arrays import Array, Index, Picture
from metrocli.frozen import dataclass
from metrocli.targets.pattern import Pattern


@dataclass(frozen=True)
class Sightings:
    """Targets found in one image; pixel (0, 0) is the centre of the first pixel."""

    targets: tuple[str, ...]
    uv: Array
    """Image coordinates (n, 2) in pixels."""
    sigma: Array
    """Standard deviation per axis (n,) in pixels, from the residuals of the grey values; NaN if it is not known."""
    axes: Array
    """Semi-axes (n, 2) of the ellipses in pixels, the longer first; NaN for targets that are not ellipses."""
    angle: Array
    """Direction (n,) of the longer semi-axis in radians, from u towards v; NaN for targets that are not ellipses."""
    reason: str = ""
    """Message for the user: why nothing was found, or what was left out."""

    def __len__(self) -> int:
        return len(self.targets)

    def __getitem__(self, rows: Sequence[int] | Index) -> Sightings:
        """Return the sightings of these rows."""
        rows = np.asarray(rows, dtype=np.intp)
        names = tuple(self.targets[row] for row in rows)
        return Sightings(names, self.uv[rows], self.sigma[rows], self.axes[rows], self.angle[rows], self.reason)


def nothing(reason: str) -> Sightings:
    """Return empty sightings with the reason."""
    return Sightings((), np.empty((0, 2)), np.empty(0), np.empty((0, 2)), np.empty(0), reason)


def points(targets: Sequence[str], uv: Array, sigma: Array) -> Sightings:
    """Return sightings of targets that are not ellipses."""
    absent = np.full((len(uv), 2), np.nan)
    return Sightings(tuple(targets), uv, sigma, absent, absent[:, 0])


MODULES = {
    "chessboard": "chessboard",
    "circles": "circles",
    "asymmetric-circles": "circles",
    "charuco": "charuco",
    "coded-rings": "coded_rings",
    "dot": "dot",
}
"""Module of each type of pattern; each has `find(pattern, picture) -> Sightings`."""


def find(pattern: Pattern, picture: Picture) -> Sightings:
    """Return the targets in a grey image (height, width) of 8 or 16 bits, or nothing with the reason."""
    module = import_module(f"metrocli.targets.{MODULES[pattern.type]}")
    found: Sightings = module.find(pattern, picture)
    return found


_SIDE = 1000
"""Chessboards are searched in images reduced to about this longer side, in pixels"""
_SHARE = 0.5
"""A board is likely if more than this share of the images shows it"""
_MARKERS = 6
"""Fewest markers in an image of a ChArUco board"""


def likely_board(pattern: Pattern, pictures: Iterable[Picture]) -> str:
    """Return the board that most pictures show and the keys to write for it; empty if none is likely."""
    reduced = [_reduced(picture) for picture in pictures]
    if pattern.type in ("circles", "asymmetric-circles") and (size := _likely_circles(pattern, reduced)):
        return _in_words(size, "")
    from metrocli.targets.chessboard import shown_size

    sizes = [size for picture in reduced if (size := shown_size(picture)) is not None]
    size = max(sizes, key=sizes.count, default=None)
    if size is not None and sizes.count(size) > _SHARE * len(reduced):
        return _in_words(size, "" if pattern.type == "chessboard" else "type: chessboard, ")
    if pattern.type == "charuco":
        return ""  # its search has named other layouts and dictionaries
    from metrocli.targets.charuco import markers_in

    names = [name for name, count in map(markers_in, reduced) if count >= _MARKERS]
    name = max(names, key=names.count, default="")
    likely = names.count(name) > _SHARE * len(reduced)
    return f"markers of {name}: is it type: charuco, dictionary: {name}?" if likely else ""


def _in_words(size: tuple[int, int], kind: str) -> str:
    return f"{size[0]} x {size[1]}: is it {kind}columns: {size[0]}, rows: {size[1]}?"


def _likely_circles(pattern: Pattern, pictures: Sequence[Picture]) -> tuple[int, int] | None:
    """Return columns and rows of the grid that most pictures show, at most one off in each; None if none fits.

    Of sizes that equally many pictures show, the largest counts: a grid contains all smaller ones.
    """
    rows, columns = pattern.shape
    sizes = [(columns + c, rows + r) for c, r in product((-1, 0, 1), repeat=2) if (c, r) != (0, 0)]
    found: dict[tuple[int, int], int] = {}
    for size in sorted((one for one in sizes if min(one) >= 2), key=lambda one: -one[0] * one[1]):
        other = replace(pattern, columns=size[0], rows=size[1])
        found[size] = sum(len(find(other, picture)) > 0 for picture in pictures)
        if found[size] == len(pictures):  # no smaller grid can be more likely
            break
    best = max(found, key=lambda size: (found[size], size[0] * size[1]))
    return best if pictures and found[best] > _SHARE * len(pictures) else None


def _reduced(picture: Picture) -> Picture:
    factor = max(picture.shape) // _SIDE
    if factor < 2:
        return picture
    size = (picture.shape[1] // factor, picture.shape[0] // factor)
    import cv2  # which takes longer to load than most jobs without images

    smaller = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return smaller.astype(np.uint16) if picture.dtype == np.uint16 else smaller.astype(np.uint8)
