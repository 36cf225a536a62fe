"""Poses of a machine with rotary axes before its measurement, and what it would read there if it had no errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.arrays import Array, Index, Mask
from metrocli.errors import InputError
from metrocli.geometry import poses
from metrocli.instruments.machine import Machine
from metrocli.instruments.machine_path import last_sides
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.described import commanded, error_blocks, machine_of
from metrocli.tasks.calibrate_machine.files import Files
from metrocli.tasks.calibrate_machine.methods.known_axes import with_known_axes
from metrocli.tasks.calibrate_machine.methods.lengths import first_read, lengths
from metrocli.tasks.calibrate_machine.methods.probing import probing
from metrocli.tasks.calibrate_machine.methods.standstill import CARTESIAN, standstill
from metrocli.tasks.calibrate_machine.methods.targets import brought_to, targets
from metrocli.tasks.calibrate_machine.problem import MachineProblem, tool_column
from metrocli.tasks.calibrate_machine.settings import LENGTHS, PROBING, STANDSTILL, MachineSimulation, Settings
from metrocli.tasks.shared.environment import air_of
from metrocli.tasks.shared.lists import listed_places, matched

STATIONS = 4
"""Number of stations where no list has them"""
AROUND = np.array([[-0.4, -0.4, 0.1], [1.4, -0.3, 0.8], [1.3, 1.4, 0.0], [-0.4, 1.3, 1.0], [0.5, -0.9, 1.2]])
"""Places of stations that no list has, as shares of the extent of what they read: outside it, and not in a plane"""
_GOLDEN = (np.sqrt(5) - 1) / 2
"""Its multiples modulo 1 spread evenly, however many they are"""
_REFERENCE_TEMPERATURE = 20.0
"""Temperature at the first reading [degC] (ISO 1)"""
_ANGLE_DECIMALS = 9
"""Decimals of angles in files [deg]: 0.0000036 arcsec"""
_POSE_DECIMALS = 3
"""Decimals of poses [mm, deg]"""

PROBLEMS: Mapping[str, Callable[[Settings, Table, Files], MachineProblem]] = {
    STANDSTILL: standstill,
    LENGTHS: lengths,
    PROBING: probing,
}
"""The adjustment problem of a table, by the method that reads rotary axes in any pose"""


def problem_at(settings: Settings, table: Table, files: Files) -> MachineProblem:
    """Return the adjustment problem of a table, with the errors that an earlier calibration gives.

    Raises InputError if the files do not belong together.
    """
    return with_known_axes(PROBLEMS[settings.method](settings, table, files), settings, files.machine)


def poses_at(settings: Settings, files: Files, shares: Array, margin: float = 1.0) -> Table:
    """Return poses at shares (axes, n) of all ranges, with what is read there: tools, reflectors, balls, stations.

    The linear axes bring the probe to its ball; poses in which it would be nearer than `margin` to the end of their
    travel are left out. Raises InputError if no pose is left.
    """
    machine = machine_of(settings)
    position = _rounded(machine, machine.low[:, None] + (machine.high - machine.low)[:, None] * shares)
    if settings.method == PROBING:
        return _at_balls(settings, files, position, margin)
    n, names = shares.shape[1], _target_names(settings, files)
    point = {"point [text]": np.array([f"P{i + 1:03d}" for i in range(n)])}
    # a machine with one tool without a name has no column for it
    tool = {} if names == [""] else {"tool": np.array(names)[_in_golden_order(len(names), n)]}
    table = Table.of(point | machine.columns(position) | tool)
    if settings.method != LENGTHS:
        return table
    listed = files.listed_stations
    stations = [f"S{i + 1}" for i in range(STATIONS)] if listed is None else listed.texts("station")
    # each station reads all poses
    rows = np.tile(np.arange(n), len(stations))
    return table.selected(rows).joined({"station": np.repeat(np.array(stations), n)})


def without_errors(settings: Settings, table: Table, files: Files, tracker: Array) -> tuple[Table, Files]:
    """Return poses with what a machine without errors would read, and the files with the stations that read it.

    `tracker` is the pose of the tracker in the axes of what it stands on.
    """
    if settings.method == PROBING:
        return table, files
    places = places_read(settings, table, files)
    if settings.method == STANDSTILL:
        in_tracker = poses.apply(poses.inverse(tracker), places.T)
        return table.joined({" ".join(CARTESIAN) + " [mm]": in_tracker}), files
    names = list(dict.fromkeys(table.texts("station")))
    stations = files.listed_stations
    if stations is None:
        stations = listed_places("station", names, around(places, len(names)))
    files = replace(files, stations=stations)
    listed = stations.texts("station")
    station = matched(table, "station", listed, stations.file)
    path = np.linalg.norm(places - stations.stacked("xyz")[station].T, axis=0)
    # `towards` turns a length into that of the path
    air = air_of(settings.environment, table, "station")
    length = (path - first_read(path, station)) / (1.0 if air is None else air.towards)
    return table.joined({"length [mm]": length}), files


def places_read(settings: Settings, table: Table, files: Files) -> Array:
    """Return the places (3, n) of the targets on a machine without errors, in the axes of what the instrument is on."""
    machine = machine_of(settings)
    measured = targets(settings, error_blocks(machine, settings), table, files.reflectors)
    return measured.places(machine, commanded(machine, table), settings.instrument.on)


def around(places: Array, count: int) -> Array:
    """Return places (count, 3) around others (3, n), at different heights."""
    low, high = places.min(axis=1), places.max(axis=1)
    return np.asarray(low + (high - low) * AROUND[np.arange(count) % len(AROUND)])


def clock(simulation: MachineSimulation, count: int) -> dict[str, Array]:
    """Return the times of successive readings, and their temperatures if it gets warmer."""
    number = np.arange(float(count))
    warm = _REFERENCE_TEMPERATURE + simulation.warming * number / max(count - 1, 1)
    return {"t": number * simulation.interval} | ({"temp": warm} if simulation.warming else {})


def sides_of(names: Sequence[str], position: Array, time: Array) -> dict[str, Array]:
    """Return by name from which sides the axes come to positions (axes, n), in the order of time; first from below."""
    order = np.argsort(time, kind="stable")
    # before the first position each axis is 1 below it
    moves = np.diff(position[:, order], axis=1, prepend=position[:, order[:1]] - 1)
    # argsort of an order is its inverse: back to the order of the readings
    return {name: last_sides(of_axis)[np.argsort(order)] for name, of_axis in zip(names, moves, strict=True)}


def in_degrees(table: Table) -> Table:
    """Return a table whose columns of rotary axes and of angles of a tracker are in degrees, as people read them."""
    angles = [name for name in ("a", "b", "c", "azimuth", "elevation") if name in table]
    return table.joined(
        {f"{name} [deg]": np.round(np.degrees(table.numbers(name)), _ANGLE_DECIMALS) for name in angles}
    )


def _at_balls(settings: Settings, files: Files, position: Array, margin: float) -> Table:
    """Return poses in which each tool is at each ball."""
    if files.balls is None:
        raise InputError("give the approximate places of the balls: `inputs: {balls: balls.csv}`")
    machine, balls, tools = machine_of(settings), files.balls.texts("ball"), list(settings.tools)
    pair = _in_golden_order(len(balls) * len(tools), position.shape[1])
    ball, tool = pair % len(balls), pair // len(balls)
    tip = machine.tools[tool].T
    reached = brought_to(machine, position, files.balls.stacked("xyz")[ball].T, tip)
    fits = _inside(machine, reached, margin)
    if not fits.any():
        text = f"in none of {len(fits)} poses does a tool reach a listed ball within the travel of X, Y and Z"
        raise InputError([files.balls.fault(text, "check the places of the balls, the tools and `at`")])
    named = {"ball [text]": np.array(balls)[ball[fits]], **machine.columns(_rounded(machine, reached[:, fits]))}
    return Table.of(named | tool_column(settings, tool[fits]))


def _inside(machine: Machine, position: Array, margin: float) -> Mask:
    """Return which positions (axes, n) lie in the travel, of linear axes with a margin [mm]."""
    margins = np.array([0.0 if axis.turns else margin for axis in machine.axes])
    low, high = (machine.low + margins)[:, None], (machine.high - margins)[:, None]
    return np.asarray(((position >= low) & (position <= high)).all(axis=0))


def _target_names(settings: Settings, files: Files) -> list[str]:
    """Return the names of the tools and reflectors that are read; no tool that stands still for the instrument.

    A chain that ends with the bed b has its spindle there: an instrument on the bed sees only reflectors move.
    """
    reflectors = [] if files.reflectors is None else files.reflectors.texts("reflector")
    spindle_at_rest = settings.instrument.on == "bed" and settings.machine.letters[-1] == "b"
    return reflectors if reflectors and spindle_at_rest else [*settings.tools, *reflectors]


def _in_golden_order(members: int, count: int) -> Index:
    """Return `count` numbers below `members` in the order of multiples of the golden ratio, which no axis follows."""
    return np.asarray(np.floor(members * np.mod(np.arange(1, count + 1) * _GOLDEN, 1.0)), dtype=np.intp)


def _rounded(machine: Machine, position: Array) -> Array:
    """Return positions (axes, n) as a control shows them."""
    turns = np.array([axis.turns for axis in machine.axes])[:, None]
    return np.where(
        turns, np.radians(np.round(np.degrees(position), _POSE_DECIMALS)), np.round(position, _POSE_DECIMALS)
    )
