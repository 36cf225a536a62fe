"""Accuracy and repeatability of positioning of an axis (ISO 230-2:2014, clauses 4 and 5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.table import Table

if TYPE_CHECKING:
    from metrocli.table import Values

_SAME = 0.01
"""Targets of two runs are the same within this [mm]"""


@dataclass(frozen=True)
class Figures:
    """Figures of ISO 230-2 [mm]; repeatability and accuracy are nan where a direction has only one run."""

    runs: tuple[int, int]
    """Number of runs in the positive and in the negative direction"""
    accuracy: float
    """A, bi-directional accuracy of positioning"""
    repeatability: float
    """R, bi-directional repeatability of positioning"""
    reversal: float
    """B, reversal value of the axis"""
    systematic: float
    """E, bi-directional systematic positioning deviation"""
    mean_range: float
    """M, range of the mean bi-directional positioning deviation"""


def figures(up: Array, down: Array) -> Figures:
    """Return the figures from deviations (runs, targets) in the positive and in the negative direction.

    x is the mean and s the standard deviation (n - 1) of the runs at a target; all extremes are over the targets:

    - B = max |B_i| with B_i = x_up - x_down
    - M = range of (x_up + x_down)/2
    - E = range of all x
    - R = max(2 s_up + 2 s_down + |B_i|, 4 s_up, 4 s_down)
    - A = max(x + 2 s) - min(x - 2 s) over both directions
    """
    means = np.stack([up.mean(axis=0), down.mean(axis=0)])
    gap = means[0] - means[1]
    several = min(len(up), len(down)) > 1
    spread = np.stack([run.std(axis=0, ddof=1) for run in (up, down)]) if several else np.full_like(means, np.nan)
    repeat = np.maximum(2 * spread.sum(axis=0) + np.abs(gap), 4 * spread.max(axis=0))
    return Figures(
        (len(up), len(down)),
        float((means + 2 * spread).max() - (means - 2 * spread).min()),
        float(repeat.max()),
        float(np.abs(gap).max()),
        float(np.ptp(means)),
        float(np.ptp(means.mean(axis=0))),
    )


@dataclass(frozen=True)
class Run:
    """One run along an axis: targets in the order of travel, and the deviation at each."""

    axis: str
    targets: Array
    deviation: Array
    at: tuple[float, ...] = ()
    """Positions of the other axes [mm]"""


def positioning(runs: Sequence[Run]) -> Table | None:
    """Return the figures of each axis with runs in both directions over the same targets, or None without such an axis.

    There is one row for each place of the other axes. All runs of a row share one zero.
    """
    lines = dict.fromkeys((axis, run.at) for axis in "XYZ" for run in runs if run.axis == axis)
    rows = [
        (*line, found)
        for line in lines
        if (found := _of_line([run for run in runs if (run.axis, run.at) == line])) is not None
    ]
    if not rows:
        return None
    columns: dict[str, Values] = {
        "axis": np.array([axis for axis, *_ in rows]),
        "at": np.array([_named(axis, at) for axis, at, _ in rows]),
        "runs_up": np.array([one.runs[0] for *_, one in rows]),
        "runs_down": np.array([one.runs[1] for *_, one in rows]),
    }
    names = {"A": "accuracy", "R": "repeatability", "B": "reversal", "E": "systematic", "M": "mean_range"}
    columns |= {letter: np.array([getattr(one, name) for *_, one in rows]) for letter, name in names.items()}
    return Table(columns, dict.fromkeys(names, "mm"))


def _named(axis: str, at: Sequence[float]) -> str:
    others = [other for other in "XYZ" if other != axis]
    return ", ".join(f"{other} = {place:g} mm" for other, place in zip(others, at, strict=False))


def _of_line(runs: Sequence[Run]) -> Figures | None:
    either: dict[bool, list[Array]] = {True: [], False: []}
    for run in runs:
        order = np.argsort(run.targets, kind="stable")
        first = np.sort(runs[0].targets)
        if len(order) != len(first) or np.abs(run.targets[order] - first).max() > _SAME:
            return None
        either[bool(run.targets[-1] > run.targets[0])].append(run.deviation[order])
    if not (either[True] and either[False]):
        return None
    return figures(np.array(either[True]), np.array(either[False]))
