"""Readings that stand in a file twice: a block of rows that repeats another one value for value.

One measurement that counts twice makes every standard uncertainty too small, and no residual shows it. Equal single
readings are legitimate, because readings are rounded. A block is refused if chance does not explain it. With p the
share of pairs of rows with equal readings, n rows contain by chance `n^2 / 2 p^L` pairs of equal blocks of L rows.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from metrocli.errors import Fault
from metrocli.frozen import dataclass
from metrocli.table import Columns, Table
from metrocli.words import listed

Hashes = npt.NDArray[np.uint64]

_CELLS = 12
"""Fewest equal readings of a block"""
_ROWS = 3
"""Fewest rows of a block"""
_CHANCE = 1e-6
_MOST_ALIKE = 0.5
"""If more pairs of rows have equal readings, they are not readings that could be copied"""
_ODD = np.uint64(0x9E3779B97F4A7C15)
"""2^64 over the golden ratio: the factor of the hash"""


@dataclass(frozen=True)
class Copy:
    """A block of rows that repeats an earlier one."""

    first: int
    again: int
    rows: int


def faults(table: Table, columns: Columns) -> list[Fault]:
    """Return a fault for each group of rows, or else for each run of rows, that repeats another one."""
    measured = [name for name in columns.measured if name in table]
    if not measured or len(table) < 2 * _ROWS:
        return []
    readings = row_hashes(table, measured)
    rows = row_hashes(table, [name for name in (*columns.alike, *measured) if name in table])
    # of the readings alone: rows of other points or images with the same reading are chance as well
    alike = _share_alike(readings)
    if alike > _MOST_ALIKE:
        return []
    # a few equal readings are chance, however finely they are resolved (docs/decisions/054-copied-readings.md)
    least = max(_ROWS, -(-_CELLS // len(measured)))
    what = ", ".join(name for name in (*columns.alike, *measured) if name in table)
    hint = "one measurement that counts twice makes the uncertainty too small: remove the copy"
    names = list(_groups(table, columns, rows, least, alike))
    if names:
        return [table.fault(f"{text} (equal: {what})", hint) for text in names]
    run = first_run(rows, max(least, columns.fewest_copied, _by_chance(len(rows), alike)))
    if run is None:
        return []
    return [table.fault_at(run.again, f"{run.rows} rows repeat {_place(table, run)} (equal: {what})", hint)]


def _place(table: Table, run: Copy) -> str:
    if not table.lines:
        return f"row {run.first + 1} and those after it"
    return f"line {table.lines[run.first]} and those after it"


def row_hashes(table: Table, names: Sequence[str]) -> Hashes:
    """Return a number for each row that is equal for rows with equal values in these columns."""
    rows = np.zeros(len(table), dtype=np.uint64)
    for name in names:
        if name in table:
            # without it, (x, y) and (-x, -y) have one hash: their sign bits cancel
            rows = _mixed(rows * _ODD + _codes(table.columns[name]))
    return rows


def _codes(values: npt.NDArray[np.generic]) -> Hashes:
    if values.dtype.kind == "U":
        codes = np.zeros(len(values), dtype=np.uint64)
        for letter in np.ascontiguousarray(values).view(np.uint32).reshape(len(values), -1).T:
            codes = codes * _ODD + letter
        return codes
    bits: Hashes = (np.ascontiguousarray(values, dtype=np.float64) + 0.0).view(np.uint64)  # -0 is 0
    return bits


def _mixed(values: Hashes) -> Hashes:
    """Return well distributed numbers (the last steps of splitmix64, Steele et al. 2014)."""
    values = (values ^ (values >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ (values >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(values ^ (values >> np.uint64(31)))


def _share_alike(readings: Hashes) -> float:
    """Return the share of pairs of rows with equal readings, 1 if they hardly change."""
    # an instrument at rest repeats its reading: such rows count once
    values = readings[np.concatenate([[True], readings[1:] != readings[:-1]])]
    n = len(values)
    counts = np.unique(values, return_counts=True)[1]
    return float((counts * (counts - 1.0)).sum()) / (n * (n - 1.0)) if n >= 2 * _ROWS else 1.0


def _by_chance(blocks: int, alike: float) -> int:
    """Return the number of rows from which chance does not repeat a block, of so many blocks."""
    # each of n²/2 pairs of blocks repeats with alike^rows: rows such that their sum is below _CHANCE
    return int(np.ceil(np.log(2 * _CHANCE / blocks**2) / np.log(alike))) if alike > 0 else 0


def _groups(table: Table, columns: Columns, rows: Hashes, least: int, alike: float) -> list[str]:
    """Return a sentence for each set of groups (images, views, lines) with equal rows, in whatever order."""
    parts = [table.columns[name] for name in columns.group if name in table]
    if not parts:
        return []
    label = np.zeros(len(table), dtype=np.uint64)
    for part in parts:
        label = _mixed(label * _ODD + _codes(part))
    _, first, group, counts = np.unique(label, return_index=True, return_inverse=True, return_counts=True)
    sums = np.zeros(len(counts), dtype=np.uint64)
    # a sum, so that a copy with its rows in another order counts; mixed, since sums of like numbers are alike
    np.add.at(sums, group.ravel(), _mixed(rows))
    large = np.flatnonzero(counts >= max(least, _by_chance(len(counts), alike)))
    _, which, times = np.unique(sums[large], return_inverse=True, return_counts=True)
    names = [" ".join(str(part[row]) for part in parts) for row in first]
    what = " ".join(name for name in columns.group if name in table)
    return [
        f"{what} {listed([names[i] for i in sorted(large[which.ravel() == k], key=lambda i: first[i])])}: "
        "the readings are the same, value for value"
        for k in np.flatnonzero(times > 1)
    ]


def first_run(rows: Hashes, least: int) -> Copy | None:
    """Return the first run of at least `least` rows that repeats an earlier one, None without one.

    Rows that repeat the row before them (an instrument at rest) count once.
    """
    changes = np.flatnonzero(np.concatenate([[True], rows[1:] != rows[:-1]]))
    values = rows[changes]
    n = len(values)
    if n < 2 * least:
        return None
    window = np.zeros(n - least + 1, dtype=np.uint64)
    for k in range(least):
        # a hash that depends on the order: here a run has to repeat row by row
        window = window * _ODD + values[k : k + len(window)]
    ordered = np.sort(window)
    if (ordered[1:] != ordered[:-1]).all():  # as nearly always; to number them takes ten times as long
        return None
    _, first, inverse = np.unique(window, return_index=True, return_inverse=True)
    start = first[inverse.ravel()]
    # copies do not overlap: a reading that oscillates repeats itself one period later
    again = np.flatnonzero(np.arange(len(window)) - start >= least)
    if not again.size:
        return None
    b = int(again[0])
    a = int(start[b])
    equal = values[a : a + n - b] == values[b:]
    rows_equal = int(np.argmin(equal)) if not equal.all() else len(equal)
    return Copy(int(changes[a]), int(changes[b]), rows_equal)
