"""The adjustment of a network of lengths: its blocks, groups and datum, built from the readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from functools import cached_property

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group, priors
from metrocli.adjust.rounds import Aspect
from metrocli.arrays import Array, Index, Mask
from metrocli.effects.model import Model, Place
from metrocli.effects.modelled import Modelled
from metrocli.frozen import dataclass
from metrocli.instruments import tracer as t
from metrocli.instruments.tracer_start import start
from metrocli.table import Table
from metrocli.tasks.multilaterate.readings import LengthReadings, distances_of, read
from metrocli.tasks.multilaterate.settings import Files, Settings
from metrocli.tasks.shared.environment import Air, priors_of
from metrocli.tasks.shared.lengths import PathNoise, Scale, stop_priors, with_noise
from metrocli.tasks.shared.tracers import places_of

_ROUGH = 0.02
"""Points whose lengths are off by more than this share of the measured volume start from their lengths"""
LENGTHS = "lengths"
"""Name of the group of lengths from tracers"""


@dataclass(frozen=True)
class TracerNetwork(Modelled):
    """A network of lengths, ready to be adjusted."""

    noise: PathNoise
    """Standard deviations of the lengths, as a function of the adjusted paths"""
    nominal: Array
    """The mover's readings of the points, (points, 3)"""
    absolute: bool
    """Whether lengths are absolute distances, without a dead path"""
    surveyed: bool = False
    """Whether the places of all tracers are known, so that points need no listed places"""
    listed_at: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """Listed places of the tracers, (tracers, 3), nan if not listed"""
    warnings: tuple[str, ...] = ()
    stuck: tuple[str, ...] = ()
    """Tracers whose lengths stay the same, in words"""
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

    def with_noise(self, noise: PathNoise, blocks: Mapping[str, Block]) -> TracerNetwork:
        """Return the network at the values of `blocks` with another noise of its lengths."""
        return replace(self, model=with_noise(self.model.with_blocks(blocks), LENGTHS, noise), noise=noise)

    def with_noise_times(self, factor: float) -> TracerNetwork:
        """Return the network with a factor on the declared noise of its lengths."""
        return self.with_noise(self.noise.times(factor), self.blocks)

    def only(self, keep: Mask) -> TracerNetwork:
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


def build(settings: Settings, files: Files) -> TracerNetwork:
    """Return the adjustment of the files, with starting values found from the lengths; raises as `places_of` does."""
    readings = read(settings, files)
    places = places_of(readings.seen_by)
    return network_of(settings, readings, places, files.distances, _points_from(readings, places))


def _points_from(readings: LengthReadings, places: Array) -> Array:
    """Return starting values of the points, (points, 3): from distances to known tracers where the list is rough.

    A point is to known tracers what a tracer is to known points.
    """
    points, observations = readings.nominal.copy(), readings.observations
    if not (readings.absolute and readings.tracers.given.all()):
        return points
    of, ends = observations.index[t.POINT], places[observations.index[t.TRACER], :3]
    lengths = observations.readings[0]
    miss = np.abs(lengths - np.linalg.norm(points[of] - ends, axis=1))
    rough = np.bincount(of, miss > _ROUGH * readings.seen_by.extent, len(points)) > 0
    for i in np.flatnonzero(rough & (readings.seen >= 3)).tolist():
        mine = of == i
        place = start(ends[mine], lengths[mine], True, readings.nominal[i])[:3]
        points[i] = np.where((readings.sigma[i] != 0) & np.isfinite(place), place, points[i])
    return points


def network_of(
    settings: Settings,
    readings: LengthReadings,
    places: Array,
    distances: Table | None = None,
    points_at: Array | None = None,
) -> TracerNetwork:
    """Return the adjustment of readings; `places` (tracers, 5) are the starting values of the tracers.

    Points start at `points_at` (points, 3), or where they are listed.
    Raises InputError that lists every fault in the calibrated distances.
    """
    sigma, tracers = readings.sigma, readings.tracers
    free = (sigma != 0) & (readings.seen > 0)[:, None]
    extent = readings.seen_by.extent
    points = t.point_block(readings.nominal if points_at is None else points_at, readings.names, free, extent)
    stations = t.tracer_block(
        places, tracers.names, tracers.free(readings.absolute, settings.scale is not None), extent
    )
    noise = PathNoise.of(settings.noise)
    more = (readings.stops, None if readings.air is None else readings.air.block)
    blocks = {block.name: block for block in (points, stations, *more) if block is not None}
    forward = t.chain(stops=readings.stops is not None, in_air=readings.air is not None)
    groups = (
        noise.at(Group(LENGTHS, forward, readings.observations), blocks),
        *priors(points, sigma, free),
        *tracers.known(stations, settings.scale),
        *priors_of(readings.air),
        *stop_priors(readings.stops, noise.repeatability),
        *distances_of(distances, readings.names, readings.seen),
    )
    inner = settings.datum != "points" and bool(stations.free[:, :3].any()) and bool(free.any())
    datum = t.datum(points, free.all(axis=1).astype(float)) if inner else None
    acting = {"tracer": Place(stations.members, t.TRACER), "point": Place(points.members, t.POINT)}
    nominal = {t.POINT: readings.nominal}
    model = Model(blocks, groups, datum, (LENGTHS,), acting, t.aspects(t.reach()), nominal=nominal)
    return TracerNetwork(
        model,
        noise,
        readings.nominal,
        readings.absolute,
        surveyed=bool(tracers.given.all()),
        listed_at=tracers.listed_at,
        warnings=readings.warnings,
        stuck=readings.stuck,
        scale=settings.scale,
        air=readings.air,
    )
