"""Any table, with a mapping file that names column, unit and sign of each quantity of an input of a job."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from decimal import Decimal
from pathlib import Path

from metrocli import units
from metrocli.errors import Fault, InputError, UsageError
from metrocli.formats.csv_text import shortened
from metrocli.frozen import dataclass
from metrocli.imports import Imported, ImportOptions
from metrocli.imports.lines import TextLines, is_number, to_csv, with_sign
from metrocli.nodes import Node
from metrocli.settings import (
    BAD,
    At,
    Choice,
    Either,
    LocatedValue,
    MapOf,
    Section,
    TableFile,
    Text,
    Whole,
    setting,
    settings_of,
)
from metrocli.table import NUMBER, TEXT, WHOLE, Column, Columns
from metrocli.tasks import KINDS
from metrocli.words import suggestion

_THOUSANDS = {"point": ".", "comma": ",", "space": " \u00a0\u202f", "apostrophe": "'\u2019"}
"""Signs that group digits, each with its spellings"""
ENCODINGS = ("utf-8", "latin-1", "cp1252", "utf-16")
SEXAGESIMAL = "d.mmss"
"""Degrees, minutes and seconds as one number, a unit of files of total stations only"""
SEPARATORS = {"comma": ",", "semicolon": ";", "tab": "\t", "space": " "}


@dataclass(frozen=True)
class ColumnSource:
    """Where a quantity comes from."""

    column: str | None = setting(Text(), "name of the column in the file, or its number from 1", default=None)
    unit: str | None = setting(Text(), "unit in which the file has it", default=None)
    sign: str = setting(Choice("1", "+1", "-1"), "-1 turns the sign", default="1")
    value: str | None = setting(Text(), "the same text or number in each row, in place of a column", default=None)

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a fault unless there is a column or a value."""
        if (self.column is None) == (self.value is None):
            yield "", "give either `column`, its name or number in the file, or `value`"


@dataclass(frozen=True)
class Mapping:
    """How the columns of a file become an input of a job."""

    job: str = setting(Choice(*KINDS), "kind of job that reads the CSV")
    input: LocatedValue = setting(At(Text()), "key of the input in that job, such as lengths")
    columns: dict[str, LocatedValue] = setting(
        MapOf(At(Either(Text(), Section(ColumnSource)))), "quantities of the input, each with its column"
    )
    file: str | None = setting(Text(), "name of the CSV (default: that of the input)", default=None)
    separator: str | None = setting(Choice(*SEPARATORS), "between cells (default: as the first row has)", default=None)
    decimal: str = setting(Choice("point", "comma"), "decimal sign of the numbers", default="point")
    thousands: str | None = setting(
        Choice(*_THOUSANDS), "what groups the digits of large numbers (default: nothing)", default=None
    )
    encoding: str = setting(Choice(*ENCODINGS), "encoding of the file", default=ENCODINGS[0])
    comment: str = setting(Text(), "text with which comment lines begin", default="#")
    header: int | str = setting(
        Either(Whole(1), Choice("none")), "line with the names of the columns, or none (default: the first)", default=0
    )

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a fault if the CSV would not be in the folder of --out, or one sign has two meanings."""
        if self.thousands is not None and self.thousands == self.decimal:
            yield "thousands", f"{self.decimal} is the decimal sign too: one of the two is another"
        if self.file is not None and Path(self.file).name != self.file:
            yield "file", "a name without folders is expected: --out names the folder"


def files(lines: TextLines, options: ImportOptions) -> Imported:
    """Return the CSV that the mapping describes.

    Raises UsageError without a mapping file, InputError that lists all faults of it, or all faults of the rows.
    """
    if options.mapping is None:
        raise UsageError("--from columns needs a mapping file: --map map.yaml (docs/imports.md)")
    faults: list[Fault] = []
    mapping = Section(Mapping).read(options.mapping, faults)
    if mapping is BAD:
        raise InputError(faults)
    columns = {column.name: column for column in _input(mapping).columns}
    rows, names = _rows(lines, mapping)
    faults += _misfits(mapping, columns, names, options.mapping.at("columns"))
    if faults:
        raise InputError(faults)
    header, cells = [], []
    for name, placed in mapping.columns.items():
        source = _source(placed)
        header.append(_heading(columns[name], source))
        place = _place(source, names)
        if place is None:
            cells.append([with_sign(str(source.value), int(source.sign))] * len(rows))
        else:
            values = [(number, row[place]) for number, row in rows]
            if columns[name].dimension != TEXT and mapping.thousands:
                values = [(number, _ungrouped(text, mapping.thousands)) for number, text in values]
            texts, wrong = _read(lines, values, columns[name], mapping.decimal == "comma")
            if source.unit == SEXAGESIMAL and not wrong:
                texts, wrong = _in_degrees(lines, values, texts)
            cells.append([with_sign(text, int(source.sign)) for text in texts])
            faults += wrong
    if faults:
        raise InputError(shortened(faults))
    name = mapping.file or f"{mapping.input.value}.csv"
    return {name: to_csv(header, list(zip(*cells, strict=True)), f"from {lines.file} (columns)")}


def _input(mapping: Mapping) -> Columns:
    """Return the columns of the input; raises InputError if the kind of job has no such table."""
    inputs = settings_of(KINDS[mapping.job].settings()).get("inputs")
    below = settings_of(inputs[0].spec.section) if inputs and isinstance(inputs[0].spec, Section) else {}
    tables = {
        below_setting.key: columns
        for below_setting, _ in below.values()
        if (columns := _table(below_setting.spec)) is not None
    }
    if mapping.input.value not in tables:
        text = f"a job {mapping.job} has no table '{mapping.input.value}'"
        raise InputError([mapping.input.node.fault(text, suggestion(mapping.input.value, list(tables)))])
    return tables[mapping.input.value]


def _table(spec: object) -> Columns | None:
    """Return the columns that a specification of a file has; None if it is not a table."""
    if isinstance(spec, TableFile):
        columns: Columns = spec.columns
        return columns
    parts = spec.specs if isinstance(spec, Either) else ()
    return next((table for part in parts if (table := _table(part)) is not None), None)


def _source(placed: LocatedValue) -> ColumnSource:
    return placed.value if isinstance(placed.value, ColumnSource) else ColumnSource(column=placed.value)


def _rows(lines: TextLines, mapping: Mapping) -> tuple[list[tuple[int, Sequence[str]]], Sequence[str]]:
    """Return the rows with their line numbers, and the names of the columns, which are numbers without a header.

    Raises InputError for rows with another number of cells than the first.
    """
    start = mapping.header if isinstance(mapping.header, int) and mapping.header else 1
    kept = list(lines.without(mapping.comment, start))
    if not kept:
        raise InputError([lines.fault("the file has no rows")])
    separator = SEPARATORS.get(mapping.separator or "") or _separator(kept[0][1], mapping.decimal == "comma")
    rows = [(n, cells_of(line, separator)) for n, line in kept]
    width, other = len(rows[0][1]), _separator(kept[0][1], False)
    if width == 1 and mapping.separator and kept[0][1].count(other):
        name = next(name for name, sign in SEPARATORS.items() if sign == other)
        fault = lines.fault(f"no {mapping.separator} is in this line", kept[0][0], f"write `separator: {name}`")
        raise InputError([fault])
    wrong = [lines.fault(f"{len(cells)} cells instead of {width}", n) for n, cells in rows if len(cells) != width]
    if wrong:
        raise InputError(shortened(wrong))
    if mapping.header == "none":
        return rows, [str(k + 1) for k in range(width)]
    if len(rows) == 1:
        raise InputError(
            [lines.fault("there is a header and no row", rows[0][0], "without a header write `header: none`")]
        )
    return rows[1:], rows[0][1]


def _separator(line: str, comma: bool) -> str:
    """Return the most frequent separator of a line; a decimal comma is one only where there is no other."""
    others = ";\t" if comma and re.search("[;\t]", line) else ",;\t"
    return max(others, key=line.count)


def cells_of(line: str, separator: str) -> Sequence[str]:
    """Return the cells of a line; a quotation mark that is left open ends with its line."""
    if separator == " ":
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]


def _place(source: ColumnSource, names: Sequence[str]) -> int | None:
    """Return the number of the column from 0, None for a fixed value; a name comes before a number."""
    if source.column is None:
        return None
    return names.index(source.column) if source.column in names else int(source.column) - 1


def _misfits(mapping: Mapping, columns: dict[str, Column], names: Sequence[str], node: Node) -> Iterator[Fault]:
    """Yield what the mapping has that the input or the file lacks, and what the input needs besides."""
    for (key, _), (name, placed) in zip(node.entries, mapping.columns.items(), strict=True):
        if name in columns:
            yield from _faults_of(columns[name], _source(placed), placed.node, names)
        else:
            yield key.fault(f"the input has no quantity '{name}'", suggestion(name, list(columns)))
    absent = [column.name for column in columns.values() if column.required and column.name not in mapping.columns]
    if absent:
        yield node.fault(f"the input also needs {', '.join(absent)}")


def _faults_of(column: Column, source: ColumnSource, node: Node, names: Sequence[str]) -> Iterator[Fault]:
    """Yield what is wrong with a source: a column that is not there, or a unit that does not fit."""
    if source.column is not None and source.column not in names:
        number = re.fullmatch(r"[0-9]{1,6}", source.column)
        if not number or not 1 <= int(source.column) <= len(names):
            text = f"the file has no column '{source.column}'"
            yield node.fault(text, suggestion(source.column, list(names)))
    elif source.column is not None and list(names).count(source.column) > 1:
        yield node.fault(f"the file has two columns '{source.column}'", "give the number of the column, from 1")
    if source.value is not None and column.dimension != TEXT and not is_number(source.value):
        yield node.fault(f"{column.name}: '{source.value}' is not a number")
    if column.dimension == TEXT and int(source.sign) < 0:
        yield node.fault(f"{column.name} is text and has no sign: leave `sign` out")
    if column.dimension in (TEXT, WHOLE, NUMBER):
        if source.unit is not None:
            yield node.fault(f"{column.name} has no unit: leave `unit` out")
        return
    known = {unit.symbol for unit in units.DIMENSIONS[column.dimension].units}
    known |= {SEXAGESIMAL} if column.dimension == "angle" else set()
    if source.unit not in known:
        phrase = units.DIMENSIONS[column.dimension].phrase
        reason = "has no unit" if source.unit is None else f"has the unit '{source.unit}'"
        yield node.fault(f"{column.name} is {phrase} and {reason}", f"one of {', '.join(sorted(known))}")


def _heading(column: Column, source: ColumnSource) -> str:
    if source.unit is None:
        return column.name
    if source.unit == SEXAGESIMAL:
        return f"{column.name}_deg"
    ending = next(ending for ending, unit in units.suffixes(column.dimension).items() if unit.symbol == source.unit)
    return f"{column.name}_{ending}"


def _ungrouped(text: str, thousands: str) -> str:
    """Return a number without the signs that group its digits by three; other texts stay as they are."""
    signs = _THOUSANDS[thousands]
    whole = re.fullmatch(rf"[-+]?[0-9]{{1,3}}([{re.escape(signs)}][0-9]{{3}})+([.,][0-9]*)?", text)
    return re.sub(f"[{re.escape(signs)}]", "", text) if whole else text


def _in_degrees(
    lines: TextLines, cells: Sequence[tuple[int, str]], texts: Sequence[str]
) -> tuple[list[str], list[Fault]]:
    """Return angles as total stations show them, 73.0632 for 73° 06' 32", in degrees, and faults."""
    degrees, faults = [], []
    for (number, shown), text in zip(cells, texts, strict=True):
        match = re.fullmatch(r"([-+]?)([0-9]+)\.?([0-9]*)", text)
        digits = match[3].ljust(4, "0") if match else "99"
        minutes, seconds = Decimal(digits[:2]), Decimal(f"{digits[2:4] or '0'}.{digits[4:] or '0'}")
        if text and (match is None or minutes >= 60 or seconds >= 60):
            hint = "expected degrees, then two digits of minutes and two of seconds, such as 73.0632"
            faults.append(lines.fault(f"'{shown}' is not an angle in {SEXAGESIMAL}", number, hint))
        elif match is not None:
            value = Decimal(match[2]) + minutes / 60 + seconds / 3600
            text = f"{match[1]}{value.quantize(Decimal('1e-10'))}"
        degrees.append(text)
    return degrees, faults


def _read(
    lines: TextLines, cells: Sequence[tuple[int, str]], column: Column, comma: bool
) -> tuple[list[str], list[Fault]]:
    """Return the cells of a column, each with its line number, with the digits of the file, and what is wrong there."""
    texts, faults = [], []
    for number, text in cells:
        plain = text.replace(",", ".") if comma and column.dimension != TEXT else text
        if not text and not column.may_be_empty:
            faults.append(lines.fault(f"{column.name}: the cell is empty", number))
        elif comma and column.dimension != TEXT and "." in text:
            hint = "expected numbers such as 1234,5; with points write `decimal: point`"
            faults.append(
                lines.fault(f"{column.name}: '{text}' has a point, and the decimal sign is a comma", number, hint)
            )
        elif text and column.dimension != TEXT and not is_number(plain):
            hint = "write `decimal: comma` in the mapping" if "," in plain else "expected a number"
            faults.append(lines.fault(f"{column.name}: '{text}' is not a number", number, hint))
        texts.append(plain)
    return texts, faults
