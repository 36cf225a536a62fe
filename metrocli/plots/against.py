"""Normalised residuals against their order, radius, time, temperature or length, with the envelope of pure noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes

from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.plots.magnify import MOST, thinned, words
from metrocli.plots.noise_bands import Trend, largest_of, trend
from metrocli.plots.readings import image_residuals, radial, residuals_of
from metrocli.plots.style import LETTERS, Canvas, Theme
from metrocli.result import Result
from metrocli.words import shortened

LABELS = {
    "order": "order of the readings",
    "radius": "distance from the principal point (px)",
    "time": "time (s)",
    "temperature": "temperature (°C)",
    "length": "reading (mm)",
    "x": "x (mm)",
    "y": "y (mm)",
    "z": "z (mm)",
}
CAPTION = (
    "Points: residual (reading minus model) divided by its own standard deviation. Line: means of bins; the band "
    "holds all of them with 95 % if there is noise only. Dashed: bound of the largest |w| here, exceeded in 5 %."
)


@dataclass(frozen=True)
class Panel:
    """One set of residuals against one covariate."""

    name: str
    covariate: Array
    w: Array
    trend: Trend
    rows: Index
    """Readings that are shown"""
    label: str
    """Name of the reading with the largest |w|, if that is beyond `most`"""
    most: float
    """The bound that the largest |w| of all readings exceeds in 5 % of measurements if there is noise only"""

    @property
    def room(self) -> float:
        """The largest w of the axis: with room for the name of a reading beyond it."""
        return (1.3 if self.label else 1.12) * max(float(np.abs(self.w).max()), self.most)

    @property
    def beyond(self) -> Index:
        """The readings with larger |w|, largest first."""
        rows = np.flatnonzero(np.abs(self.w) > self.most)
        return rows[np.argsort(-np.abs(self.w[rows]), kind="stable")]


@dataclass(frozen=True)
class Against:
    """What the figure shows."""

    about: str
    panels: tuple[Panel, ...]


def data(result: Result, about: str) -> Against | None:
    """Return the residuals against a covariate; None if the result lacks it."""
    panels = _radial(result) if about == "radius" else _others(result, about)
    return Against(about, tuple(panels)) if panels else None


def _radial(result: Result) -> list[Panel]:
    """Return panels of the components of image residuals along and across the radius."""
    each = image_residuals(result)
    if not each:
        return []
    radius, along, across = (np.concatenate(parts) for parts in zip(*map(radial, each), strict=True))
    owners = [(residuals, k) for residuals in each for k in range(len(residuals.rows))]

    def name(row: int) -> str:
        residuals, k = owners[row]
        return residuals.name(k)

    return _panels([("along the radius", radius, along, name), ("across the radius", radius, across, name)])


def _others(result: Result, about: str) -> list[Panel]:
    """Return a panel for each kind of residual that has the covariate; all have their order."""
    sets = []
    for residual in residuals_of(result):
        covariates = {"order": np.arange(1.0, len(residual.w) + 1), **residual.covariates}
        if about in covariates:
            part = f"residual {residual.part.strip('_')}" if residual.part else ""
            name = " ".join(filter(None, [residual.kind, part]))
            sets.append((name, covariates[about], residual.w, residual.name))
    return _panels(sets)


def _panels(sets: Sequence[tuple[str, Array, Array, Callable[[int], str]]]) -> list[Panel]:
    """Return a panel for each set of residuals that others check; together they have at most `MOST` marks.

    A set is its name, the covariate (n,), w (n,), and the function that names a reading.
    """
    checked = [each for each in sets if np.isfinite(each[2]).any()]
    count = sum(int(np.isfinite(w).sum()) for _, _, w, _ in checked)
    return [panel_of(*each, MOST // len(checked), count) for each in checked]


def panel_of(name: str, covariate: Array, w: Array, named: Callable[[int], str], marks: int, count: int) -> Panel:
    """Return a panel of those residuals w (n,) that others check, with at most `marks` marks.

    `named` returns the name of a row. The bound of the largest |w| is that of `count` readings, those of all panels.
    """
    kept, most = np.flatnonzero(np.isfinite(w)), largest_of(count)
    covariate, w = covariate[kept], w[kept]
    worst = int(np.argmax(np.abs(w)))
    text = shortened(named(int(kept[worst])), 2 * LETTERS) if abs(w[worst]) > most else ""
    return Panel(name, covariate, w, trend(covariate, w), thinned(covariate, w, marks), text, most)


def height(shown: Against) -> float:
    """Return the height of the figure in inches."""
    return 2.5 + 1.9 * (len(shown.panels) - 1)


def draw(canvas: Canvas, shown: Against) -> str:
    """Draw the figure and return its caption."""
    panels = canvas.axes(len(shown.panels), 1, sharex=shown.about != "order")
    for axes, panel in zip(panels, shown.panels, strict=True):
        draw_panel(axes, panel, canvas.theme)
        axes.locator_params(axis="x", integer=shown.about == "order")
    panels[-1].set_xlabel(LABELS[shown.about])
    panels[0].legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    return _caption(shown)


def draw_panel(axes: Axes, panel: Panel, theme: Theme) -> None:
    """Draw the residuals of one panel with the means of bins and what pure noise may do."""
    x, w = panel.covariate, panel.w
    marks = "." if len(panel.rows) > 300 else "o"
    axes.plot(
        x[panel.rows],
        w[panel.rows],
        marks,
        ms=3 if marks == "o" else 4.5,
        mew=0,
        alpha=0.55,
        color=theme.first,
        label="one reading",
    )
    wrong = panel.beyond
    axes.plot(x[wrong], w[wrong], "D", ms=4, mew=0, color=theme.second)
    if panel.label:
        _name_worst(axes, x, w, wrong[0], panel.label, theme.second)
    t = panel.trend
    _envelope(axes, t, theme.band)
    axes.plot(t.middles, t.means, "-o", ms=3, color=theme.ink, lw=1.0, label="mean of a bin", zorder=4)
    out = t.beyond
    axes.plot(t.middles[out], t.means[out], "o", ms=5, color=theme.second, zorder=5)
    for side in (-1, 1):
        axes.axhline(side * panel.most, color=theme.muted, lw=0.8, ls=(0, (4, 3)))
    axes.axhline(0, color=theme.muted, lw=0.6)
    axes.set_ylabel("w (standard deviations)")
    axes.set_title(panel.name, fontweight="normal", fontsize=9)
    axes.set_ylim(-panel.room, panel.room)


def _name_worst(axes: Axes, x: Array, w: Array, row: int, label: str, colour: str) -> None:
    """Write the name of a reading beyond all others, where no mark and no bound is, towards the middle."""
    left, up = x[row] < (x.min() + x.max()) / 2, w[row] > 0
    axes.annotate(
        label, (x[row], w[row]), xytext=(-3 if left else 3, 4 if up else -4), textcoords="offset points",
        ha="left" if left else "right", va="bottom" if up else "top", fontsize=7.5, color=colour,
    )  # fmt: skip


def _envelope(axes: Axes, t: Trend, colour: str) -> None:
    if len(t.middles) > 1:
        axes.fill_between(t.middles, -t.bounds, t.bounds, color=colour, lw=0, label="pure noise", zorder=1)
    else:
        axes.errorbar(t.middles, [0.0], yerr=t.bounds, color=colour, lw=4, label="pure noise")


def _caption(shown: Against) -> str:
    parts = [CAPTION]
    for panel in shown.panels:
        bins, wrong = len(panel.trend.beyond), len(panel.beyond)
        where = f"{panel.name}: " if panel.name else ""
        text = f"{where}{bins} of {len(panel.trend.means)} means and {wrong} of {len(panel.w)} readings are outside."
        parts.append(text[0].upper() + text[1:])
    first = shown.panels[0]
    kept = f"lowest and highest of each of {MOST // len(shown.panels) // 4} strips, the others at equal steps"
    return " ".join(filter(None, [*parts, words(len(first.rows), len(first.w), kept)]))
