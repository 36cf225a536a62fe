"""Lines of a laser along axes and diagonals, or about rotary axes: their places, their directions and their runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from metrocli.arrays import Array, Index, Mask, Values
from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.instruments.machine import ANGLES, Machine
from metrocli.instruments.six_dof import ABOUT, ACROSS, ALONG, FROM_START, POSITION
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.described import commanded, placed, raise_if
from metrocli.tasks.calibrate_machine.iso230 import Run
from metrocli.tasks.calibrate_machine.methods.turned_lines import angle_faults
from metrocli.tasks.calibrate_machine.problem import since_turns
from metrocli.words import suggestion

DIRECTIONS = {"x": "X", "y": "Y", "z": "Z", "xy": "XY", "yz": "YZ", "xz": "XZ", "a": "A", "b": "B", "c": "C"}
"""Letters of the axes that move along a line, by the name of its direction"""
_APART = 0.01
"""The columns x, y, z and the distance along the line may disagree by this [mm]"""
LEAST = 3
"""Fewest positions of a line"""
_WHOLE = 0.9
"""Share of a line that a return covers"""
_LEAST_PART = 1e-6
"""An axis stands still on a line if its part of the line's direction is smaller than this"""
_ROUNDED = 2
"""Decimals of the positions of the other axes [mm, deg]"""


@dataclass(frozen=True)
class MeasuredLines:
    """The lines of a file, and the place of each of their readings."""

    names: tuple[str, ...]
    axis: tuple[str, ...]
    """Direction of each line, a key of DIRECTIONS"""
    of: Index
    """Number of the line of each reading, (n,)"""
    position: Array
    """Commanded positions, (axes, n)"""
    distance: Array
    """Distance along the line, (n,); the position of a rotary axis, which counts on over any turn [rad]"""

    @property
    def sense(self) -> Array:
        """Return the sense of travel that led to each reading, +1 or -1, (n,).

        The first reading of a run has the sense of the travel that follows it. At a turn a target is read twice: as
        the last of one run and as the first of the next. In tests in one direction the axis returns at once.
        """
        step = self._step
        before, after = np.append(0.0, np.where(self.returns, 0.0, step)), np.append(step, 0.0)
        return np.where(before != 0, before, after)

    @property
    def returns(self) -> Mask:
        """Return which steps between readings lead back to the first target, without a reading on the way, (n - 1,)."""
        size, step = np.abs(np.diff(self.distance)), self._step
        range_of = np.array([np.ptp(self.distance[self.of == i]) for i in range(len(self.names))])
        alone = (np.append(0.0, step[:-1]) == -step) & (np.append(step[1:], 0.0) == -step)
        return np.asarray(alone & (step != 0) & (size > _WHOLE * range_of[self.of[1:]]))

    @property
    def _step(self) -> Array:
        """Signs of the steps between readings, 0 between lines, (n - 1,)."""
        step = np.sign(np.diff(self.distance))
        step[np.diff(self.of) != 0] = 0.0
        return step

    @property
    def along(self) -> Array:
        """Unit vectors along the lines, in the positions of the axes, (lines, axes)."""
        rows = [np.flatnonzero(self.of == i) for i in range(len(self.names))]
        ends = [at[np.argsort(self.distance[at])[[0, -1]]] for at in rows]
        moved = np.stack([self.position[:, end[1]] - self.position[:, end[0]] for end in ends])
        return np.asarray(moved / np.linalg.norm(moved, axis=1, keepdims=True))


def lines_of(machine: Machine, table: Table) -> MeasuredLines:
    """Return the lines of a file.

    Raises InputError for unknown directions, lines with several directions or too few positions, and contradictory
    positions.
    """
    _refuse_directions(machine, table)
    names = tuple(dict.fromkeys(table.texts("line")))
    number = {name: i for i, name in enumerate(names)}
    of = np.array([number[name] for name in table.texts("line")])
    axes = np.array(table.texts("axis"))
    raise_if(_faults_of_lines(names, of, axes, table))
    distance = _distance(machine, table, axes)
    few = [i for i in range(len(names)) if len(np.unique(distance[of == i])) < LEAST]
    text = "line '{}' has fewer than {} positions: its misalignment takes up all of its readings"
    raise_if(table.fault_at(int(np.argmax(of == i)), text.format(names[i], LEAST)) for i in few)
    if machine.turns:
        raise_if(angle_faults(machine, table, axes, (of, distance)))
    position = _positions(machine, table, axes, distance)
    return MeasuredLines(names, tuple(str(axes[of == i][0]) for i in range(len(names))), of, position, distance)


def _refuse_directions(machine: Machine, table: Table) -> None:
    letters = {axis.letter for axis in machine.axes}
    known = [name for name, moving in DIRECTIONS.items() if set(moving) <= letters]
    faults = [
        table.fault_at(row, f"'{axis}' is not a direction of a line", _instead(axis, known))
        for row, axis in enumerate(table.texts("axis"))
        if axis not in known
    ]
    raise_if(iter(faults[:5]))


def _instead(axis: str, known: Sequence[str]) -> str:
    """Return what to do about a direction that the lines of a machine cannot have."""
    if axis not in DIRECTIONS:
        return suggestion(axis, known)
    if DIRECTIONS[axis] in ANGLES:
        return (
            f"lines along rotary axes have a job of their own: `machine: {{axes: {{{axis}: ..}}}}` without linear "
            f"axes, or `estimate: [E{axis.upper()}{axis.upper()}]`"
        )
    return f"the lines of this job are along rotary axes: {', '.join(known)}; those along linear ones need another job"


def _faults_of_lines(names: Sequence[str], of: Index, axes: Values, table: Table) -> Iterator[Fault]:
    for i, name in enumerate(names):
        own = sorted(set(axes[of == i]))
        if len(own) > 1:
            yield Fault(f"line '{name}' has rows along {' and '.join(own)}", table.file)


def _distance(machine: Machine, table: Table, axes: Values) -> Array:
    """Return the distances along the lines, from the column `position`, of a rotary axis from its own."""
    if not machine.turns:
        if "position" not in table:
            raise InputError(
                [table.fault("the column 'position_mm' is missing", "it holds the distance along the line")]
            )
        return table.numbers("position")
    distance = np.full(len(table), np.nan)
    for letter in dict.fromkeys(axes.tolist()):
        if letter not in table:
            text = f"the column '{letter}_deg' is missing"
            raise InputError([table.fault(text, f"it holds the targets of the lines along {letter}")])
        distance = np.where(axes == letter, table.numbers(letter), distance)
    return distance


def _positions(machine: Machine, table: Table, axes: Values, distance: Array) -> Array:
    """Return commanded positions, (axes, n): those of the file where it has them, else from the distances."""
    letters = [axis.letter for axis in machine.axes]
    position = np.repeat(machine.home[:, None], len(table), axis=1)
    for direction in dict.fromkeys(axes.tolist()):
        moving, rows = [letters.index(letter) for letter in DIRECTIONS[direction]], np.flatnonzero(axes == direction)
        size = (machine.high - machine.low)[moving]
        share = size / np.linalg.norm(size)
        for moved, part in zip(moving, share, strict=True):
            start = 0.0 if len(moving) == 1 else machine.low[moved]
            position[moved, rows] = start + distance[rows] * part
    faults = []
    for number, axis in enumerate(machine.axes):
        name = axis.key
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
        position[number] = np.where(axes == name, position[number], given)
    if faults:
        raise InputError(faults)
    commanded(machine, table.joined(machine.columns(position)))
    return position


def runs_of(machine: Machine, lines: MeasuredLines, deviation: Array) -> list[Run]:
    """Return the runs along single axes with their deviations (n,); a line may have runs in both directions."""
    turns = np.flatnonzero((np.diff(lines.of) != 0) | (np.diff(lines.sense) != 0) | lines.returns) + 1
    runs = []
    for rows in np.split(np.arange(len(lines.of)), turns):
        axis, name = DIRECTIONS[lines.axis[lines.of[rows[0]]]], lines.names[lines.of[rows[0]]]
        if len(axis) == 1 and len(rows) > 1:
            targets = np.degrees(lines.distance[rows]) if axis in ANGLES else lines.distance[rows]
            runs.append(Run(axis, targets, deviation[rows], _others(machine, axis, lines.position[:, rows[0]]), name))
    return runs


def _others(machine: Machine, letter: str, position: Array) -> str:
    """Return the positions (axes,) of the other axes, in words."""
    others = [(axis, own) for axis, own in zip(machine.axes, position.tolist(), strict=True) if axis.letter != letter]
    return ", ".join(f"{axis.letter} = {placed(axis, own, decimals=_ROUNDED)}" for axis, own in others)


def approach(machine: Machine, lines: MeasuredLines) -> dict[str, Array]:
    """Return the directions of approach, and the distances since an axis turned on its line, (n,) each.

    The directions are 0 for axes that stand still on the line.
    """
    along = lines.along
    moved = np.sign(np.where(np.abs(along) > _LEAST_PART, along, 0.0))[lines.of].T * lines.sense
    parts = np.split(np.arange(len(lines.of)), np.flatnonzero(np.diff(lines.of) != 0) + 1)
    sides = {f"from_{axis.key}": own for axis, own in zip(machine.axes, moved, strict=True)}
    ways = [since_turns(lines.position[:, rows], {name: side[rows] for name, side in sides.items()}) for rows in parts]
    common = set(ways[0]).intersection(*ways)
    return sides | {name: np.concatenate([way[name] for way in ways]) for name in sorted(common)}


def line_conditions(machine: Machine, lines: MeasuredLines) -> dict[str, Array]:
    """Return the conditions of readings on lines: distances from middle and start, unit vectors across and along.

    Of lines about rotary axes only which axis turns.
    """
    along = lines.along
    if machine.turns:
        shares = np.abs(along[lines.of].T)
        return {ABOUT.format(axis=axis.key): own for axis, own in zip(machine.axes, shares, strict=True)}
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
