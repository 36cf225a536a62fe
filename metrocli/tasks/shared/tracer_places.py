"""Starting values of the tracers from their lengths; lengths that fit no place are rejected with the likely cause."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random

import numpy as np

from metrocli import units
from metrocli.adjust.allowance import take
from metrocli.adjust.medians import median
from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index
from metrocli.errors import Fault, InputError, UndeterminedError
from metrocli.frozen import dataclass
from metrocli.instruments.tracer_start import MOST, start

_MISFIT = 0.05
"""Lengths whose median misfit exceeds this share of the volume do not belong to these points"""
_REMOTE = 500.0
"""A tracer farther away than this many times the volume is rejected: from there all lengths change alike"""
_SPARE = 3
"""Redundant lengths that a tracer needs before its misfit is meaningful"""
_AS_LONG = 5
"""Steps of an adjustment that take as long as one start"""


@dataclass(frozen=True)
class Seen:
    """Lengths with the places of their points as far as they are known, and what is known of the tracers."""

    tracers: Sequence[str]
    tracer: Index
    """Number of the tracer of each length, (n,)"""
    points: Array
    """Place of the point of each length, (n, 3)"""
    length: Array
    said: Array
    """Listed places of the tracers, (tracers, 3), nan if not listed"""
    sigma: Array
    """Standard uncertainties of the listed places, (tracers, 3): 0 exact, nan unknown"""
    extent: float
    """Largest side of the box around the points [mm]"""
    absolute: bool = False
    file: str = ""
    noun: str = "tracer"
    """What the file calls a tracer: one that moves has several stations"""


def few_of_each(tracer: Index, tracers: int) -> Index:
    """Return rows of the lengths, of which `tracer` (n,) is the number: at most MOST of each, in a random sample.

    More determine a starting value no better than it must be.
    """
    every = [np.flatnonzero(tracer == i) for i in range(tracers)]
    return np.concatenate(
        [rows[Random(0).sample(range(n), MOST)] if (n := len(rows)) > MOST else rows for rows in every]
    )


def places_of(readings: Seen) -> Array:
    """Return x0, y0, z0, dead path and scale 1 of each tracer, (tracers, 5).

    Raises UndeterminedError if a tracer reads too few points to determine or to find its place. Raises InputError if
    lengths and points do not belong together: wrong units, a reversed sign, the rows of one tracer in another order.
    """
    values = np.zeros((len(readings.tracers), 5))
    values[:, 4] = 1.0
    misfits, strange = np.zeros(len(readings.tracers)), np.zeros(len(readings.tracers), dtype=bool)
    fewest = 3 if readings.absolute else 4
    for i, name in enumerate(readings.tracers):
        mine = readings.tracer == i
        if mine.sum() < fewest and not (readings.sigma[i] == 0).all():
            raise UndeterminedError(
                f"{readings.noun} {name} reads {mine.sum()} points: "
                f"its place{'' if readings.absolute else ' and dead path'} "
                f"need at least {fewest}, not in one plane, and {fewest + 2} for a check"
            )
        points, lengths = readings.points[mine], readings.length[mine]
        values[i, :4] = _start_of(readings, i, points, lengths)
        if mine.sum() >= fewest + _SPARE:
            misfits[i] = _misfit(points, lengths, values[i])
            away = float(np.linalg.norm(values[i, :3] - points.mean(axis=0)))
            strange[i] = misfits[i] > _MISFIT * readings.extent or away > _REMOTE * readings.extent
    bad = np.flatnonzero(strange)
    if bad.size:
        raise InputError([_strange(readings, int(i), float(misfits[i]), bad.size) for i in bad])
    return values


def _start_of(readings: Seen, i: int, points: Array, lengths: Array) -> Array:
    """Return x0, y0, z0 and dead path of one tracer from its lengths; coordinates with a sigma stay as listed."""
    given = readings.said[i]
    said = None if np.isnan(given).any() else given
    known = np.isfinite(readings.sigma[i])
    if known.all():
        dead = 0.0 if readings.absolute else float(median(np.linalg.norm(points - given, axis=1) - lengths))
        return np.array([*given, dead])
    found = start(points, lengths, readings.absolute, said)
    if np.isnan(found).any():
        raise UndeterminedError(
            f"{readings.noun} {readings.tracers[i]} reads {len(points)} points, too few to find where it stands: "
            f"let it read two more, or give its approximate place in `inputs: {readings.noun}s`"
        )
    return np.array([*np.where(known, given, found[:3]), found[3]])


def _misfit(points: Array, lengths: Array, tracer: Array) -> float:
    """Return the median error of the lengths of one tracer, beside one that all of them share.

    A shared error is that of an instrument, such as the delay of a radio, and not of lengths of other points.
    """
    errors = lengths + tracer[3] - np.linalg.norm(points - tracer[:3], axis=1)
    return float(median(np.abs(errors - median(errors))))


def _strange(readings: Seen, i: int, misfit: float, bad: int) -> Fault:
    mine = readings.tracer == i
    points, lengths = readings.points[mine], readings.length[mine]
    text = (
        f"the lengths of {readings.noun} {readings.tracers[i]} do not belong to these points: "
        f"they are off by {misfit:.3g} mm"
    )
    hint = "are its rows in another order?" if bad < len(readings.tracers) else "do points and lengths belong together?"
    for factor, symbol in _factors():
        take(_AS_LONG)
        found = np.nan_to_num(start(points, factor * lengths, readings.absolute))
        if _misfit(points, factor * lengths, found) < _MISFIT * readings.extent / 10:
            hint = (
                "they fit with the other sign: lengths grow with the distance"
                if factor < 0
                else f"they fit if they are multiplied by {factor:g} ({symbol}): check the units of both files"
            )
            break
    return Fault(text, readings.file, hint=hint)


def _factors() -> list[tuple[float, str]]:
    """Return factors that correct likely mistakes in lengths, each with its cause: a reversed sign, or wrong units."""
    ones = {unit.symbol: unit.inside(1.0) for unit in units.DIMENSIONS["length"].units}
    ratios = {f"{a} written as {b}": ones[a] / ones[b] for a in ones for b in ones if a != b}
    return [(-1.0, ""), *((ratio, name) for name, ratio in ratios.items())]
