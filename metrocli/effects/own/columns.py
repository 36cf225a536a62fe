"""Further columns of numbers in the files of the readings: variables of user-defined effects."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

from metrocli import units
from metrocli.effects.acting import Acting, Variable, measured
from metrocli.effects.effect import Effect
from metrocli.effects.own.definition import WORD
from metrocli.expressions.dimensions import Compound, compound
from metrocli.expressions.expression import CONSTANTS, FUNCTIONS
from metrocli.settings import TableFile

Numeric = Callable[[Path], Iterable[str]]
_TIME = "t"
_OTHER = re.compile(r"[^A-Za-z0-9_/%.]+")
"""What a heading has between its name and its unit if it is written as `load [kN]`"""


def variables(files: Iterable[tuple[Any, Sequence[Path]]], numeric: Numeric) -> tuple[Variable, ...]:
    """Return a variable for each further column of numbers in those files that hold readings.

    `files` are specifications with their paths; `numeric` returns the headings of the columns of numbers of a file.

    A heading such as `load_kg` is the variable `load` in kg; one that does not end in a unit is a plain number of the
    whole name. Of two headings with the same name only the first one is a variable.
    """
    by_name: dict[str, Variable] = {}
    for spec, paths in files:
        for heading in _headings(spec, chain.from_iterable(map(numeric, paths))) if _of_readings(spec) else ():
            name, unit = _taken_apart(heading)
            if WORD.fullmatch(name) and name not in (*FUNCTIONS, *CONSTANTS):
                by_name.setdefault(name, measured(name, heading, unit))
    return tuple(by_name.values())


def refused(files: Iterable[tuple[Any, Sequence[Path]]], numeric: Numeric) -> dict[str, str]:
    """Return the names of columns of numbers whose headings no expression can use, each with what to write.

    They are headings with other characters than letters, digits and `_`, and names of constants such as `pi`.
    """
    reasons: dict[str, str] = {}
    for spec, paths in files:
        for path in paths if _of_readings(spec) else ():
            for heading in _headings(spec, numeric(path)):
                name, unit = _words_of(heading)
                if name and (name in CONSTANTS or not WORD.fullmatch(heading)):
                    better = f"{'my_' if name in CONSTANTS else ''}{name}{unit}"
                    reasons.setdefault(name, f"row 1 of {path.name}: write the heading '{heading}' as {better}")
    return reasons


def _words_of(heading: str) -> tuple[str, str]:
    """Return the name that a heading means, and its unit as the end of a heading, such as `load` and `_kN`."""
    if WORD.fullmatch(heading):
        name, _ = _taken_apart(heading)
        return name, heading[len(name) :]
    name, _, rest = (part.strip() for part in _OTHER.sub(" ", heading).partition(" "))
    try:
        return name, f"_{rest}" if rest and compound(rest) else ""
    except units.QuantityError:
        return name, "_UNIT"


def with_variables(
    places: Iterable[Acting], more: Sequence[Variable], not_usable: Mapping[str, str] | None = None
) -> tuple[Acting, ...]:
    """Return the places with more variables; one that a place knows already by this name keeps its meaning.

    `not_usable` are names of columns that no expression can use, each with what to write.
    """
    return tuple(
        replace(
            place,
            variables=(*place.variables, *(each for each in more if each.name not in place.all_units())),
            refused=not_usable or {},
        )
        for place in places
    )


def reading(spec: Any, more: Iterable[Variable], effects: Iterable[Effect]) -> Any:
    """Return the specification of a file of which the further columns are read that the effects use."""
    if not _of_readings(spec):
        return spec
    needed = {need for effect in effects for need in effect.needs}
    further = tuple(need for column in more for need in column.needs if need in needed)
    return TableFile(replace(spec.columns, further=further)) if further else spec


def reading_all(spec: Any, more: Iterable[Variable]) -> Any:
    """Return the specification of a file of which all further columns are read whose cells are all numbers."""
    if not _of_readings(spec):
        return spec
    return TableFile(replace(spec.columns, tried=tuple(need for column in more for need in column.needs)))


def _of_readings(spec: Any) -> bool:
    """Return whether a file is a table of readings, or of what was noted when they were made."""
    if not isinstance(spec, TableFile):
        return False
    columns = spec.columns
    return bool(columns.measured) or any(column.name == _TIME for column in columns.columns)


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
