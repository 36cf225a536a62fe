"""Other readings of the files of a job: another unit, swapped, mirrored and turned axes, each with what to write."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from metrocli.frozen import dataclass
from metrocli.table import Table
from metrocli.units import DIMENSIONS, INCH, Unit, find_unit, suffix_of, suffixes
from metrocli.words import in_a_row, lines_in_words

if TYPE_CHECKING:
    from metrocli.arrays import Array, Mask, Values

Inputs = Mapping[str, object]
_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Mistake:
    """A possible mistake in one input."""

    input: str
    words: str
    write: str
    """What to write in the file instead"""
    shrinks: float = 1.0
    """Factor by which its correction makes numbers smaller, and with them their residuals whatever is wrong"""
    file: str = ""
    sort: str = ""
    """`units`, `handed`, or what is wrong: mistakes of one sort can be indistinguishable, also in two files"""
    columns: int = 1
    """Number of columns that its correction changes"""
    alike: str = ""
    """Corrections with the same name here lead to the same fit, so that one in vain is all; empty: others differ"""
    steps: int = 24
    """Steps that its try may take, starts included; a job that is read rightly takes 12 to 15"""
    entries: Mapping[str, str | Sequence[str]] = field(default_factory=dict, compare=False)
    """Of a section of the job: the right entries by their places in the job, "" for one that is left out"""

    def __str__(self) -> str:
        return f"{self.input}: {self.words}"


def corrections(inputs: Inputs, unplaced: Collection[str] = ()) -> Iterator[tuple[Mistake, Inputs]]:
    """Yield each possible mistake in the files, with the corrected inputs: axes of lists last, as the most.

    Lists that are `unplaced` have a frame of their own: turned as a whole they fit as before, so that turns are left
    out, and all that mirrors them fits alike.
    """
    tables = [(key, table) for key, table in inputs.items() if isinstance(table, Table)]
    # two passes and no sorted list: tables of millions of rows are changed one at a time
    for corrected in (_of_numbers, partial(_of_axes, unplaced=unplaced)):
        for key, table in tables:
            for mistake, changed in corrected(key, table):
                yield mistake, {**inputs, key: changed}


ROWS = "rows"
"""Sort of the mistake of rows that share no more than the size of their numbers"""
_SOURCES = ("station", "tracer", "line", "view", "tool", "ball", "reflector")
"""Columns that name what several readings have in common, such as the operator who wrote them"""
_LIKE_OTHERS = 5.0
"""Rows in another unit differ from the others by its factor, up to so many times"""
_GAP = 3.0
"""Sizes of rows in two units have a gap between them of at least this factor"""
_TURNING = ("a", "b", "c")
"""Positions of rotary axes: their sense is a setting of the machine"""


Correction = tuple[Mistake, Table]
"""A mistake in a table, and the corrected table"""


def _correction(
    key: str, table: Table, words: tuple[str, str], changed: Table, sort: str = "", factor: float = 1.0, alike: str = ""
) -> Correction:
    """Return a mistake by its words and what to write instead; it is a sort of its own unless one is given."""
    columns = sum(changed.columns[name] is not table.columns[name] for name in table if not _known(name))
    return Mistake(key, *words, min(factor, 1.0), table.file, sort or words[0], columns, alike), changed


def _of_numbers(key: str, table: Table) -> Iterator[Correction]:
    """Yield other units, of whole columns and of some rows, and angles that are swapped or have the other sign."""
    for names in _lengths(table):
        headings = in_a_row(_headings(table, names))
        for factor, words, write in _other_units(table, names):
            changed = _no_looser(_scaled(table, names, factor), factor)
            yield _correction(key, table, (f"{headings} {words}", write), changed, "units", factor)
    # the scale of one axis alone may be in inches
    for name in dict.fromkeys(name for names in _lengths(table) if names[1:] for name in names):
        (heading,) = _headings(table, [name])
        how = f"{heading} is in inches", f"the numbers of {heading} times {INCH:g}"
        yield _correction(key, table, how, _scaled(table, [name], INCH), "units")
    angles = [name for name, unit in table.units.items() if unit == "rad"]
    for names in _alike_angles(angles):
        yield from _units_of_angles(key, table, names)
    signed = [name for name in angles if name not in _TURNING]
    yield from (_correction(key, table, *both) for both in _swaps_and_signs(table, angles, signed))
    yield from other_scales(key, table, _lengths(table))


def _lengths(table: Table) -> list[list[str]]:
    """Return the columns of lengths that may share a mistake: the places, the others, and all of them."""
    lengths = [name for name, unit in table.units.items() if unit == "mm" and not _known(name)]
    places = [name for name in lengths if name in _AXES]
    others = [name for name in lengths if name not in _AXES]
    return [*([places, others] if places and others else []), *([lengths] if lengths else [])]


def _alike_angles(angles: Sequence[str]) -> list[list[str]]:
    """Return the columns of angles that may share a mistake: all; those of rotary axes, each of them; the others."""
    turning = [name for name in angles if name in _TURNING]
    others = [name for name in angles if name not in turning]
    groups = [list(angles), *([turning, others, *([name] for name in turning)] if turning else [])]
    return [group for i, group in enumerate(groups) if group and group not in groups[:i]]


def _other_units(table: Table, names: Sequence[str]) -> Iterator[tuple[float, str, str]]:
    """Yield factors that correct numbers in another unit, with what they are in words, and what to write instead.

    A factor on a column in inches can lead to a size that no unit has: then the numbers are to be changed.
    """
    read, verb = size_of_unit(table, names[0]), "are" if names[1:] else "is"
    if table.units[names[0]] == "rad":
        angles = [unit for unit in DIMENSIONS["angle"].units if unit.reported or unit.symbol == "gon"]
        factors = {unit.symbol: unit.inside(1.0) / read for unit in angles}
        for symbol, factor in factors.items():
            if factor != 1.0:
                yield factor, f"{verb} in {symbol}", _in_heading(names, symbol)
        return
    per_metre, per_centimetre = (find_unit(symbol, "length").inside(1.0) for symbol in ("m", "cm"))
    foot = find_unit("ft", "length").inside(1.0)
    # under a heading in mm or larger: numbers in feet; under one in feet: numbers in metres or mm
    feet = (foot / read,) if read != foot else (per_metre / foot, 1 / foot)
    usual = (per_metre, 1 / per_metre, INCH, 1 / INCH, per_centimetre, 1 / per_centimetre)
    for factor in (*usual, *(feet if read >= 1 else ())):
        lengths = DIMENSIONS["length"].units
        meant = next((unit.symbol for unit in lengths if _alike(unit.times / unit.over, factor * read)), "")
        off = {INCH: "in inches", 1 / INCH: "divided by 25.4"}.get(factor, f"off by a factor {factor:g}")
        numbers = f"the numbers of {in_a_row(_headings(table, names))} times {factor:.10g}"
        write = _in_heading(names, meant) if meant else numbers
        yield factor, f"{verb} in {meant}" if meant else f"{verb} {off}", write


def _in_heading(names: Sequence[str], unit: str) -> str:
    return f"{in_a_row([f'{name}_{unit}' for name in names])} in the heading"


def other_scales(key: str, table: Table, groups: Iterable[Sequence[str]]) -> Iterator[Correction]:
    """Yield columns that are in another unit in some rows: of one source, or of one of two sizes.

    Their size comes nearer to that of the other rows with another unit, so that few are tried.
    """
    for names in groups:
        headings, size = in_a_row(_headings(table, names)), np.max(np.abs([table.numbers(name) for name in names]), 0)
        for where, rows in parts(table, size):
            for factor, words, _ in _nearer(table, names, float(np.median(size[~rows])), float(np.median(size[rows]))):
                how = f"{headings} {where} {words}", f"{headings} {where} times {factor:.10g}"
                columns = {name: table.numbers(name) * np.where(rows, factor, 1.0) for name in names}
                sort = ROWS if where.startswith("in") else "scales"
                yield _correction(key, table, how, table.changed(columns), sort, factor)


def other_columns(key: str, table: Table, names: Sequence[str], usual: float = 0) -> Iterator[Correction]:
    """Yield columns whose size comes nearer to the usual, that of others of the same sort, with another unit."""
    size = {name: np.abs(table.numbers(name)) for name in names}
    for name in names:
        (heading,), rest = _headings(table, [name]), [size[other] for other in names if other != name]
        others = float(np.median(rest)) if rest else usual
        for factor, words, write in _nearer(table, [name], others, float(np.median(size[name]))):
            changed = _scaled(table, [name], factor)
            yield _correction(key, table, (f"{heading} {words}", write), changed, "scales", factor)


def _nearer(table: Table, names: Sequence[str], others: float, own: float) -> Iterator[tuple[float, str, str]]:
    """Yield the units that bring the size of numbers nearer to that of others, as `_other_units` does."""
    ratio = math.log(others / own) if others > 0 and own > 0 else 0.0
    for unit in _other_units(table, names):
        if abs(ratio - math.log(unit[0])) < min(abs(ratio), math.log(_LIKE_OTHERS)):
            yield unit


def parts(table: Table, size: Array) -> Iterator[tuple[str, Mask]]:
    """Yield the rows of each source beside others, in words, and the fewer rows on one side of a gap between sizes."""
    texts = {column: np.array(table.texts(column)) for column in _SOURCES if column in table}
    sources = [
        (f"of {column} {name}", of == name) for column, of in texts.items() for name in dict.fromkeys(of.tolist())
    ]
    yield from (source for source in sources if not source[1].all())
    known = np.sort(size)
    gaps = known[1:] / np.maximum(known[:-1], 1e-300)
    if gaps.size and gaps.max() > _GAP and known[0] > 0:
        small = size <= known[np.argmax(gaps)]
        few = [rows for rows in (small, ~small) if 2 * rows.sum() <= len(size)]
        for rows in (rows for rows in few if not any((rows == of).all() for _, of in sources)):
            lines = np.asarray(table.lines or range(1, len(size) + 1))[rows].tolist()
            yield f"in {lines_in_words(lines)}", rows


def _units_of_angles(key: str, table: Table, names: Sequence[str]) -> Iterator[Correction]:
    degree, gon = (find_unit(symbol, "angle").inside(1.0) for symbol in ("deg", "gon"))
    read = size_of_unit(table, names[0])
    # sightings of networks have gon among their own corrections
    more = ((gon / degree, "gon"), (degree / gon, "deg")) if any(name in table for name in _TURNING) else ()
    for factor, symbol in ((degree, "deg"), (1 / degree, "rad"), *more):
        verb = "are" if names[1:] else "is"
        meant = find_unit(symbol, "angle")
        if _alike(meant.times / meant.over, factor * read) or (not table.headings and symbol != "gon"):
            words = f"{in_a_row(_headings(table, names))} {verb} in {symbol}"
            yield _correction(
                key, table, (words, _in_heading(names, symbol)), _scaled(table, names, factor), "units", factor
            )


def _of_axes(key: str, table: Table, unplaced: Collection[str]) -> Iterator[Correction]:
    """Yield swapped, mirrored and turned axes."""
    axes = [name for name in _AXES if name in table]
    for words, changed in _swaps_and_signs(table, axes, axes):
        # a right-handed list turns into a left-handed one: where the frame of the list is unknown, all fit alike
        yield _correction(key, table, words, changed, "handed", alike=key if key in unplaced else "")
    if len(axes) == len(_AXES) and key not in unplaced:
        yield from (_correction(key, table, *both) for both in _turns(table))


def _swaps_and_signs(
    table: Table, names: Sequence[str], signed: Sequence[str]
) -> Iterator[tuple[tuple[str, str], Table]]:
    """Yield two columns for each other, and single ones with the other sign: words, what to write, and the table."""
    for one, other in combinations(names, 2):
        write = f"{other} for {one} and {one} for {other} in the headings"
        yield (f"{one} and {other} are swapped", write), _ordered(table, (one, other), (other, one))
    for name in signed:
        yield (f"{name} has the wrong sign", f"{name} with the other sign"), _scaled(table, [name], -1.0)


def _turns(table: Table) -> Iterator[tuple[tuple[str, str], Table]]:
    """Yield what turns a list as a whole: words, what to write, and the turned table."""
    x, y, z = _AXES
    # swaps of two axes mirror: orders that move every axis are the two that go round
    for order in ((y, z, x), (z, x, y)):
        axes, other = ", ".join(_AXES), ", ".join(order)
        write = f"{other} for {axes} in the headings"
        yield (f"{axes} are in the order {other}", write), _ordered(table, _AXES, order)
    for first, second, third in ((x, y, z), (y, z, x), (z, x, y)):
        half = f"turned by 180 degrees about {third}", f"{first} and {second} with the other sign"
        yield half, _scaled(table, [first, second], -1.0)
        for degrees, mirrored in ((90, second), (-90, first)):
            write = f"{second} for {first} and {first} for {second} in the headings, {mirrored} with the other sign"
            swapped = _ordered(table, (first, second), (second, first))
            yield (f"turned by {degrees} degrees about {third}", write), _scaled(swapped, [mirrored], -1.0)


def _alike(one: float, other: float) -> bool:
    return abs(one / other - 1) < 1e-9


def _headings(table: Table, names: Sequence[str]) -> list[str]:
    """Return columns by their names in the file; in the internal unit if the table was read from none."""
    return [table.headings.get(name, f"{name}_{suffix_of(table.units[name])}") for name in names]


def size_of_unit(table: Table, name: str) -> float:
    """Return the unit in which a column is read, as a multiple of the internal unit."""
    dimension = "angle" if table.units[name] == "rad" else "length"
    unit: Unit = suffixes(dimension)[_headings(table, [name])[0].removeprefix(f"{name}_")]
    return unit.inside(1.0)


def _scaled(table: Table, names: Sequence[str], factor: float) -> Table:
    columns: dict[str, Values] = {**table.columns}
    columns |= {name: table.numbers(name) * factor for name in names}
    return replace(table, columns=columns)


def _no_looser(table: Table, factor: float) -> Table:
    """Return a table whose lengths were scaled, with its standard deviations no larger in relation to them.

    Places that shrink beside their standard deviation yield to the readings, whatever is wrong with these.
    """
    known = [name for name, unit in table.units.items() if unit == "mm" and _known(name)]
    return _scaled(table, known, min(factor, 1.0))


def _known(name: str) -> bool:
    """Whether a column states how well others are known."""
    return name.startswith("sigma")


def _ordered(table: Table, names: Sequence[str], order: Sequence[str]) -> Table:
    """Return the table with the columns `order` as `names`."""
    return table.changed({name: table.columns[old] for name, old in zip(names, order, strict=True)})
