"""Readings of tracers, matched to the lists of points and tracers and their uncertainties."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import repeat

import numpy as np
import numpy.typing as npt

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index
from metrocli.copies import row_hashes
from metrocli.errors import InputError, together
from metrocli.frozen import dataclass
from metrocli.table import MOST_FAULTS, Table
from metrocli.tasks.shared.known_places import sigmas
from metrocli.tasks.shared.tracer_places import Seen, few_of_each
from metrocli.words import nearest

Texts = npt.NDArray[np.str_]


@dataclass(frozen=True)
class Readings:
    """Lengths, each with its rows in the lists of points and tracers."""

    names: tuple[str, ...]
    stations: tuple[str, ...]
    """Tracers with at least one reading"""
    idle: tuple[str, ...]
    """Listed tracers without a reading"""
    length: Array
    point: Index
    station: Index
    nominal: Array
    """Listed places of the points, (points, 3)"""
    said: Array
    """Listed places of the tracers, (tracers, 3), nan if not listed"""
    point_sigma: Array
    """Standard uncertainties of the listed points, (points, 3), nan if not given"""
    tracer_sigma: Array
    """Standard uncertainties of the listed tracers, (tracers, 3), nan if not given"""
    absolute: bool
    file: str = ""

    @cached_property
    def seen(self) -> Index:
        """Number of lengths to each point, (points,)."""
        return np.bincount(self.point, minlength=len(self.names))

    @cached_property
    def extent(self) -> float:
        """Largest side of the box around the points that are read [mm]."""
        return float(np.ptp(self.nominal[self.seen > 0], axis=0).max()) or 1.0

    @property
    def by_tracers(self) -> Seen:
        """Lengths of each tracer, as the search of its place takes them: of many a random sample."""
        rows = few_of_each(self.station, len(self.stations))
        return Seen(
            self.stations,
            self.station[rows],
            self.nominal[self.point[rows]],
            self.length[rows],
            self.said,
            self.tracer_sigma,
            self.extent,
            self.absolute,
            self.file,
        )


def join(lengths: Table, points: Table, tracers: Table | None, absolute: bool) -> Readings:
    """Match lengths to points and tracers.

    Raises InputError that lists every length without a point or tracer, and every impossible reading.
    """
    if len(lengths) == 0:
        raise InputError([lengths.fault("the file has no lengths")])
    listed = sorted(set(lengths.texts("tracer"))) if tracers is None else tracers.texts("tracer")
    names, in_points = points.texts("point"), points.file or "the list of points"
    point, place, point_sigma, tracer_sigma, _ = together(
        lambda: matched(lengths, "point", points.columns["point"].astype(str), in_points),
        lambda: matched(lengths, "tracer", listed, "" if tracers is None else tracers.file),
        lambda: sigmas(points),
        lambda: None if tracers is None else sigmas(tracers),
        lambda: _refuse_readings(lengths, absolute),
    )
    used = np.bincount(place, minlength=len(listed)) > 0
    rows, station = np.flatnonzero(used), (np.cumsum(used) - 1)[place]
    stations = [listed[row] for row in rows]
    if tracers is None:
        said = sigma = np.full((len(stations), 3), np.nan)
    else:
        said, sigma = tracers.stacked("xyz")[rows], tracer_sigma[rows]
        _refuse_negative_paths(lengths, station, tracers, rows)
    return Readings(
        tuple(names),
        tuple(stations),
        tuple(listed[row] for row in np.flatnonzero(~used)),
        lengths.numbers("length"),
        point,
        station,
        points.stacked("xyz"),
        said,
        point_sigma,
        sigma,
        absolute,
        lengths.file,
    )


def matched(table: Table, column: str, names: Sequence[str] | Texts, where: str) -> Index:
    """Return for each row of a column the position of its name in `names`, (n,).

    Raises InputError that lists every name not found, with the nearest name as a hint.
    """
    quick = _by_hashes(table.columns[column].astype(str), np.array(names, dtype=np.str_))
    if quick is not None:
        return quick
    place = {name: i for i, name in enumerate(names)}
    values = table.texts(column)
    found = np.fromiter(map(place.get, values, repeat(-1)), dtype=np.intp, count=len(values))
    strange = np.flatnonzero(found < 0)
    if strange.size:
        meant = {name: nearest(name, names) for name in {values[row] for row in strange[:MOST_FAULTS].tolist()}}
        hints = {name: f"did you mean '{found}'?" for name, found in meant.items() if found}
        text = f"{column} '{{}}' is not in {where}".format
        raise InputError(table.faults_at(strange, lambda row: text(values[row]), lambda row: hints.get(values[row])))
    return found


def _by_hashes(texts: Texts, names: Texts) -> Index | None:
    """Return the position in `names` of each text, (n,); None if one is not there, or if chance gives equal hashes.

    Whole columns are so compared many times faster than text by text.
    """
    if not len(texts) or not len(names):
        return None
    width = max(texts.dtype, names.dtype)
    here, there = (row_hashes(Table({"": one.astype(width)}), ("",)) for one in (texts, names))
    order = np.argsort(there)
    begins = np.flatnonzero(np.append(True, here[1:] != here[:-1]))  # of the runs of rows with one name
    found = order[np.searchsorted(there[order[:-1]], here[begins])]
    places = np.repeat(found, np.diff(begins, append=len(here)))
    return places if (names[places] == texts).all() else None


def _refuse_readings(lengths: Table, absolute: bool) -> None:
    values = lengths.numbers("length")
    if absolute and (values <= 0).any():
        wrong = np.flatnonzero(values <= 0)
        raise InputError(lengths.faults_at(wrong, lambda row: "an absolute distance is not above zero"))
    if len(values) > 1 and np.ptp(values) == 0:
        raise InputError([lengths.fault("all lengths are equal", "is this the right column?")])


def _refuse_negative_paths(lengths: Table, station: Index, tracers: Table, rows: Index) -> None:
    """Raise InputError that lists every length whose sum with the given dead path is not above zero."""
    dead = tracers.numbers("dead_path", float("nan"))[rows][station]
    path = lengths.numbers("length") + dead
    bad = np.flatnonzero(path <= 0)
    if bad.size:
        text = "length plus dead path is {:g} mm, which is not above zero"
        raise InputError(lengths.faults_at(bad, lambda row: text.format(path[row])))
