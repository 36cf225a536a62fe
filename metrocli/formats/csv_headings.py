"""Headings of the columns of a CSV file that hold numbers, found in its first rows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from metrocli.errors import InputError
from metrocli.formats.csv_text import taken_apart

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
        text = head.decode("utf-8-sig", errors="replace").replace("\r\n", "\n").replace("\r", "\n")
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
