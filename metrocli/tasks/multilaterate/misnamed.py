"""Lengths that the list of points contradicts where all others fit it: stops under another name, and single lengths."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from metrocli import units
from metrocli.adjust.medians import median
from metrocli.arrays import Array, Index
from metrocli.errors import Fault, InputError, NoSolutionError
from metrocli.frozen import dataclass
from metrocli.instruments import tracer as t
from metrocli.instruments.tracer_start import start
from metrocli.table import Table
from metrocli.tasks.multilaterate.readings import LengthReadings, read
from metrocli.tasks.multilaterate.settings import Files, Settings
from metrocli.tasks.shared.tracers import in_another_order

T = TypeVar("T")

_OFF, _ROUGH = 30.0, 1e-3
"""A length is wrong from so many times the median misfit, and this share of the extent"""
_FEW = 4
"""Lengths of at most one point in so many are to blame: more would spoil the places of the tracers"""


@dataclass(frozen=True)
class _MisnamedLengths:
    """Lengths of a point that the list contradicts."""

    rows: Index
    text: str


def naming_wrong_lengths(settings: Settings, files: Files, solved: Callable[[Files], T]) -> T:
    """Return what is `solved`; a failure names the lengths that the list of points contradicts, if all others fit it.

    They are not the reason for a failure that remains without them.
    """
    try:
        return solved(files)
    except (NoSolutionError, InputError) as error:
        readings = read(settings, files)
        if isinstance(error, NoSolutionError) and (whole := _of_whole_tracers(readings)):
            raise type(error)("\n  ".join([str(error).partition(":")[0], *whole]), error.misfit) from error
        if isinstance(error, InputError) and readings.stuck:
            raise InputError([*map(Fault, readings.stuck), *error.faults]) from None
        wrong = _wrong_lengths(files.lengths, readings)
        if not wrong or _fails(solved, files, np.concatenate([lengths.rows for lengths in wrong])):
            raise
        texts = [lengths.text for lengths in wrong]
        if isinstance(error, InputError):
            raise InputError([files.lengths.fault(text) for text in texts]) from None
        # what an adjustment blames that these lengths have spoiled (layout, units, list) is not the reason
        raise type(error)("\n  ".join([str(error).partition(":")[0], *texts]), error.misfit) from error


def _of_whole_tracers(readings: LengthReadings) -> list[str]:
    """Return what is wrong with many lengths of a tracer: they stay the same, or fit in another order of its rows."""
    return list(readings.stuck) or [f"lengths of {name}: {words}" for name, words in in_another_order(readings.seen_by)]


def _fails(solved: Callable[[Files], object], files: Files, rows: Index) -> bool:
    """Return whether a job has no solution without some lengths either."""
    try:
        solved(replace(files, lengths=files.lengths.selected(np.delete(np.arange(len(files.lengths)), rows))))
    except NoSolutionError:
        return True
    except InputError:  # something asks for the very points that have no lengths then
        return False
    return False


def _wrong_lengths(lengths: Table, readings: LengthReadings) -> list[_MisnamedLengths]:
    """Return the lengths of each point that contradict the list, and what is wrong in words; none if it is unclear."""
    seen = readings.seen_by
    point = readings.observations.index[t.POINT][seen.rows]
    of = seen.tracers.of[seen.rows]
    places = np.array([_place(readings, np.flatnonzero(of == i), i) for i in range(len(seen.tracers.names))])[of]
    miss = np.abs(_misfits(places, seen.points, seen.length))
    bound = max(_OFF * float(median(miss)), _ROUGH * seen.extent)
    wrong = np.flatnonzero(miss > bound)
    blamed = np.unique(point[wrong])
    # nan where a tracer has no place
    if not np.isfinite(miss).all() or not 0 < _FEW * len(blamed) <= len(np.unique(point)):
        return []
    misnamed = []
    for number in blamed.tolist():
        own = wrong[point[wrong] == number]
        rows = seen.rows[own]
        others = _fitting(readings, places[own], seen.length[own], bound)
        # a table that no file has is counted as its file would be: below a head
        lines = lengths.lines or range(2, len(lengths) + 2)
        where = f"line{'s' * (len(rows) > 1)} {', '.join(str(lines[row]) for row in rows)}"
        to = f"; they fit {readings.names[others[0]]}: correct the name" if len(others) == 1 else ""
        most = units.sized(miss[own].max(), "length")
        text = (
            f"lengths of {readings.names[number]} ({where}) are off by up to {most} from where the list puts it, "
            f"those of all other points by less than {units.sized(bound, 'length')}{to}"
        )
        misnamed.append(_MisnamedLengths(rows, text))
    return misnamed


def _place(readings: LengthReadings, mine: Index, tracer: int) -> Array:
    """Return place and dead path (4,) of one tracer from its lengths to the listed points."""
    seen, near = readings.seen_by, readings.tracers.listed_at[tracer]
    return start(seen.points[mine], seen.length[mine], seen.absolute, near if np.isfinite(near).all() else None)


def _misfits(places: Array, points: Array, lengths: Array) -> Array:
    return np.asarray(lengths + places[:, 3] - np.linalg.norm(points - places[:, :3], axis=1))


def _fitting(readings: LengthReadings, places: Array, lengths: Array, bound: float) -> Index:
    """Return the points of the list that lengths from known places fit."""
    away = np.linalg.norm(readings.nominal[:, None] - places[:, :3], axis=2)
    return np.flatnonzero((np.abs(lengths + places[:, 3] - away) < bound).all(axis=1))
