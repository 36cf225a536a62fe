"""The law that a diagnosis chose, with the readings that it changes."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.plots.context import ResultContext, chosen_law, law_in_words, sizes_in_words
from metrocli.plots.magnify import micro, thinned, words
from metrocli.plots.style import Canvas
from metrocli.result import Result

_AS_CURVE = (
    ", both converted to the component that it adds to; readings that this changes less than half as much as the most "
    "are left out"
)


@dataclass(frozen=True)
class ChosenLaw:
    """What the figure shows."""

    text: str
    """The law, with the place where it acts, and its sizes"""
    variable: str
    """Name and unit of the variable; empty for a law that is not a curve"""
    x: Array
    """Variable at each reading; of a law that is not a curve what it adds, (n,)"""
    law: Array
    """What it adds to each reading, (n,)"""
    residual: Array
    """Residual of the extended job, plus what the law adds, (n,)"""
    unit: str
    rows: Index
    """Readings that are shown"""
    curve: tuple[Array, Array]
    """The line of the law: x and what it adds"""

    @property
    def scatter(self) -> tuple[float, float]:
        """Root mean square of the readings without and with the law."""
        return _rms(self.residual), _rms(self.residual - self.law)


def data(result: Result, context: ResultContext) -> ChosenLaw | None:
    """Return the chosen law in the order of its variable; None without one."""
    chosen = chosen_law(context.diagnosis)
    columns = (chosen or {}).get("data")
    if chosen is None or not columns:
        return None
    order = np.argsort(columns["x"], kind="stable")
    x, law, residual = (np.array(columns[name], dtype=float)[order] for name in ("x", "law", "residual"))
    variable = f"{columns['variable']} ({columns['variable_unit'] or 1})" if columns["variable"] else ""
    # a law of a smooth variable has finer steps than the readings
    fine = columns.get("curve")
    curve = (np.array(fine["x"]), np.array(fine["law"])) if fine else (x, law)
    text = ", ".join(filter(None, [law_in_words(chosen), sizes_in_words(chosen.get("parameters", {}))]))
    return ChosenLaw(text, variable, x, law, residual, columns["unit"], thinned(x, residual), curve)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def height(shown: ChosenLaw) -> float:
    """Return the height of the figure in inches."""
    return 3.4


def draw(canvas: Canvas, law: ChosenLaw) -> str:
    """Draw the figure and return its caption."""
    theme, rows = canvas.theme, law.rows
    axes = canvas.axes()[0]
    unit = micro(law.unit)
    axes.axhline(0, color=theme.muted, lw=0.6)
    axes.plot(law.x[rows], law.residual[rows], "o", ms=3, mew=0, alpha=0.6, color=theme.first, label="one reading")
    axes.plot(*law.curve, "-", lw=1.6, color=theme.second, label="law", zorder=4)
    axes.set_xlabel(law.variable or f"what the law adds ({unit})")
    axes.set_ylabel(f"law and residual ({unit})")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    without, with_law = law.scatter
    text = (
        f"Law: {law.text}. Points: residual of the job extended by the law, plus what the law adds"
        f"{_AS_CURVE if law.variable else ''}. "
        f"Root mean square of {len(law.x)} readings: {without:.3g} {unit}, of their distances from the law: "
        f"{with_law:.3g} {unit}. A law is not a cause."
    )
    kept = "the lowest and the highest of each strip, the others at equal steps"
    return " ".join(filter(None, [text, words(len(rows), len(law.x), kept)]))
