"""Lists that files refer to by name: rows matched to names, how well places are known, rows that stand there twice."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from itertools import repeat

import numpy as np
import numpy.typing as npt

from metrocli.adjust.model.observations import TIME
from metrocli.arrays import Array, Index, Mask
from metrocli.copies import row_hashes
from metrocli.errors import InputError
from metrocli.table import MOST_FAULTS, Table, columns
from metrocli.units import suffixes
from metrocli.words import did_you_mean

Texts = npt.NDArray[np.str_]
_STICKS, _FINE = 5, 0.3
"""So many different points in a row do not have the same reading by chance, if the last digit is finer than this share
of its standard deviation"""
_WITHOUT_NOISE = 0.1
"""Residuals below this share of the declared noise are of readings without noise, such as computed ones"""
_ROUNDING, _DIGITS = 1e-12, 15
"""Relative rounding of numbers that were converted to another unit, and the most decimals of a number"""
SIGMAS = columns("sigma?* sigma_x?* sigma_y?* sigma_z?* [length]")
"""Columns of standard deviations: one for all three coordinates, or one for each"""


def refuse(table: Table, wrong: Mapping[str, Mask]) -> None:
    """Raise InputError with a fault for each row of the masks (rows,), under their texts; nothing if all are empty."""
    faults = [
        fault
        for text, rows in wrong.items()
        for fault in table.faults_at(np.flatnonzero(rows), lambda row, text=text: text)  # type: ignore[misc]
    ]
    if faults:
        raise InputError(faults)


def sigmas(table: Table, without: float = float("nan")) -> Array:
    """Return the standard deviations of places, (rows, 3) mm: 0 is exact, nan is unknown.

    A coordinate without a column has the value `without`. Raises InputError that names every row with a negative one.
    """
    common = table.numbers("sigma", without)
    refuse(table, negative(table, "sigma", *(f"sigma_{axis}" for axis in "xyz")))
    return np.stack([table.numbers(f"sigma_{axis}") if f"sigma_{axis}" in table else common for axis in "xyz"], axis=1)


def negative(table: Table, *names: str) -> dict[str, Mask]:
    """Return the rows with a negative standard deviation in each of the named columns, under a text."""
    return {
        f"a standard deviation is negative, in column '{table.headings.get(name, name)}'": table.numbers(name) < 0
        for name in names
        if name in table
    }


def listed_places(key: str, names: Sequence[str], places: Array) -> Table:
    """Return the table of named places (n, 3) mm, with the names in the column `key`."""
    return Table.of({f"{key} [text]": names, "x y z [mm]": places})


def matched(table: Table, column: str, names: Sequence[str] | Texts, where: str) -> Index:
    """Return for each row of a column the position of its name in `names`, (n,).

    Raises InputError that lists every name not found, with the nearest name as a hint.
    """
    quick = _by_hashes(table.columns[column].astype(str), np.array(names, dtype=np.str_))
    if quick is not None:
        return quick
    place = {name: i for i, name in enumerate(names)}
    values = table.texts(column)
    rows = np.fromiter(map(place.get, values, repeat(-1)), dtype=np.intp, count=len(values))
    unmatched = np.flatnonzero(rows < 0)
    if unmatched.size:
        hints = {name: did_you_mean(name, names) for name in {values[row] for row in unmatched[:MOST_FAULTS].tolist()}}
        raise InputError(
            table.faults_at(
                unmatched,
                lambda row: f"{column} '{values[row]}' is not in {where}",
                lambda row: hints.get(values[row]),
            )
        )
    return rows


def _by_hashes(texts: Texts, names: Texts) -> Index | None:
    """Return the position in `names` of each text, (n,); None if one is not there, or if chance gives equal hashes.

    Whole columns are so compared many times faster than text by text.
    """
    if not len(texts) or not len(names):
        return None
    width = max(texts.dtype, names.dtype)
    hashes, of_names = (row_hashes(Table({"": column.astype(width)}), ("",)) for column in (texts, names))
    order = np.argsort(of_names)
    # rows with one name mostly follow each other: one search for each such run
    begins = np.flatnonzero(np.append(True, hashes[1:] != hashes[:-1]))
    # without the last name in the search, a hash beyond it finds that name and not a place behind the end
    candidates = order[np.searchsorted(of_names[order[:-1]], hashes[begins])]
    places = np.repeat(candidates, np.diff(begins, append=len(hashes)))
    # compared letter by letter: equal hashes of different names would be a wrong match
    return places if (names[places] == texts).all() else None


def repeated(
    pairs: Iterable[tuple[Hashable, Hashable]], values: Iterable[float] | None = None
) -> Iterator[tuple[int, int]]:
    """Yield each row whose pair, in either direction, is that of an earlier row, and that row.

    With `values` only pairs of the same value count.
    """
    first: dict[object, int] = {}
    listed = list(pairs)
    for row, (pair, value) in enumerate(zip(listed, values or [0.0] * len(listed), strict=True)):
        before = first.setdefault((frozenset(pair), value), row)
        if before != row:
            yield row, before


def distinguished(keys: Mapping[str, tuple[str, ...]], pair: Index, time: Array | None) -> dict[str, tuple[str, ...]]:
    """Return the keys of readings, with their times where what they read (its number, (n,)) is read twice."""
    if time is None or len(np.unique(pair)) == len(pair):
        return dict(keys)
    return {**keys, TIME: tuple(f"{when:.10g} s" for when in time.tolist())}


def name_of(keys: Mapping[str, tuple[str, ...]], key: str, row: int) -> str:
    """Return a key of a reading, with its time where the keys have that: `T2 (2000 s)`."""
    return f"{keys[key][row]} ({keys[TIME][row]})" if TIME in keys else keys[key][row]


def sticking(table: Table, name: str, read: tuple[Index, Index], sources: Sequence[str], sigma: Array) -> Iterator[str]:
    """Yield where readings of a source stay the same at several points in a row, as of a sensor that sticks.

    `read` are source and point of each reading, `sigma` its standard deviation (n,). Noise changes the last digit, also
    where the points are as far away: readings whose digits are too coarse for that may repeat.
    """
    if name not in table:
        return
    source, point = read
    order = np.argsort(source, kind="stable")
    values, of, at = table.numbers(name)[order], source[order], point[order]
    begins = np.flatnonzero(np.append(True, (values[1:] != values[:-1]) | (of[1:] != of[:-1])))
    ends = np.append(begins[1:], len(values))
    long = np.flatnonzero(ends - begins >= _STICKS)
    digit = _last_digit(table, name) if long.size else 0.0
    for begin, end in zip(begins[long].tolist(), ends[long].tolist(), strict=True):
        rows = order[begin:end]
        if len(np.unique(at[begin:end])) < _STICKS or not digit < _FINE * np.nanmin(sigma[rows]):
            continue
        line = f" from line {table.lines[rows[0]]} on" if table.lines else ""
        yield (
            f"{table.file}: {table.headings.get(name, name)} of {sources[of[begin]]} stays the same in {end - begin} "
            f"rows in a row{line}, at different points, as of a sensor that sticks: leave these rows out, unless it "
            "was held there"
        )


def unless_without_noise(lines: Iterable[str], sigma0: float) -> tuple[str, ...]:
    """Return which readings stay the same, in words; none where the readings fit as if they had no noise.

    Computed readings repeat where places are alike, and a sensor that sticks does not fit.
    """
    return () if sigma0 < _WITHOUT_NOISE else tuple(lines)


def _last_digit(table: Table, name: str) -> float:
    """Return the step of the last digit in which a column is written, in its internal unit."""
    suffix, values = table.headings.get(name, "").removeprefix(f"{name}_"), table.numbers(name)
    unit = (suffixes("length") | suffixes("angle")).get(suffix)
    step = 1.0 if unit is None else unit.inside(1.0)
    written = values[np.isfinite(values)] / step
    rounding = _ROUNDING * float(np.abs(written).max(initial=0.0))
    digits = (k for k in range(_DIGITS) if (np.abs(written - np.round(written, k)) <= rounding).all())
    return step * 10.0 ** -next(digits, _DIGITS)
