"""Accuracy and repeatability of positioning of an axis (ISO 230-2:2014)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from math import ceil

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.instruments.machine import ANGLES, AXES
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.acceptance.positioning import (
    FIGURES,
    LineUncertainty,
    at_each_target,
    expanded,
    figures,
)
from metrocli.words import in_a_row, listed

_SAME = 0.01
"""Targets of two runs are the same within this [mm, deg]"""
RUNS, _TARGETS, _LONG = 5, 5, 2000.0
"""Runs in each direction, and targets per metre and at least, that ISO 230-2:2014 asks for on axes up to this travel"""
_PER_METRE = 1000.0
_TARGETS_OF_RANGE = ((90.0, 3), (180.0, 5), (360.0, 8))
"""Fewest targets of a rotary axis by its range [deg]"""
_ASKS = "ISO 230-2:2014 asks for"


@dataclass(frozen=True)
class Run:
    """One run along an axis: targets in the order of travel, and the deviation at each."""

    axis: str
    targets: Array
    """[mm, deg]"""
    deviation: Array
    """[mm, rad]"""
    at: str = ""
    """Positions of the other axes, in words"""
    line: str = ""
    """Runs of one line have one zero"""

    @property
    def up(self) -> bool:
        """Whether it goes in the positive direction."""
        return bool(self.targets[-1] > self.targets[0])


@dataclass(frozen=True)
class _LineRuns:
    """The runs of one line over the same targets."""

    axis: str
    at: str
    name: str
    up: Array
    """(runs, targets) [mm, rad]; no rows if no run goes up"""
    down: Array
    targets: Array


def positioning(runs: Sequence[Run], known: LineUncertainty) -> tuple[Table | None, tuple[str, ...]]:
    """Return the figures of each line along an axis that was run more than once, with their U, and warnings.

    Without such a line there is no table. Runs of several lines are not pooled, since each line has its own zero. The
    figures need all runs at each target: targets that most runs lack, and then runs that lack a target, are left out.
    The runs are all of linear axes, or all of rotary ones.
    """
    whole, left_out = _whole(runs)
    warnings = (*left_out, *_too_few(whole), *_apart(_lines(runs)))
    if not whole:
        return None, warnings
    evaluated = [figures(line.up, line.down) for line in whole]
    spread = [expanded(line.up, line.down, _internal(line.axis, line.targets), known) for line in whole]
    columns: dict[str, Sequence[object]] = {
        "axis": [line.axis for line in whole],
        "at": [line.at for line in whole],
        "line": [line.name for line in whole],
        "runs_up": [len(line.up) for line in whole],
        "runs_down": [len(line.down) for line in whole],
    }
    unit = _unit_of_deviation(whole[0].axis)
    columns |= {f"{name} [{unit}]": [figure[name] for figure in evaluated] for name in FIGURES}
    columns |= {f"U_{name} [{unit}]": [figure[name] for figure in spread] for name in FIGURES}
    return Table.of(columns), warnings


def _internal(axis: str, targets: Array) -> Array:
    """Return targets of an axis [mm, deg] in internal units."""
    return np.radians(targets) if axis in ANGLES else targets


def _unit_of_target(axis: str) -> str:
    """Return the unit in which targets of an axis are shown."""
    return "deg" if axis in ANGLES else "mm"


def _unit_of_deviation(axis: str) -> str:
    """Return the internal unit of the deviation of an axis."""
    return "rad" if axis in ANGLES else "mm"


def _whole(runs: Sequence[Run]) -> tuple[list[_LineRuns], list[str]]:
    """Return the lines that were run more than once, over common targets, and warnings of what is left out of them."""
    whole, warnings = [], []
    for axis, at, name in _lines(runs):
        own = [run for run in runs if (run.axis, run.at, run.line) == (axis, at, name)]
        if len(own) < 2:
            continue
        where = f"axis {axis}, {_where(name, at)}"
        targets, rare = _common(own)
        if len(targets) < 2:
            warnings.append(
                f"{where}: no figures of ISO 230-2, since its {len(own)} runs have no two targets in common; "
                "rows have to stand in the order of travel, and at a turn a target is read twice"
            )
            continue
        places = [_places(run, targets) for run in own]
        up, down = (
            np.array(
                [run.deviation[at] for run, at in zip(own, places, strict=True) if (at >= 0).all() and run.up == to]
            )
            for to in (True, False)
        )
        warnings += [
            f"{where}: {without}; the figures of ISO 230-2 leave it out"
            for without in _left_out(targets, rare, places, _unit_of_target(axis))
        ]
        if max(len(up), len(down)) > 1 or min(len(up), len(down)) > 0:
            size = (-1, len(targets))
            whole.append(_LineRuns(axis, at, name, up.reshape(size), down.reshape(size), targets))
    return whole, warnings


def _common(runs: Sequence[Run]) -> tuple[Array, Array]:
    """Return the targets that more than half of the long runs have, in each direction, and the other targets.

    A run is long if it has half as many targets as the longest.
    """
    every = np.unique(np.concatenate([run.targets for run in runs]))
    targets = every[np.diff(every, prepend=-np.inf) > _SAME]
    met = np.array([_places(run, targets) >= 0 for run in runs])
    number = met.sum(axis=1)
    long, up = 2 * number >= number.max(), np.array([run.up for run in runs])
    sides = [met[long & (up == to)] for to in (True, False)]
    common = np.logical_and.reduce([2 * side.sum(axis=0) > len(side) for side in sides if len(side)])
    return targets[common], targets[~common]


def _places(run: Run, targets: Array) -> Index:
    """Return the place of each target in a run, -1 where the run lacks it."""
    gap = np.abs(run.targets[:, None] - targets)
    return np.where(gap.min(axis=0) <= _SAME, gap.argmin(axis=0), -1)


def _left_out(targets: Array, rare: Array, places: Sequence[Index], unit: str) -> Iterator[str]:
    """Yield what the figures of a line leave out: targets, and runs."""
    if len(rare):
        yield f"at most half of the runs in one direction have the target at {_listed(rare, unit)}"
    for number, at in enumerate(places, 1):
        if (at < 0).any():
            lacked = targets[at < 0]
            yield f"run {number} lacks the target{'s' * (len(lacked) > 1)} {_listed(lacked, unit)}"


def _listed(targets: Array, unit: str) -> str:
    return in_a_row([f"{target:g} {unit}" for target in targets.tolist()])


def at_targets(runs: Sequence[Run]) -> Table | None:
    """Return mean and standard deviation (nan of one run) in each direction at each target of the same lines."""
    parts = []
    for line in _whole(runs)[0]:
        texts = {"axis": line.axis, "at": line.at, "line": line.name}
        labels = {name: np.full(len(line.targets), text) for name, text in texts.items()}
        numbers = np.concatenate(at_each_target(line.up, line.down))
        heading = "position [mm]" if line.axis in AXES else "angle [rad]"
        places = {heading: _internal(line.axis, line.targets)}
        deviations = f"up down s_up s_down [{_unit_of_deviation(line.axis)}]"
        parts.append(Table.of({**labels, **places, deviations: numbers.T}))
    return Table.stack(parts) if parts else None


def _lines(runs: Sequence[Run]) -> list[tuple[str, str, str]]:
    """Return axis, place and name of each line, in the order of the axes."""
    return list(
        dict.fromkeys((axis, run.at, run.line) for axis in (*AXES, *ANGLES) for run in runs if run.axis == axis)
    )


def _too_few(lines: Sequence[_LineRuns]) -> list[str]:
    """Return warnings of axes of up to 2 m or one turn with fewer runs in a direction, or targets, than are asked."""
    runs: dict[tuple[str, str], list[str]] = {}
    targets: dict[tuple[str, str], list[str]] = {}
    for line in lines:
        travel, up, down, count = float(np.ptp(line.targets)), len(line.up), len(line.down), len(line.targets)
        where, fewest = _where(line.name, line.at), fewest_targets(line.axis, travel)
        if travel <= _LONG and min(up, down) < RUNS:
            lack = f"{up} run{'s' * (up != 1)} up and {down} down; {_ASKS} five in each direction"
            runs.setdefault((line.axis, lack), []).append(where)
        if count < fewest and (line.axis in ANGLES or travel <= _LONG):
            asked = str(fewest) if line.axis in ANGLES else "five per metre, and at least five"
            lack = f"{count} targets over {travel:g} {_unit_of_target(line.axis)}; {_ASKS} {asked}"
            targets.setdefault((line.axis, lack), []).append(where)
    lacking = (*runs.items(), *targets.items())
    return [f"axis {axis}, {listed(names, 5)}: {lack}" for (axis, lack), names in lacking]


def _where(line: str, at: str) -> str:
    return f"line '{line}'" if line else f"at {at or 'rest'}"


def fewest_targets(axis: str, travel: float) -> int:
    """Return the fewest targets over a travel [mm, deg] of an axis (ISO 230-2:2014)."""
    if axis in AXES:
        return max(_TARGETS, ceil(_TARGETS * travel / _PER_METRE))
    return next((count for most, count in _TARGETS_OF_RANGE if travel <= most + _SAME), _TARGETS_OF_RANGE[-1][1])


def _apart(lines: Iterable[tuple[str, str, str]]) -> list[str]:
    """Return a warning for each place of an axis that has several lines."""
    names: dict[tuple[str, str], list[str]] = {}
    for axis, at, line in lines:
        names.setdefault((axis, at), []).append(f"'{line}'")
    return [
        f"axis {axis}: lines {listed(several, 5)} have a zero of their own each; the figures of ISO 230-2 do not pool "
        "their runs. Enter runs with one zero as one line"
        for (axis, _), several in names.items()
        if len(several) > 1
    ]
