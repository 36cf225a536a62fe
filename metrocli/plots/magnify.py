"""What a figure magnifies, and what it leaves out."""

from __future__ import annotations

import math
import re

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.units import sized


def magnification(longest: float, wanted: float) -> float:
    """Return the largest of 1, 2, 5, 10, ... (also below 1) by which `longest` stays at most `wanted` long.

    1 if there is nothing to magnify.
    """
    if not (longest > 0 and wanted > 0 and math.isfinite(longest)):
        return 1.0
    factor = wanted / longest * (1 + 1e-12)
    power = 10.0 ** math.floor(math.log10(factor))
    return max(step for step in (1.0, 2.0, 5.0) if step * power <= factor) * power


def round_size(wanted: float) -> float:
    """Return the largest of 1, 2, 5, 10, ... that is at most `wanted`: the length of a scale arrow."""
    return magnification(1.0, wanted)


def in_words(factor: float) -> str:
    """Return a magnification as text: "x 5000"."""
    return f"× {factor:,.0f}".replace(",", " ") if factor >= 1 else f"× {factor:g}"


def length_in_words(length: float) -> str:
    """Return a length (mm) to two digits in the unit that suits its size: "0.21 µm"."""
    return micro(sized(length, "length"))


def micro(text: str) -> str:
    """Return a text whose units are printed with the sign µ: "0.21 µm", "17 µrad"."""
    return re.sub(r"\bu(?=(m|rad)\b)", "µ", text)


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
