"""The readings of a network, finished: lengths of tracers, and calibrated distances between their points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array, Index, Mask, extents
from metrocli.errors import InputError, all_faults
from metrocli.frozen import dataclass
from metrocli.instruments import tracer as t
from metrocli.instruments.frames import DistanceBetween
from metrocli.table import Table
from metrocli.tasks.multilaterate.settings import Files, Settings
from metrocli.tasks.shared.environment import Air, air_of, unused
from metrocli.tasks.shared.lengths import PathNoise, stops_of
from metrocli.tasks.shared.lists import matched, refuse, sigmas, sticking
from metrocli.tasks.shared.tracers import EQUAL, LengthsToTracers, Tracers, few_of_each, observed, tracers_of
from metrocli.words import counted, listed

DISTANCES = "distances"
"""Name of the group of calibrated distances"""


@dataclass(frozen=True)
class LengthReadings:
    """The lengths of a network and the lists that they refer to."""

    names: tuple[str, ...]
    """All listed points"""
    nominal: Array
    """Listed places of the points, (points, 3)"""
    sigma: Array
    """Standard uncertainties of the listed points, (points, 3), nan if not given"""
    tracers: Tracers
    observations: Observations
    """The lengths, corrected for the air; with their stops, where the noise has a repeatability"""
    stops: Block | None
    """The deviations of stops that several lengths share"""
    air: Air | None
    absolute: bool
    seen_by: LengthsToTracers
    """What the search of the tracers takes of them"""
    stuck: tuple[str, ...] = ()
    """Tracers whose lengths stay the same, in words"""
    warnings: tuple[str, ...] = ()

    @cached_property
    def seen(self) -> Index:
        """Number of lengths to each point, (points,)."""
        return np.bincount(self.observations.index[t.POINT], minlength=len(self.names))


def read(settings: Settings, files: Files) -> LengthReadings:
    """Return the lengths, matched to points and tracers and corrected for the air.

    Raises InputError that lists every length without a point or tracer, and every impossible reading.
    """
    lengths, points, tracers = files.lengths, files.points, files.tracers
    if len(lengths) == 0:
        raise InputError([lengths.fault("the file has no lengths")])
    absolute, names = settings.measures == "absolute", tuple(points.texts("point"))
    with all_faults() as each:
        with each():
            point = matched(lengths, "point", points.columns["point"].astype(str), points.file or "the list of points")
        with each():
            read_by = tracers_of(lengths, tracers, lambda texts: sorted(set(texts)), "tracer")
        with each():
            sigma = sigmas(points)
        with each():
            _refuse_readings(lengths, absolute)
    length, nominal = lengths.numbers("length"), points.stacked("xyz")
    if tracers is not None:
        path = length + tracers.numbers("dead_path", np.nan)[read_by.rows][read_by.of]
        text = "length plus dead path is {:g} mm, which is not above zero".format
        if (path <= 0).any():
            raise InputError(lengths.faults_at(np.flatnonzero(path <= 0), lambda row: text(path[row])))
    air = air_of(settings.environment, lengths, "tracer")
    observations = observed(lengths, read_by, (names, point), lengths.conditions("t", "temp"), air)
    stops = None
    if PathNoise.of(settings.noise).repeatability:
        numbers, alone = _stops(point, sigma, observations.conditions.get("t"))
        stops = t.stop_block(numbers)
        index = {} if stops is None else {t.STOP: numbers}
        observations = observations.with_index(index).with_conditions({t.ALONE: alone})
    places = np.vstack([nominal[np.bincount(point, minlength=len(names)) > 0], read_by.listed_at[read_by.given]])
    extent = float(extents(places).max()) or 1.0
    rows = few_of_each(read_by)
    seen = LengthsToTracers(read_by, rows, nominal[point[rows]], length[rows], extent, absolute, lengths.file)
    readings = LengthReadings(names, nominal, sigma, read_by, observations, stops, air, absolute, seen)
    declared = np.hypot(settings.noise.constant, settings.noise.proportional * length)
    stuck = tuple(sticking(lengths, "length", (read_by.of, point), read_by.names, declared))
    return replace(readings, stuck=stuck, warnings=(*_unused(readings), *unused(settings.environment, lengths)))


def _stops(point: Index, sigma: Array, time: Array | None) -> tuple[Index, Array]:
    """Return the number of the stop of each length, from 1, and 1 where its variance has the repeatability, (n,) each.

    A stop that is the only one of its unknown point needs neither: the point is where the carrier stood.
    """
    stops = stops_of(point, time)
    alone = stops == 0
    begins = alone.copy()
    begins[np.unique(stops, return_index=True)[1]] = True
    several = np.bincount(point, begins)[point] > 1
    known: Mask = np.asarray(np.isfinite(sigma).any(axis=1))
    kept = np.asarray(several | known[point])
    stops = np.where(kept, stops, 0)
    return np.searchsorted(np.unique(np.append(stops, 0)), stops), (alone & kept).astype(float)


def _unused(readings: LengthReadings) -> tuple[str, ...]:
    """Return a warning of points without a length, and one of tracers without a reading."""
    unseen = [readings.names[row] for row in np.flatnonzero(readings.seen == 0)]
    warnings = (f"{counted(len(unseen), 'point', 'have')} no length: {listed(unseen)}",) if unseen else ()
    idle, values = readings.tracers.idle, readings.observations.readings[0]
    equal = (EQUAL,) if len(values) > 1 and np.ptp(values) == 0 else ()
    return warnings + equal + ((f"tracers without a reading are left out: {listed(idle)}",) if idle else ())


def _refuse_readings(lengths: Table, absolute: bool) -> None:
    values = lengths.numbers("length")
    refuse(lengths, {"an absolute distance is not above zero": np.asarray(absolute & (values <= 0))})


def distances_of(table: Table | None, names: Sequence[str], seen: Index) -> list[Group]:
    """Return the group of calibrated distances; none without a list.

    Raises InputError that lists every fault in them.
    """
    if table is None:
        return []
    ends = np.zeros((2, len(table)), dtype=np.intp)
    with all_faults() as each:
        for end, column in enumerate(("from", "to")):
            with each():
                ends[end] = matched(table, column, names, "the points")
    length, sigma = table.numbers("length"), table.numbers("sigma")
    wrong = {
        "a distance to a point that no tracer reads": (seen[ends] == 0).any(axis=0),
        "a distance of a point to itself": ends[0] == ends[1],
        "a distance is not above zero": length <= 0,
        "the standard deviation of a distance is not above zero": sigma <= 0,
    }
    refuse(table, {text: np.asarray(rows) for text, rows in wrong.items()})
    observations = Observations(length[None], sigma[None], {t.POINT: ends}, components=("length",), unit="mm")
    return [Group(DISTANCES, Chain((DistanceBetween(t.POINT),)), observations)]
