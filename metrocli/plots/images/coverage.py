"""Coverage of the image by readings."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.plots.readings import image_residuals
from metrocli.plots.style import SIZES, Canvas
from metrocli.result import Result

_ACROSS = 10
"""Cells over the width of the image, as in `coverage_cells`"""


@dataclass(frozen=True)
class ImageCoverage:
    """Readings in each cell of the image."""

    counts: Array
    """(rows, columns)"""
    x_edges: Array
    y_edges: Array

    @property
    def filled(self) -> float:
        """Share of cells with at least one reading."""
        return float((self.counts > 0).mean())


def data(result: Result, about: str) -> ImageCoverage | None:
    """Return the number of readings in ten by ten cells of the image; None if its size is not known."""
    residuals = image_residuals(result)
    if residuals is None or not residuals.whole:
        return None
    edges = [np.linspace(-0.5, size - 0.5, _ACROSS + 1) for size in residuals.size]
    counts = np.histogramdd(residuals.places, bins=edges)[0]
    return ImageCoverage(counts.T, *edges)


def height(coverage: ImageCoverage) -> float:
    """Return the height of the figure in inches."""
    return min(4.9 * np.ptp(coverage.y_edges) / np.ptp(coverage.x_edges) + 0.8, 6.5)


def draw(canvas: Canvas, coverage: ImageCoverage) -> str:
    """Draw the figure and return its caption."""
    axes = canvas.axes()[0]
    axes.grid(False)
    axes.set_aspect("equal")
    shown = np.ma.masked_equal(coverage.counts, 0)
    drawn = axes.pcolormesh(coverage.x_edges, coverage.y_edges, shown, cmap=SIZES, vmin=0)
    drawn.set(edgecolor=canvas.theme.grid, linewidth=0.5)
    size = 7 if coverage.counts.max() < 1000 else 5
    for (i, j), count in np.ndenumerate(coverage.counts):
        if count:
            x, y = coverage.x_edges[j : j + 2].mean(), coverage.y_edges[i : i + 2].mean()
            colour = "#0c0c0c" if count > coverage.counts.max() / 2 else "#fdfdfd"
            number = axes.text(x, y, f"{count:.0f}", ha="center", va="center", fontsize=size, color=colour)
            number.set_in_layout(False)  # it is inside the axes
    axes.invert_yaxis()
    axes.set_xlabel("u (px)")
    axes.set_ylabel("v (px)")
    beyond = " The lens is extrapolated where there are no readings." if coverage.filled < 1 else ""
    return (
        f"Readings in each cell, {coverage.counts.sum():.0f} together; {100 * coverage.filled:.0f} % of the cells have "
        f"at least one.{beyond}"
    )
