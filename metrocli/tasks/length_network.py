"""The adjustment of a network of lengths, from readings to blocks and groups with starting values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from metrocli.adjust.blocks import Array, Block
from metrocli.adjust.chain import Chain
from metrocli.adjust.datum import Datum
from metrocli.adjust.groups import Group, prior
from metrocli.adjust.noise import Noise, adjust_with_noise
from metrocli.adjust.observations import Index, Mask, Observations
from metrocli.adjust.robust import Suspects, gross, robust_start, suspects
from metrocli.adjust.solution import Solution
from metrocli.errors import Fault, InputError, UndeterminedError
from metrocli.instruments import tracer as t
from metrocli.instruments.frames import DistanceBetween
from metrocli.instruments.tracer_start import start
from metrocli.table import Table
from metrocli.tasks.sightings import listed

LENGTHS = "lengths"
"""Name of the group of lengths"""
_FEWEST = {"changes": 4, "absolute": 3}
"""Points that a tracer of unknown place needs"""


class NoiseSettings(Protocol):
    """Standard deviation of a length."""

    @property
    def constant(self) -> float:
        """a [mm]"""

    @property
    def proportional(self) -> float:
        """b"""


class ScaleSettings(Protocol):
    """What is known of the scales."""

    @property
    def uncertainty(self) -> float:
        """Standard uncertainty of each"""


class NetworkSettings(Protocol):
    """The settings that the network needs."""

    @property
    def noise(self) -> NoiseSettings:
        """Standard deviation of a length"""

    @property
    def measures(self) -> str:
        """changes or absolute"""

    @property
    def scale(self) -> ScaleSettings | None:
        """None: scales are 1"""

    @property
    def datum(self) -> str | None:
        """inner-constraints, points, or None"""


@dataclass(frozen=True)
class Network:
    """A network of lengths ready to adjust."""

    blocks: Mapping[str, Block]
    lengths: Group
    others: tuple[Group, ...]
    datum: Datum | None
    noise: Noise
    nominal: Array
    """The mover's readings of the points (points, 3)"""
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Solved:
    """An adjusted network with what was rejected on the way."""

    network: Network
    solution: Solution
    group: Group
    """The lengths that were used"""
    rejected: tuple[tuple[int, float], ...]
    suspects: Suspects


def build(
    settings: NetworkSettings, lengths: Table, points: Table, tracers: Table | None, distances: Table | None
) -> Network:
    """Return the adjustment with its starting values."""
    if len(lengths) == 0:
        raise InputError([Fault("the file has no lengths", lengths.file)])
    names = points.texts("point")
    point = _places(lengths, "point", names, points.file)
    stations = tracers.texts("tracer") if tracers is not None else sorted(set(lengths.texts("tracer")))
    station = _places(lengths, "tracer", stations, tracers.file if tracers is not None else "")
    _check_paths(settings, lengths)
    seen = np.bincount(point, minlength=len(names))
    sigma = _sigmas(points, np.nan)
    nominal = points.stacked("xyz")
    extent = float(np.ptp(nominal[seen > 0], axis=0).max()) or 1.0
    free = (sigma != 0) & (seen > 0)[:, None]
    point_block = t.point_block(nominal, names, free, extent)
    tracer_block = _tracers(settings, lengths, _Stations(stations, station, point, nominal, extent), tracers)
    readings = lengths.numbers("length")[None]
    observations = Observations(
        readings,
        np.array(settings.noise.constant),
        {t.POINT: point, t.TRACER: station},
        keys={"point": tuple(lengths.texts("point")), "tracer": tuple(lengths.texts("tracer"))},
        conditions={name: lengths.numbers(name) for name in ("t", "temp") if name in lengths},
        components=("length",),
        unit="mm",
    )
    noise = _path_noise(settings.noise)
    blocks = {t.POINT: point_block, t.TRACER: tracer_block}
    group = Group(LENGTHS, t.chain(), observations)
    group = group.with_observations(replace(observations, sigma=noise(group, blocks)))
    others = (
        *_known(point_block, sigma, free),
        *_known(tracer_block, _padded(tracers), tracer_block.free),
        *_scales(settings, tracer_block),
        *_distances(distances, names, seen),
    )
    unseen = [name for name, n in zip(names, seen, strict=True) if n == 0]
    warnings = (f"{len(unseen)} points have no length: {listed(unseen)}",) if unseen else ()
    inner = settings.datum != "points" and bool(free.any())
    datum = t.datum(point_block, free.all(axis=1).astype(float)) if inner else None
    return Network(blocks, group, others, datum, noise, nominal, warnings)


def solve(network: Network, remove: bool) -> Solved:
    """Adjust with weights from the adjusted paths and a robust start; leave outliers out where `remove` says so."""
    group, dropped = network.lengths, []
    state = robust_start(network.blocks.values(), [group, *network.others], LENGTHS, network.datum)
    rows = np.arange(group.observations.count)
    if remove:
        bad = gross(group, state)
        dropped += [(int(i), float("nan")) for i in rows[bad]]
        rows, group = rows[~bad], group.selected(~bad)
    while True:
        solution = adjust_with_noise(state.values(), [group, *network.others], (LENGTHS, network.noise), network.datum)
        group = next(g for g in solution.groups if g.name == LENGTHS)
        if solution.cofactor is None:
            nothing = Suspects(np.zeros(0, dtype=np.intp), np.zeros(0), 0.0)
            return Solved(network, solution, group, tuple(dropped), nothing)
        found = suspects(solution, group, max(1.0, solution.sigma0 if np.isfinite(solution.sigma0) else 1.0))
        if not (remove and found.rows.size):
            return Solved(network, solution, group, tuple(dropped), found)
        worst = int(found.rows[np.argmax(found.tests)])
        dropped.append((int(rows[worst]), float(found.tests.max())))
        keep = np.arange(len(rows)) != worst
        rows, group, state = rows[keep], group.selected(keep), dict(solution.blocks)


def _places(table: Table, column: str, names: Sequence[str], file: str) -> Index:
    place = {name: i for i, name in enumerate(names)}
    values = table.texts(column)
    strange = [row for row, name in enumerate(values) if name not in place]
    if strange:
        where = f"in {file}" if file else "in the list"
        raise InputError(
            [
                Fault(f"{column} '{values[row]}' is not {where}", table.file, table.lines[row] if table.lines else None)
                for row in strange[:20]
            ]
        )
    return np.array([place[name] for name in values], dtype=np.intp)


def _check_paths(settings: NetworkSettings, lengths: Table) -> None:
    values = lengths.numbers("length")
    if settings.measures == "absolute" and (values <= 0).any():
        rows = np.flatnonzero(values <= 0)[:20]
        text = "an absolute distance is not above zero"
        raise InputError([Fault(text, lengths.file, lengths.lines[i]) for i in rows])
    if len(values) > 1 and np.ptp(values) == 0:
        raise InputError([Fault("all lengths are equal", lengths.file, hint="is this the right column?")])


def _sigmas(table: Table, default: float) -> Array:
    common = table.numbers("sigma", default)
    sigma = np.stack([table.numbers(f"sigma_{axis}") if f"sigma_{axis}" in table else common for axis in "xyz"], axis=1)
    negative = np.flatnonzero((sigma < 0).any(axis=1))
    if negative.size:
        raise InputError([Fault("a standard deviation is negative", table.file, table.lines[i]) for i in negative])
    return sigma


@dataclass(frozen=True)
class _Stations:
    names: Sequence[str]
    station: Index
    point: Index
    nominal: Array
    extent: float


def _tracers(settings: NetworkSettings, lengths: Table, given: _Stations, table: Table | None) -> Block:
    absolute = settings.measures == "absolute"
    sigma = _padded(table) if table is not None else np.full((len(given.names), 5), np.nan)
    reading = lengths.numbers("length")
    values = np.zeros((len(given.names), 5))
    values[:, 4] = 1.0
    for i, name in enumerate(given.names):
        mine = given.station == i
        fixed = table is not None and bool((sigma[i, :3] == 0).all())
        if mine.sum() < _FEWEST[settings.measures] and not fixed:
            raise UndeterminedError(
                f"tracer {name} reads {mine.sum()} lengths; its place and dead path need {_FEWEST[settings.measures]} "
                "points at least, not in one plane"
            )
        values[i, :4] = _start_of(given.nominal[given.point[mine]], reading[mine], absolute, _row(table, i))
    free = np.ones((len(given.names), 5), dtype=bool)
    free[:, :3] = sigma[:, :3] != 0
    free[:, 3] = not absolute
    free[:, 4] = settings.scale is not None
    return t.tracer_block(values, given.names, free, given.extent)


def _row(table: Table | None, i: int) -> Array | None:
    return None if table is None else table.stacked("xyz")[i]


def _start_of(points: Array, reading: Array, absolute: bool, given: Array | None) -> Array:
    """Return the start of one tracer: as given, with the dead path that fits it, or found from the data."""
    if given is None:
        found = start(points, reading, absolute)
        return np.where(np.isfinite(found), found, 0.0)
    dead = 0.0 if absolute else float(np.median(np.linalg.norm(points - given, axis=1) - reading))
    return np.array([*given, dead])


def _padded(table: Table | None) -> Array:
    """Return the standard deviations of the tracers' columns (tracers, 5), nan for dead path and scale."""
    if table is None:
        return np.zeros((0, 5))
    sigma = _sigmas(table, np.nan)
    return np.column_stack([sigma, np.full((len(sigma), 2), np.nan)])


def _known(block: Block, sigma: Array, free: Mask) -> list[Group]:
    """Return what is known of places beforehand, as observations of their own."""
    if len(sigma) == 0:
        return []
    known = free & np.isfinite(sigma) & (sigma > 0)
    groups = []
    for pattern in np.unique(known, axis=0):
        axes = tuple(int(i) for i in np.flatnonzero(pattern))
        members = np.flatnonzero((known == pattern).all(axis=1))
        if axes and members.size:
            groups.append(prior(block, members, sigma[members][:, list(axes)], columns=axes))
    return groups


def _scales(settings: NetworkSettings, block: Block) -> list[Group]:
    if settings.scale is None:
        return []
    members = np.arange(len(block.members))
    return [prior(block, members, np.full((len(members), 1), settings.scale.uncertainty), columns=(4,))]


def _distances(table: Table | None, names: Sequence[str], seen: Index) -> list[Group]:
    if table is None:
        return []
    ends = np.stack([_places(table, column, names, "the points") for column in ("from", "to")])
    observations = Observations(
        table.numbers("length")[None], table.numbers("sigma")[None], {t.POINT: ends}, components=("length",), unit="mm"
    )
    return [Group("distances", Chain((DistanceBetween(t.POINT),)), observations)]


def _path_noise(settings: NoiseSettings) -> Noise:
    """Return `sigma = sqrt(a^2 + b^2 (l + l0)^2)` with the adjusted dead paths."""

    def sigma(group: Group, blocks: Mapping[str, Block]) -> Array:
        observations = group.observations
        path = observations.readings[0] + blocks[t.TRACER].values[observations.index[t.TRACER], 3]
        return np.asarray(np.sqrt(settings.constant**2 + (settings.proportional * path) ** 2)[None])

    return sigma
