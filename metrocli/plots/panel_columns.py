"""Columns of the panels of a figure: what stands side by side where there is room, and else below each other."""

from __future__ import annotations

from itertools import pairwise

from matplotlib.axes import Axes
from matplotlib.transforms import Bbox

from metrocli.plots.style import Canvas


def ends(canvas: Canvas) -> list[tuple[float, float, float]]:
    """Return left and right end and height [points] of each column of panels of an arranged figure.

    The whole figure if it has one column, or if anything stands over two of them.
    """
    figure = canvas.figure
    wide, high = (72 * float(side) for side in figure.get_size_inches())
    whole, held = [(0.0, wide, high)], dict[int, list[Axes]]()
    for axes in figure.axes:
        spec = axes.get_subplotspec()
        if spec is None or len(spec.colspan) > 1:
            return whole
        # a scale of colours has a place of its own and stays beside the last column of panels
        held.setdefault(spec.colspan.start - (axes.get_axes_locator() is not None), []).append(axes)
    if len(held) < 2:
        return whole
    boxes = {k: [box for axes in column if (box := axes.get_tightbbox()) is not None] for k, column in held.items()}
    if not all(boxes.values()):
        return whole
    each = [Bbox.union(boxes[column]) for column in sorted(boxes)]
    if figure.legends or any(box.x1 >= other.x0 for box, other in pairwise(each)):
        return whole
    point = 72 / figure.dpi
    cuts = [0.0, *(point * (box.x1 + other.x0) / 2 for box, other in pairwise(each)), wide]
    return [(*cut, high - point * max(0.0, box.y0 - 4)) for cut, box in zip(pairwise(cuts), each, strict=True)]
