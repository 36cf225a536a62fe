"""Results in inches, for the terminal only: files and --json stay in millimetres."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from metrocli.result import Estimate, Result
from metrocli.table import Table
from metrocli.units import INCH

_SYMBOL = "in"


def in_inches(result: Result) -> Result:
    """Return a result whose lengths in mm are in inches: estimates, tables and the RMS; notes stay as they are."""
    return replace(
        result,
        estimates=tuple(map(_estimate, result.estimates)),
        tables={name: _table(table) for name, table in result.tables.items()},
        statistics={name: _figures(value) for name, value in result.statistics.items()},
    )


def _estimate(one: Estimate) -> Estimate:
    if one.unit != "mm":
        return one
    return replace(one, value=one.value / INCH, std=one.std / INCH, unit=_SYMBOL, dimension="")


def _figures(value: Any) -> Any:
    if not isinstance(value, Mapping) or "mm" not in value:
        return value
    return {_SYMBOL if unit == "mm" else unit: one / INCH if unit == "mm" else one for unit, one in value.items()}


def _table(table: Table) -> Table:
    """Return a table whose columns in mm are in inches; one with a unit for each row stays as it is."""
    columns = {
        name: table.numbers(name) / INCH if table.units.get(name) == "mm" else values
        for name, values in table.columns.items()
    }
    return Table(columns, {name: _SYMBOL if unit == "mm" else unit for name, unit in table.units.items()})
