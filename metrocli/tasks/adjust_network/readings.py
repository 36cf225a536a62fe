"""The readings of a network, finished: names are numbers, angles are those of face 1, faults are found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.errors import InputError, all_faults
from metrocli.frozen import dataclass
from metrocli.table import Table
from metrocli.tasks.adjust_network.known_points import KnownPoints, known_points
from metrocli.tasks.adjust_network.settings import INTERFEROMETER, Files, NetworkInstrument, Settings
from metrocli.tasks.adjust_network.sightings import (
    PolarSightings,
    Stations,
    refuse_pairs,
    rows_of,
    sightings_of,
    stations_of,
)
from metrocli.tasks.shared.lists import matched, refuse
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
        return Lengths(rows_of(self.table, kept), *ends, self.values[kept], self.sigma[kept])


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
    refuse(table, {"a standard deviation is negative": table.numbers("sigma") < 0})
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
    unmatched = [name for name in chosen if name not in set(names)]
    if unmatched:
        raise InputError(f"datum_points: no file names the points {listed(unmatched)}")


def _with_warnings(readings: NetworkReadings) -> NetworkReadings:
    used = set(readings.sightings.station.tolist()) | set(
        [] if readings.lengths is None else readings.lengths.first.tolist()
    )
    idle = [name for i, name in enumerate(readings.stations.names) if i not in used]
    lines = (f"stations without a reading are left out: {listed(idle)}",) if idle else ()
    return replace(readings, warnings=lines)
