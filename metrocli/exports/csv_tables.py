"""A result as CSV: a file for each of its tables, which reads back as it is; error tables of a machine together."""

from __future__ import annotations

from metrocli.errors import InputError
from metrocli.exports import Exported
from metrocli.result import Result


def files(result: Result) -> Exported:
    """Return the tables that have rows, by `NAME.csv`; a group of the result becomes part of the name."""
    found: Exported = {f"{name.replace('/', '-')}.csv": table for name, table in result.tables.items() if len(table)}
    if not found:
        raise InputError("the result has no tables")
    return {**found, **_error_tables(result)}


def _error_tables(result: Result) -> Exported:
    from metrocli.exports import error_tables, neutral

    return neutral.texts_of(error_tables.of(result)) if error_tables.has(result) else {}
