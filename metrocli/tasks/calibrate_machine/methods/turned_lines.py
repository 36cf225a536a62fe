"""Lines about rotary axes: mistakes in their angles that would give wrong figures without a word."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli.arrays import Array, Index, Values
from metrocli.errors import Fault
from metrocli.instruments.axes.rotary import RotaryAxis
from metrocli.instruments.machine import Axis, Machine
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.described import placed

_TURN = 2 * np.pi
_CLOSE = np.radians(0.01)
"""Angles that differ by less are equal"""
_GON = np.radians(400.0)
_WIDE = np.radians(30.0)
"""A line over less of a wider axis was hardly meant"""


def angle_faults(machine: Machine, table: Table, axes: Values, read: tuple[Index, Array]) -> Iterator[Fault]:
    """Yield faults of angles in another unit than the heading states, and of turns that are not counted on.

    `read` holds the number of the line and the commanded angle [rad] of each reading.
    """
    of, angle = read
    for axis in machine.axes:
        letter = axis.key
        for i in np.unique(of[axes == letter]).tolist():
            rows = np.flatnonzero(of == i)
            fault = _other_unit(axis, table, rows, angle[rows]) or _not_counted_on(axis, table, rows, angle[rows])
            if fault is not None:
                yield fault


def _other_unit(axis: Axis, table: Table, rows: Index, angle: Array) -> Fault | None:
    """Return a fault if angles called degrees are in radians or gon, and would then suit the axis."""
    letter, low, high = axis.key, float(axis.knots[0]), float(axis.knots[-1])
    heading = table.headings.get(letter, f"{letter}_deg")
    span, range_of, reach = (
        float(np.ptp(angle)),
        high - low,
        f"{placed(axis, angle.min())} to {placed(axis, angle.max())}",
    )
    meant = ""
    if heading.endswith("_deg") and span < _WIDE < range_of and _suits(np.degrees(angle), low, high):
        meant = "rad"
    elif heading.endswith("_deg") and abs(span - _GON) < _CLOSE and range_of < _GON - _CLOSE:
        meant = "gon"
    if not meant:
        return None
    whole = f"the axis has {placed(axis, low)} to {placed(axis, high)}"
    return table.fault_at(
        int(rows[0]),
        f"the targets of {letter} are {reach}; {whole}",
        f"are they in {meant}? then write `{letter}_{meant}`",
    )


def _suits(angle: Array, low: float, high: float) -> bool:
    """Return whether angles lie within a range and cover half of it or more."""
    inside = angle.min() >= low - _CLOSE and angle.max() <= high + _CLOSE
    return bool(inside and 2 * np.ptp(angle) >= high - low)


def _not_counted_on(axis: Axis, table: Table, rows: Index, angle: Array) -> Fault | None:
    """Return a fault if a periodic axis goes through 0 and its angles begin again, so that the axis seems to turn back.

    Runs that go on over many turns in one direction are no such case: each begins again at its first target.
    """
    if not (isinstance(axis, RotaryAxis) and axis.periodic) or np.ptp(angle) > _TURN - _CLOSE:
        return None
    on = np.unwrap(angle)
    jumps = np.flatnonzero(np.abs(on - angle) > _CLOSE)
    if not jumps.size or np.ptp(on) > _TURN + _CLOSE:
        return None
    at, letter = int(jumps[0]), axis.key
    text = f"{letter} goes from {placed(axis, angle[at - 1])} to {placed(axis, angle[at])}"
    return table.fault_at(
        int(rows[at]),
        f"{text}: one way the direction of approach is up, the other way it is down",
        f"if it went on, count on through the turn and write {placed(axis, on[at])}; if it turned back, give "
        f"{letter} `periodic: false`",
    )
