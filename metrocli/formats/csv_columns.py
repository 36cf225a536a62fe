"""The header of a CSV file and the columns that are wanted: their places and units, what is missing or unused."""

from __future__ import annotations

import re
from collections.abc import Sequence

from metrocli import units
from metrocli.errors import Fault
from metrocli.formats.csv_text import Raw
from metrocli.table import NUMBER, TEXT, WHOLE, Column, Columns
from metrocli.words import nearest


def has_unit(column: Column) -> bool:
    """Return whether the name of a column ends in a unit."""
    return column.dimension not in (TEXT, WHOLE, NUMBER)


def columns_in_header(raw: Raw, columns: Columns) -> tuple[dict[str, tuple[int, units.Unit | None]], list[Fault]]:
    """Return for each wanted column its index in the file and its unit, and the faults of the header."""
    faults = [
        raw.fault(f"the column '{name}' is there twice" if name else "a column has no name", raw.header_line, index)
        for index, name in enumerate(raw.header)
        if not name or name in raw.header[:index]
    ]
    places: dict[str, tuple[int, units.Unit | None]] = {}
    for column in columns.columns:
        forms = _forms(column)
        present = [name for name in forms if name in raw.header]
        if len(present) == 1:
            places[column.name] = (raw.header.index(present[0]), forms[present[0]])
        elif present:
            at = raw.header.index(present[1])
            message = f"two columns hold the same quantity: {' and '.join(present)}"
            faults.append(raw.fault(message, raw.header_line, at, "keep one of them"))
        else:
            faults.extend(_absent(raw, column, tuple(forms), columns))
    return places, faults


def _forms(column: Column) -> dict[str, units.Unit | None]:
    """Return the names that a column may have in a file, each with the unit it stands for."""
    if not has_unit(column):
        return {column.name: None}
    return {f"{column.name}_{suffix}": unit for suffix, unit in units.suffixes(column.dimension).items()}


def _absent(raw: Raw, column: Column, forms: tuple[str, ...], columns: Columns) -> list[Fault]:
    """Return the fault of a column that was not found: no unit, a wrong unit, misspelt, or missing."""
    accepted = f"accepted: {', '.join(forms)}"
    others = {c.name for c in columns.columns}
    for index, name in enumerate(raw.header):
        if has_unit(column) and name == column.name:
            return [raw.fault(f"the column '{name}' has no unit", raw.header_line, index, accepted)]
        spelt = re.fullmatch(rf"{re.escape(column.name)}\s*[_\[(/ ]\s*(.+?)[\])]?", name)
        if spelt and has_unit(column) and spelt[1] not in others and name not in others and _is_unit(spelt[1]):
            if units.is_inch(spelt[1]):
                hint = f"write {column.name}_mm, with the numbers times {units.INCH}; {accepted}"
                message = f"the column '{name}' is in inches, which files cannot use"
                return [raw.fault(message, raw.header_line, index, hint)]
            phrase = units.DIMENSIONS[column.dimension].phrase
            message = f"the column '{name}' does not name {phrase} with an accepted unit"
            return [raw.fault(message, raw.header_line, index, accepted)]
    if not column.required:
        return []
    taken = {form for other in columns.columns for form in _forms(other)} - {column.name}
    stems = {_split(name)[0]: name for name in raw.header if name not in taken and _may_be(column, _split(name)[1])}
    near = nearest(column.name, stems)
    hint = f"is it the column '{stems[near]}'? {accepted}" if near else accepted
    return [raw.fault(f"the column '{forms[0]}' is missing", raw.header_line, None, hint)]


def _split(name: str) -> tuple[str, str]:
    """Return the name of a column without its unit, and the unit, or ""."""
    stem, _, unit = name.rpartition("_")
    return (stem, unit) if stem and _is_unit(unit) else (name, "")


def _may_be(column: Column, unit: str) -> bool:
    return not unit or (has_unit(column) and unit in units.suffixes(column.dimension))


def _is_unit(text: str) -> bool:
    known = (suffix for dimension in units.DIMENSIONS for suffix in units.suffixes(dimension))
    plain = units.plain_symbol(text)
    return (
        plain in known
        or units.is_inch(plain)
        or any(plain in dimension.symbols for dimension in units.DIMENSIONS.values())
    )


def unused(raw: Raw, columns: Columns, places: dict[str, tuple[int, units.Unit | None]]) -> tuple[str, ...]:
    """Return a warning for each column of the file that is not used, with the one that is probably meant."""
    used = {index for index, _ in places.values()}
    wanted = [column for column in columns.columns if column.name not in places]
    names = [name for index, name in enumerate(raw.header) if index not in used]
    ask = {name: _meant(name, wanted) for name in names}
    # without the line and sorted: comments and the order of columns are not a change of a table
    return tuple(f"{raw.file}: the column '{name}' is not used{ask[name]}" for name in sorted(names))


def _meant(name: str, wanted: Sequence[Column]) -> str:
    """Return the question whether an unused column is a wanted one, in its own unit or in the usual one."""
    stem, unit = _split(name)
    forms = {column.name: tuple(_forms(column)) for column in wanted if _may_be(column, unit)}
    near = nearest(stem, forms)
    return f"; did you mean '{f'{near}_{unit}' if unit else forms[near][0]}'?" if near else ""
