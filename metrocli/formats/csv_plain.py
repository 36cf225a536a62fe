"""The cells of a plain CSV file, as places in an array of its letters; anything unusual is left to other readers.

Whole columns become texts or numbers at once, without a Python object for each cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import overload

import numpy as np
import numpy.typing as npt

from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass

_UNUSUAL = ' "#\t\v\f\x1c\x1d\x1e\x1f'
"""Quotation marks, comments and white space of ASCII other than line ends; a separator is allowed"""
_OF_NUMBERS = b"0123456789+-.eE\0"
"""Letters of decimal numbers, and the zero after a short one"""
_LONGEST = 30
"""Letters of the longest decimal number that is read here"""


@dataclass(frozen=True)
class PlainCells(Sequence[Sequence[str]]):
    """The cells of each column."""

    letters: npt.NDArray[np.uint8]
    """All letters of the rows, and before and behind them as many zeros as the longest cell has letters"""
    start: Index
    """First letter of each cell, (columns, rows)"""
    length: Index
    """Number of letters of each cell, (columns, rows)"""

    def __len__(self) -> int:
        return len(self.start)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return int(self.start.shape[1])

    @overload
    def __getitem__(self, column: int) -> list[str]: ...

    @overload
    def __getitem__(self, column: slice) -> list[list[str]]: ...

    def __getitem__(self, column: int | slice) -> list[str] | list[list[str]]:
        if isinstance(column, slice):
            return [self[k] for k in range(*column.indices(len(self)))]
        # one by one: an array would give each cell the place of the longest, however long that is
        text, start = self.letters.tobytes().decode("ascii"), self.start[column]
        ends = zip(start.tolist(), (start + self.length[column]).tolist(), strict=True)
        return [text[first:end] for first, end in ends]

    def texts(self, column: int) -> npt.NDArray[np.str_]:
        """Return the texts of a column, (rows,)."""
        # a letter of a numpy text has four bytes, so that a view of widened bytes is the text
        wide = self._letters(column).astype(np.uint32)
        return wide.view(f"U{wide.shape[1]}").ravel()

    def longest(self, column: int) -> int:
        """Return the number of letters of the longest cell of a column."""
        return int(self.length[column].max())

    def numbers(self, column: int) -> Array | None:
        """Return a column as numbers, (rows,); None unless all its cells are decimal numbers of usual length."""
        if self.longest(column) > _LONGEST or not self.length[column].all():
            return None
        values, sure = decimals(self._letters(column, at_end=True))
        if not sure.all():
            others = self._letters(column, ~sure)
            # translate drops the letters of numbers: whatever is left makes it no plain number ("nan", "0x1", "1_0")
            if others.tobytes().translate(None, _OF_NUMBERS):
                return None
            try:
                values[~sure] = others.view(f"S{others.shape[1]}").ravel().astype(float)
            except ValueError:
                return None
        return values

    def _letters(self, column: int, rows: slice | Mask = slice(None), at_end: bool = False) -> npt.NDArray[np.uint8]:
        """Return the letters of cells of a column, with zeros behind a short one or before it, (rows, letters)."""
        width, start, length = max(self.longest(column), 1), self.start[column, rows], self.length[column, rows]
        windows = np.lib.stride_tricks.sliding_window_view(self.letters, width)
        letters: npt.NDArray[np.uint8] = windows[start + length - width if at_end else start]
        if (length != width).any():
            place = np.arange(width)
            letters *= (place[::-1] if at_end else place) < length[:, None]
        return letters


def plain_cells(rows: str, separator: str, columns: int) -> PlainCells | None:
    """Return the cells of the rows of a file, which are all that follows its header; None unless they are plain.

    Plain are rows of ASCII letters without quotation marks, comments and white space, none of them empty, all with as
    many cells as there are columns.
    """
    if not rows.isascii() or any(mark in rows for mark in _UNUSUAL if mark != separator):
        return None
    whole = rows if rows.endswith("\n") else rows + "\n"
    letters = np.frombuffer(whole.encode("ascii"), dtype=np.uint8)
    line_ends = letters == ord("\n")
    ends = np.flatnonzero(line_ends | (letters == ord(separator)))
    # a row with a cell too many could make up for one with a cell too few
    last = line_ends[ends[columns - 1 :: columns]]
    if len(ends) % columns or not last.all() or len(last) != np.count_nonzero(line_ends):
        return None
    start = np.append(0, ends[:-1] + 1)
    length = ends - start
    if columns == 1 and not length.all():  # an empty row, which has too few cells in any other table
        return None
    # windows of the longest cell reach beyond the first and the last letter
    longest = int(length.max())
    padded = np.pad(letters, longest)
    return PlainCells(padded, start.reshape(-1, columns).T + longest, length.reshape(-1, columns).T)


_ROWS = 8192
"""Cells that are read at once, which stay in the cache"""
_HALF, _DIGITS = 10, 18
"""Letters whose digits are summed at once, and most digits of a cell: with a zero for the point they are below 2^64"""
_TIE = 0x400
"""Last 11 of 64 bits of a number in the middle between two of 53 bits"""


def decimals(letters: npt.NDArray[np.uint8]) -> tuple[Array, Mask]:
    """Return the numbers of cells, and which are sure, from their letters with zeros in front, (n, letters).

    Digits with at most one point are a whole number divided by a power of ten, both exact in 64 bits. Their quotient
    is rounded to 64 bits and then to 53: as at once, unless the first rounding ends in the middle between two numbers.
    Such cells are not sure, and no other notation is, nor any cell where the machine has no numbers of 64 bits.
    """
    values, sure = np.zeros(len(letters)), np.zeros(len(letters), dtype=bool)
    if np.finfo(np.longdouble).nmant != 63 or np.dtype(np.longdouble).itemsize != 16:
        return values, sure
    for start in range(0, len(letters), _ROWS):
        part = slice(start, start + _ROWS)
        values[part], sure[part] = _quotients(letters[part])
    return values, sure


def _quotients(letters: npt.NDArray[np.uint8]) -> tuple[Array, Mask]:
    """Return the numbers of some cells, and which are sure."""
    columns = np.ascontiguousarray(letters.T)
    digit = columns - np.uint8(ord("0"))  # beyond 9 for any other letter
    is_digit, is_point, is_minus = digit < 10, columns == ord("."), columns == ord("-")
    is_sign = is_minus | (columns == ord("+"))
    digit *= is_digit
    behind = np.arange(len(columns), dtype=np.uint8)[::-1]
    digits, points, signs, used = (
        marks.sum(axis=0, dtype=np.uint8) for marks in (is_digit, is_point, is_sign, columns > 0)
    )
    places, before = ((marks * behind[:, None]).sum(axis=0, dtype=np.uint8) for marks in (is_point, is_sign))
    sure = (digits + points + signs == used) & (digits > 0) & (digits <= _DIGITS) & (points < 2) & (signs < 2)
    sure &= (signs == 0) | (before + 1 == used)
    # the sums of digits of each half are below 2^53, and so exact
    weights = 10.0 ** (behind % _HALF) * (np.stack([behind < _HALF, behind >= _HALF]))
    low, high = (weights @ digit).astype(np.uint64)
    written = high * _POWERS[_HALF] + low
    # the point stands as a zero: what is before it is ten times too large
    front = written // _POWERS.take(np.where(points > 0, places + 1, _DIGITS + 1), mode="clip")
    written -= 9 * front * _POWERS.take(places, mode="clip")
    quotients = written.astype(np.longdouble) / _POWERS.astype(np.longdouble).take(places, mode="clip")
    # the 64 bits come first in the 16 bytes of a number
    sure &= (quotients.view(np.uint64)[::2] & np.uint64(0x7FF)) != _TIE
    values = quotients.astype(float)
    np.negative(values, out=values, where=is_minus.any(axis=0))
    return values, sure


_POWERS = np.array([10**k for k in range(_DIGITS + 2)], dtype=np.uint64)
