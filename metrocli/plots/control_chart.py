"""Control charts of the estimates of many parts: values, mean, and limits from moving ranges (ISO 7870-2)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.plots.style import Canvas
from metrocli.table import Table
from metrocli.words import listed

LEAST, FEWEST = 8, 2
"""Fewest parts for which limits mean anything, and fewest that are drawn"""
_LABELLED = 30
"""Parts up to which the axis has their names"""
_MOST = 6
"""Estimates that are drawn; the caption states how many there are"""
_NAMED = 5
"""Parts outside that the caption names for each estimate"""
_ROUNDING = 1e-12
"""Relative: equal values may differ from their mean by rounding"""
_LIMIT = 3 / 1.128
"""Three standard deviations in mean moving ranges of two values (ISO 7870-2:2013, E2 = 2.660)"""


@dataclass(frozen=True)
class Series:
    """An estimate of all parts in the order in which they were measured."""

    name: str
    unit: str
    values: Array
    stds: Array
    parts: tuple[str, ...]
    tolerance: tuple[float, float] = (float("nan"), float("nan"))
    """Lower and upper limit, nan without one"""

    @property
    def limited(self) -> bool:
        """Whether there are enough parts for limits."""
        return len(self.values) >= LEAST

    @property
    def mean(self) -> float:
        return float(self.values.mean())

    @property
    def limits(self) -> tuple[float, float]:
        """The mean plus and minus 2.66 mean moving ranges."""
        reach = _LIMIT * float(np.abs(np.diff(self.values)).mean())
        return self.mean - reach, self.mean + reach

    @property
    def outside(self) -> Index:
        """Numbers of the parts beyond the limits, (n,); none of few parts."""
        if not self.limited:
            return np.zeros(0, dtype=np.intp)
        low, high = self.limits
        rounding = _ROUNDING * float(np.abs(self.values).max())
        return np.flatnonzero((self.values < low - rounding) | (self.values > high + rounding))


def series_of(table: Table) -> tuple[Series, ...]:
    """Return the estimates of a gathered table that at least FEWEST parts have."""
    return tuple(quantity for quantity in _series(table) if len(quantity.values) >= FEWEST)


def _series(table: Table) -> Iterator[Series]:
    for name in table:
        if f"{name}.std" in table:
            values, stds = table.numbers(name), table.numbers(f"{name}.std")
            kept = np.isfinite(values)
            parts = tuple(job.partition("[")[2].rstrip("]") or job for job in table.texts("job"))
            known = tuple(part for part, is_kept in zip(parts, kept, strict=True) if is_kept)
            ends = [np.unique(table.numbers(f"{name}.{end}", np.nan)[kept]) for end in ("low", "high")]
            low, high = (float(end[0]) if end.size == 1 else float("nan") for end in ends)
            yield Series(name, table.units.get(name, ""), values[kept], stds[kept], known, (low, high))


def height(series: tuple[Series, ...]) -> float:
    """Return the height of the figure in inches."""
    return 1.5 * min(len(series), _MOST) + 0.4


def draw(canvas: Canvas, series: tuple[Series, ...]) -> str:
    """Draw the charts and return their caption."""
    theme = canvas.theme
    shown = series[:_MOST]
    all_axes = canvas.axes(len(shown), 1, sharex=True)
    for axes, quantity in zip(all_axes, shown, strict=True):
        number, low, high = np.arange(1, len(quantity.values) + 1), *quantity.limits
        if quantity.limited:
            axes.axhspan(low, high, color=theme.band, lw=0)
        for end in filter(np.isfinite, quantity.tolerance):
            axes.axhline(end, color=theme.second, lw=1.0, ls="--")
        axes.axhline(quantity.mean, color=theme.ink, lw=0.8)
        known = np.where(np.isfinite(quantity.stds), quantity.stds, 0.0)
        axes.errorbar(number, quantity.values, yerr=2 * known, fmt="o", ms=2.5, lw=0.7, color=theme.first)
        out = quantity.outside
        axes.plot(number[out], quantity.values[out], "D", ms=4.5, color=theme.second)
        axes.set_title(f"{quantity.name}" + (f" ({quantity.unit})" if quantity.unit not in ("", "1") else ""))
    parts = max((quantity.parts for quantity in shown), key=len)
    if len(parts) <= _LABELLED:
        all_axes[-1].set_xticks(np.arange(1, len(parts) + 1), parts, rotation=90 if len(parts) > 8 else 0)
    all_axes[-1].set_xlabel("part, in the order of the list")
    left = f" The first {_MOST} of {len(series)} estimates are shown." if len(series) > _MOST else ""
    dashed = " Dashed: limits of the tolerance." if any(np.isfinite(chart.tolerance).any() for chart in shown) else ""
    points = "Points: estimates with two standard uncertainties. Line: mean."
    if not any(line.limited for line in series):
        return f"{points} Control limits need {LEAST} parts.{dashed}{left}"
    band = f"Band: the mean plus and minus 2.66 mean moving ranges (ISO 7870-2); {_count(series)}"
    return f"{points} {band}{dashed}{left}"


def _count(series: tuple[Series, ...]) -> str:
    several = [
        f"{listed([quantity.parts[i] for i in quantity.outside], _NAMED)} with {quantity.name}"
        for quantity in series
        if len(quantity.outside)
    ]
    return f"outside are {'; '.join(several)} (diamonds)." if several else "no part is outside."
