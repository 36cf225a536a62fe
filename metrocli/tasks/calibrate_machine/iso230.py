"""Accuracy and repeatability of positioning of an axis (ISO 230-2:2014)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.acceptance.positioning import FIGURES, Measured, at_each_target, expanded, figures
from metrocli.words import listed

if TYPE_CHECKING:
    from metrocli.table import Values

_SAME = 0.01
"""Targets of two runs are the same within this [mm]"""
_RUNS, _LONG = 5, 2000.0
"""Runs in each direction that ISO 230-2:2014 asks for, on axes up to this travel [mm]"""


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


@dataclass(frozen=True)
class _Line:
    """The runs of one line in both directions, over the same targets."""

    axis: str
    at: tuple[float, ...]
    name: str
    up: Array
    """(runs, targets) [mm]"""
    down: Array
    targets: Array


def positioning(runs: Sequence[Run], known: Measured) -> tuple[Table | None, tuple[str, ...]]:
    """Return the figures of each line along an axis with runs in both directions, with their U, and warnings.

    Without such a line there is no table. Runs of several lines are not pooled, since each line has its own zero. A run
    that lacks a target of the others is left out: the figures need all runs at each target.
    """
    whole, lacking = _whole(runs)
    warnings = (*lacking, *(line for one in whole for line in _too_few(one)), *_apart(_lines(runs)))
    if not whole:
        return None, warnings
    columns: dict[str, Values] = {
        "axis": np.array([one.axis for one in whole]),
        "at": np.array([_named(one.axis, one.at) for one in whole]),
        "line": np.array([one.name for one in whole]),
        "runs_up": np.array([len(one.up) for one in whole]),
        "runs_down": np.array([len(one.down) for one in whole]),
    }
    found = [figures(one.up, one.down) for one in whole]
    spread = [expanded(one.up, one.down, one.targets, known) for one in whole]
    columns |= {name: np.array([one[name] for one in found]) for name in FIGURES}
    columns |= {f"U_{name}": np.array([one[name] for one in spread]) for name in FIGURES}
    return Table(columns, {name: "mm" for name in columns if name.removeprefix("U_") in FIGURES}), warnings


def _whole(runs: Sequence[Run]) -> tuple[list[_Line], list[str]]:
    """Return the lines with runs in both directions, and a warning for each run of theirs that is left out."""
    whole, warnings = [], []
    for axis, at, name in _lines(runs):
        own, lacking = _complete([run for run in runs if (run.axis, run.at, run.line) == (axis, at, name)])
        up, down = _both_ways(own)
        if len(up) and len(down):
            whole.append(_Line(axis, at, name, up, down, np.sort(own[0].targets)))
            warnings += lacking
    return whole, warnings


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
    for one in _whole(runs)[0]:
        texts = {"axis": one.axis, "at": _named(one.axis, one.at), "line": one.name}
        labels = {name: np.full(len(one.targets), text) for name, text in texts.items()}
        means, spread = at_each_target(one.up, one.down)
        numbers = dict(zip(("up", "down", "s_up", "s_down"), (*means, *spread), strict=True))
        parts.append(labels | {"position": one.targets} | numbers)
    if not parts:
        return None
    columns: dict[str, Values] = {name: np.concatenate([one[name] for one in parts]) for name in parts[0]}
    return Table(columns, dict.fromkeys(("position", "up", "s_up", "down", "s_down"), "mm"))


def _lines(runs: Sequence[Run]) -> list[tuple[str, tuple[float, ...], str]]:
    """Return axis, place and name of each line, in the order of the axes."""
    return list(dict.fromkeys((axis, run.at, run.line) for axis in "XYZ" for run in runs if run.axis == axis))


def _too_few(line: _Line) -> list[str]:
    """Return a warning if an axis of up to 2 m has fewer than five runs in a direction."""
    up, down = len(line.up), len(line.down)
    if min(up, down) >= _RUNS or float(np.ptp(line.targets)) > _LONG:
        return []
    return [f"axis {line.axis}: {up} runs up and {down} down; ISO 230-2:2014 asks for five in each direction"]


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
