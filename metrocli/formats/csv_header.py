"""What stands before the header of a CSV file: marks of editors and of Excel, and lines of an instrument."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise

MARKS = "\ufeff"
"""Byte order marks, which some editors write more than once; they are invisible"""
_SEPARATOR = re.compile(r'"?sep=(.)"?\s*', re.IGNORECASE)
"""A first line that names the separator of cells for Excel"""
_LOOKED_AT = 50
"""Lines in which a header is sought that is not the first line"""
_NUMBER = re.compile(r"[-+]?[0-9]*\.?[0-9]*(?:[eE][-+]?[0-9]+)?|[-+]?(?:inf|nan)", re.IGNORECASE)


def separator_of(line: str) -> str | None:
    """Return the separator that a line for Excel names, such as `sep=;`; None for any other line."""
    match = _SEPARATOR.fullmatch(line)
    return match[1] if match else None


def later_header(lines: Sequence[tuple[int, str]]) -> int | None:
    """Return the line of a header that follows lines of an instrument; None if the first line is the header.

    `lines` are those that are rows, with their numbers. A header has names only and no empty cell. It has as many cells
    as the row after it, and more than the first line.
    """
    # by the last lines: those of the instrument come first and have any marks
    separator = max(",;\t", key=lambda mark: sum(line.count(mark) for _, line in lines[-_LOOKED_AT:]))
    width = lines[-1][1].count(separator)
    for (number, line), (_, after) in pairwise(lines[1:_LOOKED_AT]):
        cells = line.split(separator)
        if line.count(separator) == after.count(separator) == width > lines[0][1].count(separator):
            return number if all(cell.strip() and not _NUMBER.fullmatch(cell.strip()) for cell in cells) else None
    return None


_DECIMAL_COMMA = re.compile(r"(?<![\d.])\d+,\d+(?![\d.])")


def has_decimal_comma(line: str) -> bool:
    """Return whether a row may have too many cells since a comma is its decimal sign; an empty end is not a number."""
    return bool(_DECIMAL_COMMA.search(line)) and not line.rstrip().endswith(",")
