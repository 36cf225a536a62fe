"""The text of a CSV file: its header, cells and rows."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

from metrocli.errors import Fault, InputError
from metrocli.formats.csv_header import MARKS, has_decimal_comma, later_header, separator_of
from metrocli.formats.csv_plain import PlainCells
from metrocli.formats.file_bytes import FileBytes, read_bytes
from metrocli.frozen import dataclass
from metrocli.words import composed

MOST_FAULTS = 20
MOST_COLUMNS = 5000
"""A wider table is not a measurement, and to compare all its names would take minutes"""

Cells = Sequence[Sequence[str]]
"""Cells of each column"""
Plainly = Callable[[str, str, int], "PlainCells | None"]
"""Returns the cells of rows with a separator and a number of columns if the rows are plain, else None"""


@dataclass(frozen=True)
class Raw:
    """A CSV file as its header and cells, all of them text."""

    file: str
    text: str
    """The whole file, unchanged."""
    separator: str
    header_line: int
    header: tuple[str, ...]
    cells: Cells
    numbers: Sequence[int]
    """Line number of each row."""
    bare: bool = False
    """Whether no cell has white space, so that none needs to be stripped."""
    faults: tuple[Fault, ...] = ()
    """Of rows with another number of cells than the header, which are left out of the cells"""

    @cached_property
    def lines(self) -> list[str]:
        """All lines of the file, unchanged."""
        return self.text.split("\n")

    def fault(self, message: str, line: int, cell: int | None = None, hint: str | None = None) -> Fault:
        shown = self.lines[line - 1]
        return Fault(message, self.file, line, 1 if cell is None else self.start(shown, cell), shown, hint)

    def start(self, line: str, cell: int) -> int:
        """Return the position in the line, from 1, at which a cell begins; the end of the line for a missing cell.

        Separators within quotation marks do not count.
        """
        quoted, seen = False, 0
        for at, character in enumerate(line):
            if seen == cell and not (character == " " and line[at:].strip()):
                return at + 1
            quoted ^= character == '"'
            seen += character == self.separator and not quoted
        return len(line) + 1


def read_text(path: Path, shown: str, held: FileBytes | None = None) -> str:
    data = (held or read_bytes(path, "a CSV file", shown)).data
    # UTF-16 and binary files, which are named as such and not by their first byte that is not UTF-8
    if b"\0" in data:
        line = data[: data.index(b"\0")].count(b"\n") + 1
        raise InputError([Fault("this is not a text file", shown, line, 1, hint="expected CSV in UTF-8")])
    try:
        # one form of letters with accents: names that look alike would differ in their bytes
        text = composed(data.decode("utf-8").lstrip(MARKS))
        return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        column = error.start - data.rfind(b"\n", 0, error.start)
        hint = "save the file in UTF-8"
        raise InputError([Fault("the file is not text in UTF-8", shown, line, column, hint=hint)]) from error


def taken_apart(text: str, file: str) -> Raw:
    """Split the text into header and cells.

    Raises InputError if there is no header or no row, or if a row has another number of cells than the header.
    """
    raw = sound_rows(text, file)
    if raw.faults:
        raise InputError(shortened(raw.faults))
    return raw


def sound_rows(text: str, file: str, plainly: Plainly | None = None) -> Raw:
    """Split the text into header, cells, and faults of rows; `plainly` may take the cells apart as a whole.

    Raises InputError if there is no header, or no row with as many cells.
    """
    lines = ((n, line, end) for n, line, end in _lines(text) if _is_row(line))
    names, stated = next(lines, None), None
    if names is not None and (stated := separator_of(names[1])) is not None:
        names = next(lines, None)
    if names is None:
        raise InputError(
            [Fault("the file is empty", file, 1, 1, hint="expected a header with the names of the columns")]
        )
    number, heading, end = names
    separator = stated or max(",;\t", key=heading.count)
    header = tuple(cell.strip() for cell in next(csv.reader([heading], delimiter=separator)))
    if len(header) > MOST_COLUMNS:
        hint = "keep the columns that a job reads; is it a table with rows and columns exchanged?"
        message = f"the header has {len(header)} columns, more than {MOST_COLUMNS}"
        raise InputError([Fault(message, file, number, hint=hint)])
    raw = Raw(file, text, separator, number, header, (), ())
    if all(re.fullmatch(r"[-+.\deE]+", cell) for cell in header):
        raise InputError([raw.fault("the columns have no names", number, None, "write their names in the first line")])
    if len(header) == 1:
        _refuse_preamble(raw)
    # a header that ends in an empty name has empty columns, which only the slow reader drops
    cells = plainly(text[end + 1 :], separator, len(header)) if plainly and header[-1] else None
    if cells is not None:
        return replace(raw, cells=cells, numbers=range(number + 1, number + 1 + cells.rows), bare=True)
    return _without_empty(_row_by_row(raw))


def _without_empty(raw: Raw) -> Raw:
    """Return a file without the last columns that have neither a name nor a cell, and then without its empty rows."""
    width = len(raw.header)
    # spreadsheets save columns that were once used and are empty now
    while width > 1 and not raw.header[width - 1] and not any(cell.strip() for cell in raw.cells[width - 1]):
        width -= 1
    if width == len(raw.header):
        return raw
    kept = [row for row in range(len(raw.numbers)) if any(column[row].strip() for column in raw.cells[:width])]
    cells = tuple([column[row] for row in kept] for column in raw.cells[:width])
    return replace(raw, header=raw.header[:width], cells=cells, numbers=[raw.numbers[row] for row in kept])


def _lines(text: str) -> Iterator[tuple[int, str, int]]:
    """Yield the number of each line, the line, and its end in the text; the rest of the text is not split."""
    number, start = 1, 0
    while start <= len(text):
        end = text.find("\n", start)
        end = len(text) if end < 0 else end
        yield number, text[start:end], end
        number, start = number + 1, end + 1


def _row_by_row(raw: Raw) -> Raw:
    first, separator, width = raw.header_line, raw.separator, len(raw.header)
    numbers = [
        n for n, line in enumerate(raw.lines[first:], first + 1) if line and (line[0] not in "# \t" or _is_row(line))
    ]
    if not numbers:
        raise InputError([raw.fault("there is a header and no row", first)])
    if '"' in raw.text:
        return _quoted(raw)
    rows = [raw.lines[n - 1] for n in numbers]
    counts = [row.count(separator) + 1 for row in rows]
    faults = _wrong_rows(raw, list(zip(numbers, counts, strict=True)))
    if faults:
        kept = [i for i, count in enumerate(counts) if count == width]
        rows, numbers = [rows[i] for i in kept], [numbers[i] for i in kept]
    # one split for all rows: their counts are known to agree
    flat = separator.join(rows).split(separator)
    return replace(raw, cells=tuple(flat[k::width] for k in range(width)), numbers=numbers, faults=faults)


def _is_row(line: str) -> bool:
    return line.strip()[:1] not in ("", "#")


def _quoted(raw: Raw) -> Raw:
    """Split a file with quotation marks, in which a cell may contain separators, and line ends, which are spaces."""
    rows: list[list[str]] = []
    numbers: list[int] = []

    def lines() -> Iterator[str]:
        for number, line in enumerate(raw.lines[raw.header_line :], raw.header_line + 1):
            if len(numbers) > len(rows):  # within a cell
                # a space in place of the line end; what looks like a comment is text of the cell here
                yield f" {line}"
            elif _is_row(line):
                numbers.append(number)
                yield line

    try:
        for row in csv.reader(lines(), delimiter=raw.separator, strict=True):
            rows.append(row)
    except csv.Error as error:
        message = "a quotation mark is not closed, or text follows a closing quotation mark"
        raise InputError([raw.fault(message, numbers[-1])]) from error
    faults = _wrong_rows(raw, [(number, len(row)) for number, row in zip(numbers, rows, strict=True)])
    kept = [(number, row) for number, row in zip(numbers, rows, strict=True) if len(row) == len(raw.header)]
    cells = tuple(zip(*(row for _, row in kept), strict=True))
    return replace(raw, cells=cells, numbers=[number for number, _ in kept], faults=faults)


def _wrong_rows(raw: Raw, counts: Sequence[tuple[int, int]]) -> tuple[Fault, ...]:
    """Return the faults of rows, given as (line, number of cells), that have another number of cells than the header.

    Raises InputError if no row has the right number: the other cells then have no columns that could be checked.
    """
    wrong = [(line, count) for line, count in counts if count != len(raw.header)]
    if wrong:
        _refuse_preamble(raw)
    decimal = raw.separator == "," and all(has_decimal_comma(raw.lines[line - 1]) for line, _ in wrong)
    faults = []
    for line, count in wrong[: MOST_FAULTS + 1]:
        more = count > len(raw.header)
        comma = more and decimal
        hint = "is there a decimal comma? write 0.1, not 0,1" if comma else f"columns: {', '.join(raw.header)}"
        message = f"cells in this row: {count}; columns in the header: {len(raw.header)}"
        faults.append(raw.fault(message, line, min(count, len(raw.header)) if more else count, hint))
    if len(wrong) == len(counts):
        raise InputError(shortened(faults))
    return tuple(faults)


def _refuse_preamble(raw: Raw) -> None:
    """Raise InputError if the first line is not the header, but one of an instrument before it."""
    lines = [(n, line) for n, line in enumerate(raw.lines, 1) if n >= raw.header_line and _is_row(line)]
    if later := later_header(lines):
        hint = f"delete the lines before it, or read the file by `metrocli import` with a mapping and `header: {later}`"
        raise InputError([raw.fault(f"this is not the header, which is line {later}", raw.header_line, None, hint)])


def shortened(faults: Sequence[Fault]) -> list[Fault]:
    """Return the first MOST_FAULTS faults in the order of the file, and one fault that counts the rest."""
    faults = sorted(faults, key=lambda fault: (fault.line or 0, fault.column or 0))
    if len(faults) <= MOST_FAULTS:
        return list(faults)
    last = faults[MOST_FAULTS]
    rest = Fault(f"and {len(faults) - MOST_FAULTS} more faults from here on", last.file, last.line, last.column)
    return [*faults[:MOST_FAULTS], rest]


_HEAD = 1 << 16
"""Bytes from the beginning of a file that are looked at"""


def numeric(path: Path) -> tuple[str, ...]:
    """Return the headings of the columns of which most of the first cells that are not empty are numbers.

    Where such a column is used, another cell is a fault with its line. A file that cannot be read has none; its faults
    are reported where the whole of it is read.
    """
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
        text = head.decode("utf-8", errors="replace").lstrip(MARKS).replace("\r\n", "\n").replace("\r", "\n")
        whole = text if len(head) < _HEAD else text[: text.rfind("\n")]
        raw = taken_apart(whole, str(path))
    except (OSError, InputError):
        return ()
    return tuple(name for name, cells in zip(raw.header, raw.cells, strict=True) if _hold_numbers(cells))


def _hold_numbers(cells: Sequence[str]) -> bool:
    filled = [cell.strip() for cell in cells if cell.strip()]
    return 2 * sum(map(_is_number, filled)) > len(filled)


def _is_number(cell: str) -> bool:
    try:
        return math.isfinite(float(cell))
    except ValueError:
        return False
