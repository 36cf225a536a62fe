"""Lines that `plan` proposes and `simulate` reads: of six channels, or runs to and fro for the figures of ISO 230-2."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.arrays import Array, Values
from metrocli.instruments.axes.rotary import RotaryAxis
from metrocli.instruments.machine import Axis, Machine
from metrocli.tasks.calibrate_machine.iso230 import RUNS, fewest_targets
from metrocli.tasks.calibrate_machine.methods.lines import DIRECTIONS, LEAST, MeasuredLines

_GOLDEN = (np.sqrt(5) - 1) / 2
_AWAY = 0.25
"""Largest shift of a target against equal steps, so that it meets no period, as a share of the step"""
_BEYOND = {False: 1.0, True: np.radians(1.0)}
"""How far an axis goes beyond the last target to approach it from the other side [mm, rad], by whether it turns"""
_MOST_BEYOND = 0.1
"""The same as a share of the step at most"""
_DECIMALS = 1
"""Of targets [mm, deg]"""


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
    return min(float(_BEYOND[isinstance(axis, RotaryAxis)]), _MOST_BEYOND * float(np.ptp(axis.knots)) / _count(axis))


def _count(axis: Axis) -> int:
    """Return the number of steps between the targets of an axis."""
    turns = isinstance(axis, RotaryAxis)
    size = float(np.degrees(np.ptp(axis.knots)) if turns else np.ptp(axis.knots))
    return max(fewest_targets(axis.letter, size), len(axis.knots)) - 1


def _targets(axis: Axis) -> Array:
    """Return targets of an axis at unequal steps, from end to end; short of the ends where it cannot go beyond them."""
    turns, count = isinstance(axis, RotaryAxis), _count(axis)
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
        return named | {f"{axis.letter.lower()} [rad]": lines.position[i] for i, axis in enumerate(machine.axes)}
    return named | {"position [mm]": lines.distance}
