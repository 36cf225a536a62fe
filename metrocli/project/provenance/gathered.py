"""The estimates of all results of a project as one table."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from metrocli import units
from metrocli.errors import InputError
from metrocli.formats import hdf5
from metrocli.project.staleness import State
from metrocli.table import Table


def table_of(states: Iterable[State]) -> Table:
    """Return a row for each job that has a result which can be believed.

    Columns: job, the columns of its list of parts, status, up_to_date (yes or no), sigma0, and for each estimate NAME
    and NAME.std; empty where a result has no such estimate. Raises InputError if there is no result.
    """
    rows: list[dict[str, str | float]] = []
    known: dict[str, str] = {}
    for state in states:
        if state.label is None:
            continue
        result, record = hdf5.read(state.step.job.output)
        part = state.step.job.wishes.part
        row: dict[str, str | float] = {"job": state.step.name, **(part.values if part else {})}
        row |= {"status": record.status, "up_to_date": "no" if state.reason else "yes"}
        sigma0 = result.statistics.get("sigma0")
        row |= {"sigma0": float(sigma0)} if isinstance(sigma0, float | int) else {}
        for one in result.estimates:
            named = one.name if one.unit in ("", "1") or units.suffix_of(one.unit) else f"{one.name} [{one.unit}]"
            row |= {named: one.value, f"{named}.std": one.std}
            known |= {named: one.unit, f"{named}.std": one.unit}
        rows.append(row)
    if not rows:
        raise InputError("the project has no results yet; run it first")
    names = dict.fromkeys(name for row in rows for name in row)
    return Table({name: _column([row.get(name) for row in rows]) for name in names}, known)


def _column(cells: list[str | float | None]) -> np.ndarray:
    if any(isinstance(cell, str) for cell in cells):
        return np.array(["" if cell is None else str(cell) for cell in cells])
    return np.array([np.nan if cell is None else cell for cell in cells], dtype=float)
