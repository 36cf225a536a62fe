"""Results and plans as text: values to the second digit of their standard uncertainty, tables in columns."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from metrocli import units
from metrocli.plan import Plan
from metrocli.project.pipeline import exit_code
from metrocli.record import Record
from metrocli.result import Estimate, Result, ShownTable
from metrocli.table import Table

MOST_ROWS = 40
_FIRST = ("observations", "unknowns", "dof", "sigma0", "chi2", "p_value", "iterations", "rms")


def result_text(result: Result, record: Record, path: Path) -> str:
    """Return the summary of a result as text."""
    parts = [f"{result.kind}{f': {result.title}' if result.title else ''}"]
    parts += [estimates_text(result.estimates)] if result.estimates else []
    parts += [_statistics_line(result.statistics)]
    parts += result.notes
    parts += [_shown(result.tables, shown) for shown in result.shown if shown.name in result.tables]
    parts += map(str, record.verdicts)
    parts += _doubt_lines(record)
    return "\n".join([*parts, f"result: {path}"])


def plan_text(plan: Plan) -> str:
    """Return the summary of a plan as text."""
    parts = [f"{plan.kind}: planned", *plan.notes]
    parts += [estimates_text(plan.figures)] if plan.figures else []
    return "\n".join([*parts, *(_shown(plan.tables, shown) for shown in plan.shown)])


def print_unfit(record: Record, printed: bool = False) -> int:
    """Print to stderr why a result is not fit for use, unless already printed; return the exit code.

    That is, each acceptance criterion that is not met and each doubt.
    """
    unmet = [str(verdict) for verdict in record.verdicts if not verdict.met]
    for line in () if printed else (*unmet, *_doubt_lines(record)):
        click.echo(line, err=True)
    return exit_code(record)


def _doubt_lines(record: Record) -> list[str]:
    return [f"DOUBTFUL: {doubt}" for doubt in record.doubts]


def estimates_text(estimates: Iterable[Estimate]) -> str:
    """Return a line for each estimate: name, value, standard uncertainty and unit."""
    return columns_text([_estimate_row(estimate) for estimate in estimates])


def _estimate_row(estimate: Estimate) -> list[str]:
    """Return name, value, standard uncertainty and unit; an angle also as a slope."""
    value, std = units.rounded(estimate.value, estimate.std)
    row = [estimate.name, value, f"± {std}", "" if estimate.unit == "1" else estimate.unit]
    if estimate.unit == "rad":
        (slope, unit), (spread, _) = units.as_slope(estimate.value), units.as_slope(estimate.std)
        row.append(f"({units.format_quantity(slope, unit, spread)})")
    return row


def _statistics_line(statistics: Mapping[str, Any]) -> str:
    parts = []
    for name in _FIRST:
        value = statistics.get(name)
        if isinstance(value, Mapping):
            parts += [f"{name} {number:.4g} {unit}" for unit, number in value.items()]
        elif value is not None:
            parts.append(f"{name.replace('_value', '')} {value:.4g}" if isinstance(value, float) else f"{name} {value}")
    return ", ".join(parts)


def _shown(tables: Mapping[str, Table], shown: ShownTable) -> str:
    """Return a table, or the columns of it that are shown."""
    table = tables[shown.name]
    columns = {name: table.columns[name] for name in shown.columns or table if name in table}
    return f"\n{shown.name}\n{table_text(replace(table, columns=columns))}"


def table_text(table: Table) -> str:
    """Return a table in columns with units; a long table is cut after MOST_ROWS rows."""
    heads = [f"{name} [{table.units[name]}]" if table.units.get(name) else name for name in table]
    columns = [_column_texts(table.columns[name][:MOST_ROWS].tolist(), _digits_of(table, name)) for name in table]
    rows = [list(row) for row in zip(*columns, strict=True)]
    more = [f"... {len(table) - MOST_ROWS} more rows (show --table prints all)"] if len(table) > MOST_ROWS else []
    return "\n".join([columns_text([heads, *rows]), *more])


def _digits_of(table: Table, name: str) -> int | None:
    """Return the decimals that show two digits of the smallest standard uncertainty of a column; None without one.

    The standard uncertainties of a column `x` stand in `sx` or `s_x`.
    """
    beside = next((column for column in (f"s{name}", f"s_{name}") if column in table), None)
    stds = [std for std in table.numbers(beside).tolist() if std > 0] if beside else []
    return max(1 - math.floor(math.log10(min(stds))), 0) if stds else None


def _column_texts(values: Sequence[Any], decimals: int | None = None) -> list[str]:
    """Return a column as text: numbers with `decimals`, else with those that show five digits of the largest."""
    numbers = [abs(value) for value in values if isinstance(value, float) and math.isfinite(value)]
    largest = max(numbers, default=0.0)
    whole = all(number == round(number) for number in numbers)
    digits = 0 if whole else min(max(4 - math.floor(math.log10(largest)), 0), 12)
    return [_cell(value, digits if decimals is None else decimals) for value in values]


def _cell(value: Any, digits: int) -> str:
    if not isinstance(value, float):
        return str(value)
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def columns_text(rows: Sequence[Sequence[str]]) -> str:
    """Return rows of text in aligned columns, numbers to the right."""
    count = max(len(row) for row in rows)
    filled = [[*row, *[""] * (count - len(row))] for row in rows]
    columns = [_aligned([row[k] for row in filled]) for k in range(count)]
    return "\n".join("  ".join(cells).rstrip() for cells in zip(*columns, strict=True))


def _aligned(cells: Sequence[str]) -> list[str]:
    width = max(len(cell) for cell in cells)
    numeric = any(cell[:1] in "-+0123456789" for cell in cells[1:] or cells if cell)
    return [cell.rjust(width) if numeric else cell.ljust(width) for cell in cells]
