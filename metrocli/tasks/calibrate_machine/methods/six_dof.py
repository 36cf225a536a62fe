"""six-dof: adjust lines along axes and diagonals, each with its own misalignment, together with the error tables.

Squareness follows from the length of the diagonals after subtracting the contribution of the tables (Kuprin et al.).
If all tables are zero, two face diagonals d1, d2 give `C0Y = (d2^2 - d1^2) / (4 Lx Ly)`.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array, Mask
from metrocli.errors import Fault, InputError
from metrocli.instruments.axes.rotary import gauge
from metrocli.instruments.machine import ANGLES, AXES, TOOL, Machine
from metrocli.instruments.six_dof import CHANNELS, COLUMNS, DISPLACEMENT, LINE, TURN, line_block, line_chain
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.described import (
    error_blocks,
    machine_of,
    must_support,
    placed,
    raise_if,
    tool_prior,
)
from metrocli.tasks.calibrate_machine.methods.lines import MeasuredLines, approach, line_conditions, lines_of, runs_of
from metrocli.tasks.calibrate_machine.problem import MachineProblem, conditions, model_of
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.words import listed

READINGS = "lines"
_MEASURED = 0.1
"""Deviations that are the positions themselves within this share are what was measured"""


def six_dof(settings: Settings, table: Table) -> MachineProblem:
    """Return the adjustment of the lines."""
    machine = machine_of(settings)
    blocks = error_blocks(machine, settings)
    if len(settings.tools) > 1:
        raise InputError("method six-dof has one tool: the receiver's vector, `machine: {tool: [...]}`")
    lines = lines_of(machine, table)
    alone = positioning_alone(settings, lines, table)
    must_support(machine, lines.position, blocks)
    laser = settings.noise.of_laser
    read = table.stacked(CHANNELS).T if alone is None else alone[None]
    observations = Observations(
        read,
        np.full(read.shape, laser.angle if machine.turns else laser.displacement),
        machine.index(lines.position) | {TOOL: np.zeros(len(table), dtype=np.intp), LINE: lines.of},
        covariance=laser.covariance(lines.along[lines.of].T) if alone is None else None,
        keys={"line": tuple(table.texts("line")), "at": _targets(machine, lines)},
        conditions=conditions(machine, lines.position, table)
        | line_conditions(machine, lines)
        | approach(machine, lines),
        components=CHANNELS if alone is None else (TURN if machine.turns else DISPLACEMENT,),
        unit="rad" if machine.turns else "mm",
        units=("mm",) * 3 + ("rad",) * 3 if alone is None else (),
    )
    readings = Group(READINGS, line_chain(machine, alone is not None), observations)
    free: Mask | bool = True
    if alone is not None:
        free = np.array([[channel == _own(axis) for channel in COLUMNS] for axis in lines.axis])
    others = (*tool_prior(blocks, settings), *gauge(machine, blocks))
    return MachineProblem(
        model_of({**blocks, LINE: line_block(lines.names, free)}, readings, others),
        machine,
        np.ones(len(table)),
        tuple(settings.tools),
        facts={"lines": len(lines.names)},
        runs=tuple(runs_of(machine, lines, _deviations(lines, table))),
        positioning_alone=alone is not None,
    )


def _own(direction: str) -> str:
    """Return the channel of the positioning along a direction: ex, ..., of rotary axes ea, ..."""
    return f"e{direction}"


def _targets(machine: Machine, lines: MeasuredLines) -> tuple[str, ...]:
    """Return the distance of each reading along its line in words."""
    distances = lines.distance.tolist()
    if not machine.turns:
        return tuple(f"{distance:g} mm" for distance in distances)
    return tuple(placed(machine.axes[0], distance) for distance in distances)


def _deviations(lines: MeasuredLines, table: Table) -> Array:
    """Return the reading of its own direction at each reading of lines along single axes, (n,); else nan."""
    deviations = np.full(len(table), np.nan)
    for direction in dict.fromkeys(lines.axis):
        if len(direction) == 1:
            rows = np.array(lines.axis)[lines.of] == direction
            deviations = np.where(rows, table.numbers(_own(direction)), deviations)
    return deviations


def positioning_alone(settings: Settings, lines: MeasuredLines, table: Table) -> Array | None:
    """Return the deviation of each reading, (n,), where the file has no other channels; None if it has all six.

    Raises InputError if it has some of them, or if the noise of the channels that it has is not given.
    """
    missing = [name for name in CHANNELS if name not in table or np.isnan(table.numbers(name)).any()]
    if not missing and not settings.angular:
        lacking = [key for key in ("straightness", "angle") if getattr(settings.noise, key) is None]
        if lacking or len(settings.machine.axes.given) < len(AXES):
            needs = listed([*(f"noise: {key}" for key in lacking), *(() if lacking else ("all three axes",))])
            raise InputError(f"the lines have all six channels, so the job needs {needs}")
        return None
    own = [_own(axis) for axis in lines.axis]
    more = sorted(set(CHANNELS) - set(missing) - set(own))
    absent = [name for name in dict.fromkeys(own) if name not in table]
    if more or absent or any(len(axis) > 1 for axis in lines.axis):
        raise InputError([Fault(_channels_wanted(settings.angular, missing), table.file)])
    named = sorted({f"E{axis}{axis}".upper() for axis in lines.axis})
    unlike = [name for name in settings.estimated if name not in named]
    if unlike:
        raise InputError(
            f"displacement alone determines {listed(named)} only: leave {listed(unlike)} out of `estimate`"
        )
    deviations = _deviations(lines, table)
    if np.isnan(deviations).any():
        row = int(np.flatnonzero(np.isnan(deviations))[0])
        raise InputError([table.fault_at(row, "the displacement is empty")])
    raise_if(_measured_positions(lines, deviations, table))
    return deviations


def unmeasured(table: Table) -> Iterator[Fault]:
    """Yield a fault for each channel that is 0 in all rows of lines along a direction: read ones have noise."""
    axes = np.array(table.texts("axis"))
    zero: dict[str, list[str]] = {}
    for name in (name for name in CHANNELS if name in table):
        along = [axis for axis in dict.fromkeys(axes.tolist()) if not table.numbers(name)[axes == axis].any()]
        zero |= {name: along} if along else {}
    measured = {(name, axis) for name in CHANNELS if name in table for axis in axes.tolist()}
    left = measured - {(name, axis) for name, along in zero.items() for axis in along}
    # an instrument of one channel, whose file has columns for six
    alone = left == {(_own(axis), axis) for axis in axes.tolist()}
    for name, along in zero.items():
        heading = table.headings.get(name, name)
        text = f"the column '{heading}' is 0 in all rows of lines along {listed(along)}: it was not measured"
        hint = "six-dof needs all six channels, or the displacement alone: ex along x, ey along y, ez along z"
        out = "leave the column out" if len(along) == len(set(axes.tolist())) else f"leave '{heading}' empty there"
        yield table.fault(text, out if alone else hint)


def _channels_wanted(angular: bool, missing: list[str]) -> str:
    if angular:
        letters = ", ".join(f"{_own(letter)} along {letter}" for letter in "".join(ANGLES).lower())
        return f"lines along rotary axes have their own angle alone: {letters}"
    return (
        f"lines have either all six channels ({', '.join(missing)} {'is' if not missing[1:] else 'are'} "
        "missing), or the displacement alone: ex along x, ey along y, ez along z"
    )


def _measured_positions(lines: MeasuredLines, deviation: Array, table: Table) -> Iterator[Fault]:
    """Yield a fault for each line whose deviations are what was measured: they grow as the positions do."""
    for i, name in enumerate(lines.names):
        rows = np.flatnonzero(lines.of == i)
        at, read = (values[rows] - values[rows].mean() for values in (lines.distance, deviation))
        if np.abs(read - at).max() < _MEASURED * np.abs(at).max():
            text = f"the readings of line '{name}' grow as its positions do: they are measured positions"
            yield table.fault_at(int(rows[0]), text, "write the deviations: measured minus commanded")
