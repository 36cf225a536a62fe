"""Names beside the places of a figure, on the side that has no other places."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from metrocli.arrays import Array
from metrocli.plots.style import LETTERS
from metrocli.words import shortened

_SHORT = 10
"""Letters of a name that has room on either side; a longer one is written towards the middle of the figure"""


def sides(at: Array, row: int, nearest: int) -> tuple[int, int]:
    """Return 1 or -1 to the right and up: away from the middle of the places (n, 2) nearest to one of them."""
    near = np.argsort(np.linalg.norm(at - at[row], axis=1), kind="stable")[: nearest + 1]
    right, up = (1 if part >= 0 else -1 for part in at[row] - at[near].mean(axis=0))
    return right, up


def name(axes: Axes, text: str, at: Array, row: int, nearest: int, **look: object) -> None:
    """Write the name of a place; a long one is shortened."""
    right, up = sides(at, row, nearest)
    if len(text) > _SHORT:
        right = 1 if 2 * at[row, 0] < at[:, 0].min() + at[:, 0].max() else -1
    axes.annotate(
        shortened(text, LETTERS), tuple(at[row]), xytext=(6 * right, 5 * up), textcoords="offset points", fontsize=8,
        ha="left" if right > 0 else "right", va="bottom" if up > 0 else "top", **look,  # type: ignore[arg-type]
    )  # fmt: skip
