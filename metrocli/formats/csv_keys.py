"""Rows of a CSV file that have the same key."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from metrocli.errors import Fault
from metrocli.formats.csv_text import Raw
from metrocli.table import Columns

if TYPE_CHECKING:
    from collections.abc import Container

    from metrocli.table import Values

_BLOCK = 100_000
"""Rows that are taken from an array at once as values of Python, which need much memory"""


def repeated(raw: Raw, columns: Columns, values: dict[str, Values], without: Container[int | None]) -> list[Fault]:
    """Return a fault for each row that has the same key as an earlier row, but for the lines `without` a key."""
    names = [name for name in columns.key if name in values]
    if not names:
        return []
    if _all_different([values[name] for name in names]):
        return []
    keys = list(zip(*(values[name].tolist() for name in names), strict=True))
    first: dict[tuple[object, ...], int] = {}
    faults = []
    for row, key in enumerate(keys):
        if raw.numbers[row] in without:
            continue
        if key in first:
            said = ", ".join(f"{name} {value}" for name, value in zip(names, key, strict=True))
            faults.append(raw.fault(f"{said}: a second row", raw.numbers[row], None, f"first in line {first[key]}"))
        else:
            first[key] = raw.numbers[row]
    return faults


def _all_different(keys: list[Values]) -> bool:
    """Return whether no two rows have the same values in all columns; False also if there are too many values."""
    code, kinds = np.zeros(len(keys[0]), dtype=np.int64), 1
    for column in keys:
        numbers: dict[object, int] = {}
        number = np.empty(len(code), dtype=np.int64)
        for at in range(0, len(code), _BLOCK):
            block = column[at : at + _BLOCK].tolist()
            for value in dict.fromkeys(block):
                numbers.setdefault(value, len(numbers))
            number[at : at + _BLOCK] = np.fromiter(map(numbers.__getitem__, block), dtype=np.int64, count=len(block))
        code = code * len(numbers) + number
        kinds *= len(numbers)
    return kinds < 1 << 62 and bool((np.diff(np.sort(code)) > 0).all())
