"""The tracers of lengths: their names, lists and readings, and where they stand, found from the lengths."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from random import Random

import numpy as np

from metrocli import units
from metrocli.adjust.allowance import take
from metrocli.adjust.medians import median
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group, priors
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array, Index, Mask
from metrocli.errors import Fault, InputError, UndeterminedError, all_faults
from metrocli.frozen import dataclass
from metrocli.instruments import tracer as t
from metrocli.instruments.tracer_start import MOST, start
from metrocli.table import Table
from metrocli.tasks.shared.environment import Air
from metrocli.tasks.shared.lengths import Scale, scale_priors
from metrocli.tasks.shared.lists import distinguished, matched, sigmas

_MISFIT = 0.05
"""Lengths whose median misfit exceeds this share of the volume do not belong to these points"""
_REMOTE = 500.0
"""A tracer farther away than this many times the volume is rejected: from there all lengths change alike"""
_WORSE = 10.0
"""Lengths of one known tracer do not belong to the points if they fit so many times worse than those of the others"""
_FEWEST_ORDERED, _FAR_BETTER = 8, 5.0
"""Fewest lengths of a tracer that may be in another order, and how many times better they fit then"""
_SPARE = 3
"""Redundant lengths that a tracer needs before its misfit is meaningful"""
EQUAL = "all lengths are equal: is this the right column?"
NOTHING_FITS = "no other unit, sign or order of rows that was tried fits"
_AS_LONG = 5
"""Steps of an adjustment that take as long as one start"""


@dataclass(frozen=True)
class Tracers:
    """The tracers that read lengths, with their listed places."""

    names: tuple[str, ...]
    of: Index
    """Number of the tracer of each length, (n,)"""
    listed_at: Array
    """Listed places of the tracers, (tracers, 3), nan if not listed"""
    sigma: Array
    """Standard uncertainties of the listed places, (tracers, 3): 0 exact, nan unknown"""
    rows: Index
    """Rows of the tracers in their list"""
    idle: tuple[str, ...] = ()
    """Listed tracers without a reading"""
    noun: str = "tracer"
    """What the file calls a tracer: one that moves has several stations"""

    @property
    def given(self) -> Mask:
        """Tracers whose whole place is known, exactly or with a standard uncertainty, (tracers,)."""
        return np.asarray(np.isfinite(self.sigma).all(axis=1))

    def free(self, absolute: bool, scaled: bool) -> Mask:
        """Return the unknowns of each tracer, (tracers, 5): its place, unless exact, its dead path, and its scale."""
        m = len(self.names)
        known = np.column_stack([self.sigma == 0, np.full(m, absolute), np.full(m, not scaled)])
        return np.asarray(~known)

    def known(self, block: Block, scale: Scale | None) -> tuple[Group, ...]:
        """Return the priors of their places and scales."""
        sigma = np.column_stack([self.sigma, np.full((len(self.names), 2), np.nan)])
        return (*priors(block, sigma, block.free), *scale_priors(scale, block))


def tracers_of(lengths: Table, listed: Table | None, order: Callable[[list[str]], Iterable[str]], noun: str) -> Tracers:
    """Return the tracers of lengths, in the order of their list, without one in that which `order` gives to the names.

    `noun` is the column of their names. Raises InputError that lists every length of a tracer that is not in the list,
    and every negative standard deviation there.
    """
    names = list(order(lengths.texts(noun))) if listed is None else listed.texts(noun)
    with all_faults() as each:
        with each():
            place = matched(lengths, noun, names, "" if listed is None else listed.file)
        with each():
            sigma = np.full((len(names), 3), np.nan) if listed is None else sigmas(listed)
    used = np.bincount(place, minlength=len(names)) > 0
    rows = np.flatnonzero(used)
    listed_at = np.full((len(names), 3), np.nan) if listed is None else listed.stacked("xyz")
    idle = tuple(names[row] for row in np.flatnonzero(~used))
    seen = tuple(names[row] for row in rows)
    return Tracers(seen, (np.cumsum(used) - 1)[place], listed_at[rows], sigma[rows], rows, idle, noun)


def observed(
    lengths: Table,
    tracers: Tracers,
    points: tuple[Sequence[str], Index],
    conditions: Mapping[str, Array],
    air: Air | None,
) -> Observations:
    """Return lengths, corrected for the air, with index and keys of their tracers and points; their sigma is 1 mm.

    `points` are the names of all points and the number of that of each length.
    """
    names, point = points
    keys = {"point": _of_each(names, point), tracers.noun: _of_each(tracers.names, tracers.of)}
    length, given = lengths.numbers("length"), dict(conditions)
    if air is not None:
        length, given[t.AIR] = length * air.towards, air.ratio
    return Observations(
        length[None],
        np.ones(1),
        {t.POINT: point, t.TRACER: tracers.of},
        keys=distinguished(keys, point * len(tracers.names) + tracers.of, conditions.get("t")),
        conditions=given,
        components=("length",),
        unit="mm",
    )


def _of_each(names: Sequence[str], index: Index) -> tuple[str, ...]:
    """Return the name of each reading's member; readings of the same member share the text in memory."""
    return tuple(np.array(names, dtype=object)[index].tolist())


@dataclass(frozen=True)
class LengthsToTracers:
    """Lengths with the places of their points as far as they are known, from which tracers are found."""

    tracers: Tracers
    rows: Index
    """The lengths that are used, (n,)"""
    points: Array
    """Place of the point of each, (n, 3)"""
    length: Array
    extent: float
    """Largest side of the box around the points [mm]"""
    absolute: bool = False
    file: str = ""


def few_of_each(tracers: Tracers) -> Index:
    """Return rows of the lengths: at most MOST of each tracer, in a random sample.

    More determine a starting value no better than it must be.
    """
    every = [np.flatnonzero(tracers.of == i) for i in range(len(tracers.names))]
    return np.concatenate(
        [rows[Random(0).sample(range(n), MOST)] if (n := len(rows)) > MOST else rows for rows in every]
    )


def places_of(seen: LengthsToTracers) -> Array:
    """Return x0, y0, z0, dead path and scale 1 of each tracer, (tracers, 5).

    Raises UndeterminedError if a tracer reads too few points to determine or to find its place. Raises InputError if
    lengths and points do not belong together: wrong units, a reversed sign, the rows of one tracer in another order.
    """
    tracers = seen.tracers
    count, fewest = len(tracers.names), 3 if seen.absolute else 4
    values = np.zeros((count, 5))
    values[:, 4] = 1.0
    misfits, misfitting = np.zeros(count), np.zeros(count, dtype=bool)
    for i, name in enumerate(tracers.names):
        points, lengths = _of_tracer(seen, i)
        if len(points) < fewest and not (tracers.sigma[i] == 0).all():
            raise UndeterminedError(
                f"{tracers.noun} {name} reads {len(points)} points: "
                f"its place{'' if seen.absolute else ' and dead path'} "
                f"need at least {fewest}, not in one plane, and {fewest + 2} for a check"
            )
        values[i, :4] = _start_of(seen, i, points, lengths)
        if len(points) >= fewest + _SPARE:
            misfits[i] = _misfit(points, lengths, values[i])
            away = float(np.linalg.norm(values[i, :3] - points.mean(axis=0)))
            misfitting[i] = misfits[i] > _MISFIT * seen.extent or away > _REMOTE * seen.extent
    if tracers.given.all():  # known tracers find their points: a rough list of points is off for all of them alike
        misfitting &= misfits > _WORSE * median(misfits)
    bad = np.flatnonzero(misfitting)
    if bad.size:
        raise InputError([_strange(seen, int(i), float(misfits[i]), bad.size) for i in bad])
    return values


def _of_tracer(seen: LengthsToTracers, i: int) -> tuple[Array, Array]:
    """Return the places of the points that a tracer reads, (n, 3), and the lengths."""
    mine = seen.tracers.of[seen.rows] == i
    return seen.points[mine], seen.length[mine]


def _start_of(seen: LengthsToTracers, i: int, points: Array, lengths: Array) -> Array:
    """Return x0, y0, z0 and dead path of one tracer from its lengths; coordinates with a sigma stay as listed."""
    tracers, given = seen.tracers, seen.tracers.listed_at[i]
    listed_at = None if np.isnan(given).any() else given
    known = np.isfinite(tracers.sigma[i])
    if known.all():
        dead = 0.0 if seen.absolute else float(median(np.linalg.norm(points - given, axis=1) - lengths))
        return np.array([*given, dead])
    places = start(points, lengths, seen.absolute, listed_at)
    if np.isnan(places).any():
        raise UndeterminedError(
            f"{tracers.noun} {tracers.names[i]} reads {len(points)} points, too few to find where it stands: "
            f"let it read two more, or give its approximate place in `inputs: {tracers.noun}s`"
        )
    return np.array([*np.where(known, given, places[:3]), places[3]])


def _misfit(points: Array, lengths: Array, tracer: Array) -> float:
    """Return the median error of the lengths of one tracer, beside one that all of them share.

    A shared error is that of an instrument, such as the delay of a radio, and not of lengths of other points.
    """
    errors = lengths + tracer[3] - np.linalg.norm(points - tracer[:3], axis=1)
    return float(median(np.abs(errors - median(errors))))


def _strange(seen: LengthsToTracers, i: int, misfit: float, bad: int) -> Fault:
    points, lengths = _of_tracer(seen, i)
    tracers = seen.tracers
    name = f"{tracers.noun} {tracers.names[i]}"
    text = f"the lengths of {name} do not belong to these points: they are off by {units.sized(misfit, 'length')}"
    if np.ptp(seen.length) == 0:
        return Fault(text, seen.file, hint=EQUAL)
    of = "another set-up" if bad < len(tracers.names) else "another list of points"
    nothing = f"{NOTHING_FITS}: check that they are not those of {of}"
    hint = next((words for words, other in _read_otherwise(lengths) if _fits(seen, points, other)), nothing)
    return Fault(text, seen.file, hint=hint)


def _fits(seen: LengthsToTracers, points: Array, lengths: Array) -> bool:
    take(_AS_LONG)
    places = np.nan_to_num(start(points, lengths, seen.absolute))
    spread = min(seen.extent, float(np.ptp(lengths)))  # lengths near zero fit any points
    return _misfit(points, lengths, places) < _MISFIT * spread / 10


def in_another_order(seen: LengthsToTracers) -> Iterator[tuple[str, str]]:
    """Yield tracers whose lengths fit the list far better in another order of their rows, with that order in words."""
    for i, name in enumerate(seen.tracers.names):
        points, lengths = _of_tracer(seen, i)
        if len(points) >= _FEWEST_ORDERED:
            orders = [("", lengths), *_other_orders(lengths)]
            fits = [_misfit(points, other, start(points, other, seen.absolute)) for _, other in orders]
            best = int(np.argmin(fits))
            if fits[best] * _FAR_BETTER < fits[0]:
                yield name, orders[best][0]


def _read_otherwise(lengths: Array) -> Iterator[tuple[str, Array]]:
    """Yield what may be wrong with the lengths of one tracer, and the lengths without it."""
    for factor, likely in _factors():
        unit = f"they fit if they are multiplied by {factor:g}, as {likely} are: check the units of both files"
        sign = "they fit with the other sign: lengths grow with the distance"
        yield sign if factor < 0 else unit, factor * lengths
    yield from _other_orders(lengths)


def _other_orders(lengths: Array) -> Iterator[tuple[str, Array]]:
    yield "they fit in the reverse order of its rows", lengths[::-1]
    for rows, way in ((1, "down"), (-1, "up")):
        yield f"they fit if they are moved {way} by one of its rows", np.roll(lengths, rows)


def _factors() -> list[tuple[float, str]]:
    """Return factors that correct likely mistakes in lengths, each with its cause: a reversed sign, or wrong units.

    Of the units with one ratio those stand for all whose heading is in mm.
    """
    ones = {unit.symbol: unit.inside(1.0) for unit in units.DIMENSIONS["length"].units if unit.reported}
    ones |= {"cm": 10.0, "inches": units.INCH}
    causes: dict[float, str] = {}
    for b in sorted(ones, key=lambda unit: unit != "mm"):
        for a in ones:
            causes.setdefault(float(f"{ones[a] / ones[b]:.9g}"), f"numbers in {a} under a heading in {b}")
    causes.pop(1.0)
    return [(-1.0, ""), *causes.items()]
