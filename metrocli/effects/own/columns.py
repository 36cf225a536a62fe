"""Further columns of numbers in the files of the readings: variables of effects of one's own."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

from metrocli import units
from metrocli.effects.acting import Acting, Variable, measured
from metrocli.effects.effect import Effect
from metrocli.effects.own.names import WORD
from metrocli.expressions.dimensions import Compound, compound
from metrocli.expressions.expression import CONSTANTS, FUNCTIONS
from metrocli.settings import TableFile

Numeric = Callable[[Path], Iterable[str]]
_TIME = "t"


def variables(files: Iterable[tuple[Any, Sequence[Path]]], numeric: Numeric) -> tuple[Variable, ...]:
    """Return a variable for each further column of numbers in those files that hold readings.

    `files` are specifications with their paths; `numeric` returns the headings of the columns of numbers of a file.

    A heading such as `load_kg` is the variable `load` in kg; one that does not end in a unit is a plain number of the
    whole name. Of two headings with the same name only the first one is a variable.
    """
    found: dict[str, Variable] = {}
    for spec, paths in files:
        for heading in _headings(spec, chain.from_iterable(map(numeric, paths))) if _of_readings(spec) else ():
            name, unit = _taken_apart(heading)
            if WORD.fullmatch(name) and name not in (*FUNCTIONS, *CONSTANTS):
                found.setdefault(name, measured(name, heading, unit))
    return tuple(found.values())


def with_variables(places: Iterable[Acting], more: Sequence[Variable]) -> tuple[Acting, ...]:
    """Return the places with more variables; one that a place knows already by this name keeps its meaning."""
    return tuple(
        replace(one, variables=(*one.variables, *(each for each in more if each.name not in one.all_units())))
        for one in places
    )


def reading(spec: Any, more: Iterable[Variable], effects: Iterable[Effect]) -> Any:
    """Return the specification of a file of which the further columns are read that the effects use."""
    if not _of_readings(spec):
        return spec
    needed = {need for effect in effects for need in effect.needs}
    further = tuple(need for one in more for need in one.needs if need in needed)
    return TableFile(replace(spec.columns, further=further)) if further else spec


def reading_all(spec: Any, more: Iterable[Variable]) -> Any:
    """Return the specification of a file of which all further columns are read whose cells are all numbers."""
    if not _of_readings(spec):
        return spec
    return TableFile(replace(spec.columns, tried=tuple(need for one in more for need in one.needs)))


def _of_readings(spec: Any) -> bool:
    """Return whether a file is a table of readings, or of what was noted when they were made."""
    if not isinstance(spec, TableFile):
        return False
    columns = spec.columns
    return bool(columns.measured) or any(one.name == _TIME for one in columns.columns)


def _headings(spec: TableFile, there: Iterable[str]) -> Iterator[str]:
    """Yield the headings that the kind of job does not read itself."""
    own = {column.name for column in spec.columns.columns}
    return (heading for heading in there if not {heading, _taken_apart(heading)[0]} & own)


def _taken_apart(heading: str) -> tuple[str, Compound]:
    """Return the name and the unit of a heading."""
    name, _, suffix = heading.rpartition("_")
    if name and not suffix.isdigit():
        try:
            return name, compound(suffix)
        except units.QuantityError:
            pass
    return heading, compound("1")
