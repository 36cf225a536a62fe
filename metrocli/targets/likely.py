"""The size of the board that images show, where they do not show the one of the job.

Method: docs/algorithms/target-detection.md.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from metrocli.targets.find import find
from metrocli.targets.pattern import Pattern

if TYPE_CHECKING:
    from metrocli.imageset import Picture

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
    found = {
        size: sum(len(find(replace(pattern, columns=size[0], rows=size[1]), picture)) > 0 for picture in reduced)
        for size in sizes
        if min(size) >= 2
    }
    best = max(found, key=lambda size: (found[size], size[0] * size[1]))
    return best if reduced and found[best] > _SHARE * len(reduced) else None


def _reduced(pattern: Pattern, picture: Picture) -> Picture:
    factor = max(picture.shape) // _SIDE
    if pattern.type != "chessboard" or factor < 2:
        return picture
    size = (picture.shape[1] // factor, picture.shape[0] // factor)
    import cv2  # which takes longer to load than most jobs without images

    smaller = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return smaller.astype(np.uint16) if picture.dtype == np.uint16 else smaller.astype(np.uint8)
