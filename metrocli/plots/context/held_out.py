"""Gain of each finding of a diagnosis in each held-out part of the readings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.plots.context import ResultContext
from metrocli.plots.style import Canvas
from metrocli.result import Result

_MOST = 4
"""Most findings that are shown"""


@dataclass(frozen=True)
class Gains:
    """Gain of one finding."""

    name: str
    folds: Array
    """(n,) log score with it minus log score without it, one for each held-out part"""
    std: float
    """Standard deviation of their sum"""

    @property
    def total(self) -> float:
        """The gain in all parts together."""
        return float(self.folds.sum())


@dataclass(frozen=True)
class HeldOut:
    """What the figure shows."""

    gains: tuple[Gains, ...]
    """Those with the largest gains"""
    findings: int


def data(result: Result, context: ResultContext) -> HeldOut | None:
    """Return the gains by part; None without a diagnosis that found something."""
    diagnosis = context.diagnosis or {}
    chosen = [law for law in diagnosis.get("laws", ()) if law.get("chosen")]
    named = [(_name(effect), effect["gain"]) for effect in diagnosis.get("effects", ())]
    named += [(f"law {_name(law)}", law["gain"]) for law in chosen]
    if diagnosis.get("together"):
        named.append(("all of them together", diagnosis["together"]))
    gains = [
        Gains(name, np.array(gain["folds"], dtype=float), float(gain["log_score_std"]))
        for name, gain in named
        if gain.get("folds")
    ]
    if not gains:
        return None
    largest = sorted(gains, key=lambda gain: -gain.total)[:_MOST]
    return HeldOut(tuple(largest), len(gains))


def _name(finding: Mapping[str, Any]) -> str:
    """Return an effect or a law with its place."""
    adds = finding.get("adds", "")
    words = finding["name"] if "name" in finding else "; ".join(adds.values()) if isinstance(adds, Mapping) else adds
    return " ".join([str(words), *map(str, dict(finding.get("where", {})).values())])


def height(gains: HeldOut) -> float:
    """Return the height of the figure in inches."""
    return 0.9 + 1.5 * len(gains.gains)


def draw(canvas: Canvas, gains: HeldOut) -> str:
    """Draw the figure and return its caption."""
    theme = canvas.theme
    panels = canvas.axes(len(gains.gains), 1, sharex=True, sharey=True)
    words = []
    for axes, group in zip(panels, gains.gains, strict=True):
        number = np.arange(1, len(group.folds) + 1)
        colours = [theme.first if gain > 0 else theme.second for gain in group.folds]
        axes.bar(number, group.folds, width=0.7, color=colours)
        axes.axhline(0, color=theme.muted, lw=0.8)
        axes.set_title(group.name, fontweight="normal", fontsize=9)
        axes.set_ylabel("gain (log score)")
        axes.grid(axis="x", visible=False)
        size = f"{'above' if group.total > 2 * group.std else 'below'} two standard deviations"
        better = f"better in {(group.folds > 0).sum()} of {len(group.folds)} parts"
        words.append(
            f"{group.name}: {group.total:+.1f} ± {group.std:.1f} (standard deviation) in all ({size}), {better}."
        )
    most = max(len(gain.folds) for gain in gains.gains)
    panels[-1].set_xticks(np.unique(np.linspace(1, most, min(most, 12)).round()))
    panels[-1].set_xlabel("held-out part (number)")
    left = gains.findings - len(gains.gains)
    words += [f"{left} findings with smaller gains are not shown."] if left else []
    return (
        "Each part of the readings is predicted from the others, with and without the finding. Above zero (blue) the "
        f"finding predicts it better, below (orange) worse. {' '.join(words)}"
    )
