"""Further columns of numbers in the files of the readings: variables of effects of one's own."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

from metrocli import units
from metrocli.effects.acting import Acting, Variable, measured
from metrocli.effects.effect import Effect
from metrocli.expressions.dimensions import Compound, compound
from metrocli.formats.csv_headings import numeric
from metrocli.project.named_files import Input
from metrocli.settings import TableFile

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_TIME = "t"


def variables(inputs: Iterable[Input]) -> tuple[Variable, ...]:
    """Return a variable for each further column of numbers in the files of the readings.

    A heading such as `load_kg` is the variable `load` in kg; one that does not end in a unit is a plain number of the
    whole name. Of two headings with the same name only the first one is a variable.
    """
    found: dict[str, Variable] = {}
    for item in inputs:
        for heading in _headings(item) if _of_readings(item) else ():
            name, unit = _taken_apart(heading)
            if _NAME.fullmatch(name):
                found.setdefault(name, measured(name, heading, unit))
    return tuple(found.values())


def with_variables(places: Iterable[Acting], more: Sequence[Variable]) -> tuple[Acting, ...]:
    """Return the places with more variables; one that a place knows already by this name keeps its meaning."""
    return tuple(
        replace(one, variables=(*one.variables, *(each for each in more if each.name not in one.all_units())))
        for one in places
    )


def reading(item: Input, more: Iterable[Variable], effects: Iterable[Effect]) -> Input:
    """Return an input of which the further columns are read that the effects use."""
    if not _of_readings(item):
        return item
    needed = {need for effect in effects for need in effect.needs}
    further = tuple(need for one in more for need in one.needs if need in needed)
    columns = replace(item.spec.columns, further=further)
    return replace(item, spec=TableFile(columns)) if further else item


def _of_readings(item: Input) -> bool:
    """Return whether an input is a table of readings, or of what was noted when they were made."""
    if not isinstance(item.spec, TableFile):
        return False
    columns = item.spec.columns
    return bool(columns.measured) or any(one.name == _TIME for one in columns.columns)


def _headings(item: Input) -> Iterable[str]:
    """Yield the headings of columns of numbers that the kind of job does not read itself."""
    own = {column.name for column in item.spec.columns.columns}
    for path in item.paths:
        for heading in numeric(path):
            if not {heading, heading.rpartition("_")[0]} & own:
                yield heading


def _taken_apart(heading: str) -> tuple[str, Compound]:
    """Return the name and the unit of a heading."""
    name, _, suffix = heading.rpartition("_")
    if name and not suffix.isdigit():
        try:
            return name, compound(suffix)
        except units.QuantityError:
            pass
    return heading, compound("1")
