"""The estimates of all results of a project as one table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from metrocli import units
from metrocli.errors import InputError
from metrocli.formats import hdf5
from metrocli.project.campaign import KEY
from metrocli.project.staleness import State
from metrocli.result import Estimate
from metrocli.table import Table

_OWN = ("job", "status", "up_to_date", "sigma0")


def table_of(states: Iterable[State]) -> Table:
    """Return a row for each job that has a result which can be believed.

    Columns: job, the columns of its list of parts, status, up_to_date (yes or no), sigma0, and for each estimate NAME
    and NAME.std; empty where a result has no such estimate. Where names meet, columns of the list are called for.NAME,
    estimates estimates.NAME. Raises InputError if there is no result.
    """
    rows: list[dict[str, str | float]] = []
    parts: list[Mapping[str, str]] = []
    known: dict[str, str] = {}
    for state in states:
        if state.label is None:
            continue
        result, record = hdf5.read(state.step.job.output)
        part = state.step.job.wishes.part
        parts.append(part.values if part else {})
        sigma0 = result.statistics.get("sigma0")
        row: dict[str, str | float] = {"job": state.step.name, "status": record.status}
        row |= {"up_to_date": "no" if state.reason else "yes"}
        row |= {"sigma0": float(sigma0)} if isinstance(sigma0, float | int) else {}
        for one in result.estimates:
            named = _named(one)
            row |= {named: one.value, f"{named}.std": one.std}
            known |= {named: one.unit, f"{named}.std": one.unit}
        rows.append(row)
    if not rows:
        raise InputError("the project has no results yet; run it first")
    names = dict.fromkeys(name for row in rows for name in row)
    taken = {*names, *(f"{name}_{units.suffix_of(known.get(name, ''))}" for name in names)}
    listed = {name: f"{KEY}.{name}" if name in taken else name for part in parts for name in part}
    columns = {"job": _column([row["job"] for row in rows])}
    columns |= {shown: _column([part.get(name) for part in parts]) for name, shown in listed.items()}
    columns |= {name: _column([row.get(name) for row in rows]) for name in names}
    return Table(columns, known)


def _named(one: Estimate) -> str:
    """Return the name of the column of an estimate, with its unit where a CSV has no ending for it."""
    name = one.name if one.unit in ("", "1") or units.suffix_of(one.unit) else f"{one.name} [{one.unit}]"
    return f"estimates.{name}" if name in _OWN else name


def _column(cells: Sequence[str | float | None]) -> np.ndarray:
    if any(isinstance(cell, str) for cell in cells):
        return np.array(["" if cell is None else str(cell) for cell in cells])
    return np.array([np.nan if cell is None else cell for cell in cells], dtype=float)
