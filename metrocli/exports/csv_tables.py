"""Export a result as CSV: one file for each table, and the error tables of a machine together in a few files."""

from __future__ import annotations

from metrocli.errors import InputError
from metrocli.exports import Exported
from metrocli.result import Result
from metrocli.table import Table


def files(result: Result) -> Exported:
    """Return the tables that have rows, by file name `NAME.csv`; a group of the result becomes part of the name.

    For a machine, `errors.csv` holds the error tables, and the summary of the errors is `errors-summary.csv`. Raises
    InputError if the result has no tables.
    """
    own = _error_tables(result)
    found: dict[str, Table | str] = {}
    for name, table in result.tables.items():
        file = name.replace("/", "-")
        if len(table):
            found[f"{file}-summary.csv" if f"{file}.csv" in own else f"{file}.csv"] = table
    if not found:
        raise InputError("the result has no tables")
    return {**found, **own}


def _error_tables(result: Result) -> Exported:
    from metrocli.exports import csv_errors, error_tables

    tables = error_tables.of(result) if error_tables.has(result) else None
    return csv_errors.CONTROL.files(tables) if tables and tables.curves else {}
