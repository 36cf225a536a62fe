"""The NC program of planned poses: the axes turn while Z is away, and a probe first stands off its ball."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli.arrays import Array, Mask
from metrocli.errors import InputError
from metrocli.instruments.axes.rotary import RotaryAxis
from metrocli.instruments.machine import Axis, Machine
from metrocli.nc_program import Block, Dwell, Feed, Rapid, Remark, Stop, program
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.described import commanded, machine_of
from metrocli.tasks.calibrate_machine.files import Files
from metrocli.tasks.calibrate_machine.methods.targets import brought_to
from metrocli.tasks.calibrate_machine.plans.planned import PLACES, REST
from metrocli.tasks.calibrate_machine.problem import tools_of
from metrocli.tasks.calibrate_machine.settings import LENGTHS, PROBING, Settings

_CLEAR = 50.0
"""Distance of the tip from the centre of a ball before it is probed [mm]"""
_AWAY = "Z"
"""The axis that goes to its upper end between poses"""
_UNCHECKED = (
    "collisions are not checked: run it without workpiece and in single block first",
    "tool centre point control is off: the words are positions of the axes",
)
_PROBED = (
    f"at M0 the tip of the probe is {_CLEAR:g} mm off the ball, along the tool",
    "put the probing cycle of the control in the place of M0; it returns to this position",
)


def by_set_up(table: Table) -> Table:
    """Return poses in the order in which a program visits them: one station and one tool after the other."""
    given = [np.array(table.texts(name)) for name in ("tool", "station") if name in table]
    keys = [np.unique(names, return_inverse=True)[1] for names in given]
    order = np.lexsort([np.arange(len(table)), *keys])
    return table.selected(order)


def with_room(settings: Settings, table: Table, files: Files) -> Table:
    """Return the poses at which a touch probe can stand off its ball within the travel; all of other readings."""
    if not _probes(settings):
        return table
    machine, place = machine_of(settings), _before(settings, table, files)
    low, high = machine.low[:, None], machine.high[:, None]
    linear = np.array([not axis.turns for axis in machine.axes])[:, None]
    inside: Mask = np.asarray((~linear | ((place >= low) & (place <= high))).all(axis=0))
    if not inside.any():
        text = f"in none of {len(table)} poses can the probe stand {_CLEAR:g} mm off its ball within the travel"
        raise InputError(f"{text}: check the places of the balls and the tools")
    return table.selected(inside)


def program_of_poses(settings: Settings, table: Table, files: Files) -> str:
    """Return the program of poses in their order."""
    machine = machine_of(settings)
    linear = not machine.only_turns
    remarks = [
        *(PLACES * linear),
        *_UNCHECKED[: 1 + linear],
        *(_PROBED if _probes(settings) else ["a reading in each dwell"]),
    ]
    blocks = _blocks(settings, machine, table, files)
    return program("metrocli poses for calibrate-machine", remarks, blocks, settings.plan.control)


def _probes(settings: Settings) -> bool:
    """Return whether a touch probe finds the balls; an R-test reads them where it stands."""
    return settings.method == PROBING and settings.sensor != "tool"


def _blocks(settings: Settings, machine: Machine, table: Table, files: Files) -> Iterator[Block]:
    position, names = commanded(machine, table), _names(settings, table)
    before = _before(settings, table, files) if _probes(settings) else position
    ready = ""
    for i, (set_up, name) in enumerate(names):
        if set_up != ready:
            yield from _retract(machine)
            yield Stop(set_up)
            ready = set_up
        yield from _retract(machine)
        yield from _approach(machine, before[:, i], settings.plan.feed)
        yield Remark(name) if not _probes(settings) else Stop(name)
        if not _probes(settings):
            yield Dwell(REST)
    yield from _retract(machine)


def _names(settings: Settings, table: Table) -> list[tuple[str, str]]:
    """Return for each pose what is set up for it, and what is read there."""
    tools = table.texts("tool", "")
    if settings.method == PROBING:
        balls = table.texts("ball")
        return [(f"mount probe {tool}".strip(), f"ball {ball}") for tool, ball in zip(tools, balls, strict=True)]
    points = table.texts("point")
    mounted = [f"reflector {tool}".strip() for tool in tools]
    if settings.method == LENGTHS:
        stations = table.texts("station")
        mounted = [f"interferometer at {at}, {mount}" for mount, at in zip(mounted, stations, strict=True)]
    return [(mount, f"point {point}") for mount, point in zip(mounted, points, strict=True)]


def _before(settings: Settings, table: Table, files: Files) -> Array:
    """Return the positions (axes, n) in which the tip stands off its ball along the tool."""
    if files.balls is None:
        return commanded(machine_of(settings), table)
    machine, balls = machine_of(settings), files.balls.texts("ball")
    ball = [balls.index(name) for name in table.texts("ball")]
    vectors = machine.tools[tools_of(table, settings)]
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    along = np.where(length > 0, vectors / np.where(length > 0, length, 1.0), [0.0, 0.0, -1.0])
    longer = (vectors + _CLEAR * along).T
    return brought_to(machine, commanded(machine, table), files.balls.stacked("xyz")[ball].T, longer)


def _retract(machine: Machine) -> Iterator[Block]:
    for axis in machine.axes:
        if axis.letter == _AWAY:
            yield Rapid({_AWAY: float(axis.knots[-1])})


def _approach(machine: Machine, position: Array, feed: float) -> Iterator[Block]:
    """Yield moves to a position: the rotary axes first, then the linear ones, the one that was away at last."""
    at = {axis.letter: own for axis, own in zip(machine.axes, position.tolist(), strict=True)}
    turning = [axis.letter for axis in machine.axes if axis.turns]
    yield Rapid({letter: float(np.degrees(at[letter])) for letter in turning}, any_turn(machine.axes))
    beside = {letter: own for letter, own in at.items() if letter not in (*turning, _AWAY)}
    if beside:
        yield Rapid(beside)
    if _AWAY in at:
        yield Feed({_AWAY: at[_AWAY]}, feed)


def any_turn(axes: tuple[Axis, ...]) -> str:
    """Return the letters of the axes that take any turn."""
    return "".join(axis.letter for axis in axes if isinstance(axis, RotaryAxis) and axis.periodic)
