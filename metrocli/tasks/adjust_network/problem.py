"""The adjustment of a network: its blocks, groups and datum, built from readings and starting values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group, prior, prior_of_entries, priors
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.movements import Affine, of_members, of_points
from metrocli.adjust.rounds import Aspect, Noise, with_aspects
from metrocli.arrays import Array, Index, Mask
from metrocli.effects.links.stations import BEGUN
from metrocli.effects.model import Model, Place
from metrocli.effects.modelled import Modelled
from metrocli.effects.wanted import Wanted
from metrocli.frozen import dataclass
from metrocli.instruments import stations as s
from metrocli.instruments import tracer as t
from metrocli.instruments.frames import DistanceBetween
from metrocli.instruments.polar import AZIMUTH, DISTANCE, ELEVATION, FACE
from metrocli.tasks.adjust_network import noise as n
from metrocli.tasks.adjust_network.readings import QUANTITIES, KnownPoints, Lengths, Readings
from metrocli.tasks.adjust_network.settings import GIVEN, Settings
from metrocli.tasks.adjust_network.start import Start
from metrocli.tasks.shared.lists import told_apart

LENGTHS, BARS, HEIGHTS = "lengths", "bars", "heights"
"""Names of the groups of readings beside those of sightings"""
GIVEN_POINTS = "given points"
"""Names of the groups of given coordinates begin so"""
_MOST_LISTED = 500
"""Most given points whose coordinates are tested one by one"""
OF_POINT, OF_STATION, OF_INSTRUMENT, OF_TRACER, OF_BAR, OF_SETUP, OF_LINE = (
    f"number of {name}" for name in ("point", "station", "instrument", "tracer", "bar", "setup", "line")
)
"""Indices of the readings: their places"""
ROW = "row"
"""Index of the readings: their row in the file"""
FREEDOMS = (*t.FREEDOMS, "scale")


@dataclass(frozen=True)
class Network(Modelled):
    """A network, ready to be adjusted."""

    readings: Readings
    noise: Mapping[str, Noise]
    """Standard deviations of the groups whose noise depends on the geometry"""
    settings: Settings
    start: Start
    wanted: tuple[Wanted, ...] = ()
    """Effects that the job adds"""
    first: int = -1
    """Station that stands at the origin, where nothing else says where the network is; -1 if the frame is given"""
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
            if group.name in self.model.measured:
                given = group.observations.conditions
                whole = {**given, n.FACTOR: given.get(n.FACTOR, np.ones(group.observations.count)) * factor}
                group = group.with_noise_times(factor)
                group = replace(group, observations=replace(group.observations, conditions=whole))
            groups.append(group)
        return replace(self, model=replace(self.model, groups=tuple(groups)), factor=self.factor * factor)

    def of(self, readings: Readings, blocks: Mapping[str, Block]) -> Network:
        """Return the network of other readings, at the values of blocks."""
        other = build(self.settings, readings, self.start, self.wanted).with_noise_times(self.factor)
        alike = {name: one for name, one in blocks.items() if other.blocks[name].members == one.members}
        return other.with_blocks({name: one.with_values(alike.get(name, one).values) for name, one in other.blocks.items()})


def build(settings: Settings, readings: Readings, start: Start, wanted: Sequence[Wanted] = ()) -> Network:
    """Return the adjustment of readings with starting values, and with the effects that a job adds."""
    extent = float(np.nanmax(np.ptp(start.points[np.isfinite(start.points).all(axis=1)], axis=0), initial=0.0)) or 1.0
    blocks = {block.name: block for block in _blocks(readings, start, extent)}
    bend = 0.0 if settings.vertical is None else settings.vertical.refraction / (2 * settings.vertical.radius)
    groups = [*_sightings(readings, blocks, bend), *_lengths(readings), *_bars(readings), *_heights(readings, settings)]
    groups += _given(readings, blocks)
    noise: dict[str, Noise] = {group.name: n.of_sightings for group in groups if is_sighting(group)}
    if any(group.name == LENGTHS for group in groups):
        noise[LENGTHS] = n.of_lengths
    measured = tuple(group.name for group in groups)
    first, datum = _datum(settings, readings, blocks)
    places = _places(readings)
    aspects = {} if settings.vertical is None else _verticals(1 / settings.vertical.radius)
    nominal = {t.POINT: blocks[t.POINT].values.copy()}
    ready = [_weighed(with_aspects(group, aspects, blocks)[0], noise, blocks) for group in groups]
    model = Model(blocks, (*ready, *_known(readings, blocks)), datum, measured, places, aspects, nominal=nominal)
    found = Network(model, readings, noise, settings, start, tuple(wanted), first)
    return found.with_effects(wanted)


def is_sighting(group: Group) -> bool:
    """Return whether a group has sightings of trackers or total stations."""
    return ROW in group.observations.index


def _weighed(group: Group, noise: Mapping[str, Noise], blocks: Mapping[str, Block]) -> Group:
    """Return a group with its standard deviations at the values of the blocks."""
    if group.name not in noise:
        return group
    return group.with_observations(replace(group.observations, sigma=noise[group.name](group, blocks)))


def kind_of_stations(readings: Readings) -> list[str]:
    """Return the block to which each station belongs; empty for one without a reading."""
    used = np.zeros(len(readings.stations.names), dtype=bool)
    used[readings.sightings.station] = True
    found = []
    for number, over in enumerate(readings.stations.over.tolist()):
        levelled = readings.of(number).is_levelled
        kind = (s.OVER if over >= 0 else s.LEVELLED) if levelled else s.STATION
        found.append(kind if used[number] else "")
    if readings.lengths is not None:
        for number in np.unique(readings.lengths.first):
            found[number] = t.TRACER
    return found


def _rows(kinds: Sequence[str], kind: str) -> Index:
    return np.array([i for i, one in enumerate(kinds) if one == kind], dtype=np.intp)


def _blocks(readings: Readings, start: Start, extent: float) -> Iterator[Block]:
    stations, points = readings.stations, readings.points
    free = points.sigma != 0
    yield t.point_block(start.points, points.names, free & _seen(readings)[:, None], extent)
    kinds = kind_of_stations(readings)
    for kind in (s.STATION, s.LEVELLED, s.OVER, t.TRACER):
        rows = _rows(kinds, kind)
        names = [stations.names[i] for i in rows]
        if not names:
            continue
        if kind == s.STATION:
            yield s.station_block(start.poses[rows], names, extent)
        elif kind == s.LEVELLED:
            yield s.place_block(kind, start.poses[rows, :3], names, np.array(True), extent)
        elif kind == s.OVER:
            offset = np.zeros((len(rows), 3))
            offset[:, 2] = stations.height[rows]
            open_ones = np.stack([*[stations.centring[rows] > 0] * 2, stations.sigma_height[rows] != 0], axis=1)
            yield s.place_block(kind, offset, names, open_ones, extent)
        else:
            yield _interferometers(readings, rows, start, extent)
    if any(kind in (s.LEVELLED, s.OVER) for kind in kinds):
        yield _orientations(readings, start)
    if readings.sightings.raised.any():
        names, height, sigma = readings.setups
        seen = np.bincount(readings.sightings.setup, minlength=len(names)) > 0
        yield s.setup_block(height, names, (sigma != 0) & seen)


def _seen(readings: Readings) -> Mask:
    """Return which points some reading concerns, (points,)."""
    seen = np.zeros(readings.points.count, dtype=bool)
    seen[readings.sightings.point] = True
    for pairs, with_first in ((readings.lengths, False), (readings.bars, True), (readings.heights, True)):
        if pairs is not None:
            seen[pairs.second] = True
            if with_first:
                seen[pairs.first] = True
    return seen


def _interferometers(readings: Readings, rows: Index, start: Start, extent: float) -> Block:
    from metrocli.instruments.tracer_start import start as place_of

    values = np.zeros((len(rows), 5))
    values[:, 4] = 1.0
    free = np.zeros((len(rows), 5), dtype=bool)
    free[:, :3] = True
    lengths = readings.lengths
    for at, number in enumerate(rows.tolist()):
        absolute = readings.of(number).measures == "absolute"
        free[at, 3] = not absolute
        if lengths is not None:
            own = lengths.first == number
            near = readings.stations.listed[number]
            told = near if np.isfinite(near).all() else None
            values[at, :4] = place_of(start.points[lengths.second[own]], lengths.values[own], absolute, told)
    return t.tracer_block(values, [readings.stations.names[i] for i in rows], free, extent)


def _orientations(readings: Readings, start: Start) -> Block:
    """Return the azimuths of the rounds; a round in which no azimuth was read has none."""
    seen = readings.sightings
    read = np.bincount(seen.orientation, np.isfinite(seen.values[0]), len(seen.rounds)) > 0
    level = np.array([readings.of(station).is_levelled for station, _ in seen.rounds])
    several = np.bincount([station for station, _ in seen.rounds], minlength=len(readings.stations.names)) > 1
    names = [
        f"{readings.stations.names[station]} {name}" if several[station] else readings.stations.names[station]
        for station, name in seen.rounds
    ]
    block = s.orientation_block(np.where(level, start.gamma, 0.0), names)
    return replace(block, free=(read & level)[:, None])


def _sightings(readings: Readings, blocks: Mapping[str, Block], bend: float) -> Iterator[Group]:
    """Yield the groups of sightings: distances, azimuths and elevations, by kind of station and of target."""
    seen = readings.sightings
    if not len(seen.point):
        return
    kinds = kind_of_stations(readings)
    numbers = {name: i for i, name in enumerate((s.STATION, s.LEVELLED, s.OVER))}
    member = np.zeros(len(kinds), dtype=np.intp)
    for name in numbers:
        rows = _rows(kinds, name)
        member[rows] = np.arange(len(rows))
    code = 2 * np.array([numbers.get(one, 0) for one in kinds])[seen.station] + seen.raised
    codes = np.unique(code).tolist()
    whole = _observations(readings)
    for component in (DISTANCE, AZIMUTH, ELEVATION):
        read = np.isfinite(seen.values[component])
        for one in codes:
            rows = np.flatnonzero(read & (code == one))
            if not rows.size:
                continue
            block, raised = list(numbers)[one // 2], bool(one % 2)
            chosen = whole.selected(rows)
            index = {block: member[seen.station[rows]], **_of_points(readings, block, rows)}
            if block != s.STATION:
                index[s.ORIENTATION] = seen.orientation[rows]
            if raised:
                index[s.SETUP] = seen.setup[rows]
            name = QUANTITIES[component] + (_variant(block, raised) if len(codes) > 1 else "")
            observations = replace(
                chosen,
                readings=chosen.readings[[component]],
                sigma=np.ones((1, len(rows))),
                index={**chosen.index, **index},
                keys={**chosen.keys, "quantity": (QUANTITIES[component],) * len(rows)},
                components=(QUANTITIES[component],),
                unit="mm" if component == DISTANCE else "rad",
            )
            yield Group(name, s.sighting(block, raised, component, bend), observations)


def _variant(block: str, raised: bool) -> str:
    """Return the end of the name of a group of sightings, where there are several kinds of station or target."""
    return f" from {block}" + " to raised targets" * raised


def _of_points(readings: Readings, block: str, rows: Index) -> dict[str, Index]:
    seen = readings.sightings
    if block != s.OVER:
        return {t.POINT: seen.point[rows]}
    return {t.POINT: np.stack([seen.point[rows], readings.stations.over[seen.station[rows]]])}


def _observations(readings: Readings) -> Observations:
    """Return all sightings with their keys, places and conditions, (3, n)."""
    seen, stations = readings.sightings, readings.stations
    instrument = stations.instrument[seen.station]
    index = {OF_POINT: seen.point, OF_STATION: seen.station, OF_INSTRUMENT: instrument, OF_SETUP: seen.setup}
    index[ROW] = np.arange(len(seen.point))
    keys = {
        "station": tuple(stations.names[i] for i in seen.station),
        "point": tuple(readings.points.names[i] for i in seen.point),
    }
    if (seen.face < 0).any():
        keys["face"] = tuple("1" if one > 0 else "2" for one in seen.face.tolist())
    if any(name for _, name in seen.rounds):
        keys["round"] = tuple(seen.rounds[i][1] for i in seen.orientation)
    conditions = seen.table.conditions("t", "temp") | n.parts_of(readings.instruments, instrument)
    conditions |= {FACE: seen.face} | dict(zip(n.GIVEN, seen.sigma, strict=True))
    conditions |= _begun(conditions, seen.station)
    if seen.raised.any():
        conditions[s.TARGET_HEIGHT] = seen.height
    pair = seen.point * len(stations.names) + seen.station
    pair = pair * 2 + (seen.face < 0)
    keys = told_apart(keys, pair * len(seen.rounds) + seen.orientation, conditions.get("t"))
    return Observations(seen.values, np.ones(1), index, keys=keys, conditions=conditions)


def _begun(conditions: Mapping[str, Array], station: Index) -> dict[str, Array]:
    """Return the first time at which the station of each reading read, where there are times."""
    if "t" not in conditions:
        return {}
    first = np.full(int(station.max()) + 1, np.inf)
    np.minimum.at(first, station, conditions["t"])
    return {BEGUN: first[station]}


def _lengths(readings: Readings) -> Iterator[Group]:
    found = readings.lengths
    if found is None:
        return
    rows, stations = np.unique(found.first), readings.stations
    tracer = np.searchsorted(rows, found.first)
    instrument = stations.instrument[found.first]
    index = {
        t.POINT: found.second, t.TRACER: tracer, OF_POINT: found.second, OF_STATION: found.first,
        OF_INSTRUMENT: instrument, OF_TRACER: tracer,
    }  # fmt: skip
    keys = {
        "station": tuple(stations.names[i] for i in found.first),
        "point": tuple(readings.points.names[i] for i in found.second),
    }
    conditions = found.table.conditions("t", "temp") | n.parts_of(readings.instruments, instrument)
    conditions |= _begun(conditions, found.first)
    keys = told_apart(keys, found.second * len(stations.names) + found.first, conditions.get("t"))
    observations = Observations(
        found.values[None], np.ones(1), index, keys=keys, conditions=conditions, components=("length",), unit="mm"
    )
    yield Group(LENGTHS, t.chain(), observations)


def _bars(readings: Readings) -> Iterator[Group]:
    found = readings.bars
    if found is not None:
        index = {t.POINT: np.stack([found.first, found.second]), OF_BAR: np.arange(len(found.first))}
        keys = {"bar": tuple(found.table.texts("bar"))}
        yield _pairs(BARS, Chain((DistanceBetween(t.POINT),)), found, index, keys, "length")


def _heights(readings: Readings, settings: Settings) -> Iterator[Group]:
    found = readings.heights
    if found is not None:
        curved = settings.vertical is not None
        keys = {end: tuple(found.table.texts(end)) for end in ("from", "to")}
        pair = np.minimum(found.first, found.second) * readings.points.count + np.maximum(found.first, found.second)
        if len(np.unique(pair)) < len(pair):
            keys["line"] = tuple(str(line) for line in found.table.lines) or tuple(map(str, range(len(pair))))
        index = {t.POINT: np.stack([found.first, found.second]), OF_LINE: np.arange(len(found.first))}
        group = _pairs(HEIGHTS, Chain((s.HeightBetween(t.POINT, curved),)), found, index, keys, "dh")
        conditions = dict(group.observations.conditions)
        for number in np.unique(np.concatenate([found.first, found.second])).tolist():
            sign = (found.second == number).astype(float) - (found.first == number)
            conditions[s.heights_of(readings.points.names[number])] = sign
        if "method" in found.table:
            methods = _methods(readings)
            conditions["method"] = np.array([methods.index(one) for one in found.table.texts("method")], dtype=float)
        yield replace(group, observations=replace(group.observations, conditions=conditions))


def _methods(readings: Readings) -> tuple[str, ...]:
    """Return the methods of height differences, in the order of the file."""
    found = readings.heights
    return () if found is None or "method" not in found.table else tuple(dict.fromkeys(found.table.texts("method")))


def _pairs(
    name: str, chain: Chain, found: Lengths, index: Mapping[str, Index], keys: Mapping[str, tuple[str, ...]], what: str
) -> Group:
    conditions = found.table.conditions("t", "temp")
    observations = Observations(
        found.values[None], found.sigma[None], index, keys=keys, conditions=conditions, components=(what,), unit="mm"
    )
    return Group(name, chain, observations)


def _given(readings: Readings, blocks: Mapping[str, Block]) -> Iterator[Group]:
    """Yield what is known of points: coordinates with a joint covariance, and others axis by axis."""
    points, block = readings.points, blocks[t.POINT]
    listed = block.with_values(np.where(np.isfinite(points.listed), points.listed, block.values))
    sigma = points.sigma.copy()
    if points.covariance is not None:
        member, column = points.given
        free = block.free[member, column]
        if free.any():
            joint = points.covariance[np.ix_(free, free)]
            group = prior_of_entries(listed, member[free], column[free], joint)
            yield _of_list(replace(group, name=GIVEN_POINTS), np.unique(member[free]), block)
        sigma[member, column] = np.nan
    for axis in range(3):
        rows = np.flatnonzero(block.free[:, axis] & (sigma[:, axis] > 0))
        if rows.size:
            group = prior(listed, rows, sigma[rows, axis][:, None], columns=(axis,))
            yield _of_list(replace(group, name=f"{GIVEN_POINTS} {'xyz'[axis]}"), rows, block)


def _of_list(group: Group, members: Index, block: Block) -> Group:
    """Return a group of given coordinates, with a condition for each of its points."""
    observations = group.observations
    named = {s.listed(block.members[i]): np.ones(observations.count) for i in members[:_MOST_LISTED]}
    keys = {"point": observations.keys["member"]} if "member" in observations.keys else {}
    return replace(group, observations=replace(observations, conditions=named, keys=keys, unit="mm"))


def _known(readings: Readings, blocks: Mapping[str, Block]) -> Iterator[Group]:
    """Yield what is known of heights of instruments and targets, and of their centring."""
    if s.OVER in blocks:
        rows = _rows(kind_of_stations(readings), s.OVER)
        stations, over = readings.stations, blocks[s.OVER]
        known = np.stack([*[stations.centring[rows]] * 2, stations.sigma_height[rows]], axis=1)
        for number, group in enumerate(priors(over, known, over.free)):
            yield replace(group, name=f"heights of instruments {number + 1}")
    if s.SETUP in blocks:
        heights = blocks[s.SETUP]
        rows = np.flatnonzero(heights.free[:, 0] & (readings.setups[2] > 0))
        if rows.size:
            yield prior(heights, rows, readings.setups[2][rows, None])


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


def _datum(settings: Settings, readings: Readings, blocks: Mapping[str, Block]) -> tuple[int, Datum | None]:
    """Return the station at the origin, -1 if the frame is given, and the datum; None where given points fix all."""
    points = readings.points
    if settings.datum == GIVEN or (settings.datum is None and not open_by_given(readings)):
        return -1, None
    listed = np.isfinite(points.listed).all(axis=1)
    if settings.datum_points is not None:
        members = np.isin(np.array(points.names), settings.datum_points)
    else:
        members = listed if listed.any() else np.ones(points.count, dtype=bool)
    block = blocks[t.POINT]
    reference = np.where(np.isfinite(points.listed), points.listed, block.values)
    used = {name: move for name, move in movements().items() if name in blocks}
    taking = (members & block.free.all(axis=1)).astype(float)
    datum = Datum(t.POINT, np.nan_to_num(reference), taking, used, FREEDOMS)
    first = -1 if listed.any() else int(np.argmax([kind != "" for kind in kind_of_stations(readings)]))
    return first, datum


def open_by_given(readings: Readings) -> list[str]:
    """Return the motions that given points, verticals and lengths leave open."""
    points = readings.points
    used = np.isfinite(points.sigma) & _seen(readings)[:, None]
    level = any(readings.of(i).is_levelled for i in np.unique(readings.sightings.station))
    level = level or readings.heights is not None
    lengths = readings.lengths is not None or readings.bars is not None
    lengths = lengths or bool(np.isfinite(readings.sightings.values[DISTANCE]).any())
    needed = [0, 1, 2, *([] if level else [3, 4]), 5, *([] if lengths else [6])]
    place = np.nan_to_num(points.listed)
    centred = place - place[used.any(axis=1)].mean(axis=0) if used.any() else place
    centred /= float(np.abs(centred[used.any(axis=1)]).max(initial=0.0)) or 1.0
    moves = of_points(scale=True).at(centred, np.arange(points.count))[used][:, needed]
    if not len(moves):
        return [FREEDOMS[i] for i in needed]
    _, values, vectors = np.linalg.svd(moves, full_matrices=True)
    values = np.concatenate([values, np.zeros(len(needed) - len(values))]) if len(values) < len(needed) else values
    loose = vectors[values < 1e-6 * values[0]]
    return [FREEDOMS[i] for k, i in enumerate(needed) if (np.abs(loose[:, k]) > 0.1).any()]


def _places(readings: Readings) -> dict[str, Place]:
    """Return the places at which effects can act."""
    kinds = kind_of_stations(readings)
    tracers = tuple(readings.stations.names[i] for i in _rows(kinds, t.TRACER))
    bars = () if readings.bars is None else tuple(readings.bars.table.texts("bar"))
    return {
        "instrument": Place(tuple(readings.instruments), OF_INSTRUMENT),
        "station": Place(readings.stations.names, OF_STATION),
        "point": Place(readings.points.names, OF_POINT),
        "tracer": Place(tracers, OF_TRACER),
        "bar": Place(bars, OF_BAR),
        "setup": Place(readings.setups[0], OF_SETUP),
        "method": Place(_methods(readings)),
    }


def _verticals(curvature: float) -> dict[str, Aspect]:
    """Return the leans of the verticals at stations and targets, and the curvature in height differences."""

    def lean(column: int, target: bool, blocks: Mapping[str, Block], observations: Observations) -> Array:
        place = _place_of(target, blocks, observations)
        return np.zeros(observations.count) if place is None else place[:, column] * curvature

    def curved(blocks: Mapping[str, Block], observations: Observations) -> Array:
        if OF_LINE not in observations.index:
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
        return blocks[t.POINT].values[index[OF_POINT]] if OF_POINT in index else None
    if s.LEVELLED in index:
        return blocks[s.LEVELLED].values[index[s.LEVELLED]]
    return blocks[t.POINT].values[index[t.POINT][1]] if s.OVER in index else None
