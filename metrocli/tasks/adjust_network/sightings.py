"""Set-ups of instruments, and what trackers and total stations read from them: angles are those of face 1."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from metrocli.arrays import Array, Index, Mask
from metrocli.errors import InputError, all_faults
from metrocli.frozen import dataclass
from metrocli.table import ABSENT, Table
from metrocli.tasks.adjust_network.settings import INTERFEROMETER, Files, NetworkInstrument, Settings
from metrocli.tasks.shared.lists import matched, negative, refuse

_PAIRS = (("az", "hz"), ("el", "zd"))
QUANTITIES = ("az", "el", "d")
"""Columns of what a polar instrument reads, in the order of `metrocli.instruments.tracker`"""


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
    gamma: Array
    """Known azimuth of the x axis of a levelled station, nan if it is an unknown, (stations,)"""


@dataclass(frozen=True)
class PolarSightings:
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
    def station_of_round(self) -> Index:
        """Station of each round, (rounds,)."""
        return np.array([station for station, _ in self.rounds], dtype=np.intp)

    @property
    def raised(self) -> Mask:
        """Sightings whose target stands above its point."""
        return np.asarray((self.setup > 0) | (self.height != 0))


def stations_of(settings: Settings, files: Files, names: Sequence[str]) -> Stations:
    table = files.stations
    if not len(table):
        raise InputError([table.fault("there is no station", "list each set-up: station,instrument")])
    n = len(table)
    with all_faults() as each:
        with each():
            instrument = matched(table, "instrument", list(settings.instruments), "`instruments:`")
        with each():
            over = np.full(n, -1, dtype=np.intp)
            rows = np.array([i for i, text in enumerate(table.texts("over", "")) if text], dtype=np.intp)
            if rows.size:
                over[rows] = matched(table.selected(rows), "over", names, "the points")
    chosen = list(settings.instruments.values())
    levelled = np.array([chosen[i].is_levelled for i in instrument])
    height, gamma = table.numbers("height", np.nan), table.numbers("gamma", np.nan)
    refuse(
        table,
        {
            "a station over a point needs an instrument that is levelled": (over >= 0) & ~levelled,
            "a station over a point needs a height_mm": (over >= 0) & np.isnan(height),
            "a station with a known gamma needs an instrument that is levelled": np.isfinite(gamma) & ~levelled,
            **negative(table, "sigma_height"),
        },
    )
    place = np.stack([table.numbers(axis, np.nan) for axis in "xyz"], axis=1)
    centring = np.nan_to_num(table.numbers("centring", 0.0))
    names_of, sigma = tuple(table.texts("station")), table.numbers("sigma_height", 0.0)
    return Stations(names_of, instrument, over, height, sigma, centring, place, gamma)


def sightings_of(
    settings: Settings, table: Table, stations: Stations, names: Sequence[str], setups: tuple[str, ...]
) -> PolarSightings:
    if table is ABSENT or not len(table):
        nothing = np.zeros(0, dtype=np.intp)
        none = np.zeros((3, 0))
        return PolarSightings(table, nothing, nothing, none, none, np.zeros(0), nothing, (), nothing, np.zeros(0))
    n = len(table)
    with all_faults() as each:
        with each():
            station = matched(table, "station", stations.names, "the stations")
        with each():
            point = matched(table, "point", names, "the points")
        with each():
            setup = np.zeros(n, dtype=np.intp)
            rows = np.array([i for i, text in enumerate(table.texts("setup", "")) if text], dtype=np.intp)
            if rows.size:
                setup[rows] = matched(table.selected(rows), "setup", setups[1:], "the set-ups") + 1
    values, face = _reduced(table)
    sigma = np.stack([_sigma(table, *pair) for pair in (("az", "hz"), ("el", "zd"), ("d", "d"))])
    with all_faults() as each:
        with each():
            _refuse_faces(table)
        with each():
            _refuse_sightings(table, values, list(settings.instruments.values()), stations, station)
        with each():
            chosen = list(settings.instruments.values())
            _refuse_exact(table, values, sigma, [chosen[i] for i in stations.instrument], station)
    orientation, rounds = _rounds(table.texts("round", ""), station)
    height = np.nan_to_num(table.numbers("th", 0.0))
    return PolarSightings(table, station, point, values, sigma, face, orientation, rounds, setup, height)


def _sigma(table: Table, name: str, other: str) -> Array:
    return table.numbers(f"sigma_{name}" if f"sigma_{name}" in table else f"sigma_{other}", np.nan)


def _reduced(table: Table) -> tuple[Array, Array]:
    """Return azimuth, elevation and distance as in face 1, (3, n), and the face, 1 or -1.

    Raw angles of face 2 have a zenith distance above 180 deg, or below 0: `zd := 360 deg - zd`, `hz := hz - 180 deg`.
    """
    given = table.numbers("face", 1.0)
    azimuth = table.numbers("az") if "az" in table else -table.numbers("hz", np.nan)
    zenith = np.pi / 2 - table.numbers("el") if "el" in table else table.numbers("zd", np.nan)
    zenith = np.where(np.abs(zenith) > 2 * np.pi, zenith, np.remainder(zenith, 2 * np.pi))
    raw = np.asarray(zenith > np.pi)
    zenith = np.where(raw, 2 * np.pi - zenith, zenith)
    azimuth = np.where(raw, azimuth + np.pi, azimuth)
    face = np.where((given == 2.0) | raw, -1.0, 1.0)
    return np.stack([azimuth, np.pi / 2 - zenith, table.numbers("d", np.nan)]), face


def _refuse_faces(table: Table) -> None:
    given = table.numbers("face", 1.0)
    refuse(table, {"the face is 1 or 2": np.asarray(~np.isin(np.where(np.isnan(given), 1.0, given), (1.0, 2.0)))})


def _refuse_exact(
    table: Table, values: Array, sigma: Array, instruments: Sequence[NetworkInstrument], station: Index
) -> None:
    """Raise InputError for readings that neither the instrument nor the file gives a standard deviation."""
    known = np.zeros((3, len(instruments)), dtype=bool)
    for number, instrument in enumerate(instruments):
        if instrument.noise is not None:
            across = bool(instrument.noise.lateral or instrument.noise.centring)
            known[:, number] = (
                across or bool(instrument.noise.azimuth),
                across or bool(instrument.noise.elevation),
                bool(instrument.noise.distance is not None or instrument.noise.centring),
            )
    exact = np.isfinite(values) & ~(sigma > 0) & ~known[:, station]
    exact |= sigma <= 0
    refuse(
        table,
        {
            f"{name} has no standard deviation: give `noise:` of the instrument, or a column sigma": exact[k]
            for k, name in enumerate(("the azimuth", "the elevation", "the distance"))
        },
    )


def _refuse_sightings(
    table: Table, values: Array, instruments: Sequence[NetworkInstrument], stations: Stations, station: Index
) -> None:
    if len(table) and np.isnan(values).all():
        hint = "the columns are az or hz, el or zd, and d, with their units: az_rad, zd_gon, d_mm"
        raise InputError([table.fault("no reading has a direction or a distance", hint)])
    kinds = np.array([instruments[i].type == INTERFEROMETER for i in stations.instrument])
    _, elevation, distance = values
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
    of = [numbers.setdefault(pair, len(numbers)) for pair in zip(station.tolist(), names, strict=True)]
    return np.array(of, dtype=np.intp), tuple(numbers)


def refuse_pairs(table: Table) -> None:
    faults = [
        table.fault(f"the file has both '{a}' and '{b}'", f"keep one: {a} or {b}")
        for a, b in _PAIRS
        if a in table and b in table
    ]
    if faults:
        raise InputError(faults)
