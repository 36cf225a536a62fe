"""The positioning of the axes of a machine with rotary ones as compensation tables, and a test move for their sign."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrocli.exports.error_tables import (
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
from metrocli.result import Result


def positioning_of(result: Result) -> ErrorTables:
    """Return the determined positioning errors of all axes of a machine with rotary axes, those of these in degrees.

    They are actual minus commanded in the count of the axis: the table, which is right-handed, times its `sense`. What
    is known only together with other errors is left out.
    """
    tables, rows = of(result), result.tables["rotary_axes"]
    open_ones = {*tables.left_out, *tables.together}
    linear = {name: tables.curves[name] for name in POSITIONING if name in tables.curves and name not in open_ones}
    turning, widths, periodic = dict[str, ErrorTable](), reversal_of(result), ""
    for row, letter in enumerate(rows.texts("axis")):
        name, sense = f"E{letter}{letter}", float(rows.numbers("sense")[row])
        held = result.tables.get(f"tables/{name}")
        if held is None or name in open_ones:
            continue
        position, value, std = (np.degrees(held.numbers(key)) for key in ("position", "value", "std"))
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
    """Return the curve of a periodic axis from 0 to 360 deg."""
    inside = np.mod(curve.positions, TURN)
    grid = np.unique(np.concatenate([[0.0, TURN], inside]).round(9))
    order = np.argsort(inside)
    values, std = (
        np.interp(grid, inside[order], own[order], period=TURN)
        for own in (curve.values, np.zeros_like(inside) if curve.std is None else curve.std)
    )
    return ErrorTable(grid, values, std)


def test_move(axis: str, curve: ErrorTable) -> str:
    """Return what a user does and sees on the machine if the sign is right."""
    k, unit = int(np.argmax(np.abs(curve.values))), unit_of(axis)
    return (
        f"test move of {axis}: go to {curve.positions[k]:.3f} {unit}, read the position and switch the compensation "
        f"on. The axis must move by {-curve.values[k]:+.{digits_of(axis)}f} {unit}, against its error. If it moves the "
        "other way, the sign is wrong"
    )
