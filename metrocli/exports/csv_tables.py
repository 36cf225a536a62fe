"""A result as CSV: one file for each of its tables, which reads back as it is."""

from __future__ import annotations

from metrocli.errors import InputError
from metrocli.exports import Exported
from metrocli.result import Result


def files(result: Result) -> Exported:
    """Return the tables that have rows, by `NAME.csv`; a group of the result becomes part of the name."""
    tables = {f"{name.replace('/', '-')}.csv": table for name, table in result.tables.items() if len(table)}
    if not tables:
        raise InputError("the result has no tables")
    return tables
