"""Stations whose readings are of another sort than those of the others: other units, or angles of another sense.

The stations of the majority see the same figure of points. Each of the others is read in all ways that are usual: the
right one makes its figure congruent with theirs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments.tracker import AZIMUTH, DISTANCE, ELEVATION, cartesian
from metrocli.tasks.adjust_network.readings import NetworkReadings
from metrocli.tasks.adjust_network.starts.agreement import fitted, medians
from metrocli.units import INCH, find_unit

_FEWEST = 5
"""Points that two stations share, at least: among fewer a single wrong reading decides"""
_CONGRUENT = 2e-3
"""Share of the extent of two figures, by which half of the points differ at most where they are congruent"""
_IN_SPACE = 0.02
"""Share of its longest extent that a figure has in each direction: one in a plane is its own mirror image"""
_SAME = 1e-9
"""Relative difference of the sizes of two units that are one"""


@dataclass(frozen=True)
class Convention:
    """A usual way to state a quantity of a sighting, which is not that of the heading."""

    component: int
    words: str
    write: str
    """What to do with the numbers of the column"""
    read: Callable[[Array], Array]
    """The numbers as they should be, of those that were read"""
    shrinks: float = 1.0
    """Factor of distances that become shorter: residuals shrink with them, whatever is right"""

    @property
    def is_length(self) -> bool:
        """Whether it is of distances."""
        return self.component == DISTANCE


def _from_the_zenith(angles: Array) -> Array:
    return np.asarray(np.pi / 2 - angles)


def _in_unit(component: int, unit: str, factor: float) -> Convention:
    shrinks = min(factor, 1.0) if component == DISTANCE else 1.0
    return Convention(component, f"is in {unit}", f"times {factor:.10g}", lambda values: factor * values, shrinks)


_ANGLES = {unit: find_unit(unit, "angle").inside(1.0) for unit in ("gon", "deg", "rad")}
_LENGTHS = {unit: find_unit(unit, "length").inside(1.0) for unit in ("m", "mm", "cm", "ft")} | {"inches": INCH}
_OTHER_WAY = Convention(AZIMUTH, "counts the other way", "with the other sign", np.negative)
_OF_ELEVATIONS = (
    Convention(ELEVATION, "has the wrong sign", "with the other sign", np.negative),
    Convention(ELEVATION, "is a zenith distance", "as 90 deg minus it", _from_the_zenith),
)
_OF_ZENITH_DISTANCES = (Convention(ELEVATION, "is an elevation", "as 90 deg minus it", _from_the_zenith),)


def other_conventions(
    readings: NetworkReadings, zenith: bool, sizes: Sequence[float]
) -> Iterator[tuple[tuple[int, ...], Convention]]:
    """Yield stations with a convention by which they see what the majority sees; of two halves, each beside the other.

    Where distances are in two units, the majority beside all others is yielded, too. `zenith` if the readings have
    zenith distances, to which a convention then applies. `sizes` are those of the units in the headings, one for each
    component [rad, rad, mm]. Nothing is yielded where none makes all stations agree.
    """
    conventions = (_OTHER_WAY, *_other_units(sizes), *(_OF_ZENITH_DISTANCES if zenith else _OF_ELEVATIONS))
    figures = _Figures(readings, zenith)
    alike = [figures.like(station) for station in figures.stations]
    most, groups = max(map(len, alike), default=0), dict.fromkeys(map(tuple, alike))
    for group in groups:
        others = tuple(station for station in figures.stations if station not in group)
        # mirror images do not show which is right, but a unit in use does: the majority may have the wrong one
        tried = [
            one for one in conventions if len(group) == most or (groups.keys() == {group, others} and one.is_length)
        ]
        for convention in tried if others else ():
            if all(figures.agrees(station, group, convention) for station in others):
                yield others, convention


def _other_units(sizes: Sequence[float]) -> Iterator[Convention]:
    for component, units in ((AZIMUTH, _ANGLES), (ELEVATION, _ANGLES), (DISTANCE, _LENGTHS)):
        factors = {unit: size / sizes[component] for unit, size in units.items()}
        yield from (_in_unit(component, unit, factor) for unit, factor in factors.items() if abs(factor - 1) > _SAME)


class _Figures:
    """The points as each station sees them."""

    def __init__(self, readings: NetworkReadings, zenith: bool) -> None:
        self._readings, self._zenith = readings, zenith
        rows: Index = np.flatnonzero(np.isfinite(readings.sightings.values).all(axis=0))
        station = readings.sightings.station[rows]
        order = np.argsort(station, kind="stable")
        parts = np.split(order, np.flatnonzero(np.diff(station[order])) + 1) if len(rows) else []
        self._rows_of = {int(station[part[0]]): rows[part] for part in parts}
        self.stations = [number for number, own in self._rows_of.items() if len(own) >= _FEWEST]
        self._own = {number: self._figure(number) for number in self.stations}

    def _figure(self, station: int, convention: Convention | None = None) -> Array:
        """Return where a station sees each point, (points, 3), nan where it does not."""
        seen, rows = self._readings.sightings, self._rows_of[station]
        values = seen.values[:, rows].copy()
        if convention is not None:
            own = values[convention.component]
            turned = self._zenith and convention.component == ELEVATION
            values[convention.component] = (
                _from_the_zenith(convention.read(_from_the_zenith(own))) if turned else convention.read(own)
            )
        return medians(cartesian(values)[0].T, seen.point[rows], self._readings.points.count)

    def like(self, station: int) -> list[int]:
        """Return the stations whose figures are congruent with that of one, with this one."""
        own = self._own[station]
        return [other for other in self.stations if other == station or self._congruent(own, self._own[other])]

    def agrees(self, station: int, group: tuple[int, ...], convention: Convention) -> bool:
        """Return whether a station agrees by a convention with one of a group that shares enough points with it."""
        own = self._figure(station, convention)
        return any(self._congruent(own, self._own[other], other, station) for other in group)

    def _congruent(self, one: Array, other: Array, *stations: int) -> bool:
        """Return whether two figures are congruent: by a turn about the vertical if both `stations` are levelled."""
        shared = np.isfinite(one).all(axis=1) & np.isfinite(other).all(axis=1)
        if shared.sum() < _FEWEST:
            return False
        x, y = one[shared], other[shared]
        spread = np.linalg.svd(y - y.mean(axis=0), compute_uv=False)
        level = len(stations) > 1 and all(self._readings.of(station).is_levelled for station in stations)
        if spread[-1] < _IN_SPACE * spread[0]:
            return False
        miss = np.linalg.norm(poses.apply(fitted(x, y, level), x) - y, axis=1)
        return bool(np.median(miss) < _CONGRUENT * np.ptp(y, axis=0).max())
