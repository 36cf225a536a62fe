"""Stations whose readings are of another sort than those of the others: other units, or angles of another sense.

The stations of the majority see the same figure of points. Each of the others is read in all ways that are usual: the
right one makes its figure congruent with theirs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import combinations

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.diagnosis.corrections import Mistake
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments.tracker import AZIMUTH, DISTANCE, ELEVATION
from metrocli.table import Table
from metrocli.tasks.adjust_network.readings import NetworkReadings
from metrocli.tasks.adjust_network.starts.agreement import fitted, medians
from metrocli.units import INCH, find_unit
from metrocli.words import in_a_row

_SAME = 1e-9
"""Relative difference of the sizes of two units that are one"""
_FEWEST = 5
"""Points that two stations share, at least: among fewer a single wrong reading decides"""
_MOST_POINTS, _MOST_STATIONS = 200, 3
"""Points that are compared of two stations, and stations with which one is compared by other conventions"""
_CONGRUENT = 2e-3
"""Share of the extent of the smaller figure, by which half of the points differ at most where two are congruent"""
_MOST_TRIED = 20
"""Stations whose sightings alone are taken for stated in another way, at most"""
_STEEPEST = 0.05
"""Least cosine of an elevation by which a horizontal distance is divided"""
_ROUNDED = 1e-9
"""What a number of degrees may lack to a whole minute by rounding"""
_RIGHT_LENGTHS = 0.2
"""Share of the lengths between points that agree at least in congruent figures"""


@dataclass(frozen=True)
class Convention:
    """A usual way to state quantities of a sighting, which is not that of the heading."""

    components: tuple[int, ...]
    words: str
    write: str
    """What to do with the numbers of the columns"""
    read: Callable[[Array], Array]
    """The numbers as they should be, of those that were read"""
    shrinks: float = 1.0
    """Factor of distances that become shorter: residuals shrink with them, whatever is right"""

    @property
    def is_length(self) -> bool:
        """Whether it is of distances."""
        return self.components == (DISTANCE,)


def _from_the_zenith(angles: Array) -> Array:
    return np.asarray(np.pi / 2 - angles)


_ANGLES = {unit: find_unit(unit, "angle").inside(1.0) for unit in ("gon", "deg", "rad")}
_LENGTHS = {unit: find_unit(unit, "length").inside(1.0) for unit in ("m", "mm", "cm", "ft")} | {"inches": INCH}


def in_units(components: tuple[int, ...], size: float) -> Iterator[Convention]:
    """Yield the conventions of quantities in other units than that of their heading, of a size [rad or mm]."""
    verb = "are" if components[1:] else "is"
    for unit, own in (_LENGTHS if components == (DISTANCE,) else _ANGLES).items():
        factor = own / size
        if abs(factor - 1) > _SAME:
            shrinks = min(factor, 1.0) if components == (DISTANCE,) else 1.0
            read = partial(np.multiply, factor)
            yield Convention(components, f"{verb} in {unit}", f"times {factor:.10g}", read, shrinks)


_EITHER = (Convention((AZIMUTH,), "counts the other way", "with the other sign", np.negative),)
_AS_READ = Convention((), "", "", np.positive)
_OF_ELEVATIONS = (
    Convention((ELEVATION,), "has the wrong sign", "with the other sign", np.negative),
    Convention((ELEVATION,), "is a zenith distance", "as 90 deg minus it", _from_the_zenith),
)
_OF_ZENITH_DISTANCES = (Convention((ELEVATION,), "is an elevation", "as 90 deg minus it", _from_the_zenith),)


def other_conventions(
    readings: NetworkReadings, zenith: bool, units: Sequence[Convention]
) -> Iterator[tuple[tuple[int, ...], Convention]]:
    """Yield stations with a convention by which they see what the majority sees; of two halves, each beside the other.

    `zenith` if the readings have zenith distances, to which a convention then applies. `units` are the conventions in
    other units. Where distances are in two units, or two instruments differ, the majority beside all others is yielded,
    too. Stations that share too few points with the others are left as they are.
    """
    figures = _Figures(readings, zenith)
    groups = figures.groups()
    most = max(map(len, groups), default=0)
    if most == 1 < len(groups) - 1:  # none of several agrees with another: nothing shows which are right
        return
    every = (*_EITHER, *units, *(_OF_ZENITH_DISTANCES if zenith else _OF_ELEVATIONS))
    for group in groups:
        others = [station for station in figures.stations if station not in group]
        # mirror images do not show which is right, but a unit in use does, and an instrument has one convention at all
        # its stations: the majority may have the wrong one
        of_most, instrument = len(group) == most, readings.stations.instrument
        apart = not np.isin(instrument[group], instrument[others]).any()
        for convention in (one for one in every if of_most or ((one.is_length or apart) and len(groups) == 2)):
            agreeing = tuple(station for station in others if figures.agrees(station, group, convention))
            if agreeing:
                yield agreeing, convention


def written_otherwise(table: Table, elevation: Array) -> Iterator[tuple[Mistake, dict[str, Array]]]:
    """Yield sightings that a file may state in another way than in a unit, with their columns as they should be.

    They are those of all stations or of a single one. `elevation` is that of each sighting, as it was read.
    """
    if "station" not in table:
        return
    station = np.array(table.texts("station"), dtype=object)
    names = list(dict.fromkeys(station.tolist()))
    for words, write, columns in _other_ways(table, elevation):
        for name in ("", *(names[:_MOST_TRIED] if names[1:] else ())):
            here = (station == name) | (not name)
            where = f" at station {name}" if name else ""
            mistake = Mistake("readings", words + where, write + where, file=table.file, sort="ways", columns=0)
            yield mistake, {key: np.where(here, values, table.numbers(key)) for key, values in columns.items()}


def _other_ways(table: Table, elevation: Array) -> Iterator[tuple[str, str, dict[str, Array]]]:
    angles = {name: table.numbers(name) for name in ("az", "hz", "el", "zd") if name in table}
    decimal = {name: _of_sexagesimal(values) for name, values in angles.items()}
    if angles and all(table.headings.get(name, "").endswith("_deg") for name in angles):
        what = in_a_row(list(angles))
        yield f"{what} have minutes and seconds as decimals (D.MMSS)", f"decimal degrees in {what}", decimal
    if "d" in table:
        distance = table.numbers("d")
        level = np.where(np.isfinite(elevation), np.maximum(np.cos(elevation), _STEEPEST), 1.0)
        yield "d is a horizontal distance", "d over the sine of the zenith distance", {"d": distance / level}


def _of_sexagesimal(angles: Array) -> Array:
    """Return angles [rad] whose decimals of a degree are minutes and seconds, such as 12.3045 for 12 deg 30' 45"."""
    degrees = np.abs(np.degrees(angles))
    whole = np.floor(degrees + _ROUNDED)
    minutes = np.floor((degrees - whole) * 100 + 100 * _ROUNDED)
    seconds = ((degrees - whole) * 100 - minutes) * 100
    return np.asarray(np.copysign(np.radians(whole + minutes / 60 + seconds / 3600), angles))


class _Figures:
    """The points as each station sees them, in its round with the most sightings."""

    def __init__(self, readings: NetworkReadings, zenith: bool) -> None:
        self._readings, self._zenith = readings, zenith
        seen = readings.sightings
        rows: Index = np.flatnonzero(np.isfinite(seen.values).all(axis=0))
        order = rows[np.argsort(seen.orientation[rows], kind="stable")]
        parts = np.split(order, np.flatnonzero(np.diff(seen.orientation[order])) + 1) if len(order) else []
        # azimuths of two rounds have two zeros
        self._rows_of = {int(seen.station[part[0]]): part for part in sorted(parts, key=len) if len(part) >= _FEWEST}
        self.stations = sorted(self._rows_of)
        self._own = {number: self._figure(number) for number in self.stations}

    def _figure(self, station: int, convention: Convention = _AS_READ) -> Array:
        """Return where a station sees each point, (points, 3), nan where it does not."""
        seen, rows = self._readings.sightings, self._rows_of[station]
        values = seen.values[:, rows].copy()
        for component in convention.components:
            own, turned = values[component], self._zenith and component == ELEVATION
            values[component] = (
                _from_the_zenith(convention.read(_from_the_zenith(own))) if turned else convention.read(own)
            )
        return medians(self._readings.local(rows, values), seen.point[rows], self._readings.points.count)

    def groups(self) -> list[list[int]]:
        """Return the stations in groups whose figures are congruent, also by way of a third one."""
        group = {station: [station] for station in self.stations}
        for one, other in combinations(self.stations, 2):
            if group[one] is not group[other] and self._congruent(self._own[one], one, other):
                group[one] += group[other]
                group |= dict.fromkeys(group[other], group[one])
        return list({id(stations): stations for stations in group.values()}.values())

    def agrees(self, station: int, group: Sequence[int], convention: Convention) -> bool:
        """Return whether a station agrees by a convention with one of those of a group that share most points."""
        own = self._figure(station, convention)
        sharing = sorted(group, key=lambda other: -int(np.isfinite(own + self._own[other]).all(axis=1).sum()))
        return any(self._congruent(own, station, other) for other in sharing[:_MOST_STATIONS])

    def _congruent(self, own: Array, station: int, other: int) -> bool:
        shared = np.flatnonzero(np.isfinite(own + self._own[other]).all(axis=1))
        if len(shared) < _FEWEST:
            return False
        some = shared[:: -(-len(shared) // _MOST_POINTS)]
        x, y = own[some], self._own[other][some]
        bound = _CONGRUENT * min(np.ptp(x, axis=0).max(), np.ptp(y, axis=0).max())
        # lengths between points need no fit, and rule out nearly all: where half of the points are right, so is a
        # quarter of the lengths
        lengths = [np.linalg.norm(each - np.roll(each, 1, axis=0), axis=1) for each in (x, y)]
        if np.quantile(np.abs(lengths[0] - lengths[1]), _RIGHT_LENGTHS) > 2 * bound:
            return False
        level = bool(self._readings.levelled[[station, other]].all())
        miss = np.linalg.norm(poses.apply(fitted(x, y, level), x) - y, axis=1)
        return bool(np.median(miss) < bound)
