"""The adjustment of a network of lengths: its blocks, groups and datum, built from the readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from functools import cached_property, partial

import numpy as np

from metrocli.adjust.iterated_weights import Aspect
from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group, priors
from metrocli.adjust.model.observations import Index, Mask, Observations
from metrocli.effects.model import Model, Place
from metrocli.effects.modelled import Modelled
from metrocli.errors import InputError, together
from metrocli.frozen import dataclass
from metrocli.instruments import tracer as t
from metrocli.instruments.frames import DistanceBetween
from metrocli.table import Table
from metrocli.tasks.multilaterate.readings import Readings, join, matched
from metrocli.tasks.multilaterate.settings import Settings
from metrocli.tasks.shared.environment import Air, air_of, priors_of, unused
from metrocli.tasks.shared.lengths import PathNoise, Scale, scale_priors, stop_priors, stops_of, with_noise
from metrocli.tasks.shared.pairs import told_apart
from metrocli.tasks.shared.tracer_places import places_of
from metrocli.words import listed

LENGTHS, DISTANCES = "lengths", "distances"
"""Names of the groups: lengths from tracers, and calibrated distances between points"""


@dataclass(frozen=True)
class Network(Modelled):
    """A network of lengths, ready to be adjusted."""

    noise: PathNoise
    """Standard deviations of the lengths, as a function of the adjusted paths"""
    nominal: Array
    """The mover's readings of the points, (points, 3)"""
    absolute: bool
    """Whether lengths are absolute distances, without a dead path"""
    said: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """Listed places of the tracers, (tracers, 3), nan if not listed"""
    warnings: tuple[str, ...] = ()
    scale: Scale | None = None
    """Prior knowledge of the tracers' scales, if they are estimated"""
    air: Air | None = None
    """The air at the lengths, if the job gives it"""

    @property
    def lengths(self) -> Group:
        """The lengths from tracers."""
        return self.model.group(LENGTHS)

    @property
    def aspects(self) -> Mapping[str, Aspect]:
        """Conditions that effects in the network vary with and that follow from its geometry; none without effects."""
        return t.aspects(t.reach()) if self.effects else {}

    @cached_property
    def seen(self) -> Index:
        """Number of lengths to each point, (points,)."""
        return np.bincount(self.lengths.observations.index[t.POINT], minlength=len(self.nominal))

    @cached_property
    def unknown(self) -> Mask:
        """Points that only the lengths determine: free, and in no prior or calibrated distance, (points,)."""
        held = np.zeros(len(self.nominal), dtype=bool)
        for group in self.others:
            if t.POINT in group.observations.index:
                held[group.observations.index[t.POINT].ravel()] = True
        return self.blocks[t.POINT].free.all(axis=1) & ~held

    def with_noise(self, noise: PathNoise, blocks: Mapping[str, Block]) -> Network:
        """Return the network at the values of `blocks` with another noise of its lengths."""
        return replace(self, model=with_noise(self.model.with_blocks(blocks), LENGTHS, noise), noise=noise)

    def only(self, keep: Mask) -> Network:
        """Return the network with only these lengths; points that lose all their lengths are no longer unknowns."""
        lengths = self.lengths.selected(keep)
        left = np.bincount(lengths.observations.index[t.POINT], minlength=len(self.nominal)) > 0
        points = self.blocks[t.POINT]
        fewer = replace(points, free=points.free & left[:, None])
        others = tuple(_without(group, left) for group in self.others)
        datum = None if self.datum is None else replace(self.datum, members=self.datum.members * left)
        blocks = {**self.blocks, t.POINT: fewer}
        return self.with_model(replace(self.model, blocks=blocks, groups=(lengths, *others), datum=datum))


def _without(group: Group, left: Mask) -> Group:
    index = group.observations.index.get(t.POINT)
    return group if index is None else group.selected(np.asarray(left[np.atleast_2d(index)].all(axis=0)))


def build(settings: Settings, lengths: Table, points: Table, tracers: Table | None, distances: Table | None) -> Network:
    """Return the adjustment of the files, with starting values found from the lengths; raises as `places_of` does."""
    readings = join(lengths, points, tracers, settings.measures == "absolute")
    return network_of(settings, readings, places_of(readings.by_tracers), lengths, distances)


def network_of(
    settings: Settings, readings: Readings, places: Array, lengths: Table, distances: Table | None
) -> Network:
    """Return the adjustment of readings; `places` (tracers, 5) are the starting values of the tracers.

    Raises InputError that lists every fault in the calibrated distances.
    """
    names, sigma = readings.names, readings.point_sigma
    free = (sigma != 0) & (readings.seen > 0)[:, None]
    point_block = t.point_block(readings.nominal, names, free, readings.extent)
    tracer_block = _tracers(settings, readings, places)
    air = air_of(settings.environment, lengths, "tracer")
    observations = _observations(settings, readings, lengths, air)
    noise = PathNoise.of(settings.noise)
    blocks = {t.POINT: point_block, t.TRACER: tracer_block}
    stop_block = None
    if noise.repeatability:
        stops, alone = _stops(readings, observations.conditions.get("t"))
        observations = replace(observations, conditions={**observations.conditions, t.ALONE: alone})
        stop_block = t.stop_block(stops)
    if stop_block is not None:
        blocks[t.STOP] = stop_block
        observations = replace(observations, index={**observations.index, t.STOP: stops})
    if air is not None:
        blocks[t.AIR] = air.block
        observations = replace(observations, conditions={**observations.conditions, t.AIR: air.ratio})
    forward = t.chain(stops=stop_block is not None, in_air=air is not None)
    group = noise.at(Group(LENGTHS, forward, observations), blocks)
    tracer_sigma = np.column_stack([readings.tracer_sigma, np.full((len(readings.stations), 2), np.nan)])
    others = (
        *priors(point_block, sigma, free),
        *priors(tracer_block, tracer_sigma, tracer_block.free),
        *scale_priors(settings.scale, tracer_block),
        *priors_of(air),
        *stop_priors(stop_block, noise.repeatability),
        *_distances(distances, names, readings.seen),
    )
    inner = settings.datum != "points" and bool(tracer_block.free[:, :3].any()) and bool(free.any())
    datum = t.datum(point_block, free.all(axis=1).astype(float)) if inner else None
    absolute = settings.measures == "absolute"
    acting = {
        "tracer": Place(tracer_block.members, t.TRACER),
        "point": Place(point_block.members, t.POINT),
    }
    nominal = {t.POINT: readings.nominal}
    model = Model(blocks, (group, *others), datum, (LENGTHS,), acting, t.aspects(t.reach()), nominal=nominal)
    warnings = (*_unused(readings), *unused(settings.environment, lengths))
    return Network(model, noise, readings.nominal, absolute, readings.said, warnings, settings.scale, air)


def _of_each(names: tuple[str, ...], index: Index) -> tuple[str, ...]:
    """Return the name of each reading's member; readings of the same member share the text in memory."""
    return tuple(np.array(names, dtype=object)[index].tolist())


def _observations(settings: Settings, readings: Readings, lengths: Table, air: Air | None) -> Observations:
    """Return the lengths, corrected for the air, with their points, tracers and conditions."""
    keys = {"point": _of_each(readings.names, readings.point), "tracer": _of_each(readings.stations, readings.station)}
    conditions = lengths.conditions("t", "temp")
    return Observations(
        readings.length[None] if air is None else (readings.length * air.towards)[None],
        np.array(settings.noise.constant),
        {t.POINT: readings.point, t.TRACER: readings.station},
        keys=told_apart(keys, readings.point * len(readings.stations) + readings.station, conditions.get("t")),
        conditions=conditions,
        components=("length",),
        unit="mm",
    )


def _stops(readings: Readings, time: Array | None) -> tuple[Index, Array]:
    """Return the number of the stop of each length, from 1, and 1 where its variance has the repeatability, (n,) each.

    A stop that is the only one of its unknown point needs neither: the point is where the carrier stood.
    """
    stops = stops_of(readings.point, time)
    alone = stops == 0
    _, first = np.unique(stops, return_index=True)
    begins = alone.copy()
    begins[first] = True
    several = np.bincount(readings.point, begins)[readings.point] > 1
    known: Mask = np.asarray(np.isfinite(readings.point_sigma).any(axis=1))
    kept = np.asarray(several | known[readings.point])
    stops = np.where(kept, stops, 0)
    return np.searchsorted(np.unique(np.append(stops, 0)), stops), (alone & kept).astype(float)


def _unused(readings: Readings) -> tuple[str, ...]:
    """Return a warning of points without a length, and one of tracers without a reading."""
    unseen = [readings.names[row] for row in np.flatnonzero(readings.seen == 0)]
    warnings = (f"{len(unseen)} points have no length: {listed(unseen)}",) if unseen else ()
    return warnings + ((f"tracers without a reading are left out: {listed(readings.idle)}",) if readings.idle else ())


def _tracers(settings: Settings, readings: Readings, places: Array) -> Block:
    free = np.ones((len(readings.stations), 5), dtype=bool)
    free[:, :3] = readings.tracer_sigma != 0
    free[:, 3] = settings.measures != "absolute"
    free[:, 4] = settings.scale is not None
    return t.tracer_block(places, readings.stations, free, readings.extent)


def _distances(table: Table | None, names: Sequence[str], seen: Index) -> list[Group]:
    if table is None:
        return []
    ends = np.stack(together(*(partial(matched, table, column, names, "the points") for column in ("from", "to"))))
    length, sigma = table.numbers("length"), table.numbers("sigma")
    wrong = {
        "a distance to a point that no tracer reads": (seen[ends] == 0).any(axis=0),
        "a distance of a point to itself": ends[0] == ends[1],
        "a distance is not above zero": length <= 0,
        "the standard deviation of a distance is not above zero": sigma <= 0,
    }
    faults = [table.fault_at(row, text) for text, rows in wrong.items() for row in np.flatnonzero(rows).tolist()]
    if faults:
        raise InputError(faults)
    observations = Observations(length[None], sigma[None], {t.POINT: ends}, components=("length",), unit="mm")
    return [Group(DISTANCES, Chain((DistanceBetween(t.POINT),)), observations)]
