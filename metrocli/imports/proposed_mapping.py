"""What a file that no format was named for is: that of a program, or a table with a proposed mapping.

The mapping has separator, header, decimal sign and units as the file shows them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import groupby

from metrocli import units
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.imports.cameras import program_of
from metrocli.imports.columns import SEPARATORS, cells_of
from metrocli.imports.lines import TextLines

_NUMBER = re.compile(r"[-+]?(?:[0-9]+[.,']?)+(?:[eE][-+]?[0-9]+)?|[-+]?[.,][0-9]+")
_IN_BRACKETS = re.compile(r"[\[(]\s*([^\[\]()]+?)\s*[\])]\s*$")
_LOOKED_AT = 50
"""Rows that are looked at for their signs"""
_PIXELS = ("pixel", "pixels", "pix")
_COMMENTS = ("//", "%", ";", "!", "'", "*")
_KEY = re.compile(r"\s*(?:-\s+)?(?:\[|[\w.]+\s*:(?:\s|$)\s*)")
"""A key of YAML, or a list in brackets"""
_KEYED = {"<": "XML", "{": "JSON", "[": "JSON"}
_SIGNS = {
    "gama-xml": r"<gama-(local|xml)\b",
    "lgc2": r"^\*(?:TITR|POIN|CALA)\b",
    "metashape-markers": r"<marker\s+marker_id=",
    "vnl": r"^#\s*filename\s+x\s+y\b",
}
_NOT_READ = {
    "GSI of Leica": r"^\*?(?:11|41)[0-9]{4}[+-][0-9A-Za-z]{8}",
    "M5 of Zeiss or Trimble": r"^For M5\|Adr",
    "camera or point list of MicMac": r"<(?:ExportAPERO|DicoAppuisFlottant|SetOfMesureAppuisFlottants)\b",
    "camera of Pix4D": r"^Pix4D camera calibration file",
    "target of Kalibr": r"^target_?[tT]ype\s*:",
}
_EXPORT = "export a table of it, one row a reading, and read that with a mapping"
_CAMERA = "docs/tasks/align-part.md has the camera file that jobs read, in pixels"
_INSTEAD = {
    "camera or point list of MicMac": f"export points as a table; {_CAMERA}",
    "camera of Pix4D": f"its numbers are mm; {_CAMERA}",
    "target of Kalibr": "write `pattern: {type: aprilgrid, columns: .., rows: .., pitch: .., marker_size: ..}`",
}


@dataclass(frozen=True)
class _EqualRows:
    """Rows of equal numbers of cells that follow each other in a file."""

    separator: str
    rows: Sequence[tuple[int, Sequence[str]]]
    """Line and cells of each"""
    whole: bool
    """Whether they are all rows of the file"""

    @property
    def numbers(self) -> int:
        """How many cells are numbers; a single cell a row, or a single row after others, is not a table."""
        counts = [sum(map(_is_number, cells)) for _, cells in self.rows]
        table = len(self.rows[-1][1]) > 1 and (self.whole or sum(map(bool, counts)) > 1)
        return sum(counts) if table else 0


def proposed(lines: TextLines) -> str:
    """Return a mapping file that names what a table looks like, for a person to complete.

    Raises InputError for a file that is not a table.
    """
    plain = list(lines.without("#"))
    if not plain:
        raise InputError([lines.fault("the file has no rows")])
    keys = [_KEY.match(line) for _, line in plain]
    nested = any(key and key.end() == len(line) for key, (_, line) in zip(keys, plain, strict=True))
    yaml = "YAML" if nested and 2 * sum(map(bool, keys)) > len(keys) else None
    if name := _KEYED.get(plain[0][1].strip()[0], yaml):
        raise InputError([lines.fault(f"this is {name} that no format of `import --from` has", plain[0][0])])
    table = max((_longest(sign, plain) for sign in SEPARATORS.values()), key=lambda rows: (rows.numbers, rows.whole))
    if not table.numbers:
        hint = "expected rows with the same number of cells, separated by comma, semicolon, tab or space"
        raise InputError([lines.fault("this is not a table of numbers", plain[0][0], hint)])
    first = next(place for place, (_, cells) in enumerate(table.rows) if any(map(_is_number, cells)))
    data, names = table.rows[first:], table.rows[first - 1][1] if first else ()
    before = [(n, line) for n, line in plain if n < table.rows[0][0] and not names]
    after = [n for n, _ in plain if n > table.rows[-1][0]]
    mark = _comment([line for _, line in before])
    decimal, thousands = _signs([cell for _, row in data[:_LOOKED_AT] for cell in row if _is_number(cell)])
    word = next(name for name, sign in SEPARATORS.items() if sign == table.separator)
    return "\n".join(
        [
            f"# mapping for {lines.file}: name job, input, each QUANTITY and UNIT; delete columns that no job reads",
            f"# then: metrocli import {lines.file} --map map.yaml",
            *([_removed(before[0][0], before[-1][0])] if before and not mark else []),
            *([_removed(after[0], after[-1])] if after else []),
            "job: multilaterate",
            "input: lengths",
            f"separator: {word}",
            f"decimal: {decimal}",
            *([f"thousands: {thousands}"] if thousands else []),
            f"header: {table.rows[first - 1][0] if names else 'none'}",
            *([f'comment: "{mark}"'] if mark else []),
            "columns:",
            *_columns(names, data[0][1]),
        ]
    )


def _longest(separator: str, kept: Sequence[tuple[int, str]]) -> _EqualRows:
    """Return those rows of a file with the most numbers that follow each other with the same number of cells."""
    rows = [(number, cells_of(line, separator)) for number, line in kept]
    runs = [list(run) for _, run in groupby(rows, key=lambda row: len(row[1]))]
    return max((_EqualRows(separator, run, len(runs) == 1) for run in runs), key=lambda run: run.numbers)


def _removed(first: int, last: int) -> str:
    return f"# remove {f'line {first}' if first == last else f'lines {first} to {last}'}: no rows of this table"


def _signs(numbers: Sequence[str]) -> tuple[str, str]:
    """Return the names of the decimal sign of numbers, and of the sign that groups their digits, if there is one."""
    comma = any(re.search(r",[0-9]*$", number) for number in numbers)
    group, name = (r"\.", "point") if comma else (",", "comma")
    grouped = any(re.match(rf"[-+]?[0-9]{{1,3}}({group}[0-9]{{3}})+(?![0-9{group}])", number) for number in numbers)
    return "comma" if comma else "point", name if grouped and (
        comma or any("," in number for number in numbers)
    ) else ""


def _comment(lines: Sequence[str]) -> str:
    """Return the sign with which all these lines begin, nothing where they differ."""
    return next((mark for mark in _COMMENTS if lines and all(line.lstrip().startswith(mark) for line in lines)), "")


def _columns(names: Sequence[str], sample: Sequence[str]) -> Iterator[str]:
    """Yield the line of each column: text has no unit, a number the one that its name states, else UNIT."""
    for place, cell in enumerate(sample, 1):
        name = names[place - 1] if names else ""
        source = f"{{column: {place}, unit: {_unit(name) or 'UNIT'}}}" if _is_number(cell) else f"{{column: {place}}}"
        remark = "" if not _is_number(cell) or _unit(name) else "; the file states no unit"
        yield f"  QUANTITY{place}: {source}  # {f'{name}, ' if name else ''}e.g. {cell}{remark}"


def _is_number(cell: str) -> bool:
    return _NUMBER.fullmatch(cell) is not None


def _unit(name: str) -> str:
    """Return the unit that the name of a column ends with, such as "X [mm]", "Run 1 (um)" or "x_mm"; else nothing."""
    match = _IN_BRACKETS.search(name)
    symbol = match[1] if match else name.rpartition("_")[2]
    plain = units.plain_symbol(symbol) if symbol else ""
    known = {unit.symbol for dimension in units.DIMENSIONS.values() for unit in dimension.units}
    return "px" if plain.lower() in _PIXELS else plain if plain in known else ""


def must_be_read(lines: TextLines) -> None:
    """Raise InputError, with what to do, for a file of a program whose files are not read."""
    text = "\n".join(lines.lines)
    for name, sign in _NOT_READ.items():
        if re.search(sign, text, re.MULTILINE):
            raise InputError(
                [lines.fault(f"this is a file that is not read: {name}", None, _INSTEAD.get(name, _EXPORT))]
            )


def format_of(lines: TextLines) -> str | None:
    """Return the format of a file that only files of one program have; None for any other, such as a table."""
    text = "\n".join(lines.lines)
    known = (name for name, sign in _SIGNS.items() if re.search(sign, text, re.MULTILINE))
    return next(known, None) or program_of(text)
