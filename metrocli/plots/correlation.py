"""Correlation matrix of the estimates."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.plots.style import BOTH_SIDES, LETTERS, Canvas
from metrocli.result import Result
from metrocli.words import shortened

MOST = 60
"""Most estimates that are shown, those with the largest correlations"""
HIGH = 0.95
_WITH_NUMBERS = 14


@dataclass(frozen=True)
class CorrelationFigure:
    """What the figure shows."""

    names: tuple[str, ...]
    matrix: Array
    estimates: int

    @property
    def largest(self) -> tuple[str, str, float]:
        """The two estimates with the largest absolute correlation, and it."""
        off = np.where(np.eye(len(self.matrix), dtype=bool), -1.0, np.abs(self.matrix))
        i, j = np.unravel_index(int(np.nanargmax(off)), off.shape)
        return self.names[i], self.names[j], float(self.matrix[i, j])


def data(result: Result, about: str) -> CorrelationFigure | None:
    """Return `C_ij / sqrt(C_ii C_jj)` of the estimates with a variance; None if no two of them are correlated."""
    variance = np.diag(result.covariance)
    rows = np.flatnonzero(np.isfinite(variance) & (variance > 0))
    if len(rows) < 2:
        return None
    std = np.sqrt(variance[rows])
    matrix = result.covariance[np.ix_(rows, rows)] / std[:, None] / std
    if not np.any(matrix[~np.eye(len(rows), dtype=bool)]):
        return None
    kept = np.arange(len(rows))
    if len(rows) > MOST:
        strongest = np.abs(matrix - np.eye(len(rows))).max(axis=1)
        kept = np.sort(np.argsort(-strongest, kind="stable")[:MOST])
    names = tuple(result.estimates[rows[k]].name for k in kept)
    return CorrelationFigure(names, matrix[np.ix_(kept, kept)], len(rows))


def height(correlation: CorrelationFigure) -> float:
    """Return the height of the figure in inches."""
    return float(np.clip(0.33 * len(correlation.names) + 1.3, 2.6, 6.2))


def draw(canvas: Canvas, correlation: CorrelationFigure) -> str:
    """Draw the figure and return its caption."""
    (axes,), bar = canvas.axes_and_bar()
    count = len(correlation.names)
    axes.grid(False)
    axes.spines[:].set_visible(False)
    drawn = axes.pcolormesh(
        correlation.matrix, cmap=BOTH_SIDES, vmin=-1, vmax=1, edgecolor=canvas.theme.surface, lw=0.6
    )
    axes.set_aspect("equal")
    axes.invert_yaxis()
    ticks, names = np.arange(count) + 0.5, [shortened(name, LETTERS) for name in correlation.names]
    size = 8.0 if count <= 20 else 7.0 if count <= 32 else 4.5
    axes.set_xticks(ticks, names, rotation=90, fontsize=size)
    axes.set_yticks(ticks, names, fontsize=size)
    axes.tick_params(length=0)
    if count <= _WITH_NUMBERS:
        for (i, j), number in np.ndenumerate(correlation.matrix):
            if i != j:
                colour = "#fdfdfd" if abs(number) > 0.75 else "#0c0c0c"
                x, y = j + 0.5, i + 0.5
                written = axes.text(x, y, _short(number), ha="center", va="center", fontsize=6.5, color=colour)
                written.set_in_layout(False)  # it is inside the axes
    canvas.colour_bar(drawn, bar, "coefficient of correlation")
    high = int((np.abs(np.triu(correlation.matrix, 1)) > HIGH).sum())
    first, second, value = correlation.largest
    beyond = f"{high} pair exceeds" if high == 1 else f"{high or 'No'} pairs exceed"
    text = f"{beyond} {HIGH} in size; the largest is {value:+.3f} of {first} and {second}."
    if count == correlation.estimates:
        return text
    return f"{text} {count} of {correlation.estimates} estimates are shown, those with the largest correlations."


def _short(value: float) -> str:
    """Return a coefficient with two decimals: ".98", "-.05", "0"."""
    text = f"{value:.2f}"
    return "0" if text in ("0.00", "-0.00") else text.replace("0.", ".")
