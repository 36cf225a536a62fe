"""The adjustment of a network: its groups and unknowns, and the datum where nothing determines a motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.movements import Affine, of_members, of_points
from metrocli.adjust.rounds import Aspect, Noise, with_aspects
from metrocli.arrays import Array, Mask
from metrocli.effects.model import Model, Place
from metrocli.effects.modelled import Modelled
from metrocli.effects.requested import RequestedEffect
from metrocli.effects.variance_groups import still_read
from metrocli.errors import UndeterminedError
from metrocli.frozen import dataclass
from metrocli.instruments import stations as s
from metrocli.instruments import tracer as t
from metrocli.instruments.tracker import DISTANCE
from metrocli.tasks.adjust_network import groups as g
from metrocli.tasks.adjust_network import noise as n
from metrocli.tasks.adjust_network.readings import NetworkReadings
from metrocli.tasks.adjust_network.settings import GIVEN, Settings
from metrocli.tasks.adjust_network.starts.agreement import NetworkStart
from metrocli.tasks.adjust_network.unknowns import blocks_of, kind_of_stations, rows_of_kind, seen_points
from metrocli.words import in_a_row


@dataclass(frozen=True)
class Network(Modelled):
    """A network, ready to be adjusted."""

    readings: NetworkReadings
    noise: Mapping[str, Noise]
    """Standard deviations of the groups whose noise depends on the geometry"""
    settings: Settings
    start: NetworkStart
    requests: tuple[RequestedEffect, ...] = ()
    """Effects that the job adds"""
    first: int = -1
    """Station that stands at the origin, where nothing else gives the frame; -1 if it is given"""
    factor: float = 1.0
    """How many times the declared noise its readings have"""

    @property
    def aspects(self) -> Mapping[str, Aspect]:
        """Conditions that follow from the geometry."""
        return self.model.aspects

    def with_noise_times(self, factor: float) -> Network:
        """Return the network with a factor on the declared noise of its readings."""
        groups = []
        for group in self.model.groups:
            if group.name in self.model.measured and not g.is_certified(group.name):
                given = group.observations.conditions
                whole = {**given, n.FACTOR: given.get(n.FACTOR, np.ones(group.observations.count)) * factor}
                group = group.with_noise_times(factor)
                group = replace(group, observations=replace(group.observations, conditions=whole))
            groups.append(group)
        return replace(self, model=replace(self.model, groups=tuple(groups)), factor=self.factor * factor)

    def of(self, readings: NetworkReadings, blocks: Mapping[str, Block]) -> Network:
        """Return the network of other readings, at the values of blocks."""
        bare = build(self.settings, readings, self.start)
        requests = still_read(bare.model, self.requests)
        other = replace(bare.with_effects(requests), requests=self.requests).with_noise_times(self.factor)
        alike = {name: block for name, block in blocks.items() if other.blocks[name].members == block.members}
        return other.with_blocks(
            {name: block.with_values(alike.get(name, block).values) for name, block in other.blocks.items()}
        )


def build(
    settings: Settings, readings: NetworkReadings, start: NetworkStart, requests: Sequence[RequestedEffect] = ()
) -> Network:
    """Return the adjustment of readings with starting values, and with the effects that a job adds."""
    extent = start.extent or 1.0
    blocks = {block.name: block for block in blocks_of(readings, start, extent)}
    bend = 0.0 if settings.vertical is None else settings.vertical.refraction / (2 * settings.vertical.radius)
    groups = [
        *g.sightings(readings, blocks, bend),
        *g.lengths(readings),
        *g.bars(readings),
        *g.heights(readings, settings),
    ]
    groups = g.with_exact_lists(groups, readings)
    groups += g.given(readings, blocks)
    noise: dict[str, Noise] = {group.name: n.of_sightings for group in groups if g.is_sighting(group)}
    if any(group.name == g.LENGTHS for group in groups):
        noise[g.LENGTHS] = n.of_lengths
    measured = tuple(group.name for group in groups)
    first, datum = datum_of(settings, readings, blocks)
    places = _places(readings)
    aspects = {} if settings.vertical is None else _verticals(1 / settings.vertical.radius)
    if readings.lengths is not None or readings.bars is not None:
        aspects |= {name: partial(_of_lengths, aspect) for name, aspect in t.aspects(t.reach()).items()}
    nominal = {t.POINT: blocks[t.POINT].values.copy()}
    ready = [weighed_at(with_aspects(group, aspects, blocks)[0], noise, blocks) for group in groups]
    model = Model(blocks, (*ready, *g.known(readings, blocks)), datum, measured, places, aspects, nominal=nominal)
    network = Network(model, readings, noise, settings, start, tuple(requests), first)
    return network.with_effects(requests)


def weighed_at(group: Group, noise: Mapping[str, Noise], blocks: Mapping[str, Block]) -> Group:
    """Return a group with its standard deviations at the values of the blocks."""
    if group.name not in noise:
        return group
    return group.with_observations(replace(group.observations, sigma=noise[group.name](group, blocks)))


def _places(readings: NetworkReadings) -> dict[str, Place]:
    """Return the places at which effects can act."""
    kinds = kind_of_stations(readings)
    tracers = tuple(readings.stations.names[i] for i in rows_of_kind(kinds, t.TRACER))
    bars = () if readings.bars is None else tuple(readings.bars.table.texts("bar"))
    return {
        "instrument": Place(tuple(readings.instruments), g.OF_INSTRUMENT),
        "station": Place(readings.stations.names, g.OF_STATION),
        "point": Place(readings.points.names, g.OF_POINT),
        "tracer": Place(tracers, g.OF_TRACER),
        "bar": Place(bars, g.OF_BAR),
        "setup": Place(readings.setups[0], g.OF_SETUP),
        "method": Place(g.methods(readings)),
    }


def _of_lengths(aspect: Aspect, blocks: Mapping[str, Block], observations: Observations) -> Array:
    """Return a condition of the beams of interferometers, 0 for other readings."""
    return aspect(blocks, observations) if t.TRACER in observations.index else np.zeros(observations.count)


def _verticals(curvature: float) -> dict[str, Aspect]:
    """Return the leans of the verticals at stations and targets, and the curvature in height differences."""

    def lean(column: int, target: bool, blocks: Mapping[str, Block], observations: Observations) -> Array:
        place = _place_of(target, blocks, observations)
        return np.zeros(observations.count) if place is None else place[:, column] * curvature

    def curved(blocks: Mapping[str, Block], observations: Observations) -> Array:
        if g.OF_LINE not in observations.index:
            return np.zeros(observations.count)
        ends = blocks[t.POINT].values[observations.index[t.POINT], :2]
        square = (ends**2).sum(axis=2) * curvature / 2
        return np.asarray(square[1] - square[0])

    names = zip((*s.LEAN, *s.TARGET_LEAN), (0, 1, 0, 1), (False, False, True, True), strict=True)
    return {name: partial(lean, column, target) for name, column, target in names} | {s.CURVATURE: curved}


def _place_of(target: bool, blocks: Mapping[str, Block], observations: Observations) -> Array | None:
    """Return the places of targets or stations of sightings, (n, 2 or more); None for other readings."""
    index = observations.index
    if target:
        return blocks[t.POINT].values[index[g.OF_POINT]] if g.OF_POINT in index else None
    if s.LEVELLED in index:
        return blocks[s.LEVELLED].values[index[s.LEVELLED]]
    return blocks[t.POINT].values[index[t.POINT][1]] if s.OVER in index else None


FREEDOMS = (*t.FREEDOMS, "scale")


def movements() -> dict[str, Affine]:
    """Return how shifts, turns and the scale of a network change each of its blocks."""
    places = of_points(scale=True)
    turned, raised = np.zeros((7, 1)), np.zeros((7, 1, 1))
    turned[5] = raised[6] = 1.0
    offsets = np.zeros((7, 3, 3))
    offsets[6] = np.eye(3)
    lengths = of_members(5, places)
    lengths.matrix[6, 3, 3] = 1.0
    return {
        t.POINT: places,
        s.STATION: of_members(6, places, slice(3, 6)),
        s.LEVELLED: of_members(3, places),
        s.OVER: Affine(offsets, np.zeros((7, 3))),
        t.TRACER: lengths,
        s.ORIENTATION: Affine(np.zeros((7, 1, 1)), turned),
        s.SETUP: Affine(raised, np.zeros((7, 1))),
    }


def datum_of(settings: Settings, readings: NetworkReadings, blocks: Mapping[str, Block]) -> tuple[int, Datum | None]:
    """Return the station at the origin, -1 if the frame is given, and the datum; None where given points fix all."""
    points = readings.points
    if settings.datum == GIVEN or (settings.datum is None and not open_by_given(readings)):
        return -1, None
    listed: Mask = np.asarray(np.isfinite(points.listed).all(axis=1))
    if settings.datum_points is not None:
        members = np.asarray(np.isin(np.array(points.names), settings.datum_points))
    else:
        members = listed if listed.any() else np.ones(points.count, dtype=bool)
    block = blocks[t.POINT]
    reference = np.where(np.isfinite(points.listed), points.listed, block.values)
    open_ones = _not_determined(readings)
    chosen = np.eye(len(FREEDOMS))[:, open_ones]
    used = {name: move.mixed(chosen) for name, move in movements().items() if name in blocks}
    taking = (members & block.free.all(axis=1)).astype(float)
    datum = Datum(t.POINT, np.nan_to_num(reference), taking, used, tuple(FREEDOMS[i] for i in open_ones))
    first = -1 if listed.any() else int(np.argmax([kind != "" for kind in kind_of_stations(readings)]))
    return first, datum


def _not_determined(readings: NetworkReadings) -> list[int]:
    """Return the numbers of the freedoms that no levelled or oriented station and no length determines.

    The reduced system of a single station does not tell the scale, or the turns of its vertical, from a shift.
    """
    stations = np.unique(readings.sightings.station)
    level = bool(readings.levelled[stations].any())
    oriented = np.isfinite(readings.stations.gamma[stations]).any()
    lengths = readings.lengths is not None or readings.bars is not None
    lengths = lengths or bool(np.isfinite(readings.sightings.values[DISTANCE]).any())
    return [0, 1, 2, *([] if level else [3, 4]), *([] if oriented else [5]), *([] if lengths else [6])]


def open_by_given(readings: NetworkReadings) -> list[str]:
    """Return the motions that given points, verticals and lengths leave open."""
    used = np.isfinite(readings.points.sigma) & seen_points(readings)[:, None]
    return _left_open(readings, np.nan_to_num(readings.points.listed), used)


def _open_by_datum(network: Network) -> list[str]:
    """Return the motions that the points of inner constraints leave open, beside verticals and lengths."""
    if network.datum is None:
        return []
    used = np.repeat(network.datum.members[:, None] > 0, 3, axis=1)
    return _left_open(network.readings, network.datum.reference, used)


def _left_open(readings: NetworkReadings, place: Array, used: Mask) -> list[str]:
    """Return the motions that fixed coordinates (points, 3) leave open, with verticals and lengths."""
    # levelled height differences show the direction of the vertical: tilts are not motions then
    needed = [i for i in _not_determined(readings) if i not in (3, 4) or readings.heights is None]
    fixed = used.any(axis=1)
    centred = place - place[fixed].mean(axis=0) if fixed.any() else place
    # about their middle and of size 1: shifts and turns are then alike in size
    centred = centred / (float(np.abs(centred[fixed]).max(initial=0.0)) or 1.0)
    moves = of_points(scale=True).at(centred, np.arange(len(place)))[used][:, needed]
    if not len(moves):
        return [FREEDOMS[i] for i in needed]
    _, values, vectors = np.linalg.svd(moves, full_matrices=True)
    values = np.concatenate([values, np.zeros(len(needed) - len(values))]) if len(values) < len(needed) else values
    loose = vectors[values < 1e-6 * values[0]]
    return [FREEDOMS[i] for k, i in enumerate(needed) if (np.abs(loose[:, k]) > 0.1).any()]


def must_be_held(settings: Settings, network: Network) -> None:
    """Raise UndeterminedError for given points, or points named for inner constraints, that do not fix every motion."""
    if settings.datum == GIVEN:
        loose, by = open_by_given(network.readings), "`datum: given`, but the given points"
        cure = "Give a sigma_mm to more points ({}), or write `datum: inner-constraints`"
    elif settings.datum_points is not None:
        loose, by = _open_by_datum(network), "the points of `datum_points`"
        cure = "Name more points ({}), or leave `datum_points` out: then all points hold the network"
    else:
        return
    if loose:
        cure = cure.format("three that are not on a line fix every motion")
        # no misfit: no other reading of the files would fix these motions, so none is tried
        raise UndeterminedError(f"{by} leave open: {in_a_row(loose)}.\n  {cure}", 0.0)
