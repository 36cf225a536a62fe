"""Columns of weather in another unit: whole, or in the rows of one source, as the air of one hall never is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import numpy as np

from metrocli.arrays import Array, Mask
from metrocli.diagnosis.corrections import ROWS, Mistake, parts
from metrocli.frozen import dataclass
from metrocli.table import Table
from metrocli.tasks.job import Job
from metrocli.units import DIMENSIONS, Unit, suffixes
from metrocli.words import in_a_row


@dataclass(frozen=True)
class Sort:
    """What is usual of one sort of weather, in internal units."""

    dimension: str
    usual: float
    within: float
    """Air farther from the usual than this is reported, if another unit brings it near"""
    alike: float
    """Air of one job differs by less"""
    near: float
    """Rows in another unit, brought into the right one, differ from the others by less"""
    foreign: tuple[Unit, ...]
    """Units that files cannot use"""


SORTS = {
    "temp": Sort("temperature", 20.0, 40.0, 20.0, 5.0, (Unit("degF", over=1.8, offset=-32 / 1.8),)),
    "pressure": Sort(
        "pressure", 1000.0, 500.0, 100.0, 30.0, (Unit("mmHg", 1.333223684), Unit("inHg", 33.86389))
    ),
}  # fmt: skip
"""By column"""


@dataclass(frozen=True)
class Odd:
    """Weather that is far from that of the other rows, or from the usual, unless it is in another unit."""

    column: str
    where: str
    """Heading and rows in words"""
    rows: Mask
    values: Array
    """The column in the unit that is meant, in internal units"""
    unit: str
    """The unit that is meant"""
    size: str
    """Its value as it stands, and in the other unit"""


def odd_weather(table: Table) -> Iterator[Odd]:
    """Yield the columns of weather in another unit: in the rows of some sources or of one size, or as a whole."""
    for name, sort in SORTS.items():
        if name not in table or not len(table):
            continue
        values, every = table.numbers(name), np.ones(len(table), dtype=bool)
        by_unit = dict[Unit, tuple[list[str], Mask]]()
        for where, rows in parts(table, np.abs(values)):
            others = float(np.median(values[~rows]))
            unit = _meant(table, name, values[rows], others, (sort.alike, sort.near))
            if unit is None:
                continue
            places, covered = by_unit.get(unit, ([], ~every))
            # rows of one size are often those of the sources before
            if (rows & ~covered).any():
                by_unit[unit] = [*places, where], covered | rows
        whole = None if by_unit else _meant(table, name, values, sort.usual, (sort.within, sort.within / 2))
        if whole is not None:
            by_unit[whole] = [], every
        for unit, (places, rows) in by_unit.items():
            yield _odd(table, name, rows, in_a_row(places), unit)


def in_another_unit(table: Table, name: str, value: float) -> str:
    """Return in words that a value is usual in another unit; empty if it is not."""
    sort = SORTS.get(name)
    unit = _meant(table, name, np.array([value]), sort.usual, (sort.within, sort.within / 2)) if sort else None
    if unit is None:
        return ""
    return f"{_in_both_units(table, name, value, unit)}: look at the unit of {_heading(table, name)}"


def remarks(table: Table) -> Iterator[str]:
    """Yield a warning of each column that is in another unit."""
    for odd in odd_weather(table):
        yield f"{table.file}: {odd.where} seems to be in {odd.unit}: {odd.size}"


def other_weather(job: Job[Any, Any], fits: bool = False) -> Iterator[tuple[Mistake, Job[Any, Any]]]:
    """Yield the weather that is in another unit, of some sources or of all, with the job that is right then."""
    if job.settings.environment is None:
        return
    tables = [(each.name, getattr(job.files, each.name)) for each in fields(job.files)]
    for key, table in tables:
        for odd in odd_weather(table) if isinstance(table, Table) else ():
            words, write = f"{odd.where} is in {odd.unit}", f"{odd.where} in the unit of the heading"
            mistake = Mistake(key, words, write, file=table.file, sort=ROWS)
            yield mistake, job.with_files(**{key: table.changed({odd.column: odd.values})})


def _odd(table: Table, name: str, rows: Mask, where: str, unit: Unit) -> Odd:
    values = table.numbers(name)
    right = np.where(rows, unit.array_inside(_as_written(table, name, values)), values)
    size = _in_both_units(table, name, float(np.median(values[rows])), unit)
    return Odd(name, f"{_heading(table, name)} {where}".rstrip(), rows, right, unit.symbol, size)


def _meant(table: Table, name: str, values: Array, others: float, limits: tuple[float, float]) -> Unit | None:
    """Return the unit in which values far from others are near these."""
    far, near = limits
    if abs(float(np.median(values)) - others) <= far:
        return None
    sort, written = SORTS[name], float(np.median(_as_written(table, name, values)))
    units = (*DIMENSIONS[sort.dimension].units, *sort.foreign)
    best = min(units, key=lambda unit: abs(unit.inside(written) - others))
    return best if abs(best.inside(written) - others) < near else None


def _in_both_units(table: Table, name: str, value: float, unit: Unit) -> str:
    """Return a value in the unit of the heading, and what it is if it is in another."""
    written = float(_as_written(table, name, np.array([value]))[0])
    internal = DIMENSIONS[SORTS[name].dimension].unit
    size = "usual" if unit.symbol == internal else f"{unit.inside(written):.4g} {internal}"
    return f"{written:.6g} {_unit(table, name).symbol} is read, and {written:.6g} {unit.symbol} are {size}"


def _as_written(table: Table, name: str, values: Array) -> Array:
    unit = _unit(table, name)
    return (values - unit.offset) * unit.over / unit.times


def _unit(table: Table, name: str) -> Unit:
    return suffixes(SORTS[name].dimension)[_heading(table, name).removeprefix(f"{name}_")]


def _heading(table: Table, name: str) -> str:
    return table.headings.get(name, f"{name}_{DIMENSIONS[SORTS[name].dimension].unit}")
