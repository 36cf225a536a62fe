"""Values with their expanded uncertainty against tolerance and guard band (ISO 14253-1)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from metrocli.frozen import dataclass
from metrocli.plots.style import Canvas
from metrocli.result import Result


@dataclass(frozen=True)
class Decision:
    """One measurand against its limits, in its unit."""

    name: str
    unit: str
    value: float
    U: float
    k: float
    low: float
    high: float
    """Limits of the tolerance; infinite where one is missing"""
    accepted: tuple[float, float] | None
    """Limits between which a value conforms although it may be wrong by U; None if there are none"""
    zone: str


def data(result: Result, about: str) -> tuple[Decision, ...] | None:
    """Return the measurands that have limits, with the acceptance zone `[low + U, high - U]`."""
    decisions = []
    for estimate in result.estimates:
        details = result.details.get(estimate.name, {})
        decision: Mapping[str, Any] = details.get("tolerance", {})
        limits = decision.get("limits") if isinstance(decision, Mapping) else None
        if limits is None or len(limits) != 2:
            continue
        accepted = decision.get("acceptance")
        zone = (float(accepted[0]), float(accepted[1])) if accepted is not None and len(accepted) == 2 else None
        low, high = float(limits[0]), float(limits[1])
        spread, k, words = float(details["U"]), float(details.get("k", 2.0)), str(decision.get("zone", ""))
        decisions.append(Decision(estimate.name, estimate.unit, estimate.value, spread, k, low, high, zone, words))
    return tuple(decisions) or None


def height(decisions: tuple[Decision, ...]) -> float:
    """Return the height of the figure in inches."""
    return 1.25 * len(decisions) + 0.5


def middle_of(decision: Decision) -> float:
    """Return the value from which the figure counts: the middle of the tolerance, or its only limit."""
    ends = [end for end in (decision.low, decision.high) if math.isfinite(end)]
    return sum(ends) / len(ends)


def draw(canvas: Canvas, decisions: tuple[Decision, ...]) -> str:
    """Draw the figure and return its caption."""
    theme = canvas.theme
    for axes, decision in zip(canvas.axes(len(decisions), 1), decisions, strict=True):
        zero = middle_of(decision)
        micro = decision.unit == "mm"
        size, unit = (1e3, "µm") if micro else (1.0, decision.unit)
        low, high, value, spread = (
            (end - zero) * size for end in (decision.low, decision.high, decision.value, decision.U + zero)
        )
        reach = [abs(end) for end in (low, high, value - spread, value + spread) if math.isfinite(end)]
        edge = 1.25 * max(max(reach), 1e-300)
        left, right = max(low, -edge), min(high, edge)
        axes.axvspan(left, right, color=theme.second, alpha=0.22, lw=0, label="guard band")
        if decision.accepted is not None:
            ends = [(end - zero) * size for end in decision.accepted]
            axes.axvspan(max(ends[0], -edge), min(ends[1], edge), color=theme.surface, lw=0)
            axes.axvspan(max(ends[0], -edge), min(ends[1], edge), color=theme.third, alpha=0.28, lw=0, label="accepted")
        for end in (low, high):
            if math.isfinite(end):
                axes.axvline(end, color=theme.ink, lw=1.6)
        label = f"value ± U (k = {decision.k:.3g})"
        axes.errorbar(value, 0, xerr=spread, fmt="o", ms=5, color=theme.first, capsize=4, lw=1.6, label=label)
        axes.set_xlim(-edge, edge)
        axes.set_ylim(-1, 1)
        axes.set_yticks([])
        axes.grid(False)
        axes.spines["left"].set_visible(False)
        axes.set_xlabel(f"deviation from {zero:.10g} {decision.unit} ({unit})")
        axes.set_title(f"{decision.name}: {decision.zone}")
    canvas.figure.axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
    return (
        "Thick lines: limits of the tolerance. A value in the green zone conforms even if it is wrong by U "
        "(ISO 14253-1); in the guard band it is undecided."
    )
