"""Difference of two cameras over the image, as vectors."""

from __future__ import annotations

import numpy as np

from metrocli.plots.context import ResultContext
from metrocli.plots.magnify import in_words, magnification
from metrocli.plots.style import Canvas, arrows
from metrocli.result import Result
from metrocli.tasks.shared.images.calibrated import LensDifference, lens_differences

_NOTHING = 1e-4
"""Difference [px] that is as good as none: a smaller one has no visible vector"""
_SHARE = 1 / 14
"""Length of the largest vector, as a share of the width of the image"""

Shown = list[LensDifference]


def data(result: Result, context: ResultContext) -> Shown | None:
    """Return the difference of each camera from the earlier result; None without one."""
    return (lens_differences(context.before, result) or None) if context.before is not None else None


def height(shown: Shown) -> float:
    """Return the height of the figure in inches."""
    return sum(min(5.6 * difference.size[1] / difference.size[0] + 0.7, 6.0) for difference in shown) + 0.2


def draw(canvas: Canvas, shown: Shown) -> str:
    """Draw the figure and return its caption."""
    largest = max(_NOTHING, *(difference.largest[0] for difference in shown))
    factor = magnification(largest, _SHARE * shown[0].size[0])
    for axes, difference in zip(canvas.axes(len(shown)), shown, strict=True):
        axes.set_aspect("equal")
        known = np.isfinite(difference.change).all(axis=0)
        arrows(axes, difference.uv[:, known].T, factor * difference.change[:, known].T, canvas.theme.first)
        axes.set_xlim(-0.5, difference.size[0] - 0.5)
        axes.set_ylim(difference.size[1] - 0.5, -0.5)
        axes.set_xlabel("u (px)")
        axes.set_ylabel("v (px)")
        axes.set_title(difference.name)
    each = "; ".join(in_text(difference) for difference in shown)
    return f"Image points of this camera less those of the other one, magnified {in_words(factor)}: {each}."


def in_text(difference: LensDifference) -> str:
    """Return the size of a difference, in words."""
    largest, u, v = difference.largest
    name = f"{difference.name}: " if difference.name else ""
    return f"{name}rms {difference.rms:.2g} px, largest {largest:.2g} px at ({u:.0f}, {v:.0f})"
