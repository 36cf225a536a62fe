"""Read CSV files as tables and write tables as CSV: column names end in their unit, faults have line and column.

Whole columns are converted at once. Single cells are examined only if that fails, to locate the fault.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from metrocli import copies, units
from metrocli.arrays import Array, Values
from metrocli.errors import Fault, InputError
from metrocli.formats.csv_columns import columns_in_header, has_unit, unused
from metrocli.formats.csv_plain import PlainCells, plain_cells
from metrocli.formats.csv_text import Raw, read_text, shortened, sound_rows
from metrocli.formats.file_bytes import FileBytes, atomic_write
from metrocli.table import NUMBER, TEXT, WHOLE, Column, Columns, Table

LONGEST_TEXT = 200
_WHOLE_LIMIT = 1 << 62
_NO_PART = re.compile(r"(?<=[0-9])\.0*$")
_CLOCK = re.compile(r"\d:\d\d|\d-\d\d?-\d|\d\.\d\d?\.\d")
"""Parts of times of day and of dates"""
_DEGREE = units.find_unit("deg", "angle")
_FORMULA = ("=", "+", "@")
"""Texts that spreadsheets take for formulas, and run; behind a space, which readers of CSV drop, they do not"""


def read(path: Path, columns: Columns, shown: str = "", held: FileBytes | None = None) -> Table:
    """Return the wanted columns of a CSV file in internal units.

    `shown` is the name of the file in messages, `held` its content if it is already read. The table's warnings list
    unused columns. Raises InputError with all faults, at most MOST_FAULTS per file.
    """
    raw = sound_rows(read_text(path, shown or str(path), held), shown or str(path), plain_cells)
    columns = _every(raw, columns) if columns.every else columns
    further = tuple(dict.fromkeys((*(name for name in columns.further if name in raw.header), *_tried(raw, columns))))
    columns = replace(columns, columns=(*columns.columns, *(Column(name) for name in further)))
    places, faults = columns_in_header(raw, columns)
    complete, without_key = not faults, set[int | None]()
    values: dict[str, Values] = {}
    for column in columns.columns:
        if column.name in places:
            index, unit = places[column.name]
            before = len(faults)
            values[column.name] = _convert(raw, index, column, unit, faults)
            if column.name in columns.key:
                without_key |= {fault.line for fault in faults[before:]}
    raw = replace(raw, cells=())  # which take more memory than the values
    faults += raw.faults
    if complete:
        faults += _repeated(raw, columns, values, {name: unit for name, (_, unit) in places.items()}, without_key)
    if faults:
        raise InputError(shortened(faults))
    internal = {c.name: units.internal_unit(c.dimension) for c in columns.columns if has_unit(c) and c.name in values}
    headings = {name: raw.header[index] for name, (index, _) in places.items()}
    table = Table(values, internal, raw.file, raw.numbers, headings, unused(raw, columns, places), further)
    copied = copies.faults(table, columns)
    if copied:
        raise InputError(shortened(copied))
    return table


def _in_file(value: object, unit: units.Unit | None) -> str:
    """Return a value of a key as the file has it: numbers in the unit of their column."""
    if not isinstance(value, float):
        return str(value)
    return f"{value if unit is None else unit.outside(value):.12g}" + (
        f" {unit.symbol}" if unit and unit.symbol != "1" else ""
    )


def _repeated(
    raw: Raw,
    columns: Columns,
    values: dict[str, Values],
    given: Mapping[str, units.Unit | None],
    without: Container[int | None],
) -> list[Fault]:
    """Return a fault for each row that has the same key as an earlier row, but for the lines `without` a key.

    `given` are the units of the columns in the file.
    """
    names = [name for name in columns.key if name in values]
    if not names:
        return []
    if _all_different(Table({name: values[name] for name in names})):
        return []
    keys = list(zip(*(values[name].tolist() for name in names), strict=True))
    first: dict[tuple[object, ...], int] = {}
    faults = []
    for row, key in enumerate(keys):
        if raw.numbers[row] in without:
            continue
        if key in first:
            message = ", ".join(
                f"{name} {_in_file(value, given.get(name))}" for name, value in zip(names, key, strict=True)
            )
            hint = _which_row(columns, values, raw.numbers[first[key]], (first[key], row))
            faults.append(raw.fault(f"{message}: a second row", raw.numbers[row], None, hint))
        else:
            first[key] = row
    return faults


def _which_row(columns: Columns, values: dict[str, Values], line: int, rows: Sequence[int]) -> str:
    """Return what to do with a row whose key is that of the row in an earlier line."""
    own = [name for name in columns.key if name in values]
    pairs = [column[[*rows]].tolist() for name, column in values.items() if name not in own]
    # nan, an empty cell, is equal to itself here
    same = all(one == other or (one != one and other != other) for one, other in pairs)
    further = [f"'{name}'" for name in columns.key if name not in values]
    column = f", or distinguish the rows by a column {' or '.join(further)}" if further else ""
    alike = "with the same values: leave it out" if same else "with other values: leave the wrong row out"
    return f"first in line {line}, {alike}, or give it another {' or '.join(own)}{column}"


def _all_different(keys: Table) -> bool:
    """Return whether no two rows have the same values in all columns; False also where chance gives equal numbers."""
    # one hash for each row costs far less than a tuple for each, and nearly always decides
    numbers = np.sort(copies.row_hashes(keys, tuple(keys)))
    return bool((numbers[1:] != numbers[:-1]).all())


def _tried(raw: Raw, columns: Columns) -> list[str]:
    """Return the headings of those columns for laws of which every cell is a number."""
    return [name for name in columns.tried if name in raw.header and _all_numbers(raw, raw.header.index(name))]


def _every(raw: Raw, columns: Columns) -> Columns:
    """Return a column for each name in the header: of numbers, or of text if any cell is not a finite number."""
    kinds = [NUMBER if _all_numbers(raw, k) else TEXT for k in range(len(raw.header))]
    return replace(columns, columns=tuple(Column(*column) for column in zip(raw.header, kinds, strict=True)))


def _all_numbers(raw: Raw, index: int) -> bool:
    return _quick(raw, index) is not None or all(map(_is_number, raw.cells[index]))


def _quick(raw: Raw, index: int) -> Array | None:
    """Return a column of finite numbers that a plain file holds in the usual notation; None for any other."""
    values = raw.cells.numbers(index) if isinstance(raw.cells, PlainCells) else None
    return values if values is not None and np.isfinite(values).all() else None


def _is_number(cell: str) -> bool:
    try:
        return math.isfinite(float(cell)) and _is_plain(cell)
    except ValueError:
        return False


def _is_plain(text: str) -> bool:
    """Return whether text has neither digits of other scripts nor underscores, which Python reads in numbers."""
    return text.isascii() and "_" not in text


def _convert(raw: Raw, index: int, column: Column, unit: units.Unit | None, faults: list[Fault]) -> Values:
    """Return one column in internal units; cells that are empty and may be so become NaN."""
    if column.dimension == TEXT:
        return _texts(raw, index, column, faults)
    quick = _quick(raw, index) if column.dimension != WHOLE else None
    numbers = _numbers(raw, index, column, faults) if quick is None else quick
    values = np.asarray(numbers, dtype=float)
    inside = values if unit is None else unit.array_inside(values)
    _refuse_beyond(raw, index, column, unit, inside, faults)
    return np.array(numbers, dtype=np.int64) if column.dimension == WHOLE and not column.may_be_empty else inside


def _numbers(raw: Raw, index: int, column: Column, faults: list[Fault]) -> list[float] | list[int]:
    """Return the cells of a column as numbers, and add a fault for each that is not a number."""
    cells = raw.cells[index]
    kind = int if column.dimension == WHOLE else float
    try:
        numbers = list(map(kind, cells))
        sound = _is_plain("".join(cells)) and bool((np.abs(np.asarray(numbers, dtype=float)) < _most(column)).all())
    except (ValueError, OverflowError):
        sound = False
    if sound:
        return numbers
    read = [_number(cell.strip(), column) for cell in cells]
    name = raw.header[index]
    faults += [
        raw.fault(f"column '{name}': {reason}", raw.numbers[row], index, hint)
        for row, (_, reason, hint) in enumerate(read) if reason
    ]  # fmt: skip
    return [value for value, _, _ in read]


def _refuse_beyond(
    raw: Raw, index: int, column: Column, unit: units.Unit | None, values: Array, faults: list[Fault]
) -> None:
    """Add a fault for each value that the column's quantity cannot have."""
    allowed = column.allowed or units.range_of(column.dimension)
    # what no instrument reads, such as 9.9e37 for an overload; plausibility is left to the residuals
    beyond = np.flatnonzero(allowed.excludes(values)).tolist()
    if not beyond:
        return
    limits = units.in_words(allowed, column.dimension, unit.symbol if unit else "")
    cells = raw.cells[index]
    for row in beyond:
        cell = cells[row].strip()
        message = f"column '{raw.header[index]}': {cell} is beyond what it can hold, {limits}"
        if abs(values[row]) > units.OVERLOAD:
            hint = "is it an overload marker of the instrument? leave the row out"
        elif unit is not None and unit.symbol == "rad" and allowed.holds(_DEGREE.inside(float(values[row]))):
            hint = f"is it in degrees? then write {column.name}_deg"
        elif has_unit(column):
            hint = (
                f"if it is right, allow it in the job: ranges: {{{column.name}: {cell} {unit.symbol if unit else ''}}}"
            )
        else:
            hint = None
        faults.append(raw.fault(message, raw.numbers[row], index, hint))


def _most(column: Column) -> float:
    return _WHOLE_LIMIT if column.dimension == WHOLE else float("inf")


def _number(cell: str, column: Column) -> tuple[float | int, str, str | None]:
    """Return one cell as a number; if it is not a number 0, the reason, and what to do."""
    if not cell and column.may_be_empty:
        return float("nan"), "", None
    try:
        # tables with an empty cell somewhere are written with 2.0 for 2
        value = int(_NO_PART.sub("", cell)) if column.dimension == WHOLE else float(cell)
        if _is_plain(cell) and abs(value) < _most(column):
            return value, "", None
        odd = "has digits that are not ASCII" if not cell.isascii() else "has an underscore" if "_" in cell else ""
        reason = f"'{cell}' {odd or 'is not a finite number'}"
    except ValueError:
        reason = f"'{cell}' is not a {'whole ' if column.dimension == WHOLE else ''}number" if cell else "an empty cell"
    if column.dimension == "time" and _CLOCK.search(cell):
        return 0, reason, "write the time since one moment, such as that of the first row, in the unit of the heading"
    comma = re.fullmatch(r"([+-]?[0-9]*),([0-9]+)", cell)
    hint = f"write {comma[1]}.{comma[2]}" if comma else None if cell.isascii() else "write 0 to 9, as on a keyboard"
    return 0, reason, f"write {cell.replace('_', '')}" if reason.endswith("underscore") else hint


def _texts(raw: Raw, index: int, column: Column, faults: list[Fault]) -> Values:
    if isinstance(raw.cells, PlainCells) and raw.cells.length[index].all() and raw.cells.longest(index) <= LONGEST_TEXT:
        return raw.cells.texts(index)
    cells = raw.cells[index] if raw.bare else [cell.strip() for cell in raw.cells[index]]
    name = raw.header[index]
    if not column.may_be_empty and "" in cells:
        rows = [row for row, cell in enumerate(cells) if not cell]
        faults.extend(raw.fault(f"column '{name}': an empty cell", raw.numbers[row], index) for row in rows)
    if max(map(len, cells)) > LONGEST_TEXT:
        rows = [row for row, cell in enumerate(cells) if len(cell) > LONGEST_TEXT]
        message = f"column '{name}': more than {LONGEST_TEXT} characters in one cell"
        faults.extend(raw.fault(message, raw.numbers[row], index) for row in rows)
        cells = [cell[:LONGEST_TEXT] for cell in cells]
    return np.array(cells, dtype=np.str_)


def write(path: Path, table: Table) -> None:
    """Write a table with its units in the header, completely or not at all; numbers read back without change."""
    with atomic_write(path) as temporary:
        temporary.write_text(to_text(table), encoding="utf-8", newline="\n")


def to_text(table: Table) -> str:
    """Return a table as the text of a CSV file."""
    out = io.StringIO()
    columns = [_cells(table.columns[name]) for name in table]
    # quoted, since a first cell that begins with # would be read back as a comment
    looks_like_comment = bool(columns) and any(cell.startswith("#") for cell in columns[0])
    writer = csv.writer(out, lineterminator="\n", quoting=csv.QUOTE_ALL if looks_like_comment else csv.QUOTE_MINIMAL)
    writer.writerow([_header(name, table.units.get(name, "")) for name in table])
    writer.writerows(zip(*columns, strict=True))
    return out.getvalue()


def _header(name: str, unit: str) -> str:
    suffix = units.suffix_of(unit)
    return f"{name}_{suffix}" if suffix else name


def _cells(values: Values) -> list[str]:
    if values.dtype.kind == "f":
        # nan is the empty cell, and `repr` is the shortest text that reads back as the same number
        return ["" if value != value else repr(value) for value in values.tolist()]
    return [f" {text}" if text.startswith(_FORMULA) else text for text in map(str, values.tolist())]
