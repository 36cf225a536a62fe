"""The readings of a network, finished: names are numbers, angles are those of face 1, faults are found.

The points are all that a file names, with their listed places and how well these are known.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field, replace
from functools import cached_property
from typing import Any

import numpy as np

from metrocli.arrays import Array, Index, Mask
from metrocli.errors import InputError, all_faults
from metrocli.frozen import dataclass
from metrocli.instruments.tracker import cartesian
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.adjust_network import noise as n
from metrocli.tasks.adjust_network.settings import INTERFEROMETER, Files, NetworkInstrument, Settings
from metrocli.tasks.adjust_network.sightings import PolarSightings, Stations, refuse_pairs, sightings_of, stations_of
from metrocli.tasks.shared.lists import matched, negative, refuse, sigmas, sticking
from metrocli.uncertainty.predicted import POINTS_COVARIANCE, points_of
from metrocli.words import listed


@dataclass(frozen=True)
class Lengths:
    """Readings that concern two names: points, or a station and a point."""

    table: Table
    first: Index
    second: Index
    values: Array
    sigma: Array

    def without(self, rows: Index) -> Lengths | None:
        """Return the readings without some rows; None if none are left."""
        kept = np.delete(np.arange(len(self.values)), rows)
        if not kept.size:
            return None
        ends = self.first[kept], self.second[kept]
        return Lengths(self.table.selected(kept), *ends, self.values[kept], self.sigma[kept])


@dataclass(frozen=True)
class NetworkReadings:
    """All readings of a network and the lists that they refer to."""

    instruments: Mapping[str, NetworkInstrument]
    points: KnownPoints
    stations: Stations
    sightings: PolarSightings
    lengths: Lengths | None
    bars: Lengths | None
    heights: Lengths | None
    setups: tuple[tuple[str, ...], Array, Array]
    """Names, heights and sigmas of the targets' set-ups; the first is for targets without one"""
    warnings: tuple[str, ...] = ()
    stuck: tuple[str, ...] = ()
    """Readings of one station that stay the same, in words"""

    def without(self, sightings: tuple[Index, Index], others: Mapping[str, Index]) -> NetworkReadings:
        """Return the readings without some components of sightings (component, row), and rows of `lengths` ..."""
        values = self.sightings.values.copy()
        values[sightings] = np.nan
        fewer: dict[str, Any] = {}
        for name, rows in others.items():
            pairs: Lengths | None = getattr(self, name)
            fewer[name] = None if pairs is None else pairs.without(rows)
        return replace(self, sightings=replace(self.sightings, values=values), **fewer)

    def of(self, station: int) -> NetworkInstrument:
        """Return the instrument of a station."""
        return self.instruments[list(self.instruments)[self.stations.instrument[station]]]

    @cached_property
    def levelled(self) -> Mask:
        """Which stations have a vertical standing axis, (stations,)."""
        return np.array([self.of(i).is_levelled for i in range(len(self.stations.names))], dtype=bool)

    def local(self, rows: Index, values: Array) -> Array:
        """Return where whole sightings put their points, from the origin of the instrument, (n, 3).

        `values` (3, n) are azimuth, elevation and distance of the sightings in some rows. Heights of targets are taken
        along the standing axis, as a start needs them.
        """
        places = cartesian(values)[0].T
        places[:, 2] -= self.raised(rows)
        return places

    def raised(self, rows: Index) -> Array:
        """Return the heights of the targets above their points, (n,) mm."""
        return np.asarray(self.sightings.height[rows] + self.setups[1][self.sightings.setup[rows]])


def read(settings: Settings, files: Files) -> NetworkReadings:
    """Return the readings of a network; raises InputError that lists every fault."""
    known = known_points(files)
    names = known.names
    with all_faults() as each:
        with each():
            stations = stations_of(settings, files, names)
        with each():
            refuse_pairs(files.sightings)
    with all_faults() as each:
        with each():
            setups = _setups(files.setups)
        with each():
            sightings = sightings_of(settings, files.sightings, stations, names, setups[0])
        with each():
            lengths = _lengths(settings, files.lengths, stations, names)
        with each():
            bars = _between(files.bars, "length", names)
        with each():
            heights = _between(files.heights, "dh", names)
        with each():
            if settings.datum_points is not None:
                _must_be_points(settings.datum_points, names)
    readings = NetworkReadings(settings.instruments, known, stations, sightings, lengths, bars, heights, setups)
    return _with_warnings(readings)


def _setups(table: Table | None) -> tuple[tuple[str, ...], Array, Array]:
    if table is None:
        return ("",), np.zeros(1), np.zeros(1)
    refuse(table, negative(table, "sigma"))
    names = ("", *table.texts("setup"))
    return names, np.append(0.0, table.numbers("height")), np.append(0.0, table.numbers("sigma"))


def _lengths(settings: Settings, table: Table | None, stations: Stations, names: Sequence[str]) -> Lengths | None:
    if table is None or not len(table):
        return None
    with all_faults() as each:
        with each():
            station = matched(table, "station", stations.names, "the stations")
        with each():
            point = matched(table, "point", names, "the points")
    chosen = list(settings.instruments.values())
    kinds = np.array([chosen[i].type == INTERFEROMETER for i in stations.instrument])
    absolute = np.array([chosen[i].measures == "absolute" for i in stations.instrument])
    values = table.numbers("length")
    refuse(
        table,
        {
            "the station is not one of an interferometer": ~kinds[station],
            "an absolute distance is not above zero": absolute[station] & (values <= 0),
        },
    )
    return Lengths(table, station, point, values, np.full(len(values), np.nan))


def _between(table: Table | None, column: str, names: Sequence[str]) -> Lengths | None:
    """Return calibrated lengths or height differences between two points."""
    if table is None or not len(table):
        return None
    first, second = (matched(table, end, names, "the points") for end in ("from", "to"))
    values, sigma = table.numbers(column), table.numbers("sigma")
    refuse(
        table,
        {
            "both ends are the same point": first == second,
            "the standard deviation is not above zero": sigma <= 0,
            "a calibrated length is not above zero": np.asarray((values <= 0) & (column == "length")),
        },
    )
    return Lengths(table, first, second, values, sigma)


def _must_be_points(chosen: Iterable[str], names: Sequence[str]) -> None:
    known = set(names)
    unmatched = [name for name in chosen if name not in known]
    if unmatched:
        raise InputError(f"datum_points: no file names the points {listed(unmatched)}")


def _with_warnings(readings: NetworkReadings) -> NetworkReadings:
    used = set(readings.sightings.station.tolist()) | set(
        [] if readings.lengths is None else readings.lengths.first.tolist()
    )
    idle = [name for i, name in enumerate(readings.stations.names) if i not in used]
    lines = [f"stations without a reading are left out: {listed(idle)}"] if idle else []
    seen, names, stuck = readings.sightings, readings.stations.names, list[str]()
    sigma = n.declared(readings.instruments, readings.stations.instrument[seen.station], seen.values, seen.sigma)
    for columns, declared in zip((("az", "hz"), ("el", "zd"), ("d",)), sigma, strict=True):
        for name in columns:
            stuck += sticking(seen.table, name, (seen.station, seen.point), names, declared)
    return replace(readings, warnings=tuple(lines), stuck=tuple(stuck))


@dataclass(frozen=True)
class KnownPoints:
    """All points of a network, with their listed places and how well these are known."""

    names: tuple[str, ...]
    listed: Array
    """(points, 3) mm, nan for a point that is in no list"""
    sigma: Array
    """(points, 3): 0 exact, a number a prior, nan unknown"""
    covariance: Array | None = None
    """Joint covariance of the coordinates `given`, (k, k)"""
    given: tuple[Index, Index] = field(default_factory=lambda: (np.zeros(0, dtype=np.intp),) * 2)
    """Points and columns of the coordinates with a joint covariance, (k,) each"""

    @property
    def count(self) -> int:
        """Number of points."""
        return len(self.names)


def known_points(files: Files) -> KnownPoints:
    """Return all points that a file names: those of the list come first; raises InputError that lists every fault."""
    return _with_covariance(KnownPoints(*_points(files)), files)


def _points(files: Files) -> tuple[tuple[str, ...], Array, Array]:
    """Return names, listed places and sigmas of all points that a file names: those of the list come first."""
    table, sigma = _table_of_points(files.points), np.zeros((0, 3))
    names: list[str] = []
    place = np.zeros((0, 3))
    if table is not None:
        names, place = list(table.texts("point")), table.stacked("xyz")
        sigma = sigmas(table) if not isinstance(files.points, Result) else _spread(files.points, len(names))
    columns = [(files.sightings, "point"), (files.lengths, "point"), (files.bars, "from"), (files.bars, "to")]
    columns += [(files.heights, "from"), (files.heights, "to"), (files.stations, "over")]
    known = set(names)
    every = [table.texts(column) for table, column in columns if table is not None and column in table]
    more = [name for name in dict.fromkeys(name for names in every for name in names) if name and name not in known]
    unknown = np.full((len(more), 3), np.nan)
    return (*names, *more), np.concatenate([place, unknown]), np.concatenate([sigma, unknown])


def _table_of_points(points: Table | Result | None) -> Table | None:
    if not isinstance(points, Result):
        return points
    if "points" not in points.tables:
        raise InputError("the result among the inputs has no table of points: a camera needs `rig: network`")
    return points.tables["points"]


def _spread(points: Result, count: int) -> Array:
    """Return the standard uncertainties of the points of a result; nan where it has none."""
    whole = points.arrays.get(POINTS_COVARIANCE)
    return np.full((count, 3), np.nan) if whole is None else np.sqrt(np.einsum("nkk->nk", np.asarray(whole)))


def _with_covariance(known: KnownPoints, files: Files) -> KnownPoints:
    """Return the points with the joint covariance of their given coordinates, if a file or a result has one."""
    if isinstance(files.points, Result):
        return _joint_of_result(known, files.points)
    table = files.covariance
    if table is None:
        return known
    ends = []
    with all_faults() as each:
        for end in "ab":
            with each():
                point = matched(table, f"point_{end}", known.names, "the points")
                axis = matched(table, f"axis_{end}", ("x", "y", "z"), "x, y, z")
                ends.append(3 * point + axis)
    entries = np.unique(np.concatenate(ends))
    matrix = np.zeros((len(entries), len(entries)))
    first, second = (np.searchsorted(entries, end) for end in ends)
    matrix[first, second] = matrix[second, first] = table.numbers("covariance_mm2")
    member, column = np.divmod(entries, 3)
    missing = np.isnan(known.sigma[member, column])
    if missing.any():
        what = [f"{known.names[i]} {'xyz'[k]}" for i, k in zip(member[missing], column[missing], strict=True)]
        raise InputError([table.fault(f"coordinates without a sigma in the list of points: {listed(what, 5)}")])
    if not (np.linalg.eigvalsh(matrix) > 0).all():
        raise InputError(
            [table.fault("the covariance is not positive definite", "check its signs, and that each variance is there")]
        )
    return KnownPoints(known.names, known.listed, known.sigma, matrix, (member, column))


_HELD = 1e-6
"""Variance of a motion that a datum holds, relative to the mean variance of the coordinates"""


def _joint_of_result(known: KnownPoints, points: Result) -> KnownPoints:
    if POINTS_COVARIANCE not in points.arrays:
        return known
    joint = points_of(points).joint
    rows = np.arange(len(joint))
    # a datum holds the motions of a free network exactly; here they are known to a thousandth of its coordinates
    joint[rows, rows] += _HELD * np.trace(joint) / max(len(joint), 1)
    if not (np.linalg.eigvalsh(joint) > 0).all():
        return known
    return KnownPoints(known.names, known.listed, known.sigma, joint, (rows // 3, rows % 3))
