"""Readings of a type A evaluation that stand twice: in one column, or under two quantities.

A series is short and its readings are rounded, so equal ones are common. With the resolution r and the standard
deviation s of a series, two readings are equal by chance with `p = r / (2 sqrt(pi) s)`: the density of the difference
of two normal variables at 0. A run of L of n readings repeats by chance in `n^2 / 2 p^L` places.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from metrocli.copies import first_run, row_hashes
from metrocli.errors import Fault
from metrocli.table import Table

Array = npt.NDArray[np.float64]

_FEWEST = 3
"""Fewest readings of a run"""
_COARSE = 0.5
"""Share of equal readings from which a series is too coarse to be judged"""
_DECIMALS, _WHOLE, _ROUNDING = 16, 1e13, 2e-15
"""Most decimals of a reading, largest whole number that is compared, and relative rounding of a double in it"""
_UNLIKELY, _REFUSED = 1e-3, 1e-6
"""Chance below which a run is reported, and below which it is refused as in all other files of readings"""


def repeated(name: str, table: Table, column: str) -> Fault | str | None:
    """Return a fault, or a warning, for a run of readings that repeats an earlier one; None without one."""
    values = table.numbers(column)
    alike = _alike(values)
    pairs = len(values) ** 2 / 2
    if not 0 < alike < 1:
        return None
    least = max(_FEWEST, math.ceil(math.log(_UNLIKELY / pairs) / math.log(alike)))
    run = first_run(row_hashes(table, (column,)), least)
    if run is None:
        return None
    said = f"{run.rows} readings of '{name}' repeat {_place(table, run.first)} and those after it, value for value"
    why = "one measurement that counts twice makes the uncertainty too small: remove the copy"
    if pairs * alike**run.rows < _REFUSED:
        return table.fault_at(run.again, said, why)
    return f"{table.file}: {said}; {why}"


def same(first: Array, second: Array) -> bool:
    """Return whether two series are equal value for value, and not by chance."""
    return np.array_equal(first, second) and len(first) >= _FEWEST and _alike(first) ** len(first) < _UNLIKELY


def _alike(values: Array) -> float:
    """Return the chance that two readings are equal, 1 for a series without spread.

    Of readings that differ from the one before them more are equal: `p / (1 - p)` bounds their share.
    """
    step = _resolution(values)
    if step == 0:
        return 1.0
    p = step / (2 * math.sqrt(math.pi) * float(values.std(ddof=1)))
    return p / (1 - p) if p < _COARSE else 1.0


def _resolution(values: Array) -> float:
    """Return the largest step of which all differences are multiples, 0 for a series without spread."""
    distinct = np.unique(values)
    steps = np.diff(distinct)
    if not len(steps):
        return 0.0
    for decimals in range(_DECIMALS):
        whole = distinct * 10.0**decimals
        largest = np.abs(whole).max()
        if largest > _WHOLE:
            break
        if np.abs(whole - np.rint(whole)).max() <= _ROUNDING * largest:
            return float(np.gcd.reduce(np.diff(np.rint(whole)).astype(np.int64))) / 10.0**decimals
    return float(steps.min())


def _place(table: Table, row: int) -> str:
    return f"line {table.lines[row]}" if table.lines else f"row {row + 1}"
