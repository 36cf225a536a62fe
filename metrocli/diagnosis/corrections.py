"""Other readings of the files of a job: another unit, swapped, mirrored and turned axes, each with what to write."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from itertools import combinations, permutations, product, starmap
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
_TURNED = ("turned by 90 degrees about {0}", "turned by -90 degrees about {0}", "turned by 180 degrees about {0}")


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
    for axes, (key, table) in product((False, True), tables):
        for words, write, factor, changed in _of_table(table):
            sort = "units" if abs(factor) != 1.0 else "handed" if words in _HANDED else words
            turns = words.startswith(_TURNS)
            if (sort == "handed" or turns) != axes or (turns and key in unplaced):
                continue
            columns = sum(changed.columns[name] is not table.columns[name] for name in table if not _known(name))
            alike = key if key in unplaced and sort == "handed" else ""
            mistake = Mistake(key, words, write, min(abs(factor), 1.0), table.file, sort, columns, alike)
            yield mistake, {**inputs, key: changed}
        if not axes:
            for mistake, changed in other_scales(key, table, _lengths(table)):
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


def _of_table(table: Table) -> Iterator[tuple[str, str, float, Table]]:
    """Yield what may be wrong, what to write instead, the factor of the numbers, and the corrected table."""
    for names in _lengths(table):
        yield from _units_of_lengths(table, names)
    angles = [name for name, unit in table.units.items() if unit == "rad"]
    for names in _alike_angles(angles):
        yield from _units_of_angles(table, names)
    for one, other in combinations(angles, 2):
        yield (*_swap(one, other), 1.0, _swapped(table, one, other))
    for angle in (angle for angle in angles if angle not in _TURNING):
        yield _sign(angle)[0], _sign(angle)[1], 1.0, _scaled(table, [angle], -1.0)
    yield from _of_axes(table, [name for name in _AXES if name in table])


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
    return [group for i, group in enumerate(groups) if group not in groups[:i]]


def _units_of_lengths(table: Table, names: Sequence[str]) -> Iterator[tuple[str, str, float, Table]]:
    headings = in_a_row(_headings(table, names))
    for factor, words, unit in _other_units(table, names):
        write = f"{in_a_row([f'{name}_{unit}' for name in names])} in the heading"
        numbers = f"the numbers of {headings} times {factor:.10g}"
        changed = _no_looser(_scaled(table, names, factor), factor)
        yield f"{headings} {words}", write if unit else numbers, factor, changed


def _other_units(table: Table, names: Sequence[str]) -> Iterator[tuple[float, str, str]]:
    """Yield factors that correct numbers in another unit, with what they are in words, and that unit if it has a name.

    A factor on a column in inches can lead to a size that no unit has: then the numbers are to be changed.
    """
    verb = "are" if names[1:] else "is"
    if table.units[names[0]] == "rad":
        read = size_of_unit(table, names[0])
        angles = {
            unit.symbol: unit.inside(1.0) / read
            for unit in DIMENSIONS["angle"].units
            if unit.reported or unit.symbol == "gon"
        }
        yield from ((factor, f"{verb} in {symbol}", symbol) for symbol, factor in angles.items() if factor != 1.0)
        return
    read = size_of_unit(table, names[0])
    per_metre, per_centimetre = (find_unit(symbol, "length").inside(1.0) for symbol in ("m", "cm"))
    for factor in (per_metre, 1 / per_metre, INCH, 1 / INCH, per_centimetre, 1 / per_centimetre):
        lengths = DIMENSIONS["length"].units
        meant = next((unit.symbol for unit in lengths if _alike(unit.times / unit.over, factor * read)), "")
        off = {INCH: "in inches", 1 / INCH: "divided by 25.4"}.get(factor, f"off by a factor {factor:g}")
        yield factor, f"{verb} in {meant}" if meant else f"{verb} {off}", meant


def other_scales(key: str, table: Table, groups: Iterable[Sequence[str]]) -> Iterator[tuple[Mistake, Table]]:
    """Yield columns that are in another unit in some rows: of one source, or of one of two sizes.

    Their size comes nearer to that of the other rows with another unit, so that few are tried.
    """
    for names in groups:
        headings, size = in_a_row(_headings(table, names)), np.max(np.abs([table.numbers(name) for name in names]), 0)
        for where, rows in parts(table, size):
            for factor, words, _ in _nearer(table, names, float(np.median(size[~rows])), float(np.median(size[rows]))):
                mistake = Mistake(
                    key, f"{headings} {where} {words}", f"{headings} {where} times {factor:.10g}", min(factor, 1.0),
                    table.file, ROWS if where.startswith("in") else "scales", len(names),
                )  # fmt: skip
                columns = {name: table.numbers(name) * np.where(rows, factor, 1.0) for name in names}
                yield mistake, table.changed(columns)


def other_columns(key: str, table: Table, names: Sequence[str], usual: float = 0) -> Iterator[tuple[Mistake, Table]]:
    """Yield columns whose size comes nearer to the usual, that of others of the same sort, with another unit."""
    size = {name: np.abs(table.numbers(name)) for name in names}
    for name in names:
        (heading,), rest = _headings(table, [name]), [size[other] for other in names if other != name]
        others = float(np.median(rest)) if rest else usual
        for factor, words, unit in _nearer(table, [name], others, float(np.median(size[name]))):
            write = f"{name}_{unit} in the heading" if unit else f"the numbers of {heading} times {factor:.10g}"
            mistake = Mistake(key, f"{heading} {words}", write, min(factor, 1.0), table.file, "scales")
            yield mistake, _scaled(table, [name], factor)


def _nearer(table: Table, names: Sequence[str], others: float, own: float) -> Iterator[tuple[float, str, str]]:
    """Yield the units that bring the size of numbers nearer to that of others, as `_other_units` does."""
    ratio = math.log(others / own) if others > 0 and own > 0 else 0.0
    for factor, words, unit in _other_units(table, names):
        if abs(ratio - math.log(factor)) < min(abs(ratio), math.log(_LIKE_OTHERS)):
            yield factor, words, unit


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


def _units_of_angles(table: Table, names: Sequence[str]) -> Iterator[tuple[str, str, float, Table]]:
    if not names:
        return
    degree, gon = (find_unit(symbol, "angle").inside(1.0) for symbol in ("deg", "gon"))
    read = size_of_unit(table, names[0])
    # sightings of networks have gon among their own corrections
    more = ((gon / degree, "gon"), (degree / gon, "deg")) if any(name in table for name in _TURNING) else ()
    for factor, symbol in ((degree, "deg"), (1 / degree, "rad"), *more):
        verb = "are" if names[1:] else "is"
        meant = find_unit(symbol, "angle")
        if _alike(meant.times / meant.over, factor * read) or (not table.headings and symbol != "gon"):
            words = f"{in_a_row(_headings(table, names))} {verb} in {symbol}"
            write = f"{in_a_row([f'{name}_{symbol}' for name in names])} in the heading"
            yield words, write, factor, _scaled(table, names, factor)


def _of_axes(table: Table, axes: Sequence[str]) -> Iterator[tuple[str, str, float, Table]]:
    """Yield swapped, mirrored and turned axes."""
    for one, other in combinations(axes, 2):
        yield (*_swap(one, other), 1.0, _swapped(table, one, other))
    for axis in axes:
        yield *_sign(axis), 1.0, _scaled(table, [axis], -1.0)
    if len(axes) < len(_AXES):
        return
    # swaps of two axes are above: orders that move every axis are the two that go round
    for order in permutations(axes):
        if all(one != other for one, other in zip(order, axes, strict=True)):
            words = f"{', '.join(axes)} are in the order {', '.join(order)}"
            yield words, f"{', '.join(order)} for {', '.join(axes)} in the headings", 1.0, _ordered(table, axes, order)
    for first, second, third in (("x", "y", "z"), ("y", "z", "x"), ("z", "x", "y")):
        half = _scaled(table, [first, second], -1.0)
        yield _TURNED[2].format(third), f"{first} and {second} with the other sign", 1.0, half
        for words, mirrored in ((_TURNED[0], second), (_TURNED[1], first)):
            write = f"{second} for {first} and {first} for {second} in the headings, {mirrored} with the other sign"
            yield words.format(third), write, 1.0, _scaled(_swapped(table, first, second), [mirrored], -1.0)


def _swap(one: str, other: str) -> tuple[str, str]:
    return f"{one} and {other} are swapped", f"{other} for {one} and {one} for {other} in the headings"


def _sign(name: str) -> tuple[str, str]:
    return f"{name} has the wrong sign", f"{name} with the other sign"


def _alike(one: float, other: float) -> bool:
    return abs(one / other - 1) < 1e-9


def _headings(table: Table, names: Sequence[str]) -> list[str]:
    """Return columns by their names in the file; in the internal unit if the table was read from none."""
    return [table.headings.get(name, f"{name}_{suffix_of(table.units[name])}") for name in names]


def size_of_unit(table: Table, name: str) -> float:
    """Return the unit in which a column is read, as a multiple of the internal unit."""
    dimension = "angle" if table.units[name] == "rad" else "length"
    heading = table.headings.get(name, f"{name}_{suffix_of(table.units[name])}")
    unit: Unit = suffixes(dimension)[heading.removeprefix(f"{name}_")]
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


def _swapped(table: Table, one: str, other: str) -> Table:
    return _ordered(table, (one, other), (other, one))


def _ordered(table: Table, names: Sequence[str], order: Sequence[str]) -> Table:
    """Return the table with the columns `order` as `names`."""
    return table.changed({name: table.columns[old] for name, old in zip(names, order, strict=True)})


_HANDED = {words for words, _ in (*starmap(_swap, combinations(_AXES, 2)), *map(_sign, _AXES))}
"""What turns a right-handed list into a left-handed one: where the frame of the list is unknown, all fit alike"""
_TURNS = ("turned by", "x, y, z are in the order")
"""How the words begin for what turns a list as a whole"""
