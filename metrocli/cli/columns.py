"""Tables as text: one unit for each column, and the digits that suit its uncertainty."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

from metrocli import units
from metrocli.table import Table

MOST_ROWS, _WORST = 40, 12
"""Most rows of a table, and of a list of those that differ most"""
UNIT = "unit"
"""Column that holds the unit of each row"""
_ALONE = "uncertainty"
"""Column of uncertainties that belong to no other column"""
_EXACT = 1e-3
"""A standard uncertainty below this share of their median, such as that of a given point, sets no digits"""


def table_text(table: Table) -> str:
    """Return a table in columns with units; a long table is cut after MOST_ROWS rows.

    A table whose rows have different units, in the column `unit`, is shown as one part for each unit.
    """
    shown = replace(table, columns={name: values[:MOST_ROWS] for name, values in table.columns.items()})
    more = [f"... {len(table) - MOST_ROWS} more rows (show --table prints all)"] if len(table) > MOST_ROWS else []
    return "\n".join([*map(_text, _by_unit(shown)), *more])


def columns_text(rows: Sequence[Sequence[str]]) -> str:
    """Return rows of text in aligned columns, numbers to the right."""
    count = max(len(row) for row in rows)
    filled = [[*row, *[""] * (count - len(row))] for row in rows]
    columns = [_aligned([row[k] for row in filled], name=k == 0) for k in range(count)]
    return "\n".join("  ".join(cells).rstrip() for cells in zip(*columns, strict=True))


def worst_rows(rows: Sequence[Sequence[str]], by: str = "E_n") -> list[str]:
    """Return a heading and the first of its rows, which fall in `by`, as lines, and a line that counts the others."""
    lines, more = [columns_text(rows[: _WORST + 1])], len(rows) - _WORST - 1
    return [*lines, f"... {more} more, with smaller {by} (--json has all)"] if more > 0 else lines


def _aligned(cells: Sequence[str], name: bool) -> list[str]:
    """Return cells of equal width: numbers, also with units, to the right; names such as "1.x" to the left."""
    width = max(len(cell) for cell in cells)
    begins = any(cell[:1] in "-+0123456789" for cell in cells[1:] or cells if cell)
    numeric = begins and not (name and any(cell.strip("-+.0123456789e") for cell in cells[1:]))
    return [cell.rjust(width) if numeric else cell.ljust(width) for cell in cells]


def in_unit_of_row(table: Table) -> list[str]:
    """Return the columns whose numbers have the unit of their row; those of plain numbers have the unit 1."""
    return [name for name, values in table.columns.items() if values.dtype.kind == "f" and name not in table.units]


def _by_unit(table: Table) -> Iterator[Table]:
    """Yield the rows of each unit as a table of its own, whose numbers have that unit."""
    if UNIT not in table or not len(table):
        yield table
        return
    each = table.texts(UNIT)
    for unit in dict.fromkeys(each):
        rows = [row for row, name in enumerate(each) if name == unit]
        columns = {name: values[rows] for name, values in table.columns.items() if name != UNIT}
        yield Table(columns, {**table.units, **dict.fromkeys(in_unit_of_row(table), unit)})


def _text(table: Table) -> str:
    columns = [[head, *cells] for head, cells in (_column(table, name) for name in table)]
    return columns_text(list(zip(*columns, strict=True)))


def _column(table: Table, name: str) -> tuple[str, list[str]]:
    """Return the head of a column, with its unit, and its cells."""
    unit, values = table.units.get(name, ""), table.columns[name].tolist()
    stds = {*filter(None, (_std_of(table, other) for other in table)), *({_ALONE} & set(table))}
    if name in stds:
        # all uncertainties of one kind in one unit: sx, sy, sz
        alike = [std for std in stds if table.units.get(std, "") == unit]
        least = _least([std for other in alike for std in table.numbers(other).tolist()])
        size, symbol = units.column_unit(least, unit)
    else:
        beside = _std_of(table, name)
        least = _least(table.numbers(beside).tolist()) if beside else 0.0
        size, symbol = units.column_unit(max(map(abs, _numbers(values)), default=0.0), unit)
    if size != 1.0:
        values = [value / size for value in values]
    decimals = max(1 - math.floor(math.log10(least / size)), 0) if least > 0 else _five_digits(values)
    return name if symbol in ("", "1") else f"{name} [{symbol}]", [_cell(value, decimals) for value in values]


def _std_of(table: Table, name: str) -> str | None:
    """Return the column with the uncertainties of a column `x`: `sx`, `s_x`, `x_std`, or `U_x` with k = 2."""
    return next((form for form in (f"s{name}", f"s_{name}", f"{name}_std", f"U_{name}") if form in table), None)


def _least(stds: Sequence[float]) -> float:
    """Return the smallest standard uncertainty that sets digits; 0 without one."""
    positive = sorted(std for std in stds if 0 < std < math.inf)
    return next((std for std in positive if std >= _EXACT * positive[len(positive) // 2]), 0.0)


def _numbers(values: Sequence[Any]) -> list[float]:
    return [value for value in values if isinstance(value, float) and math.isfinite(value)]


def _five_digits(values: Sequence[Any]) -> int:
    """Return the decimals that show five digits of the largest number; none if all are whole."""
    numbers = _numbers(values)
    if all(number == round(number) for number in numbers):
        return 0
    return min(max(4 - math.floor(math.log10(max(map(abs, numbers)))), 0), 12)


def _cell(value: Any, decimals: int) -> str:
    if not isinstance(value, float):
        return str(value)
    return f"{value:.{decimals}f}" if math.isfinite(value) else "-"


def text_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a table; columns without any cell are left out."""
    lines = [tuple(head), *map(tuple, rows)]
    kept = [i for i in range(len(head)) if any(line[i] for line in lines[1:])]
    widths = {i: max(len(line[i]) for line in lines) for i in kept}
    return ["  ".join(f"{line[i]:{widths[i]}}" for i in kept).rstrip() for line in lines]
