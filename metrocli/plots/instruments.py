"""What each instrument of a network does: its normalised residuals, and the differences of its two faces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.plots.noise_bands import largest_of
from metrocli.plots.style import LETTERS, Canvas
from metrocli.result import Result
from metrocli.words import shortened

_PER_MM = 1e3
_QUANTITIES = ("azimuth", "elevation", "distance")
_MOST = 800
"""Marks of one row"""
_ROWS = 24
"""Most rows of a figure"""


@dataclass(frozen=True)
class Row:
    """Values of one instrument or station."""

    name: str
    values: Array
    """(n,) normalised residuals, or half differences of the faces [µm]"""


@dataclass(frozen=True)
class PanelRows:
    """Rows of values; two faces have a panel for each quantity."""

    panels: tuple[tuple[str, tuple[Row, ...]], ...]
    bound: float
    """Bound that the largest of all normalised residuals exceeds in 5 % of measurements; 0 for two faces"""
    left: int
    """Rows that have no room"""


def data(result: Result, about: str) -> PanelRows | None:
    """Return the residuals by instrument and quantity (`residuals`), or the differences of the faces (`faces`)."""
    return _residuals(result) if about == "residuals" else _faces(result)


def _residuals(result: Result) -> PanelRows | None:
    table, stations = result.tables.get("residuals"), result.tables.get("stations")
    if table is None or stations is None or not {"station", "quantity"} <= set(table) or "instrument" not in stations:
        return None
    of = dict(zip(stations.texts("station"), stations.texts("instrument"), strict=True))
    names = [
        f"{of.get(station, '')} {quantity}".strip()
        for station, quantity in zip(table.texts("station"), table.texts("quantity"), strict=True)
    ]
    rows = _grouped(names, table.numbers("normalised"))
    count = sum(len(row.values) for row in rows)
    return PanelRows((("", rows[:_ROWS]),), largest_of(count), len(rows[_ROWS:])) if rows else None


def _faces(result: Result) -> PanelRows | None:
    table = result.tables.get("two_face")
    if table is None or not len(table):
        return None
    stations = table.texts("station")
    panels = tuple((name, _grouped(stations, table.numbers(name) * _PER_MM)) for name in _QUANTITIES)
    left = max(len(rows[_ROWS:]) for _, rows in panels)
    return PanelRows(tuple((name, rows[:_ROWS]) for name, rows in panels if rows), 0.0, left)


def _grouped(names: Sequence[str], values: Array) -> tuple[Row, ...]:
    """Return the finite values of each name, in the order of the names."""
    of = np.array(names)
    finite = np.isfinite(values)
    rows = (Row(name, values[finite & (of == name)]) for name in dict.fromkeys(names))
    return tuple(row for row in rows if len(row.values))


def height(shown: PanelRows) -> float:
    """Return the height of the figure in inches."""
    return 0.9 + 0.27 * max(len(rows) for _, rows in shown.panels)


def draw(canvas: Canvas, shown: PanelRows) -> str:
    """Draw the figure and return its caption."""
    theme = canvas.theme
    for axes, (title, rows) in zip(canvas.axes(1, len(shown.panels)), shown.panels, strict=True):
        for at, row in enumerate(rows):
            some = row.values[:: max(len(row.values) // _MOST, 1)]
            # a spread of the marks that is the same in each drawing
            beside = 0.25 * np.sin(2.4 * np.arange(len(some)))
            axes.plot(some, at + beside, ".", ms=2.5, color=theme.first, alpha=0.6)
            rms = float(np.sqrt(np.mean(row.values**2)))
            axes.plot([-rms, rms], [at, at], "|", ms=11, mew=1.8, color=theme.second)
            axes.plot([np.mean(row.values)], [at], "D", ms=4, color=theme.ink)
        axes.axvline(0, color=theme.muted, lw=0.8)
        for side in (-shown.bound, shown.bound) if shown.bound else ():
            axes.axvline(side, color=theme.muted, lw=0.8, ls="--")
        axes.set_yticks(range(len(rows)), [shortened(row.name, LETTERS) for row in rows])
        axes.set_ylim(len(rows) - 0.5, -0.5)
        axes.set_title(title)
        axes.set_xlabel("w" if shown.bound else "µm")
    more = f" {shown.left} more rows are not shown." if shown.left else ""
    signs = "Bars: plus and minus the root mean square; diamonds: mean."
    if shown.bound:
        return (
            f"Normalised residuals (reading minus model), one row for each instrument and quantity. {signs} Pure noise "
            "has a root mean square of 1, and its largest value is inside the dashed lines in 95 % of measurements."
            f"{more}"
        )
    return (
        "Half of face 1 less face 2 of each point, across and along the beam, one row for each station. "
        f"{signs} A mean beyond the scatter is an error of the instrument that changes its sign between the faces."
        f"{more}"
    )
