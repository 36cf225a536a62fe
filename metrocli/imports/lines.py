"""The lines of an imported file, numbers as they are written there, and the CSV text that comes of them."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable, Iterator, Sequence

from metrocli import units
from metrocli.errors import Fault, UsageError
from metrocli.formats.csv_header import separator_of
from metrocli.frozen import dataclass
from metrocli.words import listed, suggestion

_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")


@dataclass(frozen=True)
class TextLines:
    """A text file by lines."""

    file: str
    lines: Sequence[str]

    def fault(self, message: str, line: int | None = None, hint: str | None = None) -> Fault:
        """Return a fault of the file, or of one of its lines, counted from 1."""
        shown = self.lines[line - 1] if line is not None else None
        return Fault(message, self.file, line, None if line is None else 1, shown, hint)

    def without(self, comment: str, start: int = 1) -> Iterator[tuple[int, str]]:
        """Yield number and text of each line from `start` on that is neither empty nor a comment."""
        for number, line in enumerate(self.lines[start - 1 :], start):
            if number == 1 and separator_of(line) is not None:
                continue
            if line.strip() and not (comment and line.lstrip().startswith(comment)):
                yield number, line


def is_number(text: str) -> bool:
    """Return whether text is a plain finite number with a decimal point."""
    return _NUMBER.fullmatch(text) is not None and math.isfinite(float(text))


def with_sign(number: str, sign: int) -> str:
    """Return a number times 1 or -1, with the same digits; an empty cell stays empty."""
    if sign > 0 or not number:
        return number
    return number[1:] if number.startswith("-") else f"-{number.removeprefix('+')}"


def must_be_length(unit: str) -> None:
    """Raise UsageError unless a unit is one of length; it is empty if the user gave none."""
    known = list(units.suffixes("length"))
    if not unit:
        raise UsageError(f"the file does not state the unit of its lengths: give it by --unit, one of {listed(known)}")
    if unit not in known:
        raise UsageError(f"--unit {unit} is not a unit of length: {suggestion(unit, known)}")


NOTE = "# note: "
"""Begins a line of a CSV on what was left out"""


def to_csv(header: Sequence[str], rows: Iterable[Sequence[str]], origin: str, notes: Iterable[str] = ()) -> str:
    """Return the text of a CSV file; its first line names where it comes from, and notes follow."""
    text = io.StringIO()
    text.write(f"# {origin}\n")
    text.writelines(f"{NOTE}{note}\n" for note in notes)
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()
