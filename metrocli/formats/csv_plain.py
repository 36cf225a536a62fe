"""The cells of a plain CSV file, taken apart as a whole; anything unusual is left to the reader that explains it."""

from __future__ import annotations

from collections.abc import Sequence

_UNUSUAL = ' "#\t\v\f\x1c\x1d\x1e\x1f'
"""Quotation marks, comments and white space of ASCII other than line ends; a separator is allowed"""


def plain_cells(lines: Sequence[str], first: int, separator: str, columns: int) -> tuple[Sequence[str], ...] | None:
    """Return the cells of each column of the lines from number `first` (from 0); None unless they are plain.

    Plain are lines of ASCII letters without quotation marks, comments and white space, none of them empty except the
    last, all with as many cells as there are columns.
    """
    end = len(lines) if lines[-1] else len(lines) - 1
    rows = lines[first:end]
    if not rows or "" in rows:
        return None
    text = separator.join(rows)
    if not text.isascii() or any(mark in text for mark in _UNUSUAL if mark != separator):
        return None
    # a row with a cell too many could make up for one with a cell too few
    if set(map(str.count, rows, [separator] * len(rows))) != {columns - 1}:
        return None
    flat = text.split(separator)
    return tuple(flat[k::columns] for k in range(columns))
