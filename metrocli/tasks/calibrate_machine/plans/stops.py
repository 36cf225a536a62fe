"""Plan points at standstill, and lines of a laser: what those of the job and the proposed ones will determine."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from metrocli.arrays import Array, Values
from metrocli.errors import UndeterminedError
from metrocli.instruments.axes.rotary import RotaryAxis
from metrocli.instruments.machine import POSITION, Axis, Machine
from metrocli.instruments.six_dof import CHANNELS
from metrocli.nc_program import Block as NcBlock
from metrocli.nc_program import Dwell, Feed, Rapid, Stop, program
from metrocli.plan import Plan
from metrocli.result import Estimate
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.described import machine_of
from metrocli.tasks.calibrate_machine.files import NO_FILES
from metrocli.tasks.calibrate_machine.iso230 import RUNS, fewest_targets
from metrocli.tasks.calibrate_machine.methods.lines import DIRECTIONS, LEAST, MeasuredLines
from metrocli.tasks.calibrate_machine.methods.poses import in_degrees, without_errors
from metrocli.tasks.calibrate_machine.methods.six_dof import six_dof
from metrocli.tasks.calibrate_machine.methods.standstill import standstill
from metrocli.tasks.calibrate_machine.plans.planned import (
    PLACES,
    REST,
    Worth,
    judged,
    planned,
    tracker_in_words,
    tracker_pose,
    worth_of,
    worth_or_lack,
)
from metrocli.tasks.calibrate_machine.plans.pose_program import any_turn
from metrocli.tasks.calibrate_machine.problem import MachineProblem, tool_column, tools_of
from metrocli.tasks.calibrate_machine.settings import MachineSimulation, Settings
from metrocli.tasks.calibrate_machine.volume import grid_of, spread_over

_FEWEST, _GROWTH, _MOST = 12, 1.25, 5000
_COUNTED = "rotary axes count on through the turn, a little beyond both ends"
_TITLE, _RESTS = "metrocli lines for calibrate-machine", "a reading in each dwell"


def plan_of_points(settings: Settings, points: Table | None) -> Plan:
    """Return what the job's points will determine, and propose points over the volume, as few as the ratio allows.

    The points follow a sequence that fills the volume evenly from its start on, so that place and time are not
    correlated. Raises UndeterminedError if even the longest list does not reach the wanted ratio.
    """
    wanted = settings.plan
    own = []
    if points is not None:
        own = judged(f"the points of the job: {len(points)}", settings, _seen(settings, points))
    # Each point gives three coordinates and each knot has six errors: at least two points per knot are needed
    count = max(float(_FEWEST), 2 * sum(len(axis.knots) for axis in machine_of(settings).axes) / len(settings.tools))
    while True:
        table = all_over(settings, round(count))
        worth = worth_or_lack(settings, _seen(settings, table))
        if isinstance(worth, Worth) and worth.identified.ratio <= wanted.ratio:
            break
        if count > _MOST:
            raise UndeterminedError(f"{len(table)} points do not reach a ratio of {wanted.ratio:g}: give fewer knots")
        count *= _GROWTH
    blocks = visits_with_tools(settings, table)
    text = program("metrocli points for calibrate-machine", [*PLACES, _RESTS], blocks, wanted.control)
    machine = machine_of(settings)
    where = tracker_in_words(machine.low, machine.high, wanted)
    notes = [*own, f"proposed: {len(table)} points", where]
    files: dict[str, Table | str] = {"points.csv": table, "points.nc": text}
    return planned(notes, (Estimate("points", float(len(table)), 0.0, "1"),), worth, files, [])


def visits_with_tools(settings: Settings, points: Table) -> Iterator[NcBlock]:
    """Yield visits to the points of one tool after the other."""
    tool = tools_of(points, settings)
    for number, name in enumerate(settings.tools):
        yield Stop(f"mount reflector {name}".strip())
        yield from visits(points.stacked(POSITION)[tool == number], settings.plan.feed)


def visits(places: Array, feed: float) -> list[NcBlock]:
    """Return moves to places (n, 3) with a rest at each."""
    return [block for at in places.tolist() for block in (Feed(dict(zip("XYZ", at, strict=True)), feed), Dwell(REST))]


def all_over(settings: Settings, count: int) -> Table:
    """Return `count` points and the eight corners for each tool, one tool after the other.

    Each tool has its own piece of the Halton sequence. If the points went to the tools in turn, each of two tools
    would get only one half of X, and each of three tools only a third of Y (bases 2 and 3).
    """
    machine, names = machine_of(settings), list(settings.tools)
    corners, inside = grid_of(machine, (2, 2, 2)), spread_over(machine, count * len(names))
    pieces = np.split(inside, len(names), axis=1)
    position = np.round(np.concatenate([part for piece in pieces for part in (corners, piece)], axis=1), 2)
    table = Table.of({"point": [f"P{i + 1:03d}" for i in range(position.shape[1])], "x y z [mm]": position.T})
    return table.joined(tool_column(settings, np.repeat(np.arange(len(names)), 8 + count)))


def _seen(settings: Settings, table: Table) -> Callable[[], MachineProblem]:
    """Return a function that builds the adjustment of points, measured by a tracker on a machine without errors."""
    machine = machine_of(settings)
    pose = tracker_pose(machine.low, machine.high, settings.plan)
    return lambda: standstill(settings, without_errors(settings, table, NO_FILES, pose)[0])


def plan_of_lines(settings: Settings, lines: Table | None) -> Plan:
    """Return what the job's lines will determine, and propose lines along the axes and three face diagonals.

    Of a job that reads the positioning alone it proposes five runs to and fro along each of its axes.
    """
    own = [] if lines is None else judged("the lines of the job", settings, lambda: six_dof(settings, lines))
    wanted, machine = settings.plan, machine_of(settings)
    alone, given = settings.reads_positioning, proposed_lines(settings)
    places = {} if machine.turns else {"x y z [mm]": given.position.T}
    table = Table.of({**columns_of(machine, given), **places})
    read = table.joined(
        dict.fromkeys((f"e{axis}" for axis in given.names) if alone else CHANNELS, np.zeros(len(table)))
    )
    worth = worth_of(settings, six_dof(settings, read))
    blocks: list[NcBlock] = []
    for k, name in enumerate(given.names):
        blocks.append(Stop(f"set the laser up along {name}"))
        if alone:
            axis = next(axis for axis in machine.axes if axis.letter == name.upper())
            blocks += _to_and_fro(axis, given, k, wanted.feed)
        else:
            blocks += visits(given.position[:, given.of == k].T, wanted.feed)
    text = program(_TITLE, [*([_COUNTED] if machine.turns else PLACES), _RESTS], blocks, wanted.control)
    notes = [*own, f"proposed: {len(given.names)} lines"]
    ratio = worth.identified.ratio
    weak = f"the lines have a ratio of {ratio:.1f}, more than {wanted.ratio:g}: measure further lines at other places"
    files: dict[str, Table | str] = {"lines.csv": in_degrees(table), "lines.nc": text}
    figures = (Estimate("readings", float(len(table)), 0.0, "1"),)
    return planned(notes, figures, worth, files, [] if alone or ratio <= wanted.ratio else [weak])


def _to_and_fro(axis: Axis, lines: MeasuredLines, line: int, feed: float) -> Iterator[NcBlock]:
    """Yield moves to the targets of an axis with a rest at each; at a turn the axis goes beyond the target."""
    own, turns = lines.distance[lines.of == line], axis.turns
    way = np.sign(np.diff(own, prepend=own[0], append=own[-1]))
    after = np.where(way[1:] == 0, way[:-1], way[1:])
    for target, fore, aft in zip(own.tolist(), way[:-1].tolist(), after.tolist(), strict=True):
        places = [target] if fore else [target - aft * beyond(axis), target]
        for place in places:
            at = {axis.letter: float(np.degrees(place)) if turns else place}
            yield Rapid(at, any_turn((axis,))) if turns else Feed(at, feed)
        yield Dwell(REST)


_GOLDEN = (np.sqrt(5) - 1) / 2
_AWAY = 0.25
"""Largest shift of a target against equal steps, so that it meets no period, as a share of the step"""
_BEYOND = {False: 1.0, True: np.radians(1.0)}
"""How far an axis goes beyond the last target to approach it from the other side [mm, rad], by whether it turns"""
_MOST_BEYOND = 0.1
"""The same as a share of the step at most"""
_DECIMALS = 1
"""Of targets [mm, deg]"""


def proposed_lines(settings: Settings) -> MeasuredLines:
    """Return lines along axes and diagonals, or the tests of positioning where a job reads no more than that."""
    machine = machine_of(settings)
    if settings.reads_positioning:
        return tests_of_positioning(machine, [name[-1] for name in settings.estimated])
    return planned_lines(machine, (settings.simulation or MachineSimulation()).step)


def planned_lines(machine: Machine, step: float) -> MeasuredLines:
    """Return lines along the axes in both directions and along three face diagonals, with readings every `step` mm."""
    of, positions, distances = [], [], []
    names = tuple(
        name for name, letters in DIRECTIONS.items() if set(letters) <= {axis.letter for axis in machine.axes}
    )
    for line, name in enumerate(names):
        moving = [axis.letter in DIRECTIONS[name] for axis in machine.axes]
        size = (machine.high - machine.low) * moving
        length = float(np.linalg.norm(size))
        along = np.linspace(0.0, length, max(LEAST, round(length / step) + 1))
        way = np.append(along, along[::-1]) if len(name) == 1 else along
        start = np.where(size > 0, machine.low, machine.home)
        of.append(np.full(len(way), line))
        positions.append(start[:, None] + size[:, None] / length * way)
        distances.append(way if len(name) > 1 else positions[-1][moving.index(True)])
    return MeasuredLines(names, names, np.concatenate(of), np.concatenate(positions, axis=1), np.concatenate(distances))


def tests_of_positioning(machine: Machine, letters: Sequence[str]) -> MeasuredLines:
    """Return a line of five runs up and five down for each of some axes (ISO 230-2:2014), with a target near each knot.

    At a turn its target is read twice. The other axes stand at their references.
    """
    names, of, positions = tuple(letter.lower() for letter in letters), [], []
    for line, letter in enumerate(letters):
        number = [axis.letter for axis in machine.axes].index(letter)
        targets = _targets(machine.axes[number])
        way = np.tile(np.append(targets, targets[::-1]), RUNS)
        place = np.repeat(machine.home[:, None], len(way), axis=1)
        place[number] = way
        of.append(np.full(len(way), line))
        positions.append(place)
    position, line_of = np.concatenate(positions, axis=1), np.concatenate(of)
    moving = np.array([[axis.letter for axis in machine.axes].index(letter) for letter in letters])
    return MeasuredLines(names, names, line_of, position, position[moving[line_of], np.arange(len(line_of))])


def beyond(axis: Axis) -> float:
    """Return how far an axis goes beyond the last target before it comes back [mm, rad]."""
    return min(float(_BEYOND[axis.turns]), _MOST_BEYOND * float(np.ptp(axis.knots)) / _count(axis))


def _count(axis: Axis) -> int:
    """Return the number of steps between the targets of an axis."""
    size = float(np.degrees(np.ptp(axis.knots)) if axis.turns else np.ptp(axis.knots))
    return max(fewest_targets(axis.letter, size), len(axis.knots)) - 1


def _targets(axis: Axis) -> Array:
    """Return targets of an axis at unequal steps, from end to end; short of the ends where it cannot go beyond them."""
    turns, count = axis.turns, _count(axis)
    off = np.mod(np.arange(1, count + 2) * _GOLDEN, 1.0) * 2 - 1
    off[[0, -1]] = 0.0
    low, high = axis.knots[0], axis.knots[-1]
    places = np.linspace(low, high, count + 1) + off * _AWAY * (high - low) / count
    shown = np.round(np.degrees(places) if turns else places, _DECIMALS)
    rounded: Array = np.radians(shown) if turns else shown
    if isinstance(axis, RotaryAxis) and axis.periodic:
        return rounded
    ends = beyond(axis)
    return np.asarray(np.clip(rounded, low + ends, high - ends))


def columns_of(machine: Machine, lines: MeasuredLines) -> dict[str, Values]:
    """Return the columns line, axis and place of lines, under headings; those of rotary axes are their angles."""
    named: dict[str, Values] = {"line": np.array(lines.names)[lines.of], "axis": np.array(lines.axis)[lines.of]}
    if machine.turns:
        return named | machine.columns(lines.position)
    return named | {"position [mm]": lines.distance}
