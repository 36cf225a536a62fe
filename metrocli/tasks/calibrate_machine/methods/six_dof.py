"""six-dof: adjust lines along axes and diagonals, each with its own misalignment, together with the error tables.

Squareness follows from the length of the diagonals after subtracting the contribution of the tables (Kuprin et al.).
If all tables are zero, two face diagonals d1, d2 give `C0Y = (d2^2 - d1^2) / (4 Lx Ly)`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array, Index, Mask, Values
from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.instruments.machine import AXES, TOOL, Machine
from metrocli.instruments.six_dof import (
    ACROSS,
    ALONG,
    CHANNELS,
    COLUMNS,
    FROM_START,
    LINE,
    POSITION,
    LineNoise,
    line_block,
    line_chain,
)
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.described import commanded, error_blocks, machine_of, must_support, tool_prior
from metrocli.tasks.calibrate_machine.iso230 import Run, others_at
from metrocli.tasks.calibrate_machine.problem import SIDES, MachineProblem, conditions, model_of, since_turns
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.words import listed, suggestion

READINGS = "lines"
DIRECTIONS = {"x": (0,), "y": (1,), "z": (2,), "xy": (0, 1), "yz": (1, 2), "xz": (0, 2)}
"""Numbers of the axes that move along a line, by the name of its direction"""
_APART = 0.01
"""The columns x, y, z and the distance along the line may disagree by this [mm]"""
_LEAST, _RUNS = 3, 5
"""Targets of a planned line at least, and runs in each direction (ISO 230-2)"""
_LEAST_PART = 1e-6
"""An axis stands still on a line if its part of the line's direction is smaller than this"""


@dataclass(frozen=True)
class MeasuredLines:
    """The lines of a file, and the place of each of their readings."""

    names: tuple[str, ...]
    axis: tuple[str, ...]
    """Direction of each line, a key of DIRECTIONS"""
    of: Index
    """Number of the line of each reading, (n,)"""
    position: Array
    """Commanded positions, (3, n)"""
    distance: Array
    """Distance along the line, (n,)"""

    @property
    def sense(self) -> Array:
        """Return the sense of travel that led to each reading, +1 or -1, (n,).

        The first reading of a run has the sense of the travel that follows it. At a turn a target is read twice: as
        the last of one run and as the first of the next.
        """
        step = np.sign(np.diff(self.distance))
        step[np.diff(self.of) != 0] = 0.0
        before, after = np.append(0.0, step), np.append(step, 0.0)
        return np.where(before != 0, before, after)

    @property
    def along(self) -> Array:
        """Unit vectors along the lines, (lines, 3)."""
        rows = [np.flatnonzero(self.of == i) for i in range(len(self.names))]
        ends = [at[np.argsort(self.distance[at])[[0, -1]]] for at in rows]
        moved = np.stack([self.position[:, end[1]] - self.position[:, end[0]] for end in ends])
        return np.asarray(moved / np.linalg.norm(moved, axis=1, keepdims=True))


def lines_of(machine: Machine, table: Table) -> MeasuredLines:
    """Return the lines of a file.

    Raises InputError for unknown directions, lines with several directions or too few positions, and contradictory
    positions.
    """
    _refuse_directions(table)
    names = tuple(dict.fromkeys(table.texts("line")))
    number = {name: i for i, name in enumerate(names)}
    of = np.array([number[name] for name in table.texts("line")])
    axes = np.array(table.texts("axis"))
    faults = []
    for i, name in enumerate(names):
        rows = np.flatnonzero(of == i)
        if len(set(axes[rows])) > 1:
            faults.append(Fault(f"line '{name}' has rows along {' and '.join(sorted(set(axes[rows])))}", table.file))
        elif len(np.unique(table.numbers("position")[rows])) < _LEAST:
            text = f"line '{name}' has fewer than {_LEAST} positions: its misalignment takes up all of its readings"
            faults.append(table.fault_at(int(rows[0]), text))
    if faults:
        raise InputError(faults)
    position = _positions(machine, table, axes)
    axis = tuple(str(axes[of == i][0]) for i in range(len(names)))
    return MeasuredLines(names, axis, of, position, table.numbers("position"))


def _refuse_directions(table: Table) -> None:
    faults = [
        table.fault_at(row, f"'{axis}' is not a direction of a line", suggestion(axis, DIRECTIONS))
        for row, axis in enumerate(table.texts("axis"))
        if axis not in DIRECTIONS
    ]
    if faults:
        raise InputError(faults[:5])


def _positions(machine: Machine, table: Table, axes: Values) -> Array:
    """Return commanded positions, (3, n), from the columns x, y, z, else from the distance along the line."""
    distance = table.numbers("position")
    position = np.repeat(machine.home[:, None], len(table), axis=1)
    for direction, moving in DIRECTIONS.items():
        rows = np.flatnonzero(axes == direction)
        size = (machine.high - machine.low)[list(moving)]
        share = size / np.linalg.norm(size)
        for axis, part in zip(moving, share, strict=True):
            position[axis, rows] = distance[rows] if len(moving) == 1 else machine.low[axis] + distance[rows] * part
    faults = []
    for axis, name in enumerate("xyz"):
        if name not in table:
            continue
        given = table.numbers(name)
        wrong = np.flatnonzero((axes == name) & (np.abs(given - distance) > _APART))
        faults += [
            table.fault_at(
                int(row), f"{name} = {given[row]:g} mm, but the position along {name} is {distance[row]:g} mm"
            )
            for row in wrong[:3]
        ]
        position[axis] = np.where(axes == name, position[axis], given)
    if faults:
        raise InputError(faults)
    return commanded(machine, table.joined({"x y z [mm]": position.T}))


def six_dof(settings: Settings, table: Table) -> MachineProblem:
    """Return the adjustment of the lines."""
    machine = machine_of(settings)
    blocks = error_blocks(machine, settings)
    if len(settings.tools) > 1:
        raise InputError("method six-dof has one tool: the receiver's vector, `machine: {tool: [...]}`")
    lines = lines_of(machine, table)
    displacement = displacement_only(settings, lines, table)
    must_support(machine, lines.position, blocks)
    laser = laser_noise(settings)
    along = lines.along
    read = table.stacked(CHANNELS).T if displacement is None else displacement[None]
    observations = Observations(
        read,
        np.full(read.shape, laser.displacement),
        machine.index(lines.position) | {TOOL: np.zeros(len(table), dtype=np.intp), LINE: lines.of},
        covariance=laser.covariance(along[lines.of].T) if displacement is None else None,
        keys={
            "line": tuple(table.texts("line")),
            "at": tuple(f"{distance:g} mm" for distance in lines.distance.tolist()),
        },
        conditions=conditions(machine, lines.position, table) | line_conditions(lines, along) | approach(lines),
        components=CHANNELS if displacement is None else ("displacement",),
        unit="mm",
    )
    readings = Group(READINGS, line_chain(machine, displacement is not None), observations)
    free: Mask | bool = True
    if displacement is not None:
        free = np.array([[channel == f"e{axis}" for channel in COLUMNS] for axis in lines.axis])
    return MachineProblem(
        model_of({**blocks, LINE: line_block(lines.names, free)}, readings, tool_prior(blocks, settings)),
        machine,
        np.ones(len(table)),
        tuple(settings.tools),
        facts={"lines": len(lines.names)},
        runs=tuple(runs_of(lines, table)),
        displacement_only=displacement is not None,
    )


def displacement_only(settings: Settings, lines: MeasuredLines, table: Table) -> Array | None:
    """Return the displacement of each reading, (n,), where the file has no other channels; None if it has all six.

    Raises InputError if it has some of them, or if the noise of the channels that it has is not given.
    """
    missing = [name for name in CHANNELS if name not in table or np.isnan(table.numbers(name)).any()]
    if not missing:
        lacking = [key for key in ("straightness", "angle") if getattr(settings.noise, key) is None]
        if lacking or len(settings.machine.axes.given) < len(AXES):
            needs = listed([*(f"noise: {key}" for key in lacking), *(() if lacking else ("all three axes",))])
            raise InputError(f"the lines have all six channels, so the job needs {needs}")
        return None
    own = [f"e{axis}" for axis in lines.axis]
    more = sorted(set(CHANNELS) - set(missing) - set(own))
    absent = [name for name in dict.fromkeys(own) if name not in table]
    if more or absent or any(axis not in "xyz" for axis in lines.axis):
        raise InputError(
            [
                Fault(
                    f"lines have either all six channels ({', '.join(missing)} {'is' if not missing[1:] else 'are'} "
                    "missing), or the displacement alone: ex along x, ey along y, ez along z",
                    table.file,
                )
            ]
        )
    unlike = [name for name in settings.estimated if name not in {f"E{axis}{axis}".upper() for axis in lines.axis}]
    if unlike:
        raise InputError(
            f"displacement alone determines {listed(sorted({f'E{axis}{axis}'.upper() for axis in lines.axis}))} only: "
            f"leave {listed(unlike)} out of `estimate`"
        )
    values = np.stack([table.numbers(name) for name in dict.fromkeys(own)])
    which = [list(dict.fromkeys(own)).index(name) for name in own]
    found: Array = values[np.array(which)[lines.of], np.arange(len(lines.of))]
    if np.isnan(found).any():
        row = int(np.flatnonzero(np.isnan(found))[0])
        raise InputError([table.fault_at(row, "the displacement is empty")])
    return found


def runs_of(lines: MeasuredLines, table: Table) -> list[Run]:
    """Return the runs along single axes with their displacement readings; a line may have runs in both directions."""
    turns = np.flatnonzero((np.diff(lines.of) != 0) | (np.diff(lines.sense) != 0)) + 1
    runs = []
    for rows in np.split(np.arange(len(lines.of)), turns):
        direction, name = lines.axis[lines.of[rows[0]]], lines.names[lines.of[rows[0]]]
        if len(DIRECTIONS[direction]) == 1 and len(rows) > 1:
            at = np.delete(lines.position[:, rows[0]], DIRECTIONS[direction]).round(2).tolist()
            axis, where = direction.upper(), others_at(direction.upper(), at)
            runs.append(Run(axis, lines.distance[rows], table.numbers(f"e{direction}")[rows], where, name))
    return runs


def approach(lines: MeasuredLines) -> dict[str, Array]:
    """Return the directions of approach, and the distances since an axis turned on its line, (n,) each.

    The directions are 0 for axes that stand still on the line.
    """
    moved = np.sign(np.where(np.abs(lines.along) > _LEAST_PART, lines.along, 0.0))[lines.of].T * lines.sense
    parts = np.split(np.arange(len(lines.of)), np.flatnonzero(np.diff(lines.of) != 0) + 1)
    sides = dict(zip(SIDES, moved, strict=True))
    ways = [since_turns(lines.position[:, rows], {name: side[rows] for name, side in sides.items()}) for rows in parts]
    common = set(ways[0]).intersection(*ways)
    return sides | {name: np.concatenate([way[name] for way in ways]) for name in sorted(common)}


def line_conditions(lines: MeasuredLines, along: Array) -> dict[str, Array]:
    """Return the conditions of readings on lines: distances from middle and start, unit vectors across and along."""
    least = np.eye(3)[np.argmin(np.abs(along), axis=1)]
    first = np.cross(along, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    across = np.concatenate([first, np.cross(along, first)], axis=1)[lines.of].T
    counts = np.bincount(lines.of)
    middle = np.bincount(lines.of, lines.distance) / counts
    lowest = np.full(len(counts), np.inf)
    np.minimum.at(lowest, lines.of, lines.distance)
    distances = {POSITION: lines.distance - middle[lines.of], FROM_START: lines.distance - lowest[lines.of]}
    return distances | dict(zip((*ACROSS, *ALONG), (*across, *along[lines.of].T), strict=True))


def planned_lines(machine: Machine, step: float, axes: Sequence[str] = ()) -> MeasuredLines:
    """Return lines along the axes in both directions and along three face diagonals, with readings every `step` mm.

    With `axes` they are along these alone, each five times to and fro: the test of ISO 230-2.
    """
    of, positions, distances = [], [], []
    names = tuple(axes) or tuple(DIRECTIONS)
    for line, moving in enumerate(DIRECTIONS[name] for name in names):
        size = (machine.high - machine.low) * np.isin(np.arange(3), moving)
        length = float(np.linalg.norm(size))
        along = np.linspace(0.0, length, max(_LEAST, round(length / step) + 1))
        way = np.append(along, along[::-1]) if len(moving) == 1 else along
        way = np.tile(way, _RUNS) if axes else way
        start = np.where(size > 0, machine.low, machine.home)
        of.append(np.full(len(way), line))
        positions.append(start[:, None] + size[:, None] / length * way)
        distances.append(way if len(moving) > 1 else positions[-1][moving[0]])
    return MeasuredLines(names, names, np.concatenate(of), np.concatenate(positions, axis=1), np.concatenate(distances))


def axes_alone(settings: Settings) -> tuple[str, ...]:
    """Return the axes of a laser or a scale that reads displacement alone, by its noise; none with six channels."""
    alone = settings.noise.straightness is None and settings.noise.angle is None
    return tuple(letter.lower() for letter in settings.machine.axes.given) if alone else ()


def laser_noise(settings: Settings) -> LineNoise:
    """Return the noise of the laser."""
    noise = settings.noise
    return LineNoise(noise.displacement or 0.0, noise.straightness or 0.0, noise.angle or 0.0)
