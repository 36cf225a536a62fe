"""Which readings a figure shows where it cannot show all: the extremes stay."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

MOST = 800
"""Most marks of one figure"""


def thinned(x: Array, y: Array, most: int = MOST) -> Index:
    """Return the rows of at most `most` points (n,) that stand for all, in ascending order.

    The range of x is divided into `most // 4` strips of equal width. Each strip keeps its lowest and its highest y, so
    that the outline is that of all points. The other half are rows at equal steps, which keep the density.
    """
    count = len(x)
    if count <= most:
        return np.arange(count)
    strips = max(most // 4, 1)
    span = float(np.ptp(x)) or 1.0
    strip = np.minimum(((x - x.min()) / span * strips).astype(np.intp), strips - 1)
    order = np.lexsort((y, strip))
    starts = np.flatnonzero(np.diff(strip[order], prepend=-1))
    ends = np.append(starts[1:], count) - 1
    outline = np.union1d(order[starts], order[ends])
    return np.union1d(outline, np.linspace(0, count - 1, most - len(outline)).astype(np.intp))


def thinned_vectors(places: Array, sizes: Array, most: int = MOST) -> Index:
    """Return the rows of at most `most` vectors at places (n, d), in ascending order: the longest of each cell.

    The cells are of one size, as many along each axis; the longest vector of all is always among them.
    """
    count = len(sizes)
    if count <= most:
        return np.arange(count)
    low, span = places.min(axis=0), np.maximum(np.ptp(places, axis=0), 1e-300)
    axes = places.shape[1]
    side = max(int(most ** (1 / axes) + 1e-9), 1)
    cell = np.minimum((places - low) / span * side, side - 1).astype(np.intp)
    key = cell @ side ** np.arange(axes)
    order = np.lexsort((sizes, key))
    ends = np.append(np.flatnonzero(np.diff(key[order])), count - 1)
    return np.sort(order[ends])


def words(shown: int, of: int, kept: str, what: str = "readings") -> str:
    """Return the statement of a thinned figure: "1500 of 20 000 readings are shown; ..."; empty if all are shown."""
    return "" if shown >= of else f"{shown} of {of} {what} are shown: {kept}."
