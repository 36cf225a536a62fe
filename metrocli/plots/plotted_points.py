"""Points of one kind in space, with what is drawn about them, and their names at places that do not overlap."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.plots.style import LETTERS
from metrocli.words import shortened


@dataclass(frozen=True)
class PlottedPoints:
    """Points of one kind."""

    kind: str
    names: tuple[str, ...]
    at: Array
    """(n, 3) mm"""
    vectors: Array | None = None
    """(n, 3) mm: deviation at each point, in its true size"""
    vector_name: str = ""
    covariance: Array | None = None
    """(n, 3, 3) mm²"""
    lines: Array | None = None
    """Lines from point to point about each, (n, k, 2, 3) mm: outlines of cameras, beams, steps of a board"""
    faint: bool = False
    """Whether only the lines are drawn, thin and below all others: beams of light"""
    named: tuple[int, ...] | None = None
    """Rows whose names are drawn where there is room, those that matter most first; without it all of a few"""


_SHORT = 10
"""Letters of a name that has room on either side; a longer one is written towards the middle of the figure"""


def sides(at: Array, row: int, nearest: int) -> tuple[int, int]:
    """Return 1 or -1 to the right and up: away from the middle of the places (n, 2) nearest to one of them."""
    near = np.argsort(np.linalg.norm(at - at[row], axis=1), kind="stable")[: nearest + 1]
    right, up = (1 if part >= 0 else -1 for part in at[row] - at[near].mean(axis=0))
    return right, up


def name(axes: Axes, text: str, at: Array, row: int, nearest: int, **look: object) -> None:
    """Write the name of a place; a long one is shortened."""
    right, up = _side(text, at, row, nearest)
    axes.annotate(
        shortened(text, LETTERS), tuple(at[row]), xytext=(6 * right, 5 * up), textcoords="offset points", fontsize=8,
        ha="left" if right > 0 else "right", va="bottom" if up > 0 else "top", **look,  # type: ignore[arg-type]
    )  # fmt: skip


def _side(text: str, at: Array, row: int, nearest: int) -> tuple[int, int]:
    right, up = sides(at, row, nearest)
    if len(text) > _SHORT:
        right = 1 if 2 * at[row, 0] < at[:, 0].min() + at[:, 0].max() else -1
    return right, up


def apart(texts: Sequence[str], at: Array, rows: Sequence[int], nearest: int, width: float) -> list[int]:
    """Return which of the names of rows have room, those before the others first.

    `width` is that of the figure [points]; the size of letters is that of most of them, since text has a size only
    when it is drawn.
    """
    scale, kept, taken = width / float(np.ptp(at, axis=0).max() or 1.0), list[int](), list[Array]()
    for k, (text, row) in enumerate(zip(texts, rows, strict=True)):
        size = np.array([4.9 * min(len(text), LETTERS), 9.5])
        side = np.array(_side(text, at, row, nearest))
        middle = scale * at[row] + side * ([6, 5] + size / 2)
        box = np.array([middle, size])
        if all((np.abs(middle - other[0]) > (size + other[1]) / 2).any() for other in taken):
            kept.append(k)
            taken.append(box)
    return kept
