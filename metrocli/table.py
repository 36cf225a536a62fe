"""Tables of named columns, and the description of the columns that a reader expects in a CSV file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from typing import TYPE_CHECKING, Any

from metrocli.arrays import Array, Bytes, Index, Mask, Texts, Values
from metrocli.errors import Fault
from metrocli.frozen import dataclass

if TYPE_CHECKING:
    from metrocli.units import Range

TEXT, WHOLE, NUMBER = "text", "whole", "number"
"""Dimensions of columns without a unit; every other dimension is a name in `metrocli.units.DIMENSIONS`."""

MOST_FAULTS = 20
"""Most faults of one kind that are listed one by one; the rest is only counted"""


@dataclass(frozen=True)
class Column:
    """A column that a reader looks for: its name without unit and its dimension; the file chooses the unit."""

    name: str
    dimension: str = NUMBER
    required: bool = True
    may_be_empty: bool = False
    """An empty cell is read as NaN instead of being a fault."""
    allowed: Range | None = None
    """What its values can be, in the internal unit; that of its dimension (`metrocli.units.range_of`) unless given."""


def columns(*headings: str, allowed: Range | None = None) -> tuple[Column, ...]:
    """Return columns from headings such as `"x y z [length]"`, `"t? [time]"` or `"surface* [text]"`: names, dimension.

    A column with `?` may be absent, cells of one with `*` may be empty. Without a dimension there are plain numbers.
    """
    declared = []
    for heading in headings:
        names, _, dimension = heading.removesuffix("]").partition(" [")
        for name in names.split(" "):
            declared.append(Column(name.rstrip("?*"), dimension or NUMBER, "?" not in name, "*" in name, allowed))
    return tuple(declared)


@dataclass(frozen=True)
class Columns:
    """The columns of one kind of file."""

    columns: tuple[Column, ...]
    key: tuple[str, ...] = ()
    """Names of columns whose combination must be different in each row."""
    description: str = ""
    measured: tuple[str, ...] = ()
    """Names of columns with readings: no block of rows may repeat them from another one (`metrocli/copies.py`)."""
    alike: tuple[str, ...] = ()
    """Names of columns that are equal too in a copied block, such as the target; all others may differ."""
    group: tuple[str, ...] = ()
    """Names of columns that name a block: the image, the view."""
    fewest_copied: int = 0
    """Fewest rows of a copied block, where an instrument at rest repeats its readings"""
    further: tuple[str, ...] = ()
    """Headings of further columns of numbers, which user-defined effects use: read as they are, without conversion."""
    tried: tuple[str, ...] = ()
    """Headings of columns that are read as further ones if every cell is a number: laws are sought in them."""
    every: bool = False
    """Read every column under its full name: as numbers, or as text if any cell is not a number."""


@dataclass(frozen=True)
class Table:
    """Columns of equal length in internal units (mm, rad, s, px, degC, ...), with file and lines for messages."""

    columns: Mapping[str, Values]
    units: Mapping[str, str] = field(default_factory=dict)
    """Internal unit of each column that has one; text and counts have none."""
    file: str = ""
    lines: Sequence[int] = ()
    """Line number in the file of each row, for messages."""
    headings: Mapping[str, str] = field(default_factory=dict)
    """Name of each column as the file has it, with its unit."""
    warnings: tuple[str, ...] = ()
    """Remarks of the reader that are not faults, such as an unused column."""
    further: tuple[str, ...] = ()
    """Headings of its further columns, on which user-defined effects depend."""
    _lists: dict[str, list[str]] = field(default_factory=dict, init=False, repr=False, compare=False)
    """Text columns as lists, once they are asked for"""

    @classmethod
    def of(cls, columns: Mapping[str, Any]) -> Table:
        """Return a table of columns under headings such as `"x y z [mm]"`: names, and the unit that all of them have.

        Several names stand over the columns of one array (rows, names). Texts that may be none have the unit `[text]`.
        """
        return cls({}).joined(columns)

    @classmethod
    def of_rows(cls, headings: Sequence[str], rows: Iterable[Sequence[Any]]) -> Table:
        """Return a table of rows, each with a value for every heading as in `of`; a heading has one name."""
        columns = list(zip(*rows, strict=True)) or [()] * len(headings)
        return cls.of(dict(zip(headings, columns, strict=True)))

    @classmethod
    def stack(cls, parts: Sequence[Table]) -> Table:
        """Return the rows of tables with the same columns, one table after the other."""
        import numpy as np

        return cls({name: np.concatenate([part.columns[name] for part in parts]) for name in parts[0]}, parts[0].units)

    def joined(self, columns: Mapping[str, Any]) -> Table:
        """Return the table with further columns, or others in place of its own, under headings as in `of`."""
        import numpy as np

        merged, units = dict(self.columns), dict(self.units)
        for heading, values in columns.items():
            names, _, unit = heading.removesuffix("]").partition(" [")
            array = np.asarray(values, dtype=str if unit == TEXT else None)
            several = names.split(" ")
            for name, column in zip(several, array.T if len(several) > 1 else [array], strict=True):
                merged[name] = column
                if unit not in ("", TEXT):
                    units[name] = unit
        return replace(self, columns=merged, units=units)

    def changed(self, columns: Mapping[str, Values]) -> Table:
        """Return the table with other or further columns by name, with values in internal units."""
        return replace(self, columns={**self.columns, **columns})

    def without(self, *names: str) -> Table:
        """Return the table without some columns."""
        return replace(self, columns={name: column for name, column in self.columns.items() if name not in names})

    def extended(self, rows: Mapping[str, Values]) -> Table:
        """Return the table with further rows, by columns; cells of other columns are empty, and all lines left out."""
        import numpy as np

        count = len(next(iter(rows.values())))
        empty = {True: np.full(count, ""), False: np.full(count, np.nan)}
        columns = {
            name: np.concatenate([column, rows.get(name, empty[column.dtype.kind == "U"])])
            for name, column in self.columns.items()
        }
        return replace(self, columns=columns, lines=())

    def selected(self, rows: Index | Mask) -> Table:
        """Return some rows of the table, with their lines; remarks of its reader are left out."""
        import numpy as np

        lines = [self.lines[i] for i in np.arange(len(self))[rows]] if self.lines else ()
        columns = {name: column[rows] for name, column in self.columns.items()}
        return replace(self, columns=columns, lines=lines, warnings=())

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()))) if self.columns else 0

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def numbers(self, name: str, default: float | None = None) -> Array:
        """Return a numeric column, (rows,); if it is absent, a column of `default`.

        Raises KeyError if the column is absent and there is no default.
        """
        import numpy as np

        if name not in self.columns and default is not None:
            return np.full(len(self), default)
        return np.asarray(self.columns[name], dtype=float)

    def conditions(self, *names: str) -> dict[str, Array]:
        """Return those of the named columns that it has, and its further columns, each (rows,)."""
        return {name: self.numbers(name) for name in (*names, *self.further) if name in self}

    def texts(self, name: str, default: str | None = None) -> list[str]:
        """Return a text column as a list, the same one each time; if it is absent, a list of `default`.

        Raises KeyError if the column is absent and there is no default.
        """
        if name not in self.columns and default is not None:
            return [default] * len(self)
        if name not in self._lists:
            self._lists[name] = self.columns[name].astype(str).tolist()
        return self._lists[name]

    def stacked(self, names: Sequence[str]) -> Array:
        """Return numeric columns side by side, (rows, names)."""
        import numpy as np

        return np.stack([self.numbers(name) for name in names], axis=1)

    def fault(self, message: str, hint: str | None = None) -> Fault:
        """Return a fault of the whole table, with its file."""
        return Fault(message, self.file, hint=hint)

    def fault_at(self, row: int, message: str, hint: str | None = None) -> Fault:
        """Return a fault of one row, with its line in the file."""
        return Fault(message, self.file, self.lines[row] if self.lines else None, hint=hint)

    def faults_at(
        self, rows: Iterable[int], text: Callable[[int], str], hint: Callable[[int], str | None] = lambda row: None
    ) -> list[Fault]:
        """Return a fault for each of the first MOST_FAULTS rows, and one fault that counts the rest."""
        rows = [int(row) for row in rows]
        faults = [self.fault_at(row, text(row), hint(row)) for row in rows[:MOST_FAULTS]]
        rest = len(rows) - len(faults)
        return [*faults, self.fault(f"and {rest} more like these")] if rest else faults


def ascii_letters(values: Texts) -> Bytes | None:
    """Return the letters of texts with zeros after the short ones, (texts, letters); None unless all are ASCII.

    Whole columns so become bytes many times faster than text by text.
    """
    import numpy as np

    if not values.size:
        return None
    wide = np.ascontiguousarray(values).view(np.uint32).reshape(values.size, -1)
    return wide.astype(np.uint8) if wide.max(initial=0) < 128 else None


ABSENT = Table({})
"""Stands for a table that does not exist yet: the readings of a planned or simulated measurement"""
