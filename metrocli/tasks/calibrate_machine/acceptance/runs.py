"""Runs along single axes with their figures of ISO 230-2; those of rotary axes are among the readings of poses.

A run of a rotary axis is a row of readings in the order of time, in which it goes one way and the other rotary axes
stand. The deviation at a target is that of the table, with what the readings there show beyond it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.instruments.axes.rotary import RotaryAxis, turning_axes
from metrocli.instruments.machine import errors_of
from metrocli.result import ShownTable
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.acceptance.positioning import LineUncertainty
from metrocli.tasks.calibrate_machine.iso230 import Run, at_targets, positioning
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.tasks.calibrate_machine.solve import AdjustedMachine
from metrocli.tasks.calibrate_machine.tables import Tables

_FEWEST = 3
"""Fewest targets of a run: of scattered poses some stand in a row by chance"""
_ROUNDED = 3
"""Decimals of targets and of the places of other axes [deg]"""


def positioning_of(
    tables: Tables, solved: AdjustedMachine, settings: Settings, factor: float
) -> tuple[dict[str, Table], tuple[str, ...]]:
    """Return the figures of ISO 230-2 and the means at their targets, of runs along single axes, and warnings."""
    known, noise = settings.positioning, settings.noise
    runs, own, rest = solved.problem.runs, noise.displacement, known.environment
    if settings.angular:
        own, rest = noise.angle, known.environment_angle
    elif tables.machine.turns:
        turning = _rotary_runs(tables, solved)
        runs, own = turning.runs, turning.reading
    if not runs:
        return {}, ()
    # readings scatter evenly over the range at rest (ISO 230-2:2014, annex A: E_VE)
    reading = float(np.hypot(factor * (own or 0.0), rest / np.sqrt(12)))
    figures, warnings = positioning(runs, LineUncertainty(reading, known.scale))
    acceptance = {"positioning": figures, "positioning_targets": at_targets(runs)}
    return {name: table for name, table in acceptance.items() if table is not None}, warnings


def shown_figures(name: str, table: Table) -> ShownTable:
    """Return how figures are shown: those of rotary axes in arcsec, and their targets in degrees."""
    symbols = {key: "deg" if key == "angle" else "arcsec" for key in table if table.units.get(key) == "rad"}
    if not symbols:
        return ShownTable(name)
    return ShownTable(name, tuple(f"{key} [{symbols[key]}]" if key in symbols else key for key in table))


@dataclass(frozen=True)
class _RotaryRuns:
    """Runs of rotary axes, and the standard uncertainty of a reading of an angle [rad]."""

    runs: tuple[Run, ...]
    reading: float


def _rotary_runs(tables: Tables, solved: AdjustedMachine) -> _RotaryRuns:
    """Return the runs of all rotary axes with several runs; readings need the side from which the axis came.

    The readings y of a target, with the derivatives j by the angle, show `E + j'(y - f)/(j'j)` with the standard
    uncertainty `1/sqrt(j'j)`, all whitened. E is interpolated in the table of the axis.
    """
    observations = solved.problem.readings.observations
    axes = turning_axes(tables.machine)
    order, runs, uncertain = np.argsort(observations.order, kind="stable"), list[Run](), list[float]()
    for axis in axes:
        side = observations.conditions.get(f"from_{axis.key}")
        if side is None:
            continue
        others = [observations.conditions[other.coordinate] for other in axes if other is not axis]
        there = np.degrees(np.array([*others, observations.conditions[axis.coordinate]]))[:, order].round(_ROUNDED)
        parts = list(_parts(there, side[order]))
        targets = [np.unique(there[-1][own]) for own in parts]
        rows = [order[own] for own, met in zip(parts, targets, strict=True) if len(met) >= _FEWEST]
        if _repeated(targets):
            measured = [_run(tables, solved, axis, own) for own in rows]
            names = [other.letter for other in axes if other is not axis]
            at = [np.degrees([place[own[0]] for place in others]).round(_ROUNDED) for own in rows]
            words = [", ".join(f"{n} = {v:g} deg" for n, v in zip(names, position, strict=True)) for position in at]
            runs += [Run(axis.letter, *run[:2], where) for run, where in zip(measured, words, strict=True)]
            uncertain += [run[2] for run in measured]
    return _RotaryRuns(tuple(runs), max(uncertain, default=0.0))


def _repeated(targets: Iterable[Array]) -> bool:
    """Return whether runs have targets in common: the next ones of scattered poses are not runs."""
    long = [own for own in targets if len(own) >= _FEWEST]
    return bool(long) and bool((np.unique(np.concatenate(long), return_counts=True)[1] > 1).sum() > 1)


def _parts(there: Array, side: Array) -> Iterator[Index]:
    """Yield the readings of each run: the axis, the last of `there` (k, n), goes to its side, and the others stay."""
    n = there.shape[1]
    stays = (np.diff(there[:-1], axis=1) == 0).all(axis=0)
    goes = np.diff(there[-1]) * side[1:] >= 0
    begins = np.flatnonzero(~(stays & goes & (side[1:] == side[:-1]))) + 1
    for own in np.split(np.arange(n), begins):
        if side[own[0]]:
            yield own


def _run(tables: Tables, solved: AdjustedMachine, axis: RotaryAxis, rows: Index) -> tuple[Array, Array, float]:
    """Return the targets [deg], the deviations and the largest standard uncertainty [rad] of a run."""
    blocks, group = solved.solution.blocks, solved.group
    name = errors_of(axis.letter)[axis.number + 3]
    linear = group.selected(rows).linear(blocks, frozenset({axis.block}))
    column = blocks[axis.block].column(name)
    by_angle = np.sum([touch.jacobian[:, column] for touch in linear.touches if touch.block == axis.block], axis=0)
    position = group.observations.conditions[axis.coordinate][rows]
    targets, of = np.unique(np.degrees(position).round(_ROUNDED), return_inverse=True)
    weight = np.bincount(of, (by_angle**2).sum(axis=0))
    left = np.bincount(of, (by_angle * linear.residual).sum(axis=0)) / weight
    knots, values, _ = tables.of(name)
    deviation = np.interp(axis.wrapped(np.radians(targets)), knots, values) + left
    way = slice(None) if position[-1] > position[0] else slice(None, None, -1)
    return targets[way], axis.sense * deviation[way], float(1 / np.sqrt(weight.min()))
