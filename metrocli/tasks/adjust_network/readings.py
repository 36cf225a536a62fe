"""The readings of a network, finished: names are numbers, angles are those of face 1, faults are found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field, replace

import numpy as np

from metrocli.arrays import Array, Index, Mask
from metrocli.errors import InputError, all_faults
from metrocli.frozen import dataclass
from metrocli.result import Result
from metrocli.table import ABSENT, Table
from metrocli.tasks.adjust_network.settings import INTERFEROMETER, Files, Instrument, Settings
from metrocli.tasks.shared.lists import matched, refuse, sigmas
from metrocli.uncertainty.predicted import POINTS_COVARIANCE
from metrocli.words import listed

_PAIRS = (("az", "hz"), ("el", "zd"))
QUANTITIES = ("az", "el", "d")
"""Columns of what a polar instrument reads, in the order of `metrocli.instruments.polar`"""


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


@dataclass(frozen=True)
class Stations:
    """The set-ups of the instruments."""

    names: tuple[str, ...]
    instrument: Index
    """(stations,)"""
    over: Index
    """Point over which a station stands, -1 if none, (stations,)"""
    height: Array
    sigma_height: Array
    """0 known, a number a prior, nan unknown"""
    centring: Array
    listed: Array
    """Approximate places, (stations, 3), nan if not listed"""


@dataclass(frozen=True)
class Sightings:
    """What trackers and total stations read, as in face 1."""

    table: Table
    station: Index
    point: Index
    values: Array
    """Azimuth (counter-clockwise), elevation and distance, (3, n), nan where it was not read"""
    sigma: Array
    """Standard deviations in columns of the file, (3, n), nan where the noise of the instrument holds"""
    face: Array
    """1 or -1, (n,)"""
    orientation: Index
    """Round of each sighting, among those of all levelled stations"""
    rounds: tuple[tuple[int, str], ...]
    """Station and name of each round"""
    setup: Index
    """Set-up of the target, 0 for none"""
    height: Array
    """Known height of the target above its point"""

    @property
    def raised(self) -> Mask:
        """Sightings whose target stands above its point."""
        return np.asarray((self.setup > 0) | (self.height != 0))


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
        chosen = (one[kept] for one in (self.first, self.second, self.values, self.sigma))
        return Lengths(rows_of(self.table, kept), *chosen)


@dataclass(frozen=True)
class Readings:
    """All readings of a network and the lists that they refer to."""

    instruments: Mapping[str, Instrument]
    points: KnownPoints
    stations: Stations
    sightings: Sightings
    lengths: Lengths | None
    bars: Lengths | None
    heights: Lengths | None
    setups: tuple[tuple[str, ...], Array, Array]
    """Names, heights and sigmas of the targets' set-ups; the first is for targets without one"""
    warnings: tuple[str, ...] = ()

    def without(self, sightings: tuple[Index, Index], others: Mapping[str, Index]) -> Readings:
        """Return the readings without some components of sightings (component, row), and rows of `lengths` ..."""
        values = self.sightings.values.copy()
        values[sightings] = np.nan
        fewer: dict[str, Lengths | None] = {}
        for name, rows in others.items():
            pairs: Lengths | None = getattr(self, name)
            fewer[name] = None if pairs is None else pairs.without(rows)
        return replace(self, sightings=replace(self.sightings, values=values), **fewer)

    def of(self, station: int) -> Instrument:
        """Return the instrument of a station."""
        return self.instruments[list(self.instruments)[self.stations.instrument[station]]]


def read(settings: Settings, files: Files) -> Readings:
    """Return the readings of a network; raises InputError that lists every fault."""
    points = _points(files)
    with all_faults() as each:
        with each():
            names, place, sigma = points
            known = KnownPoints(names, place, sigma)
            known = _with_covariance(known, files)
        with each():
            stations = _stations(settings, files, names)
        with each():
            _one_of_a_pair(files.readings)
    with all_faults() as each:
        with each():
            setups = _setups(files.setups)
        with each():
            sightings = _sightings(settings, files.readings, stations, names, setups[0])
        with each():
            lengths = _lengths(settings, files.lengths, stations, names)
        with each():
            bars = _between(files.bars, "length", names)
        with each():
            heights = _between(files.heights, "dh", names)
        with each():
            if settings.datum_points is not None:
                _must_be_points(settings.datum_points, names)
    found = Readings(settings.instruments, known, stations, sightings, lengths, bars, heights, setups)
    return _with_warnings(found, files)


def _points(files: Files) -> tuple[tuple[str, ...], Array, Array]:
    """Return names, listed places and sigmas of all points that a file names: those of the list come first."""
    table, sigma = _table_of_points(files.points), np.zeros((0, 3))
    names: list[str] = []
    place = np.zeros((0, 3))
    if table is not None:
        names, place = list(table.texts("point")), table.stacked("xyz")
        sigma = sigmas(table) if not isinstance(files.points, Result) else _spread(files.points, len(names))
    columns = [(files.readings, "point"), (files.lengths, "point"), (files.bars, "from"), (files.bars, "to")]
    columns += [(files.heights, "from"), (files.heights, "to")]
    every = [table.texts(column) for table, column in columns if table is not None and column in table]
    more = [name for name in dict.fromkeys(name for one in every for name in one) if name not in set(names)]
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
    first, second = (np.searchsorted(entries, one) for one in ends)
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


def _joint_of_result(known: KnownPoints, points: Result) -> KnownPoints:
    from metrocli.uncertainty.predicted import points_of

    if POINTS_COVARIANCE not in points.arrays:
        return known
    places, n = points_of(points), len(points.tables["points"])
    common = places.common.reshape(3 * n, -1)
    joint = common @ places.core @ common.T
    for i in range(n):
        joint[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += places.own[i]
    if not (np.linalg.eigvalsh(joint) > 1e-9 * np.trace(joint) / len(joint)).all():
        return known
    rows = np.arange(3 * n)
    return KnownPoints(known.names, known.listed, known.sigma, joint, (rows // 3, rows % 3))


def _stations(settings: Settings, files: Files, names: Sequence[str]) -> Stations:
    table = files.stations
    if not len(table):
        raise InputError([table.fault("there is no station", "list each set-up: station,instrument")])
    n = len(table)
    with all_faults() as each:
        with each():
            instrument = matched(table, "instrument", list(settings.instruments), "`instruments:`")
        with each():
            over = np.full(n, -1, dtype=np.intp)
            rows = np.array([i for i, one in enumerate(_texts(table, "over")) if one], dtype=np.intp)
            if rows.size:
                over[rows] = matched(rows_of(table, rows), "over", names, "the points")
    chosen = list(settings.instruments.values())
    levelled = np.array([chosen[i].is_levelled for i in instrument])
    height = table.numbers("height", np.nan)
    refuse(
        table,
        {
            "a station over a point needs an instrument that is levelled": (over >= 0) & ~levelled,
            "a station over a point needs a height_mm": (over >= 0) & np.isnan(height),
            "a standard deviation is negative": table.numbers("sigma_height", 0.0) < 0,
        },
    )
    place = np.stack([table.numbers(axis, np.nan) for axis in "xyz"], axis=1)
    centring = np.nan_to_num(table.numbers("centring", 0.0))
    return Stations(
        tuple(table.texts("station")), instrument, over, height, table.numbers("sigma_height", 0.0), centring, place
    )


def _texts(table: Table, column: str) -> list[str]:
    return table.texts(column) if column in table else [""] * len(table)


def rows_of(table: Table, rows: Index | Mask) -> Table:
    """Return some rows of a table, with their lines."""
    lines = [table.lines[i] for i in np.arange(len(table))[rows]] if table.lines else ()
    return Table({name: one[rows] for name, one in table.columns.items()}, table.units, table.file, lines)


def _one_of_a_pair(table: Table) -> None:
    faults = [
        table.fault(f"the file has both '{a}' and '{b}'", f"keep one: {a} or {b}")
        for a, b in _PAIRS
        if a in table and b in table
    ]
    if faults:
        raise InputError(faults)


def _setups(table: Table | None) -> tuple[tuple[str, ...], Array, Array]:
    if table is None:
        return ("",), np.zeros(1), np.zeros(1)
    refuse(table, {"a standard deviation is negative": table.numbers("sigma") < 0})
    names = ("", *table.texts("setup"))
    return names, np.append(0.0, table.numbers("height")), np.append(0.0, table.numbers("sigma"))


def _sightings(
    settings: Settings, table: Table, stations: Stations, names: Sequence[str], setups: tuple[str, ...]
) -> Sightings:
    if table is ABSENT or not len(table):
        nothing = np.zeros(0, dtype=np.intp)
        none = np.zeros((3, 0))
        return Sightings(table, nothing, nothing, none, none, np.zeros(0), nothing, (), nothing, np.zeros(0))
    n = len(table)
    with all_faults() as each:
        with each():
            station = matched(table, "station", stations.names, "the stations")
        with each():
            point = matched(table, "point", names, "the points")
        with each():
            setup = np.zeros(n, dtype=np.intp)
            rows = np.array([i for i, one in enumerate(_texts(table, "setup")) if one], dtype=np.intp)
            if rows.size:
                setup[rows] = matched(rows_of(table, rows), "setup", setups[1:], "the set-ups") + 1
    values, face = _reduced(table)
    _refuse_sightings(table, values, [settings.instruments[name] for name in settings.instruments], stations, station)
    sigma = np.stack([_sigma(table, *pair) for pair in (("az", "hz"), ("el", "zd"), ("d", "d"))])
    orientation, rounds = _rounds(_texts(table, "round"), station)
    height = np.nan_to_num(table.numbers("th", 0.0))
    return Sightings(table, station, point, values, sigma, face, orientation, rounds, setup, height)


def _sigma(table: Table, name: str, other: str) -> Array:
    return table.numbers(f"sigma_{name}" if f"sigma_{name}" in table else f"sigma_{other}", np.nan)


def _reduced(table: Table) -> tuple[Array, Array]:
    """Return azimuth, elevation and distance as in face 1, (3, n), and the face, 1 or -1.

    Raw angles of face 2 have a zenith distance above 180 deg: `zd := 360 deg - zd`, `hz := hz - 180 deg`.
    """
    given = table.numbers("face", 1.0)
    refuse(table, {"the face is 1 or 2": np.asarray(~np.isin(np.where(np.isnan(given), 1.0, given), (1.0, 2.0)))})
    azimuth = table.numbers("az") if "az" in table else -table.numbers("hz", np.nan)
    zenith = np.pi / 2 - table.numbers("el") if "el" in table else table.numbers("zd", np.nan)
    over = zenith > np.pi if "zd" in table else zenith < 0
    raw = np.asarray(np.nan_to_num(np.where(over, 1.0, 0.0)) > 0)
    zenith = np.where(raw, 2 * np.pi - zenith if "zd" in table else -zenith, zenith)
    azimuth = np.where(raw, azimuth + np.pi, azimuth)
    face = np.where((given == 2.0) | raw, -1.0, 1.0)
    return np.stack([azimuth, np.pi / 2 - zenith, table.numbers("d", np.nan)]), face


def _refuse_sightings(
    table: Table, values: Array, instruments: Sequence[Instrument], stations: Stations, station: Index
) -> None:
    kinds = np.array([instruments[i].type == INTERFEROMETER for i in stations.instrument])
    azimuth, elevation, distance = values
    refuse(
        table,
        {
            "a distance is not above zero": np.asarray(distance <= 0),
            "nothing was read": np.asarray(np.isnan(values).all(axis=0)),
            "an interferometer reads lengths, which stand in the file `lengths`": kinds[station],
            "the vertical angle is outside the sphere": np.asarray(np.abs(elevation) > np.pi / 2 + 1e-9),
        },
    )


def _rounds(names: Iterable[str], station: Index) -> tuple[Index, tuple[tuple[int, str], ...]]:
    """Return the number of the round of each sighting, and station and name of each round."""
    numbers: dict[tuple[int, str], int] = {}
    of = [numbers.setdefault(one, len(numbers)) for one in zip(station.tolist(), names, strict=True)]
    return np.array(of, dtype=np.intp), tuple(numbers)


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
    strange = [name for name in chosen if name not in set(names)]
    if strange:
        raise InputError(f"datum_points: no file names the points {listed(strange)}")


def _with_warnings(found: Readings, files: Files) -> Readings:
    used = set(found.sightings.station.tolist()) | set([] if found.lengths is None else found.lengths.first.tolist())
    idle = [name for i, name in enumerate(found.stations.names) if i not in used]
    lines = (f"stations without a reading are left out: {listed(idle)}",) if idle else ()
    return replace(found, warnings=lines)
