"""Export as CSV: all tables of a result, or the error curves of a machine."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from metrocli import units
from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.exports import Exported, error_tables
from metrocli.exports.compensation import CompensationFormat, Texts
from metrocli.exports.error_tables import AXES, ErrorTable, ErrorTables
from metrocli.exports.volumetric import ReadErrors, chain_note, moved_by_errors
from metrocli.result import Result
from metrocli.table import Table

_UNITS = {"um": ("length", "errors.csv"), "urad": ("angle", "errors-angles.csv")}
_SQUARENESS = "errors-squareness.csv"


def written(tables: ErrorTables) -> Texts:
    """Return displacements, angles and squareness, each as the text of a CSV file.

    Raises InputError if no error table is determined.
    """
    if not tables.curves:
        raise InputError("the result determines no error table")
    head = [f"# {line}" for line in _head(tables)]
    texts = {}
    for unit, (dimension, file) in _UNITS.items():
        wanted = [name for name in tables.curves if (name[1] in AXES) == (unit == "um")]
        rows = [row for error in wanted for row in _rows(tables, error, units.find_unit(unit, dimension))]
        if rows:
            texts[file] = "\n".join([*head, f"error,position_mm,value_{unit},std_{unit}", *rows, ""])
    if tables.squareness:
        angle = units.find_unit("urad", "angle")
        rows = [
            f"{name},{angle.outside(value):.9g},{angle.outside(tables.squareness_std.get(name, np.nan)):.3g}"
            for name, value in tables.squareness.items()
        ]
        texts[_SQUARENESS] = "\n".join([*head, "error,value_urad,std_urad", *rows, ""])
    return texts


def _head(tables: ErrorTables) -> Iterable[str]:
    yield from tables.notes()
    yield chain_note(tables)[0]
    yield "straightness is free of its end-point line; squareness is the angle of these lines"


def _rows(tables: ErrorTables, name: str, unit: units.Unit) -> Iterable[str]:
    curve = tables.curves[name]
    std: Array = curve.std if curve.std is not None else np.full(len(curve.values), np.nan)
    for at, value, spread in zip(curve.positions.tolist(), curve.values.tolist(), std.tolist(), strict=True):
        yield f"{name},{at:.6f},{unit.outside(value):.6f},{unit.outside(spread):.6f}"


def read(texts: Texts) -> ReadErrors:
    """Return the curves, the squareness errors and the comments of the files."""
    curves: dict[str, ErrorTable] = {}
    for unit, (dimension, file) in _UNITS.items():
        cells = _cells(texts.get(file, ""))
        for name in dict.fromkeys(row[0] for row in cells):
            at, values, std = np.array([row[1:] for row in cells if row[0] == name], dtype=float).T
            inside = units.find_unit(unit, dimension).inside(1.0)
            curves[name] = ErrorTable(at, values * inside, std * inside)
    urad = units.find_unit("urad", "angle")
    squareness = {row[0]: urad.inside(float(row[1])) for row in _cells(texts.get(_SQUARENESS, ""))}
    comments = [line for line in next(iter(texts.values())).splitlines() if line.startswith("#")]
    return curves, squareness, comments


def _cells(text: str) -> list[list[str]]:
    return [line.split(",") for line in text.splitlines() if not line.startswith("#")][1:]


CONTROL = CompensationFormat(written, read, moved_by_errors, resolution=1e-6)


def files(result: Result) -> Exported:
    """Return the tables that have rows, by file name `NAME.csv`; a group of the result becomes part of the name.

    For a machine, `errors.csv` holds the error tables, and the summary of the errors is `errors-summary.csv`. Raises
    InputError if the result has no tables.
    """
    own = _error_tables(result)
    tables: dict[str, Table | str] = {}
    for name, table in result.tables.items():
        file = name.replace("/", "-")
        if len(table):
            tables[f"{file}-summary.csv" if f"{file}.csv" in own else f"{file}.csv"] = table
    if not tables:
        raise InputError("the result has no tables")
    return {**tables, **own}


def _error_tables(result: Result) -> Exported:
    tables = error_tables.of(result) if error_tables.has(result) else None
    return CONTROL.files(tables) if tables and tables.curves else {}
