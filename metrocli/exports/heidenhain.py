"""Heidenhain nonlinear axis error compensation: a .COM table for each axis that moves, assigned by config.CMA.

[axis of the column in .COM] = F(axis of the column in .CMA); positions refer to the machine datum (technical manual
MANUALplus 620, 6.10.3). A positive error means that the travel is too long (TNC 407 technical manual, MP720), so the
value is the error. No public manual confirms this for nonlinear tables; therefore the note describes a test move.
Products of two axes need the KinematicsComp option and are left out, which the note mentions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.exports.compensation import CompensationFormat, Texts
from metrocli.exports.error_tables import LETTERS, ErrorTable, ErrorTables, unit_of

MOST_POINTS = 256
"""Most entries of a .COM table"""
_NOTE, _ASSIGNED = "heidenhain.txt", "config.CMA"


def carried(tables: ErrorTables) -> ErrorTables:
    """Return the errors of one axis: positioning, straightness, squareness, and angles with the tool as lever."""
    kept = {f"E{direction}{moves}": curve for (moves, direction), curve in tables.of_one_axis().items()}
    return replace(tables, curves=kept, squareness={})


def written(tables: ErrorTables) -> Texts:
    """Return the tables, their assignment in config.CMA, and a note.

    Raises InputError if there is no error of one axis, or if a table is too long.
    """
    if not tables.curves:
        raise InputError("the result determines no error that depends on a single axis")
    moving = [axis for axis in LETTERS if any(name[2] == axis for name in tables.curves)]
    texts = {f"AXIS-{axis}.COM": _table(tables, axis) for axis in moving}
    assigned = ["BEGIN CONFIG.CMA", "NR  ACTIVE  " + "  ".join(moving)]
    assigned += ["0   *       " + "  ".join(f"AXIS-{axis}" for axis in moving), "[END]", ""]
    return {**texts, _ASSIGNED: "\n".join(assigned), _NOTE: _note(tables)}


def _table(tables: ErrorTables, moves: str) -> str:
    curves = {name[1]: curve for name, curve in tables.curves.items() if name[2] == moves}
    grid = np.unique(np.concatenate([curve.positions for curve in curves.values()]))
    if len(grid) > MOST_POINTS:
        raise InputError(f"axis {moves} needs {len(grid)} points; a .COM table takes at most {MOST_POINTS}")
    columns = {direction: curve.at(grid) for direction, curve in sorted(curves.items())}
    head = f"NR   {'AXISPOS':>12}  {'BACKLASH':>9}  " + "  ".join(f"{direction:>9}" for direction in columns)
    rows = [
        f"{k:<4} {at:>+12.4f}  {0.0:>+9.4f}  " + "  ".join(f"{column[k]:>+9.4f}" for column in columns.values())
        for k, at in enumerate(grid.tolist())
    ]
    return "\n".join([f"BEGIN AXIS-{moves}.COM MM", head, *rows, "[END]", ""])


def _note(tables: ErrorTables) -> str:
    name, curve = next(iter(tables.curves.items()))
    k, unit = int(np.argmax(np.abs(curve.values))), unit_of(name[2])
    lines = [
        *tables.notes(),
        "values in mm, of rotary axes in deg, are errors: positive if the travel is too long",
        "no public manual confirms the sign of nonlinear tables. Test move: activate the line of config.CMA and go to "
        f"{name[2]} = {curve.positions[k]:.3f} {unit}. {name[1]} must move by {-curve.values[k]:+.4f} {unit}. If "
        "not, change the sign of all columns",
        "the layout of the header line differs between controls; the columns are those of MANUALplus 620 and iTNC 530",
    ]
    lines.append("angles with another axis as lever are not in these tables: they need the option KinematicsComp")
    return "\n".join([*lines, ""])


def read(texts: Texts) -> dict[tuple[str, str], ErrorTable]:
    """Return the tables of the active line of config.CMA, by (axis that moves, axis corrected)."""
    rows = [line.split() for line in texts[_ASSIGNED].splitlines()]
    moving = rows[1][2:]
    active = next(row for row in rows[2:] if row[1] == "*")
    held = {}
    for moves, name in zip(moving, active[2:], strict=True):
        lines = [line.split() for line in texts[f"{name}.COM"].splitlines()[1:]]
        values = np.array([line[1:] for line in lines[1:-1]], dtype=float)
        for k, direction in enumerate(lines[0][3:], start=2):
            held[moves, direction] = ErrorTable(values[:, 0], values[:, k])
    return held


def moved(held: Mapping[tuple[str, str], ErrorTable], commanded: Array) -> Array:
    """Return the movement (n, axes) by the control: the negative error."""
    moves = np.zeros(commanded.shape)
    for (moving, direction), curve in held.items():
        moves[:, LETTERS.index(direction)] -= curve.at(commanded[:, LETTERS.index(moving)])
    return moves


CONTROL = CompensationFormat(written, read, moved, resolution=1.6e-4, carried=carried, turns=True)
