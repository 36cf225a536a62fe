"""Grids of circles, in rows and columns or with every second row shifted.

Method: docs/algorithms/target-detection.md.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli.arrays import Picture
from metrocli.targets import blobs, ellipses
from metrocli.targets.blobs import Ellipse
from metrocli.targets.ellipses import FittedEllipse, of_ellipses
from metrocli.targets.find import FoundTargets, nothing
from metrocli.targets.lattice import FEWEST, Whole, largest, ordered
from metrocli.targets.pattern import Pattern, lattice, names


def find(pattern: Pattern, picture: Picture) -> FoundTargets:
    """Return the circles of a grid, named by their place, or nothing with the reason.

    At least three quarters of the circles must be found. With polarity `either` the polarity with more circles counts.
    """
    polarities = ("dark", "bright") if pattern.polarity == "either" else (pattern.polarity,)
    return max((_of_polarity(pattern, picture, polarity) for polarity in polarities), key=len)


def shown_grids(picture: Picture) -> Iterator[Pattern]:
    """Yield the grids of circles that an image may show, by the lattice on which most of its circles lie."""
    for polarity in ("dark", "bright"):
        starts = blobs.ellipses(picture, polarity)
        if len(starts) < _FEWEST:
            continue
        starts = blobs.as_clear(picture, starts, _FEWEST)
        steps = largest(np.array([(start.u, start.v) for start in starts]), len(starts))[1]
        # in every second place of a lattice turned by 45 degrees are the circles of shifted rows
        turned = np.stack([steps[:, 0] - steps[:, 1], steps.sum(axis=1)], axis=1)
        for kind, places, share in (("circles", steps, 1), ("asymmetric-circles", turned, 2)):
            across, down = (np.ptp(places, axis=0) + 1).tolist() if len(places) else (0, 0)
            for width, rows in ((across, down), (down, across)):
                columns = (width + share - 1) // share
                if min(columns, rows) > 1 and FEWEST * columns * rows <= len(steps):
                    yield Pattern(kind, columns, rows, 1.0, polarity=polarity)


_FEWEST = 12
"""Fewest circles of a grid that nothing states"""
_NOISIEST = 0.35
"""Largest misfit that noise explains: beyond it the grain of a surface looks like ellipses"""


def _of_polarity(pattern: Pattern, picture: Picture, polarity: str) -> FoundTargets:
    starts = blobs.ellipses(picture, polarity)
    expected = lattice(pattern)
    if len(starts) < 4:
        return nothing(f"no grid of circles: {len(starts)} {polarity} ellipses in the image")
    rows, reason = _ordered(expected, starts)
    if reason:
        # the grain of a surface makes many faint ellipses, which may continue the lattice or break it
        starts = blobs.as_clear(picture, starts, int(FEWEST * len(expected)))
        rows, reason = _ordered(expected, starts)
    if reason:
        return nothing(f"no grid of circles: {reason}")
    seen = np.flatnonzero(rows >= 0)
    chosen = [starts[row] for row in rows[seen]]
    fits = [ellipses.fit(picture, start, reach) for start, reach in zip(chosen, _reaches(chosen), strict=True)]
    named = names(pattern)
    good = [(named[at], fit) for at, fit in zip(seen, fits, strict=True) if _is_circle(fit)]
    return of_ellipses([name for name, _ in good], [fit for _, fit in good if fit is not None])


def _is_circle(fit: FittedEllipse | None) -> bool:
    """Return whether the misfit is small enough beside noise: that it lies on the lattice shows that it is a circle."""
    return fit is not None and fit.misfit < min(np.hypot(ellipses.MISFIT, fit.noise), _NOISIEST)


def _ordered(expected: Whole, starts: list[Ellipse]) -> tuple[Whole, str]:
    return ordered(expected, np.array([(start.u, start.v) for start in starts]))


def _reaches(starts: list[Ellipse]) -> list[float]:
    """Return half the distance to the nearest other circle, in semi-axes: pixels beyond belong to that circle."""
    centres = np.array([(start.u, start.v) for start in starts])
    reaches = []
    for start in starts:
        distance = np.linalg.norm((centres - (start.u, start.v)) @ start.shape.T, axis=1)
        # the nearest is the circle itself
        reaches.append(float(np.sort(distance)[1]) / 2)
    return reaches
