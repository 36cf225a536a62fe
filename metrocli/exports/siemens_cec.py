"""Siemens sag and angularity compensation ($AN_CEC): errors across the axis that moves, and angles with a lever.

A table corrects the output axis as a function of one input axis. Two multiplied tables (MULT_BY_TABLE) give an angle
times a lever, as in the boring mill of the manual: `dX1 = Z1 * sin(beta(X1))` (function manual 6FC5397-1BP40, K3,
p. 245-252). The positioning errors are left to $AA_ENC_COMP. The control adds the value to the setpoint of the output
axis, so it is the negative error. No public manual states this explicitly; therefore the file describes a test move.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from metrocli import units
from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.exports.compensation import CompensationFormat, Texts
from metrocli.exports.error_tables import AXES, ErrorTable, ErrorTables
from metrocli.exports.volumetric import evenly
from metrocli.frozen import dataclass

MOST_TABLES, MOST_POINTS = 62, 2000
"""Most tables (two for each of 31 axes), and most points of a table (MD18342); an 828D has 8 tables of 200 points"""
_METRE = units.find_unit("m", "length")
_ROW = re.compile(r"\$AN_CEC\[(\d+),(\d+)\]=(\S+)")
_SETTING = re.compile(r"\$AN_CEC_(INPUT_AXIS|OUTPUT_AXIS|STEP|MIN|MULT_BY_TABLE)\[(\d+)\]=\(?([^\s)]+)")


@dataclass(frozen=True)
class CecTable:
    """One compensation table of the control."""

    curve: ErrorTable
    input_axis: str
    output_axis: str
    times: int | None = None
    """Index of the table by which it is multiplied"""


def carried(tables: ErrorTables) -> ErrorTables:
    """Return all errors except the positioning errors."""
    own = {f"E{axis}{axis}" for axis in AXES}
    return tables.only(tuple(name for name in tables.curves if name not in own), squareness=True)


def tables_of(tables: ErrorTables) -> list[CecTable]:
    """Return the tables: one for each pair of axes, then an angle and its lever for each product."""
    cec = [
        CecTable(_even(curve.times(-1)), moves, direction)
        for (moves, direction), curve in tables.of_one_axis().items()
        if np.any(curve.values)
    ]
    levers: dict[tuple[str, str], int] = {}
    products = [product for product in tables.products() if np.any(product.angle.values)]
    for product in products:
        key = (product.lever, product.direction)
        if key not in levers:
            levers[key] = len(cec)
            ends = tables.span(product.lever)
            cec.append(CecTable(ErrorTable(ends, ends / _METRE.inside(1.0)), *key))
    cec += [
        CecTable(
            _even(product.angle.times(-_METRE.inside(1.0))),
            product.moves,
            product.direction,
            levers[product.lever, product.direction],
        )
        for product in products
    ]
    return cec


def _even(curve: ErrorTable) -> ErrorTable:
    even = evenly(curve, MOST_POINTS)
    if even is None:
        raise InputError(
            f"no even grid of {MOST_POINTS} points, the most that $AN_CEC takes, contains all knots of a table"
        )
    return even


def written(tables: ErrorTables) -> Texts:
    """Return the file of all tables; raises InputError if there is no table or if there are too many."""
    cec = tables_of(tables)
    if not cec:
        raise InputError("the result determines no error except positioning errors: nothing for $AN_CEC")
    if len(cec) > MOST_TABLES:
        raise InputError(f"$AN_CEC takes at most {MOST_TABLES} tables; these errors need {len(cec)}")
    body = [line for index, table in enumerate(cec) for line in _lines(index, table)]
    return {"NC_CEC.INI": "\n".join(["%_N_NC_CEC_INI", *_head(tables, cec), "CHANDATA(1)", *body, "M17", ""])}


def _head(tables: ErrorTables, cec: Sequence[CecTable]) -> list[str]:
    first = cec[0]
    most = max(len(table.curve.positions) for table in cec)
    k = int(np.argmax(np.abs(first.curve.values)))
    where, value = first.curve.positions[k], first.curve.values[k]
    lines = [
        *tables.notes(),
        "value = minus the error in mm, added to the setpoint of the output axis",
        "no public manual confirms this sign. Test move: enable table 1 only and go to "
        f"{first.input_axis} = {where:.3f} mm. {first.output_axis} must move by {value:+.4f} mm. If not, set "
        "SD41310 $SN_CEC_TABLE_WEIGHT to -1 for all tables that are not multiplied by another table",
        "multiplied tables must act only by their product. If one of them moves its axis alone, disable all "
        "of these and use only the tables without MULT_BY_TABLE",
        f"needs {len(cec)} tables, MD18342 $MN_MM_CEC_MAX_POINTS >= {most}; an 828D has 8 tables of 200 points",
        "load while MD32710 = 0, then SD41300 and MD32710 = 1; use with $AA_ENC_COMP for the positioning errors",
    ]
    return [f"; {line}" for line in lines]


def _lines(index: int, table: CecTable) -> list[str]:
    grid = table.curve.positions
    step = (grid[-1] - grid[0]) / max(len(grid) - 1, 1)
    return [
        *(f"$AN_CEC[{index},{k}]={value:.9f}" for k, value in enumerate(table.curve.values)),
        f"$AN_CEC_INPUT_AXIS[{index}]=({table.input_axis}1)",
        f"$AN_CEC_OUTPUT_AXIS[{index}]=({table.output_axis}1)",
        f"$AN_CEC_STEP[{index}]={step:.9f}",
        f"$AN_CEC_MIN[{index}]={grid[0]:.6f}",
        f"$AN_CEC_MAX[{index}]={grid[-1]:.6f}",
        f"$AN_CEC_DIRECTION[{index}]=0",
        f"$AN_CEC_MULT_BY_TABLE[{index}]={0 if table.times is None else table.times + 1}",
        f"$AN_CEC_IS_MODULO[{index}]=0",
    ]


def read(texts: Texts) -> list[CecTable]:
    """Return the tables as the control stores them."""
    text = texts["NC_CEC.INI"]
    values: dict[int, dict[int, float]] = {}
    for index, k, value in _ROW.findall(text):
        values.setdefault(int(index), {})[int(k)] = float(value)
    settings = {(key, int(index)): value for key, index, value in _SETTING.findall(text)}
    entries = []
    for index, column in sorted(values.items()):
        grid = float(settings["MIN", index]) + float(settings["STEP", index]) * np.arange(float(len(column)))
        curve = ErrorTable(grid, np.array([column[k] for k in range(len(column))]))
        number = int(settings["MULT_BY_TABLE", index])
        axes = settings["INPUT_AXIS", index][0], settings["OUTPUT_AXIS", index][0]
        entries.append(CecTable(curve, *axes, number - 1 if number else None))
    return entries


def moved(held: Sequence[CecTable], commanded: Array) -> Array:
    """Return the movement (n, 3) mm by the control: the sum of single tables and of products."""
    values = [table.curve.at(commanded[:, AXES.index(table.input_axis)]) for table in held]
    factors = {table.times for table in held}
    moves = np.zeros(commanded.shape)
    for index, table in enumerate(held):
        if table.times is not None:
            moves[:, AXES.index(table.output_axis)] += values[index] * values[table.times]
        elif index not in factors:
            moves[:, AXES.index(table.output_axis)] += values[index]
    return moves


CONTROL = CompensationFormat(written, read, moved, resolution=2e-6, carried=carried)
