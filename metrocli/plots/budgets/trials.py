"""Monte Carlo trials of measurands as a histogram, with the coverage intervals of Monte Carlo and of GUM (JCGM 101)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.plots.style import Canvas
from metrocli.result import Result

_MOST = 8
"""Measurands that are shown"""


@dataclass(frozen=True)
class Histogram:
    """The trials of one measurand, in its unit, counted from its value."""

    measurand: str
    unit: str
    value: float
    edges: Array
    """(n + 1,)"""
    shares: Array
    """(n,) percent"""
    intervals: dict[str, tuple[float, float]]
    """Coverage intervals by method"""
    probability: float
    normal: Array | None
    """(n,) percent that GUM expects in each bin, of a normal distribution; None where k is of few degrees of freedom"""


def data(result: Result, about: str) -> tuple[Histogram, ...] | None:
    """Return the histograms of the table `trials` with the intervals in the details of the measurands."""
    table = result.tables.get("trials")
    if table is None or "share" not in table:
        return None
    names, from_, to = table.texts("measurand"), table.numbers("from"), table.numbers("to")
    histograms = []
    for estimate in result.estimates[:_MOST]:
        rows = [row for row, name in enumerate(names) if name == estimate.name]
        details = result.details.get(estimate.name, {})
        if not rows or "mc" not in details:
            continue
        edges = np.append(from_[rows], to[rows[-1]]) - estimate.value
        trials, interval = (_ends(of, estimate.value) for of in (details["mc"]["interval"], details["interval"]))
        gum = interval != trials and estimate.std > 0
        intervals = {"Monte Carlo": trials} | ({"GUM": interval} if gum else {})
        normal = _normal(edges, estimate.std) if gum and math.isinf(float(details["dof"])) else None
        share = float(details["probability"])
        shares = table.numbers("share")[rows]
        histograms.append(
            Histogram(estimate.name, estimate.unit, estimate.value, edges, shares, intervals, share, normal)
        )
    return tuple(histograms) or None


def _ends(interval: Sequence[float], value: float) -> tuple[float, float]:
    return float(interval[0]) - value, float(interval[1]) - value


def _normal(edges: Array, std: float) -> Array:
    below = np.array([math.erf(edge / std / math.sqrt(2)) for edge in edges.tolist()])
    return 50 * np.diff(below)


def height(histograms: tuple[Histogram, ...]) -> float:
    """Return the height of the figure in inches."""
    return 2.3 * len(histograms) + 0.4


def draw(canvas: Canvas, histograms: tuple[Histogram, ...]) -> str:
    """Draw the figure and return its caption."""
    theme = canvas.theme
    for axes, shown in zip(canvas.axes(len(histograms), 1), histograms, strict=True):
        size, unit = (1e3, "µm") if shown.unit == "mm" else (1.0, "" if shown.unit == "1" else shown.unit)
        edges = shown.edges * size
        axes.stairs(shown.shares, edges, fill=True, color=theme.first, alpha=0.45, label="trials")
        if shown.normal is not None:
            middles = (edges[1:] + edges[:-1]) / 2
            axes.plot(middles, shown.normal, color=theme.ink, lw=1, label="normal distribution by GUM")
        styles = {"Monte Carlo": (theme.second, "-"), "GUM": (theme.third, "--")}
        for method, ends in shown.intervals.items():
            colour, line = styles[method]
            label = f"{100 * shown.probability:.4g} % interval of {method}"
            for n, end in enumerate(ends):
                axes.axvline(end * size, color=colour, ls=line, lw=1.6, label=None if n else label)
        axes.set_ylim(0, 1.15 * float(shown.shares.max()))
        axes.set_ylabel("share of the trials (%)")
        axes.set_xlabel(f"deviation from {shown.value:.10g} {shown.unit} ({unit})" if unit else "deviation")
        axes.set_title(shown.measurand)
    canvas.figure.axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    beyond = max(100 - float(shown.shares.sum()) for shown in histograms)
    return (
        "Trials in equal bins around the value at the best estimates, with the probabilistically symmetric interval of "
        f"Monte Carlo and the interval y ± U of GUM. At most {max(beyond, 0.0):.2g} % of the trials are beyond the "
        "figure."
    )
