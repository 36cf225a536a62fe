"""Decimal numbers of many cells at once, each as `float` reads it, to the last bit."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from metrocli.arrays import Array, Mask

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
        one.sum(axis=0, dtype=np.uint8) for one in (is_digit, is_point, is_sign, columns > 0)
    )
    places, before = ((one * behind[:, None]).sum(axis=0, dtype=np.uint8) for one in (is_point, is_sign))
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
