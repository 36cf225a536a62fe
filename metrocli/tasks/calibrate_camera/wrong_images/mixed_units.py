"""Targets of a board that are listed in another unit than the rest of their list."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.words import listed

_UNITS = {10.0: "cm", 25.4: "inches", 1000.0: "m"}
"""How many times mm the units are in which some rows may be listed"""
_NEAR = 0.1
"""Share of its distance from the origin by which a place may be off that is seen beyond the points that fit a view"""
_MOST = 0.8
"""Share of the points off a view that have to lie at the same multiple of their listed places"""
_FEWEST = 4
"""Fewest points of an image off its view that may be in another unit"""


def in_another_unit(names: Sequence[str], views: Iterable[tuple[Index, Index, Array, Array]]) -> list[str]:
    """Return which targets are listed in another unit than others, if most images show it.

    Each view has the targets whose points fit it, the targets of its other points, and where these are seen and listed
    (n, 3). Numbers in another unit are a multiple, about the origin of the list. Either half may be what fits a view.
    """
    found, votes, count = Counter[float](), Counter[int](), 0
    for fitting, others, seen, at in views:
        count += 1
        times = _multiple(seen, at)
        if times is not None:
            found[max(times, 1 / times)] += 1
            votes.update((others if times > 1 else fitting).tolist())
    (most, images), *_ = [*found.most_common(1), (1.0, 0)]
    if 2 * images <= count:
        return []
    small = [names[target] for target, times in sorted(votes.items()) if 2 * times > images]
    return [
        f"{len(small)} targets fit the others with their coordinates times {most:g}, as of numbers in {_UNITS[most]}: "
        f"{listed(small, 4)}; give all rows of the list in one unit"
    ]


def _multiple(seen: Array, at: Array) -> float | None:
    """Return by what the listed places (n, 3) are multiplied where they are seen (n, 3), None if by no unit."""
    far = np.linalg.norm(seen, axis=1)
    for times in (factor**power for factor in _UNITS for power in (1, -1)):
        near = np.linalg.norm(seen - times * at, axis=1) < _NEAR * far
        if len(at) >= _FEWEST and near.mean() >= _MOST:
            return float(times)
    return None
