"""Overstock of a raw part, surface by surface: least, mean and largest, against the minimum."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.plots.style import LETTERS, Canvas
from metrocli.result import K, Result
from metrocli.words import shortened

_MOST = 40
"""Most surfaces that are shown, those with the least overstock"""


@dataclass(frozen=True)
class OverstockFigure:
    """What the figure shows, lengths in mm."""

    surfaces: tuple[str, ...]
    """Least overstock first"""
    least: Array
    spread: Array
    """Expanded uncertainty (k = 2) of the least, from the measurement of its point"""
    mean: Array
    largest: Array
    least_at: tuple[str, ...]
    minimum: float
    left_out: tuple[tuple[str, float], ...]
    """Surface and overstock of each point that was left out, as chip or flash"""
    of: int
    """Surfaces of the part"""


def data(result: Result, about: str = "") -> OverstockFigure | None:
    """Return the overstock of the surfaces; None if the result has none."""
    table, minimum = result.tables.get("surfaces"), result.statistics.get("minimum")
    if table is None or "least" not in table or not len(table) or not isinstance(minimum, int | float):
        return None
    rows = np.argsort(table.numbers("least"), kind="stable")[:_MOST]
    names, points = np.array(table.texts("surface"))[rows], np.array(table.texts("least_at"))[rows]
    rejected = result.tables.get("rejected")
    out = (
        () if rejected is None else zip(rejected.texts("surface"), rejected.numbers("overstock").tolist(), strict=True)
    )
    least, spread, mean, largest = (table.numbers(name)[rows] for name in ("least", "s_least", "mean", "largest"))
    kept = tuple((surface, value) for surface, value in out if surface in names)
    surfaces, at = tuple(names.tolist()), tuple(points.tolist())
    return OverstockFigure(surfaces, least, K * spread, mean, largest, at, float(minimum), kept, len(table))


def height(overstock: OverstockFigure) -> float:
    """Return the height of the figure in inches."""
    return 0.24 * len(overstock.surfaces) + 1.1


def draw(canvas: Canvas, overstock: OverstockFigure) -> str:
    """Draw the figure and return its caption."""
    theme, axes, rows = canvas.theme, canvas.axes()[0], np.arange(len(overstock.surfaces))
    axes.hlines(rows, overstock.least, overstock.largest, color=theme.band, lw=7)
    axes.plot(overstock.mean, rows, "|", ms=9, mew=1.6, color=theme.ink, label="mean")
    axes.errorbar(
        overstock.least, rows, xerr=overstock.spread, fmt="o", ms=4.5, capsize=3, lw=1.2, color=theme.first,
        label="least ± U (k = 2)",
    )  # fmt: skip
    if overstock.left_out:
        row = {name: k for k, name in enumerate(overstock.surfaces)}
        at = [(value, row[surface]) for surface, value in overstock.left_out]
        axes.plot(*np.transpose(at), "D", ms=5, mew=0, color=theme.second, label="left out")
    axes.axvline(overstock.minimum, color=theme.second, lw=1.2, ls=(0, (4, 3)), label="minimum")
    axes.set_yticks(rows, [shortened(name, LETTERS) for name in overstock.surfaces])
    axes.invert_yaxis()
    axes.margins(0.05, 0.6 / len(rows))
    axes.set_xlabel("overstock (mm)")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4)
    least = f"{overstock.least[0]:.3f} mm at {overstock.least_at[0]}, {overstock.surfaces[0]}"
    parts = [f"Bar: from least to largest; U of the least is that of its point. The least of all is {least}."]
    if overstock.left_out:
        parts.append("Points that were left out are chips, flash or wrong (table rejected).")
    if len(overstock.surfaces) < overstock.of:
        parts.append(f"{len(overstock.surfaces)} of {overstock.of} surfaces are shown, those with the least.")
    return " ".join(parts)
