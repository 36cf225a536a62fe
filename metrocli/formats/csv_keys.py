"""Rows of a CSV file that have the same key."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from metrocli.copies import row_hashes
from metrocli.errors import Fault
from metrocli.formats.csv_text import Raw
from metrocli.table import Columns, Table

if TYPE_CHECKING:
    from collections.abc import Container

    from metrocli.table import Values


def repeated(raw: Raw, columns: Columns, values: dict[str, Values], without: Container[int | None]) -> list[Fault]:
    """Return a fault for each row that has the same key as an earlier row, but for the lines `without` a key."""
    names = [name for name in columns.key if name in values]
    if not names:
        return []
    if _all_different(Table({name: values[name] for name in names})):
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


def _all_different(keys: Table) -> bool:
    """Return whether no two rows have the same values in all columns; False also where chance gives equal numbers."""
    numbers = np.sort(row_hashes(keys, tuple(keys)))
    return bool((numbers[1:] != numbers[:-1]).all())
