"""Split a CSV file into its header and cells, without converting them."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from metrocli.errors import Fault, InputError
from metrocli.formats.csv_plain import plain_cells
from metrocli.formats.file_bytes import FileBytes, read_bytes

MOST_FAULTS = 20
MOST_COLUMNS = 5000
"""A wider table is no measurement, and to compare all its names would take minutes"""
LONGEST_TEXT = 200
_WHOLE_LIMIT = 1 << 62


@dataclass(frozen=True)
class Raw:
    """A CSV file as its header and cells, all of them text."""

    file: str
    lines: Sequence[str]
    """All lines of the file, unchanged, for messages."""
    separator: str
    header_line: int
    header: tuple[str, ...]
    cells: tuple[Sequence[str], ...]
    """Cells of each column."""
    numbers: Sequence[int]
    """Line number of each row."""
    bare: bool = False
    """Whether no cell has white space, so that none needs to be stripped."""

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
    if b"\0" in data:
        line = data[: data.index(b"\0")].count(b"\n") + 1
        raise InputError([Fault("this is not a text file", shown, line, 1, hint="expected CSV in UTF-8")])
    try:
        return data.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        column = error.start - data.rfind(b"\n", 0, error.start)
        hint = "save the file in UTF-8"
        raise InputError([Fault("the file is not text in UTF-8", shown, line, column, hint=hint)]) from error


def taken_apart(text: str, file: str) -> Raw:
    """Split the text into header and cells.

    Raises InputError if there is no header or no row, or if a row has another number of cells than the header.
    """
    lines = text.split("\n")
    at = next((n for n, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")), None)
    if at is None:
        raise InputError(
            [Fault("the file is empty", file, 1, 1, hint="expected a header with the names of the columns")]
        )
    separator = max(",;\t", key=lines[at].count)
    header = tuple(cell.strip() for cell in next(csv.reader([lines[at]], delimiter=separator)))
    if len(header) > MOST_COLUMNS:
        hint = "keep the columns that a job reads; is it a table with rows and columns exchanged?"
        message = f"the header has {len(header)} columns, more than {MOST_COLUMNS}"
        raise InputError([Fault(message, file, at + 1, hint=hint)])
    raw = Raw(file, lines, separator, at + 1, header, (), ())
    plain = plain_cells(lines, at + 1, separator, len(header))
    if plain is not None and not _nameless(header):
        return replace(raw, cells=plain, numbers=range(at + 2, at + 2 + len(plain[0])), bare=True)
    numbers = [n for n, line in enumerate(lines[at + 1 :], at + 2) if line and (line[0] not in "# \t" or _is_row(line))]
    if _nameless(header):
        raise InputError([raw.fault("the columns have no names", at + 1, None, "write their names in the first line")])
    if not numbers:
        raise InputError([raw.fault("there is a header and no row", at + 1)])
    if '"' in text:
        return _quoted(raw)
    rows = [lines[n - 1] for n in numbers]
    wrong = [n for n, row in zip(numbers, rows, strict=True) if row.count(separator) != len(header) - 1]
    refuse_cells(raw, [(n, lines[n - 1].count(separator) + 1) for n in wrong])
    flat = separator.join(rows).split(separator)
    return replace(raw, cells=tuple(flat[k :: len(header)] for k in range(len(header))), numbers=numbers)


def _nameless(header: Sequence[str]) -> bool:
    return all(re.fullmatch(r"[-+.\deE]+", cell) for cell in header)


def _is_row(line: str) -> bool:
    return line.strip()[:1] not in ("", "#")


def _quoted(raw: Raw) -> Raw:
    """Split a file with quotation marks, in which a cell may contain separators, and line ends, which are spaces."""
    rows: list[list[str]] = []
    numbers: list[int] = []

    def lines() -> Iterator[str]:
        for number, line in enumerate(raw.lines[raw.header_line :], raw.header_line + 1):
            if len(numbers) > len(rows):  # within a cell
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
    wrong = [(number, len(row)) for number, row in zip(numbers, rows, strict=True) if len(row) != len(raw.header)]
    refuse_cells(raw, wrong)
    return replace(raw, cells=tuple(zip(*rows, strict=True)), numbers=numbers)


def refuse_cells(raw: Raw, wrong: Sequence[tuple[int, int]]) -> None:
    """Raise InputError for rows with a wrong number of cells, given as (line, number of cells)."""
    comma = raw.separator == ","
    faults = []
    for line, count in wrong[: MOST_FAULTS + 1]:
        more = count > len(raw.header)
        hint = "is there a decimal comma? write 0.1, not 0,1" if more and comma else f"columns: {', '.join(raw.header)}"
        message = f"cells in this row: {count}; columns in the header: {len(raw.header)}"
        faults.append(raw.fault(message, line, min(count, len(raw.header)) if more else count, hint))
    if faults:
        raise InputError(shortened(faults))


def shortened(faults: Sequence[Fault]) -> list[Fault]:
    """Return the first MOST_FAULTS faults in the order of the file, and one fault that counts the rest."""
    faults = sorted(faults, key=lambda fault: (fault.line or 0, fault.column or 0))
    if len(faults) <= MOST_FAULTS:
        return list(faults)
    last = faults[MOST_FAULTS]
    rest = Fault(f"and {len(faults) - MOST_FAULTS} more faults from here on", last.file, last.line, last.column)
    return [*faults[:MOST_FAULTS], rest]
