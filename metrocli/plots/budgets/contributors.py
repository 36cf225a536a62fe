"""Uncertainty budget as a Pareto chart."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.plots.style import Canvas
from metrocli.result import Result
from metrocli.words import shortened

_MOST = 10
"""Contributors with a bar of their own; all others share one"""
_LETTERS = 34
_INSIDE = 15.0
"""Percent from which on a bar has room for its number"""


@dataclass(frozen=True)
class Chart:
    """The budget of one measurand, largest contribution first."""

    measurand: str
    names: tuple[str, ...]
    shares: Array
    """(n,) percent of the variance"""

    @property
    def together(self) -> Array:
        """(n,) percent: share of this and all larger contributions."""
        return np.cumsum(self.shares)


def data(result: Result, about: str) -> tuple[Chart, ...] | None:
    """Return the shares of the contributors of each measurand, from the table `budget`."""
    table = result.tables.get("budget")
    if table is None or not len(table) or "share" not in table:
        return None
    measurands, names, shares = table.texts("measurand"), table.texts("contributor"), table.numbers("share")
    charts = []
    for measurand in dict.fromkeys(measurands):
        rows = [row for row, name in enumerate(measurands) if name == measurand and np.isfinite(shares[row])]
        rows.sort(key=lambda row: -shares[row])
        own = [(names[row], float(shares[row])) for row in rows if shares[row] != 0]
        if len(own) > _MOST + 1:
            own = [*own[:_MOST], (f"{len(own) - _MOST} others", sum(share for _, share in own[_MOST:]))]
        if own:
            charts.append(Chart(measurand, tuple(name for name, _ in own), np.array([share for _, share in own])))
    return tuple(charts) or None


def height(charts: tuple[Chart, ...]) -> float:
    """Return the height of the figure in inches."""
    return sum(0.26 * len(chart.names) + 0.75 for chart in charts) + 0.2


def draw(canvas: Canvas, charts: tuple[Chart, ...]) -> str:
    """Draw the figure and return its caption."""
    theme = canvas.theme
    heights = [len(chart.names) + 2.0 for chart in charts]
    for axes, chart in zip(canvas.axes(len(charts), 1, height_ratios=heights), charts, strict=True):
        rows = np.arange(len(chart.names))
        axes.barh(rows, chart.shares, height=0.66, color=theme.first)
        axes.plot(chart.together, rows, "-o", ms=3.5, lw=1, color=theme.second, label="this and all above")
        for row, share in zip(rows, chart.shares, strict=True):
            text = f"{share:.1f} %" if abs(share) >= 0.1 else "< 0.1 %"
            # inside a long bar, since the line of the sums begins at its end
            inside = share > _INSIDE
            axes.text(
                share - 2.5 if inside else max(share, 0) + 1, float(row), text, va="center", fontsize=7.5,
                ha="right" if inside else "left", color=theme.surface if inside else theme.ink,
                bbox=None if inside else {"facecolor": theme.surface, "edgecolor": "none", "pad": 0.6},
            )  # fmt: skip
        axes.set_yticks(rows, [shortened(name, _LETTERS) for name in chart.names])
        axes.invert_yaxis()
        axes.grid(axis="y", visible=False)
        axes.set_xlim(min(0.0, float(chart.shares.min()) * 1.2), 112)
        axes.set_title(chart.measurand)
    axes.set_xlabel("share of the variance (%)")
    canvas.figure.axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0))
    return (
        "Share of each contributor in the variance of the measurand, by GUM; the line adds them up. "
        "Contributions of 0 are left out."
    )
