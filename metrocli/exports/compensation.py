"""Compensation files for controls, checked on a model of the control.

Every file is read back and applied as the control does it; only the rounding of the file may remain of the errors.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from metrocli.arrays import Array
from metrocli.exports.error_tables import (
    AXES,
    LETTERS,
    POSITIONING,
    TURN,
    ErrorTable,
    ErrorTables,
    digits_of,
    has,
    of,
    reversal_of,
    unit_of,
)
from metrocli.frozen import dataclass
from metrocli.result import Result

Texts = Mapping[str, str]
"""Texts of the files of a format, by file name"""


@dataclass(frozen=True)
class CompensationFormat:
    """A compensation format, with a model of the control that reads it."""

    written: Callable[[ErrorTables], Texts]
    """Returns the files; raises InputError if they exceed a limit of the control"""
    read: Callable[[Texts], Any]
    """Returns the tables as the control stores them"""
    moved: Callable[[Any, Array], Array]
    """Returns the movement by the compensation at commanded positions, (n, 3) mm, or (n, 6) mm and deg"""
    resolution: float
    """Largest rounding of a written error, mm or deg"""
    coarseness: Callable[[Any], float] = lambda stored: 1.0
    """Returns the factor by which the stored tables are coarser than `resolution`"""
    carried: Callable[[ErrorTables], ErrorTables] = lambda tables: tables
    """Returns the part of the errors that the format can hold"""
    turns: bool = False
    """Whether it takes the positioning of rotary axes"""

    def __call__(self, result: Result) -> Texts:
        """Return the files of a result; raises InputError if it has no error tables."""
        turns = self.turns and "rotary_axes" in result.tables
        return self.files(positioning_of(result) if turns else of(result))

    def files(self, tables: ErrorTables) -> Texts:
        """Return the files, checked on the model of the control.

        Raises AssertionError if more than the rounding remains after they are read back and applied. This would be a
        defect of the program, such as a wrong sign, which doubles the error.
        """
        carried = self.carried(tables)
        texts = self.written(carried)
        remaining, bound = self.remaining_error(carried, texts), self.rounding_bound(texts)
        if remaining > bound:
            raise AssertionError(
                f"the compensation leaves {remaining:.2g} mm of error, but may leave only {bound:.2g} mm"
            )
        return texts

    def rounding_bound(self, texts: Texts) -> float:
        """Return the largest error (mm) that the rounding in the files may leave."""
        return self.resolution * self.coarseness(self.read(texts))

    def remaining_error(self, carried: ErrorTables, texts: Texts) -> float:
        """Return the largest error (mm) that remains when the control applies the files."""
        places = places_of(carried)
        return float(np.abs(carried.at(places) + self.moved(self.read(texts), places)).max())


def places_of(tables: ErrorTables) -> Array:
    """Return positions (n, 3) mm, or (n, 6) mm and deg: a lattice over the travel, and each axis at its knots."""
    per_axis = []
    for axis in AXES:
        ends = tables.span(axis)
        # 0.137 and 0.781 of the travel are knots of no usual table: interpolation is tested there, too
        per_axis.append(ends[0] + (ends[1] - ends[0]) * np.array([0.0, 0.137, 0.25, 0.5, 0.781, 1.0]))
    lattice = np.array(list(itertools.product(*per_axis)))
    axes = LETTERS if any(name[2] not in AXES for name in tables.curves) else AXES
    lattice = np.pad(lattice, ((0, 0), (0, len(axes) - len(AXES))))
    return np.concatenate([lattice, *(_along(tables, axes, k) for k in range(len(axes)))])


def _along(tables: ErrorTables, axes: str, axis: int) -> Array:
    """Return positions (n, axes) at all knots of an axis and midway between them, the other axes at their low ends."""
    positions = [curve.positions for name, curve in tables.curves.items() if name[2] == axes[axis]]
    knots = np.unique(np.concatenate(positions)) if positions else np.zeros(1)
    where = np.concatenate([knots, (knots[1:] + knots[:-1]) / 2])
    places = np.tile([tables.span(name)[0] for name in axes], (len(where), 1))
    places[:, axis] = where
    return places


def positioning(tables: ErrorTables) -> ErrorTables:
    """Return the positioning errors alone."""
    return tables.only(POSITIONING)


def positioning_of(result: Result) -> ErrorTables:
    """Return the determined positioning errors of all axes of a machine with rotary axes, of the latter in degrees.

    They are actual minus commanded in the count of the axis: the table, which is right-handed, times its `sense`, 1 or
    -1. What is known only together with other errors is left out, since it holds for one tool alone.
    """
    tables, rows = of(result), result.tables["rotary_axes"]
    undetermined = {*tables.left_out, *tables.together}
    linear = {name: tables.curves[name] for name in POSITIONING if name in tables.curves and name not in undetermined}
    turning, widths, periodic = dict[str, ErrorTable](), reversal_of(result), ""
    for row, letter in enumerate(rows.texts("axis")):
        name, sense = f"E{letter}{letter}", float(rows.numbers("sense")[row])
        table = result.tables.get(f"tables/{name}")
        if table is None or name in undetermined:
            continue
        position, value, std = (np.degrees(table.numbers(key)) for key in ("position", "value", "std"))
        curve = ErrorTable(position, sense * value, std)
        if bool(rows.columns["periodic"][row]):
            curve, periodic = _one_turn(curve), periodic + letter
        turning[name] = curve
        if letter in widths:
            widths[letter] = sense * float(np.degrees(widths[letter]))
    curves = {**linear, **turning}
    reversal = {letter: width for letter, width in widths.items() if f"E{letter}{letter}" in curves}
    return replace(tables, curves=curves, squareness={}, reversal=reversal, together=(), periodic=periodic)


def has_positioning(result: Result) -> bool:
    """Return whether a result of a machine with rotary axes determines the positioning of some axis."""
    return has(result) and bool(positioning_of(result).curves)


def _one_turn(curve: ErrorTable) -> ErrorTable:
    """Return the curve of a periodic axis from 0 to 360 deg, where a control wants it to begin and to end."""
    inside = np.mod(curve.positions, TURN)
    # rounded, so that 360 deg less rounding is not a second knot beside 360
    grid = np.unique(np.concatenate([[0.0, TURN], inside]).round(9))
    order = np.argsort(inside)
    values, std = (
        np.interp(grid, inside[order], own[order], period=TURN)
        for own in (curve.values, np.zeros_like(inside) if curve.std is None else curve.std)
    )
    return ErrorTable(grid, values, std)


def sign_test(axis: str, curve: ErrorTable) -> str:
    """Return what a user does and sees on the machine if the sign is right."""
    k, unit = int(np.argmax(np.abs(curve.values))), unit_of(axis)
    return (
        f"test move of {axis}: go to {curve.positions[k]:.3f} {unit}, read the position and switch the compensation "
        f"on. The axis must move by {-curve.values[k]:+.{digits_of(axis)}f} {unit}, against its error. If it moves the "
        "other way, the sign is wrong"
    )
