"""A single dot.

Method: docs/algorithms/target-detection.md.
"""

from __future__ import annotations

from metrocli.arrays import Picture
from metrocli.targets import blobs, ellipses
from metrocli.targets.ellipses import of_ellipses
from metrocli.targets.find import FoundTargets, nothing
from metrocli.targets.pattern import Pattern

EQUAL = 0.5
"""A second dot with more than this share of the first one's contrast and size makes the image ambiguous."""
MOST = 200
"""Most candidates that are fitted: an image of nothing but noise has 20,000, and each takes milliseconds."""


def find(pattern: Pattern, picture: Picture) -> FoundTargets:
    """Return the dot of the image, or nothing with the reason: no dot, or several of similar contrast and size."""
    starts = blobs.clearest(picture, blobs.ellipses(picture, pattern.polarity), MOST)
    fits = ellipses.fit_all(picture, starts)
    if not fits:
        return nothing("no dot in the image")
    fits.sort(key=lambda fit: abs(fit.contrast) * fit.ellipse.short, reverse=True)
    rivals = [
        fit
        for fit in fits[1:]
        if abs(fit.contrast) > EQUAL * abs(fits[0].contrast) and fit.ellipse.short > EQUAL * fits[0].ellipse.short
    ]
    if rivals:
        return nothing(f"{1 + len(rivals)} dots in the image: it is not clear which one is '{pattern.target}'")
    return of_ellipses([pattern.target], fits[:1])
