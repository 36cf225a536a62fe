"""Results in inches, for the terminal and for pages: result files and --json stay in millimetres."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from metrocli.cli.columns import UNIT, in_unit_of_row
from metrocli.result import Estimate, Result
from metrocli.table import Table
from metrocli.units import INCH

_SYMBOL = "in"
INCHES = "inch"
"""Value of `--units`"""


def in_inches(result: Result) -> Result:
    """Return a result whose lengths in mm are in inches: estimates, tables and the RMS; notes stay as they are."""
    lengths = {estimate.name for estimate in result.estimates if estimate.unit == "mm"}
    return replace(
        result,
        estimates=tuple(map(_estimate, result.estimates)),
        details={name: _details(own) if name in lengths else own for name, own in result.details.items()},
        tables={name: _table(table) for name, table in result.tables.items()},
        statistics={name: _figures(value) for name, value in result.statistics.items()},
    )


def in_units(result: Result, units: str) -> Result:
    """Return a result in the units of `--units`."""
    return in_inches(result) if units == INCHES else result


def estimates_in(estimates: Iterable[Estimate], units: str) -> tuple[Estimate, ...]:
    """Return estimates in the units of `--units`."""
    return tuple(map(_estimate, estimates)) if units == INCHES else tuple(estimates)


def _estimate(estimate: Estimate) -> Estimate:
    if estimate.unit != "mm":
        return estimate
    return replace(estimate, value=estimate.value / INCH, std=estimate.std / INCH, unit=_SYMBOL, dimension="")


def _details(details: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the details of a length: of these only the expanded uncertainty U has its unit."""
    return {**details, "U": details["U"] / INCH} if "U" in details else details


def _figures(value: Any) -> Any:
    """Return a statistic; those by unit, such as the RMS {"mm": 0.01}, have inches for mm, at the same place."""
    if not isinstance(value, Mapping) or "mm" not in value:
        return value
    return dict((_SYMBOL, figure / INCH) if unit == "mm" else (unit, figure) for unit, figure in value.items())


def _table(table: Table) -> Table:
    """Return a table whose columns in mm are in inches, and the rows in mm of one with a unit for each row."""
    columns = {
        name: table.numbers(name) / INCH if table.units.get(name) == "mm" else values
        for name, values in table.columns.items()
    }
    if UNIT in table:
        rows = table.columns[UNIT] == "mm"
        for name in in_unit_of_row(table):
            columns[name] = np.where(rows, table.numbers(name) / INCH, table.numbers(name))
        columns[UNIT] = np.where(rows, _SYMBOL, table.columns[UNIT])
    return Table(columns, {name: _SYMBOL if unit == "mm" else unit for name, unit in table.units.items()})
