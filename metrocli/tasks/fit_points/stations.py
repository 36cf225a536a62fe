"""Points of several stations: each is laid onto the places of the stations joined before, or onto nominal ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.errors import InputError, UndeterminedError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.table import Table
from metrocli.tasks.fit_points.listed import Spread, listed_points
from metrocli.tasks.fit_points.problem import Places, PointPairs
from metrocli.tasks.fit_points.settings import Files, Settings
from metrocli.tasks.fit_points.start import mirrored, similarity
from metrocli.tasks.shared.lists import refuse
from metrocli.words import counted, listed

_FEWEST = 3
"""Common points that join a station"""
_ON_A_LINE = 1e-6
"""Width of points on a line, relative to their length"""


@dataclass(frozen=True)
class StationPoints:
    """Stations with their points, for the join."""

    names: tuple[str, ...]
    places: tuple[str, ...]
    points: Array
    """Measured points (n, 3)"""
    station: Index
    of: Index
    """Place of each measured point"""
    scaled: bool


def stations_of(settings: Settings, files: Files) -> PointPairs:
    """Return the points of several stations with starting values.

    Raises InputError for faults of the lists, UndeterminedError for stations that common points do not join.
    """
    points, spread = listed_points(files.points)
    if settings.features:
        raise InputError(
            [points.fault("features are laid through points of one frame: leave out the column 'station'")]
        )
    refuse(points, {"a station measures, so no coordinate is exact (sigma 0)": (spread.sigma == 0).any(axis=1)})
    places, warnings = _places(points, files)
    names, station = _numbered(points.texts("station"))
    if len(names) < 2 and files.nominal is None:
        text = f"all points are of station {names[0]}: there is nothing to lay it onto"
        raise InputError([points.fault(text, "name the `nominal` points, or give the points of another station")])
    given = StationPoints(names, places.names, points.stacked("xyz"), station, places.of, settings.scale)
    values, pose, scale = _joined(given, places.values, files.nominal is None)
    return PointPairs(
        tuple(points.texts("point")),
        given.points,
        values[places.of],
        spread,
        np.full(given.points.shape, np.nan),
        settings.scale,
        settings.noise,
        points,
        spread,
        warnings,
        Places(places.names, values, places.free, places.of, places.spread),
        names,
        station,
        files.nominal is None,
        (pose, scale),
    )


def _numbered(texts: Sequence[str]) -> tuple[tuple[str, ...], Index]:
    """Return the different texts in their order, and the number of each."""
    number = {text: i for i, text in enumerate(dict.fromkeys(texts))}
    return tuple(number), np.array([number[text] for text in texts], dtype=np.intp)


def _places(points: Table, files: Files) -> tuple[Places, tuple[str, ...]]:
    """Return the places of all points, nan where they are in no list, and warnings."""
    names, of = _numbered(points.texts("point"))
    values, covariance = np.full((len(names), 3), np.nan), np.full((len(names), 3, 3), np.nan)
    if files.nominal is None:
        return Places(names, values, np.ones(values.shape, dtype=bool), of, Spread(covariance)), ()
    nominal, spread = listed_points(files.nominal)
    known = {name: i for i, name in enumerate(names)}
    place = np.array([known.get(name, -1) for name in nominal.texts("point")], dtype=np.intp)
    rows = np.flatnonzero(place >= 0)
    wanted = np.column_stack([nominal.numbers(axis, float("nan")) for axis in "xyz"])
    values[place[rows]] = wanted[rows]
    whole = spread.of(rows).among(place[rows], len(names))
    free = ~np.isfinite(values) | (whole.sigma > 0)
    alone = [name for name in nominal.texts("point") if name not in known]
    left = f"{counted(len(alone), 'point', 'are')} in the nominal list only and left out: {listed(alone)}"
    return Places(names, values, free, of, whole), (left,) if alone else ()


def _joined(given: StationPoints, values: Array, fixed: bool) -> tuple[Array, Array, Array]:
    """Return all places (m, 3), and pose (k, 6) and scale (k,) of each station; raises as `stations_of` does.

    The station whose common points are widest across comes next. `fixed`: the first station is the frame.
    """
    values, pose, scale = values.copy(), np.zeros((len(given.names), 6)), np.ones(len(given.names))
    left = list(range(len(given.names)))
    if fixed:
        rows = np.flatnonzero(given.station == left.pop(0))
        values[given.of[rows]] = given.points[rows]
    while left:
        rows_of = {station: _common(given, station, values) for station in left}
        widths = {station: _width(values[given.of[rows]]) for station, rows in rows_of.items()}
        best = max(left, key=widths.__getitem__)
        if not widths[best] > 0:
            raise UndeterminedError("\n".join(_unjoined(given, rows_of, len(left) == len(given.names) - fixed)), 0.0)
        rows, own = rows_of[best], np.flatnonzero(given.station == best)
        goals, names = values[given.of[rows]], [given.places[i] for i in given.of[rows]]
        mirrored(given.points[rows], goals, names, given.scaled, given.names[best])
        pose[best], scale[best] = similarity(given.points[rows], goals, given.scaled)
        moved = poses.apply(pose[best], scale[best] * given.points[own])
        values[given.of[own]] = np.where(np.isfinite(values[given.of[own]]), values[given.of[own]], moved)
        left.remove(best)
    return values, pose, scale


def _common(given: StationPoints, station: int, values: Array) -> Index:
    """Return the rows of a station whose places are known."""
    return np.flatnonzero((given.station == station) & np.isfinite(values[given.of]).all(axis=1))


def _width(places: Array) -> float:
    """Return how wide points are across their longest direction; 0 for too few, or all on a line."""
    if len(places) < _FEWEST:
        return 0.0
    across = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    return float(across[1]) if across[1] > _ON_A_LINE * across[0] else 0.0


def _unjoined(given: StationPoints, rows_of: dict[int, Index], none: bool) -> Iterator[str]:
    """Yield for each station that cannot be joined what it has in common with the others."""
    for station, rows in rows_of.items():
        what = listed([given.places[i] for i in given.of[rows]])
        shared = f"{len(rows)} known points ({what})" if len(rows) else "no known point"
        line = " all on a line" if len(rows) >= _FEWEST else ""
        yield f"station {given.names[station]} cannot be joined: it has {shared}{line}"
    yield "  what would join it: three points, not on a line, that it shares with " + (
        "the frame (the nominal list, or the first station)" if none else "the frame and the stations joined to it"
    )
