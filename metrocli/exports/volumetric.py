"""Export of the error on a grid in the volume, as CSV and for Etalon software."""

from __future__ import annotations

import re

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.exports.compensation import CompensationFormat, Texts
from metrocli.exports.error_tables import AXES, ErrorTable, ErrorTables

_EVEN = 1e-6
"""Largest distance [mm] of positions from an even grid"""


def evenly(curve: ErrorTable, most: int) -> ErrorTable | None:
    """Return a curve on the coarsest even grid that contains all its positions.

    Returns None if this grid needs more than `most` points.
    """
    start, end = curve.positions[0], curve.positions[-1]
    if len(curve.positions) < 2:
        return curve
    first = round((end - start) / float(np.diff(curve.positions).min()))
    for count in range(max(first, 1), most):
        if _meets(curve.positions, start, (end - start) / count):
            grid = np.linspace(start, end, count + 1)
            return ErrorTable(grid, curve.at(grid))
    return None


def _meets(positions: Array, start: float, step: float) -> bool:
    steps = (positions - start) / step
    return bool(np.abs(steps - np.round(steps)).max() * step < _EVEN)


_CHAIN = re.compile(r"axes from the workpiece to the tool: (\w+); tool ([^ ]+) ([^ ]+) ([^ ]+) mm")


def chain_note(tables: ErrorTables) -> list[str]:
    """Return the comments with what the rigid-body model needs besides the tables: order of axes, tool and units."""
    tool = " ".join(f"{offset:.6f}" for offset in tables.tool)
    return [
        f"axes from the workpiece to the tool: {tables.order}; tool {tool} mm",
        "mm and rad; straightness is free of its end-point line, squareness is the angle of these lines",
    ]


def trial_move(tables: ErrorTables) -> list[str]:
    """Return the comment that describes a test move, by which the user checks the sign on the machine."""
    own = [(name, curve) for name, curve in tables.curves.items() if name[1] == name[2]]
    name, curve = (own or list(tables.curves.items()))[0]
    k = int(np.argmax(np.abs(curve.values)))
    return [
        "no public manual confirms whether the control expects errors or corrections. Test move: switch the "
        f"compensation on and go to {name[2]} = {curve.positions[k]:.3f} mm. {name[1]} must move by "
        f"{-curve.values[k]:+.4f} mm (the part of {name} alone). If it moves the other way, set the control's switch "
        "that negates the values"
    ]


ReadErrors = tuple[dict[str, ErrorTable], dict[str, float], list[str]]
"""Curves, squareness errors, and the comments of the files, as read back"""


def moved_by_errors(held: ReadErrors, commanded: Array) -> Array:
    """Return the movement, (n, 3) mm, by a control with the same rigid-body model: the negative error.

    Raises ValueError if the comments do not name the order of the axes and the tool.
    """
    curves, squareness, comments = held
    chain = _CHAIN.search("\n".join(comments))
    if chain is None:
        raise ValueError("the comments do not name the chain")
    tool = (float(chain[2]), float(chain[3]), float(chain[4]))
    ranges = {axis: (float(where.min()), float(where.max())) for axis, where in zip(AXES, commanded.T, strict=True)}
    return -ErrorTables(curves, squareness, chain[1], tool, ranges).at(commanded)


_FILE = "errors.etalon.txt"
_BLOCK = re.compile(r"\[(\w+)\]\s*Gridpoints = \{([^}]*)\}")
_SINGLE = re.compile(r"\[(\w+)\]\s*VALUE = (\S+)")


def written(tables: ErrorTables) -> Texts:
    """Return the file; raises InputError if no error table is determined."""
    if not tables.curves:
        raise InputError("the result determines no error table: nothing to compensate")
    head = [f"// {line}" for line in [*tables.notes(), *chain_note(tables), *trial_move(tables)]]
    blocks = [_block(name, curve) for name, curve in tables.curves.items()]
    single = [f"[{name}]\nVALUE = {value:.12f}" for name, value in tables.squareness.items()]
    return {_FILE: "\n".join([*head, *blocks, *single, ""])}


def _block(name: str, curve: ErrorTable) -> str:
    rows = [f"  {at:.6f} {value:.12f}" for at, value in zip(curve.positions, curve.values, strict=True)]
    return "\n".join([f"[{name}]", "Gridpoints = {", *rows, f"}} // end of {name}"])


def read(texts: Texts) -> ReadErrors:
    """Return the curves, the squareness errors and the comments of the file."""
    text = texts[_FILE]
    curves = {}
    for name, rows in _BLOCK.findall(text):
        values = np.array([row.split() for row in rows.strip().splitlines()], dtype=float)
        curves[name] = ErrorTable(values[:, 0], values[:, 1])
    squareness = {name: float(value) for name, value in _SINGLE.findall(text)}
    return curves, squareness, [line for line in text.splitlines() if line.startswith("//")]


CONTROL = CompensationFormat(written, read, moved_by_errors, resolution=1e-6)
