"""Coverage of the image by readings."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.plots.readings import ImageResiduals, image_residuals
from metrocli.plots.style import SIZES, Canvas, images_height
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
    camera: str

    @property
    def filled(self) -> float:
        """Share of cells with at least one reading."""
        return float((self.counts > 0).mean())


def data(result: Result, about: str) -> tuple[ImageCoverage, ...] | None:
    """Return the number of readings in ten by ten cells of the image of each camera; None if a size is not known."""
    each = image_residuals(result)
    return tuple(map(_counted, each)) if each and all(residuals.whole for residuals in each) else None


def _counted(residuals: ImageResiduals) -> ImageCoverage:
    edges = [np.linspace(-0.5, size - 0.5, _ACROSS + 1) for size in residuals.size]
    counts = np.histogramdd(residuals.places, bins=edges)[0]
    return ImageCoverage(counts.T, edges[0], edges[1], residuals.camera)


def height(shown: tuple[ImageCoverage, ...]) -> float:
    """Return the height of the figure in inches."""
    return images_height([(float(np.ptp(coverage.x_edges)), float(np.ptp(coverage.y_edges))) for coverage in shown])


def draw(canvas: Canvas, shown: tuple[ImageCoverage, ...]) -> str:
    """Draw the figure and return its caption."""
    for axes, coverage in zip(canvas.images([coverage.camera for coverage in shown]), shown, strict=True):
        _draw(axes, coverage, canvas, 7 if len(shown) == 1 and coverage.counts.max() < 1000 else 5.6)
    shares = [coverage.filled for coverage in shown]
    filled = " and ".join(f"{100 * share:.0f} %" for share in shares)
    count = sum(coverage.counts.sum() for coverage in shown)
    beyond = " The lens is extrapolated where there are no readings." if min(shares) < 1 else ""
    return f"Readings in each cell, {count:.0f} together; {filled} of the cells have at least one.{beyond}"


def _draw(axes: Axes, coverage: ImageCoverage, canvas: Canvas, size: float) -> None:
    axes.grid(False)
    shown = np.ma.masked_equal(coverage.counts, 0)
    drawn = axes.pcolormesh(coverage.x_edges, coverage.y_edges, shown, cmap=SIZES, vmin=0)
    drawn.set(edgecolor=canvas.theme.grid, linewidth=0.5)
    for (i, j), count in np.ndenumerate(coverage.counts):
        if count:
            x, y = coverage.x_edges[j : j + 2].mean(), coverage.y_edges[i : i + 2].mean()
            colour = "#0c0c0c" if count > coverage.counts.max() / 2 else "#fdfdfd"
            number = axes.text(x, y, f"{count:.0f}", ha="center", va="center", fontsize=size, color=colour)
            number.set_in_layout(False)  # it is inside the axes
    axes.invert_yaxis()
