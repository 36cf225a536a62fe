"""Readings of the views, matched to views and balls; every row without a match is reported."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.arrays import Array, Index, Mask
from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.instruments.ball_grid import View
from metrocli.table import Table
from metrocli.words import suggestion

_MOST = 20


@dataclass(frozen=True)
class GridReadings:
    """The readings of the machine, row by row."""

    views: tuple[View, ...]
    """Those that have readings"""
    view: Index
    """View of each reading (n,)"""
    balls: Index
    """Ball of each reading (n, 3)"""
    values: Array
    """(n, 3) [mm]"""
    table: Table

    def at(self, view: int) -> Mask:
        """Return the readings of a view, (n,)."""
        return np.asarray(self.view == view)


def read(views: Sequence[View], half: Index, table: Table) -> GridReadings:
    """Return the rows matched to views and balls; raises InputError with every row that has no match."""
    names = [view.name for view in views]
    written = table.texts("view")
    balls = np.asarray(np.rint(table.stacked("ijk")), dtype=np.intp)
    outside = np.flatnonzero((np.abs(balls) > half).any(axis=1)).tolist()
    faults = [
        table.fault_at(row, f"view '{written[row]}' is not among the job's views", suggestion(written[row], names))
        for row in [row for row, name in enumerate(written) if name not in names][:_MOST]
    ]
    sizes = " x ".join(str(2 * n + 1) for n in half)
    limits = ", ".join(f"{name} from {-n} to {n}" for name, n in zip("ijk", half.tolist(), strict=True))
    first = _counted_from(balls, half)
    if first is not None:
        faults.append(Fault(f"i, j, k count from {first}; they count from the middle ball", table.file, hint=limits))
        outside = []
    faults += [
        table.fault_at(row, f"ball ({_ball(balls[row])}) is outside the grid of {sizes}", f"{limits}")
        for row in outside[:_MOST]
    ]
    if faults:
        raise InputError(sorted(faults, key=lambda fault: fault.line or 0)[:_MOST])
    read = set(written)
    used = [view for view in views if view.name in read]
    place = {view.name: n for n, view in enumerate(used)}
    at = np.array([place[name] for name in written], dtype=np.intp)
    return GridReadings(tuple(used), at, balls, table.stacked("xyz"), table)


def _counted_from(balls: Index, half: Index) -> int | None:
    """Return 0 or 1 if all indices count from there in a grid of this size, else None."""
    for first in (0, 1):
        if np.array_equal(balls.min(axis=0), np.full(3, first)) and np.array_equal(balls.max(axis=0), first + 2 * half):
            return first if half.any() else None
    return None


def _ball(ball: Index) -> str:
    return ", ".join(map(str, ball.tolist()))


def ball_name(ball: Index) -> str:
    """Return 'ball (1, 0, -2)'."""
    return f"ball ({_ball(ball)})"
