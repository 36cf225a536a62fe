"""Accuracy and repeatability of positioning of an axis (ISO 230-2:2014, clauses 4 and 5)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.table import Table
from metrocli.words import listed

if TYPE_CHECKING:
    from metrocli.table import Values

_SAME = 0.01
"""Targets of two runs are the same within this [mm]"""
_RUNS, _LONG = 5, 2000.0
"""Runs in each direction that ISO 230-2:2014, 5.3.2, asks for, on axes up to this travel [mm]"""


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
    line: str = ""
    """Runs of one line have one zero"""


def positioning(runs: Sequence[Run]) -> tuple[Table | None, tuple[str, ...]]:
    """Return the figures of each line along an axis with runs in both directions, and warnings.

    Without such a line there is no table. Runs of several lines are not pooled, since each line has its own zero. A run
    that lacks a target of the others is left out: the figures need all runs at each target.
    """
    lines = _lines(runs)
    rows, warnings = [], []
    for line in lines:
        own, lacking = _complete([run for run in runs if (run.axis, run.at, run.line) == line])
        found = _of_runs(own)
        if found is not None:
            rows.append((*line, found))
            warnings += lacking + _too_few(line[0], found, own)
    warnings += _apart(lines)
    if not rows:
        return None, tuple(warnings)
    columns: dict[str, Values] = {
        "axis": np.array([axis for axis, *_ in rows]),
        "at": np.array([_named(axis, at) for axis, at, *_ in rows]),
        "line": np.array([name for _, _, name, _ in rows]),
        "runs_up": np.array([one.runs[0] for *_, one in rows]),
        "runs_down": np.array([one.runs[1] for *_, one in rows]),
    }
    names = {"A": "accuracy", "R": "repeatability", "B": "reversal", "E": "systematic", "M": "mean_range"}
    columns |= {letter: np.array([getattr(one, name) for *_, one in rows]) for letter, name in names.items()}
    return Table(columns, dict.fromkeys(names, "mm")), tuple(warnings)


def _named(axis: str, at: Sequence[float]) -> str:
    others = [other for other in "XYZ" if other != axis]
    return ", ".join(f"{other} = {place:g} mm" for other, place in zip(others, at, strict=False))


def _complete(runs: Sequence[Run]) -> tuple[list[Run], list[str]]:
    """Return the runs over all targets, ordered by target, and a warning for each that is left out."""
    all_targets = np.sort(max(runs, key=lambda run: len(run.targets)).targets)
    whole, lacking = [], []
    for number, run in enumerate(runs, 1):
        order = np.argsort(run.targets, kind="stable")
        near = np.abs(run.targets[:, None] - all_targets).min(axis=0) <= _SAME
        if near.all() and len(order) == len(all_targets):
            whole.append(run)
            continue
        gone = [f"{target:g} mm" for target in all_targets[~near]]
        why = f"lacks the target {listed(gone)}" if gone else "has other targets than the longest run"
        lacking.append(f"axis {run.axis}, line '{run.line}': run {number} {why}; the figures of ISO 230-2 leave it out")
    return whole, lacking


def _of_runs(runs: Sequence[Run]) -> Figures | None:
    up, down = _both_ways(runs)
    return figures(up, down) if len(up) and len(down) else None


def _both_ways(runs: Sequence[Run]) -> tuple[Array, Array]:
    """Return the deviations (runs, targets) in the positive and in the negative direction, ordered by target."""
    either: dict[bool, list[Array]] = {True: [], False: []}
    for run in runs:
        order = np.argsort(run.targets, kind="stable")
        either[bool(run.targets[-1] > run.targets[0])].append(run.deviation[order])
    return np.array(either[True]), np.array(either[False])


def at_targets(runs: Sequence[Run]) -> Table | None:
    """Return mean and standard deviation (nan of one run) in both directions at each target of the same lines."""
    parts = []
    for axis, at, line in _lines(runs):
        own, _ = _complete([run for run in runs if (run.axis, run.at, run.line) == (axis, at, line)])
        up, down = _both_ways(own)
        if len(up) and len(down):
            position = np.sort(own[0].targets)
            names = {"axis": axis, "at": _named(axis, at), "line": line}
            labels = {name: np.full(len(position), text) for name, text in names.items()}
            means = {"up": up.mean(axis=0), "down": down.mean(axis=0)}
            spread = {"s_up": _spread(up), "s_down": _spread(down)}
            parts.append(labels | {"position": position} | means | spread)
    if not parts:
        return None
    columns: dict[str, Values] = {name: np.concatenate([one[name] for one in parts]) for name in parts[0]}
    return Table(columns, dict.fromkeys(("position", "up", "s_up", "down", "s_down"), "mm"))


def _spread(deviations: Array) -> Array:
    """Return the standard deviation of runs (runs, targets) at each target; nan of one run."""
    return deviations.std(axis=0, ddof=1) if len(deviations) > 1 else np.full(deviations.shape[1], np.nan)


def _lines(runs: Sequence[Run]) -> list[tuple[str, tuple[float, ...], str]]:
    """Return axis, place and name of each line, in the order of the axes."""
    return list(dict.fromkeys((axis, run.at, run.line) for axis in "XYZ" for run in runs if run.axis == axis))


def _too_few(axis: str, found: Figures, runs: Sequence[Run]) -> list[str]:
    """Return a warning if an axis of up to 2 m has fewer than five runs in a direction."""
    travel = float(np.ptp(runs[0].targets))
    if min(found.runs) >= _RUNS or travel > _LONG:
        return []
    up, down = found.runs
    return [f"axis {axis}: {up} runs up and {down} down; ISO 230-2:2014, 5.3.2, asks for five in each direction"]


def _apart(lines: Iterable[tuple[str, tuple[float, ...], str]]) -> list[str]:
    """Return a warning for each place of an axis that has several lines."""
    names: dict[tuple[str, tuple[float, ...]], list[str]] = {}
    for axis, at, line in lines:
        names.setdefault((axis, at), []).append(f"'{line}'")
    return [
        f"axis {axis}: lines {listed(several, 5)} have a zero of their own each; the figures of ISO 230-2 do not pool "
        "their runs. Enter runs with one zero as one line"
        for (axis, _), several in names.items()
        if len(several) > 1
    ]
