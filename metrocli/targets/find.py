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
    sightings: Sightings = module.find(pattern, picture)
    return sightings


COUNTED = ("chessboard", "circles", "asymmetric-circles")
"""Types of pattern that are found by their number of points alone"""
_SIDE = 1000
"""Chessboards are searched in images reduced to about this longer side, in pixels"""
_SHARE = 0.5
"""A size is likely if more than this share of the images shows it"""


def likely_size(pattern: Pattern, pictures: Iterable[Picture]) -> tuple[int, int] | None:
    """Return columns and rows of the board that most pictures show, at most one off in each; None if none fits.

    Of sizes that equally many pictures show, the largest counts: a board contains all smaller ones.
    """
    if pattern.type not in COUNTED:
        return None
    rows, columns = pattern.shape
    reduced = [_reduced(pattern, picture) for picture in pictures]
    sizes = [(columns + c, rows + r) for c, r in product((-1, 0, 1), repeat=2) if (c, r) != (0, 0)]
    votes: dict[tuple[int, int], int] = {}
    for size in sorted((size for size in sizes if min(size) >= 2), key=lambda size: -size[0] * size[1]):
        other = replace(pattern, columns=size[0], rows=size[1])
        votes[size] = sum(len(find(other, picture)) > 0 for picture in reduced)
        if votes[size] == len(reduced):  # no smaller board can be more likely
            break
    best = max(votes, key=lambda size: (votes[size], size[0] * size[1]))
    return best if reduced and votes[best] > _SHARE * len(reduced) else None


def _reduced(pattern: Pattern, picture: Picture) -> Picture:
    factor = max(picture.shape) // _SIDE
    if pattern.type != "chessboard" or factor < 2:
        return picture
    size = (picture.shape[1] // factor, picture.shape[0] // factor)
    import cv2  # which takes longer to load than most jobs without images

    smaller = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return smaller.astype(np.uint16) if picture.dtype == np.uint16 else smaller.astype(np.uint8)
