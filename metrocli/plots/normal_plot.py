"""Normal plot of the normalised residuals w, with bounds that pure noise leaves in 5 % of measurements."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Index
from metrocli.frozen import dataclass
from metrocli.plots.magnify import thinned, words
from metrocli.plots.noise_bands import NormalPlot, normal_plot
from metrocli.plots.readings import residuals_of
from metrocli.plots.style import Canvas
from metrocli.result import Result


@dataclass(frozen=True)
class NormalPlotFigure:
    """What the figure shows."""

    plot: NormalPlot
    rows: Index
    """Ordered values that are shown"""
    std: float
    """Root mean square of w: 1 if model and noise are right"""


def data(result: Result, about: str) -> NormalPlotFigure | None:
    """Return the normal plot of all readings that others check; None with fewer than three."""
    w = [residual.w[residual.checked] for residual in residuals_of(result)]
    together = np.concatenate(w) if w else np.zeros(0)
    if len(together) < 3:
        return None
    plotted = normal_plot(together)
    return NormalPlotFigure(plotted, thinned(plotted.expected, plotted.ordered), float(np.sqrt(np.mean(together**2))))


def height(shown: NormalPlotFigure) -> float:
    """Return the height of the figure in inches."""
    return 3.6


def draw(canvas: Canvas, shown: NormalPlotFigure) -> str:
    """Draw the figure and return its caption."""
    theme, plot, rows = canvas.theme, shown.plot, shown.rows
    axes = canvas.axes()[0]
    expected, ordered = plot.expected[rows], plot.ordered[rows]
    low, high = plot.low[rows], plot.high[rows]
    axes.fill_between(expected, low, high, color=theme.band, lw=0, label="pure noise (95 %)")
    ends = expected[[0, -1]]
    axes.plot(ends, ends, color=theme.muted, lw=0.9, ls=(0, (4, 3)), label="standard normal")
    out = (ordered < low) | (ordered > high)
    axes.plot(expected[~out], ordered[~out], "o", ms=3, mew=0, color=theme.first, label="w of a reading")
    if out.any():
        axes.plot(expected[out], ordered[out], "D", ms=3.5, mew=0, color=theme.second, label="outside")
    axes.set_xlabel("expected by the normal distribution (standard deviations)")
    axes.set_ylabel("w (standard deviations)")
    axes.legend(loc="upper left")
    count = len(plot.ordered)
    text = (
        f"{count} readings; the root mean square of w is {shown.std:.3g} where 1 is expected. {plot.outside} are "
        "outside the band, which holds all with 95 % if there is noise only. A steeper line is larger noise, bent ends "
        "are wrong readings."
    )
    kept = "the lowest and the highest of each strip, the others at equal steps"
    return " ".join(filter(None, [text, words(len(rows), count, kept)]))
