"""A result as CSV: a file for each of its tables, which reads back as it is; error tables of a machine together."""

from __future__ import annotations

from metrocli.errors import InputError
from metrocli.exports import Exported
from metrocli.result import Result
from metrocli.table import Table


def files(result: Result) -> Exported:
    """Return the tables that have rows, by `NAME.csv`; a group of the result becomes part of the name.

    The summary of a machine's errors makes room for the tables themselves: it is `errors-summary.csv`.
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
    from metrocli.exports import error_tables, neutral

    tables = error_tables.of(result) if error_tables.has(result) else None
    return neutral.CONTROL.files(tables) if tables and tables.curves else {}
