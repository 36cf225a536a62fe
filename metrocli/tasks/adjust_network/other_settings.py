"""What may be wrong in the files of a network beside units and axes: angles of other sorts, names and signs exchanged.

Exchanged names and signs are found at the rough places of the start, which single wrong rows do not spoil.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, product

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.diagnosis.corrections import Mistake, size_of_unit
from metrocli.errors import MetrocliError
from metrocli.instruments.tracker import AZIMUTH, DISTANCE, ELEVATION
from metrocli.table import Table
from metrocli.tasks.adjust_network.readings import NetworkReadings, read
from metrocli.tasks.adjust_network.settings import Files, Settings
from metrocli.tasks.adjust_network.starts.agreement import NetworkStart, disagreement, list_offset, medians, placed
from metrocli.tasks.adjust_network.starts.conventions import in_units, other_conventions, written_otherwise
from metrocli.tasks.adjust_network.starts.search import start
from metrocli.tasks.job import Job
from metrocli.words import in_a_row, listed

_GON = 0.9
"""Degrees in a gon"""
_NEAR, _FAR = 0.1, 0.5
"""Shares of the distance of two points: exchanged ones are so near to each other's place, and so far from their own"""
_RIGHT = 0.005
"""Share of the extent by which set-ups and list disagree at most where angles are of the right sort"""
_MOST = 20
"""Most corrections of one sort that are tried"""
_CLOSE = 0.05
"""Share of a height difference to which one of the other sign agrees with the rough places"""
_ALIKE = 0.02
"""Two readings of a point from one station agree so well: distances as a share, azimuths in rad"""
_ANGLES = ("az", "hz", "el", "zd")
_PAIRS = (
    ("az", "hz", "counts clockwise", "handed"),
    ("hz", "az", "counts counter-clockwise", "handed"),
    ("el", "zd", "is a zenith distance", "zenith"),
    ("zd", "el", "is an elevation", "zenith"),
)
"""Columns of angles, what they may be instead, in words, and the sort of the mistake"""
_Other = tuple[Mistake, Job[Settings, Files]]


def other_settings(job: Job[Settings, Files], fits: bool) -> Iterator[_Other]:
    """Yield what may be wrong in the files, each with the job that is right then; nothing for readings that fit."""
    if fits:
        return
    try:
        readings = read(job.settings, job.files)
    except MetrocliError:
        yield from _angles(job)
        return
    yield from _faces(job, readings)
    yield from _conventions(job, readings)
    for mistake, changed in written_otherwise(job.files.sightings, readings.sightings.values[ELEVATION]):
        yield _with(job, mistake, changed)
    rough = _started(readings)
    if rough is not None:
        yield from _exchanged(job, readings, rough)
        yield from _heights(job, readings, rough)
    yield from _stations(job, readings)
    if rough is None or not (max(disagreement(readings, rough)[0], list_offset(readings, rough)) < _RIGHT):
        yield from _angles(job)


def _started(readings: NetworkReadings) -> NetworkStart | None:
    try:
        return start(readings)
    except MetrocliError:
        return None


def _angles(job: Job[Settings, Files]) -> Iterator[_Other]:
    """Yield angles in gon, clockwise azimuths, and zenith distances for elevations."""
    table = job.files.sightings
    angles = [name for name in _ANGLES if name in table]
    each = ([name] for name in angles if angles[1:])
    for names, (symbol, factor) in product((angles, *each), (("gon", _GON), ("deg", 1 / _GON))):
        if all(table.headings.get(name, f"{name}_deg").endswith("gon") == (symbol == "deg") for name in names):
            words = f"{in_a_row(names)} are in {symbol}" if names[1:] else f"{names[0]} is in {symbol}"
            write = f"{in_a_row([f'{name}_{symbol}' for name in names])} in the heading"
            changed = {name: table.numbers(name) * factor for name in names}
            yield _with(job, Mistake("readings", words, write, file=table.file, sort="angles", columns=0), changed)
    for name, other, words, sort in _PAIRS:
        if name in table:
            write = f"{other} in the heading"
            mistake = Mistake("readings", f"{name} {words}", write, file=table.file, sort=sort, columns=0)
            yield mistake, job.with_files(readings=_renamed(table, name, other))


def _renamed(table: Table, name: str, other: str) -> Table:
    """Return a table with another name of a column of angles, and of their standard deviations."""
    names = {name: other, f"sigma_{name}": f"sigma_{other}"}
    columns = {names.get(key, key): column for key, column in table.columns.items()}
    return replace(table, columns=columns, units={names.get(key, key): unit for key, unit in table.units.items()})


def _with(job: Job[Settings, Files], mistake: Mistake, changed: dict[str, Array]) -> _Other:
    return mistake, job.with_files(readings=job.files.sightings.changed(changed))


def _exchanged(job: Job[Settings, Files], readings: NetworkReadings, rough: NetworkStart) -> Iterator[_Other]:
    """Yield points whose names are exchanged at a station or in the list, and rows with the name of another point."""
    seen, names, stations = readings.sightings, readings.points.names, readings.stations.names
    rows, places = placed(readings, rough)
    exchanged: dict[tuple[int, int], list[int]] = {}
    count = readings.points.count
    # one vote of each station and of the list: two faces are not two witnesses of a name
    votes = medians(places, seen.station[rows] * count + seen.point[rows], len(stations) * count)
    votes = np.concatenate([votes.reshape(-1, count, 3), readings.points.listed[None]])
    for station in np.unique(seen.station[rows]).tolist():
        here = seen.station[rows] == station
        # its own sightings would move the points, of two stations half the way
        others = np.delete(votes, station, axis=0).reshape(-1, 3)
        known = np.flatnonzero(np.isfinite(others).all(axis=1))
        wrong = _renamed_rows(seen.point, rows[here], places[here], medians(others[known], known % count, count))
        for (first, second), lines in wrong.items():
            if (second, first) not in wrong:
                where = listed([f"line {seen.table.lines[row]}" for row in lines]) if seen.table.lines else "its row"
                words = f"{names[first]} at station {stations[station]} is {names[second]}, {where}"
                mistake = _exchange("readings", words, f"{names[second]} for {names[first]} in {where}", seen.table)
                texts = np.array(seen.table.texts("point"), dtype=object)
                texts[lines] = names[second]
                yield mistake, job.with_files(readings=seen.table.changed({"point": texts.astype(str)}))
            elif first < second:
                exchanged.setdefault((first, second), []).append(station)
    for (first, second), at in exchanged.items():
        pair, where = (names[first], names[second]), stations[at[0]]
        # two stations alone do not show which of them is wrong
        words = f"{pair[0]} and {pair[1]} are exchanged at station {' or '.join(stations[i] for i in at)}"
        write = f"{pair[1]} for {pair[0]} and {pair[0]} for {pair[1]} in the rows of {where}"
        mistake = _exchange("readings", words, write, seen.table)
        yield mistake, job.with_files(readings=_swapped(seen.table, pair, where))
    table = job.files.points
    if not isinstance(table, Table):
        return
    middle = medians(places, seen.point[rows], count)
    for first, second in _pairs(readings.points.listed, middle):
        pair = names[first], names[second]
        yield _exchange("points", *_in_words(*pair), table), job.with_files(points=_swapped(table, pair))
        # the list is right where lengths, bars or heights, which name points too, agree with it
        mistake = _exchange("readings", *_in_words(*pair), seen.table)
        yield mistake, job.with_files(readings=_swapped(seen.table, pair))


def _renamed_rows(point: Index, rows: Index, places: Array, middle: Array) -> dict[tuple[int, int], list[int]]:
    """Return the sightings that stand near another point (at `middle`) than their own, by both points."""
    own = middle[point[rows]]
    off = np.nan_to_num(np.linalg.norm(places - own, axis=1))
    found: dict[tuple[int, int], list[int]] = {}
    for i in np.argsort(-off, kind="stable")[:_MOST].tolist():
        share = np.linalg.norm(places[i] - middle, axis=1) / np.maximum(np.linalg.norm(own[i] - middle, axis=1), 1e-9)
        share[point[rows[i]]] = np.nan
        if np.nanmin(share, initial=np.inf) < _NEAR:
            found.setdefault((int(point[rows[i]]), int(np.nanargmin(share))), []).append(int(rows[i]))
    return found


def _exchange(key: str, words: str, write: str, table: Table) -> Mistake:
    return Mistake(key, words, write, file=table.file, sort="exchanged", columns=0)


def _in_words(first: str, second: str) -> tuple[str, str]:
    """Return that two names are exchanged, and what to write."""
    return f"{first} and {second} are exchanged", f"{second} for {first} and {first} for {second}"


def _faces(job: Job[Settings, Files], readings: NetworkReadings) -> Iterator[_Other]:
    """Yield azimuths of face 2 that are raw beside reduced elevations, which mark no face.

    A station reads such a point a second time half a turn away.
    """
    seen, table = readings.sightings, job.files.sightings
    azimuth = next((name for name in ("az", "hz") if name in table), "")
    # the rows of a point in a round follow each other, in the order of the file
    order = np.lexsort((np.arange(len(seen.point)), seen.point, seen.orientation))
    same = (np.diff(seen.point[order]) == 0) & (np.diff(seen.orientation[order]) == 0)
    first, second = order[:-1][same], order[1:][same]
    turn = np.abs(np.angle(np.exp(1j * (seen.values[0, second] - seen.values[0, first]))))
    near = np.isclose(seen.values[DISTANCE, second], seen.values[DISTANCE, first], rtol=_ALIKE, equal_nan=True)
    raw = second[(turn > np.pi - _ALIKE) & near]
    if not azimuth or not raw.size or 2 * raw.size < first.size:
        return
    marked = "" if (seen.face[raw] < 0).all() else ", and face 2 is not marked,"
    words = f"{azimuth} of face 2 is raw{marked} in {raw.size} rows"
    write = f"{azimuth} minus half a turn and 2 in the column face"
    values, face = table.numbers(azimuth).copy(), table.numbers("face", 1.0).copy()
    values[raw] -= np.pi
    face[raw] = 2.0
    mistake = Mistake("readings", words, write, file=table.file, sort="faces", columns=0)
    yield _with(job, mistake, {azimuth: values, "face": face})


def _conventions(job: Job[Settings, Files], readings: NetworkReadings) -> Iterator[_Other]:
    """Yield stations whose angles or distances are of another sort than those of the others."""
    table = job.files.sightings
    columns = [next((name for name in names if name in table), "") for names in (("az", "hz"), ("el", "zd"), ("d",))]
    sizes = [size_of_unit(table, name) if name else 0.0 for name in columns]
    units = [
        convention
        for components in ((AZIMUTH, ELEVATION), (AZIMUTH,), (ELEVATION,), (DISTANCE,))
        if len(size := {sizes[component] for component in components}) == 1 and all(size)
        for convention in in_units(components, *size)
    ]
    for stations, convention in other_conventions(readings, "zd" in table, units):
        names = [readings.stations.names[station] for station in stations]
        here = np.isin(table.texts("station"), names)
        own = [columns[component] for component in convention.components]
        what = f"{in_a_row(own)} of {in_a_row(names)}"
        mistake = Mistake(
            "readings", f"{what} {convention.words}", f"{what} {convention.write}", convention.shrinks,
            file=table.file, sort="conventions", columns=0,
        )  # fmt: skip
        changed = {name: np.where(here, convention.read(table.numbers(name)), table.numbers(name)) for name in own}
        yield _with(job, mistake, changed)


def _stations(job: Job[Settings, Files], readings: NetworkReadings) -> Iterator[_Other]:
    """Yield stations over marks, of which each stands over the mark of the other where its sightings place it."""
    stations, table = readings.stations, job.files.stations
    if (stations.over >= 0).sum() < 2:
        return
    # placed by sightings alone: over its mark a station could be nowhere else
    free = replace(readings, stations=replace(stations, over=np.full_like(stations.over, -1)))
    rough = _started(free)
    if rough is None:
        return
    rows, places = placed(free, rough)
    middle = medians(places, readings.sightings.point[rows], readings.points.count)
    marks = np.where(np.isfinite(middle), middle, readings.points.listed)[stations.over]
    marks[stations.over < 0] = np.nan
    feet = rough.poses[:, :3] * [1.0, 1.0, 0.0]
    for first, second in _pairs(feet, marks * [1.0, 1.0, 0.0]):
        names = stations.names[first], stations.names[second]
        changed = _swapped(table, names, column="station")
        yield _exchange("stations", *_in_words(*names), table), job.with_files(stations=changed)


def _pairs(own: Array, middle: Array) -> Iterator[tuple[int, int]]:
    """Yield pairs of points of which each stands near the place of the other, and far from its own."""
    off = np.linalg.norm(own - middle, axis=1)
    worst = np.argsort(-np.nan_to_num(off))[:_MOST].tolist()
    for first, second in combinations(worst, 2):
        apart = float(np.linalg.norm(middle[first] - middle[second]))
        crossed = [np.linalg.norm(own[a] - middle[b]) for a, b in ((first, second), (second, first))]
        if min(off[first], off[second]) > _FAR * apart and max(crossed) < _NEAR * apart:
            yield min(first, second), max(first, second)


def _swapped(table: Table, names: tuple[str, str], station: str = "", column: str = "point") -> Table:
    """Return a table with two names exchanged, at one station if it is named."""
    texts = np.array(table.texts(column), dtype=object)
    here = np.array(table.texts("station")) == station if station else np.ones(len(table), dtype=bool)
    changed = texts.copy()
    changed[here & (texts == names[0])] = names[1]
    changed[here & (texts == names[1])] = names[0]
    return table.changed({column: changed.astype(str)})


def _heights(job: Job[Settings, Files], readings: NetworkReadings, rough: NetworkStart) -> Iterator[_Other]:
    """Yield height differences of the other sign: all of them, or single lines."""
    heights, table = readings.heights, job.files.heights
    if heights is None or table is None:
        return
    rise = rough.points[heights.second, 2] - rough.points[heights.first, 2]
    size = np.abs(heights.values)
    wrong = np.flatnonzero((np.abs(heights.values + rise) < _CLOSE * size) & (np.abs(heights.values - rise) > size))
    if len(wrong) == len(rise):
        write = "to for from and from for to in the heading"
        yield Mistake("heights", "dh has the wrong sign", write, sort="heights", columns=0), _turned(job, table, wrong)
        return
    for row in wrong[:_MOST].tolist():
        names = f"{table.texts('from')[row]} to {table.texts('to')[row]}"
        line = f", line {table.lines[row]}" if table.lines else ""
        words, write = f"the height difference from {names} has the wrong sign{line}", "it with the other sign"
        yield Mistake("heights", words, write, file=table.file, sort="heights"), _turned(job, table, np.array([row]))


def _turned(job: Job[Settings, Files], table: Table, rows: Index) -> Job[Settings, Files]:
    values = table.numbers("dh").copy()
    values[rows] *= -1
    return job.with_files(heights=table.changed({"dh": values}))
