"""The 21 error curves of a machine with their uncertainty bands."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.plots.style import Canvas
from metrocli.result import Result

_K = 2.0
_MICRO = 1e6
_PER_MM = 1e3


@dataclass(frozen=True)
class ErrorCurve:
    """One error over the position of its axis, in µm or µrad."""

    name: str
    position: Array
    value: Array
    spread: Array
    """Expanded uncertainty, k = 2"""
    status: str

    @property
    def determined(self) -> bool:
        """Whether the measurement determines it."""
        return bool(np.isfinite(self.value).any())


@dataclass(frozen=True)
class Errors:
    """What the figure shows."""

    curves: tuple[ErrorCurve, ...]
    squareness: tuple[tuple[str, float, float], ...]
    """Name, value and expanded uncertainty (µrad) of each squareness error"""


def data(result: Result, about: str) -> Errors | None:
    """Return the curves of all tables, in the order of the axes; None if the result has none."""
    names = [name for name in result.tables if name.startswith("tables/")]
    if not names:
        return None
    status = {}
    if "errors" in result.tables:
        listed = result.tables["errors"]
        status = dict(zip(listed.texts("error"), listed.texts("status"), strict=True))
    curves = []
    for name in sorted(names, key=_order):
        table, error = result.tables[name], name.removeprefix("tables/")
        size = _PER_MM if table.units.get("value") == "mm" else _MICRO
        value, std = table.numbers("value") * size, table.numbers("std") * size
        position = table.numbers("position")
        position = np.degrees(position) if table.units.get("position") == "rad" else position
        curves.append(ErrorCurve(error, position, value, _K * std, status.get(error, "")))
    square = [
        estimate
        for estimate in result.estimates
        if estimate.name in ("A0Z", "B0Z", "C0Y") and np.isfinite(estimate.value)
    ]
    return Errors(tuple(curves), tuple((error.name, error.value * _MICRO, _K * error.std * _MICRO) for error in square))


def _order(name: str) -> tuple[int, str, str]:
    """Return the place of a table: along the axis first, then straightness, then angles."""
    error = name[-3:]
    kind = 0 if error[1] == error[2] else 1 if error[1] in "XYZ" else 2
    return kind, error[1] if kind == 2 else "", error


def height(errors: Errors) -> float:
    """Return the height of the figure in inches."""
    return 1.55 * len(_panels(errors)) / len(_axes(errors)) + 0.5


def _axes(errors: Errors) -> str:
    """Return the axes of the columns: three linear ones, or those that have curves where some turn."""
    letters = {curve.name[2] for curve in errors.curves}
    return "".join(name for name in "XYZABC" if name in letters) if letters & set("ABC") else "XYZ"


def _panels(errors: Errors) -> list[list[ErrorCurve]]:
    """Return the curves of each panel: rows are the direction of the error, columns the axis that moves."""
    by_name = {curve.name: curve for curve in errors.curves}
    rows = [[f"E{direction}{axis}" for axis in _axes(errors)] for direction in "XYZABC"]
    kept = [row for row in rows if any(name in by_name for name in row)]
    return [[by_name[name]] if name in by_name else [] for row in kept for name in row]


def draw(canvas: Canvas, errors: Errors) -> str:
    """Draw the figure and return its caption."""
    theme, panels = canvas.theme, _panels(errors)
    letters = _axes(errors)
    count = len(letters)
    rows = len(panels) // count
    all_axes = canvas.axes(rows, count, sharex="col")
    for k, (axes, curves) in enumerate(zip(all_axes, panels, strict=True)):
        row, column = divmod(k, count)
        if not curves:
            axes.set_visible(False)
            continue
        curve = curves[0]
        unit = "µrad" if curve.name[1] in "ABC" else "µm"
        axes.set_title(f"{curve.name} ({unit})", fontsize=8.5)
        if curve.determined:
            usable = np.isfinite(curve.spread)
            low, high = curve.value - curve.spread, curve.value + curve.spread
            axes.fill_between(curve.position[usable], low[usable], high[usable], color=theme.band, lw=0)
            line = "--" if curve.status == "together" else "-"
            axes.plot(curve.position, curve.value, color=theme.first, marker="o", ms=2, ls=line)
            axes.axhline(0, color=theme.muted, lw=0.6)
        else:
            axes.text(0.5, 0.5, "not determined", transform=axes.transAxes, ha="center", color=theme.second, fontsize=8)
            axes.set_yticks([])
        axes.locator_params(axis="x", nbins=4)
        if row == rows - 1 or not any(panels[k + count :: count]):
            axes.set_xlabel(f"{letters[column]} ({'deg' if letters[column] in 'ABC' else 'mm'})")
            axes.tick_params(labelbottom=True)
    return _caption(errors)


def _caption(errors: Errors) -> str:
    parts = [
        "Rows: direction of the error; columns: axis that moves. Band: expanded uncertainty, k = 2 "
        "(often thinner than the line)."
    ]
    if any(curve.status == "together" for curve in errors.curves):
        parts.append("Dashed: determined only together with errors that are not, so valid for the measured tools only.")
    square = [f"{name} {value:.1f} ± {spread:.1f} µrad" for name, value, spread in errors.squareness]
    if square:
        parts.append(f"Squareness (k = 2): {', '.join(square)}.")
    return " ".join(parts)
