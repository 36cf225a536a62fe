"""A planned measurement of lengths: which tracer reads which point, what follows, and places for one more tracer.

The distance of two points has its uncertainty from their joint covariance, also in a result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from metrocli.adjust.adjustment import covariance_at
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array, Index, Values
from metrocli.effects.requested import RequestedEffect
from metrocli.errors import InputError, UsageError
from metrocli.frozen import dataclass
from metrocli.instruments import tracer as t
from metrocli.result import Estimate, Result
from metrocli.table import Table
from metrocli.tasks.multilaterate.layout_faults import is_determined
from metrocli.tasks.multilaterate.problem import TracerNetwork, network_of
from metrocli.tasks.multilaterate.readings import read as read_lengths
from metrocli.tasks.multilaterate.settings import Files, LengthSimulation, Settings
from metrocli.tasks.shared.environment import air_of
from metrocli.tasks.shared.joint_covariance import factors
from metrocli.tasks.shared.lists import matched
from metrocli.tasks.shared.part import Part
from metrocli.uncertainty.predicted import COMMON, CORE
from metrocli.words import suggestion

_REFERENCE_DEGC = 20.0
"""Temperature at the first point (ISO 1)"""
_KEPT = ("point", "tracer", "t", "temp", "pressure", "humidity")


@dataclass(frozen=True)
class PlannedPoints:
    """A planned measurement: the points, the places of the tracers, and which point each tracer reads at what time."""

    points: Table
    tracers: Table
    lengths: Table | None = None
    """Lengths whose points, tracers, times and temperatures are taken over; if None, every tracer reads every point"""

    def design(self, pace: LengthSimulation | None) -> Table:
        """Return point, tracer and conditions of each reading; times and temperatures follow from `pace`, if given."""
        if self.lengths is not None:
            kept = (*_KEPT, *self.lengths.further)
            return replace(
                self.lengths, columns={name: self.lengths.columns[name] for name in kept if name in self.lengths}
            )
        names, stations = self.points.texts("point"), self.tracers.texts("tracer")
        turn = np.repeat(np.arange(len(names)), len(stations)).astype(float)
        columns: dict[str, Values] = {"point": np.repeat(np.array(names), len(stations))}
        columns["tracer"] = np.tile(np.array(stations), len(names))
        if pace is not None and pace.interval is not None:
            columns["t"] = turn * pace.interval
        if pace is not None and pace.warming:
            columns["temp"] = _REFERENCE_DEGC + pace.warming * turn / max(len(names) - 1, 1)
        return Table(columns)

    def with_tracer(self, name: str, place: Array) -> PlannedPoints:
        """Return the measurement with one more tracer, which reads every point that the others read."""
        row = {"tracer": name, **dict(zip("xyz", place.tolist(), strict=True))}
        more = replace(self, tracers=self.tracers.extended({key: np.array([value]) for key, value in row.items()}))
        if self.lengths is None:
            return more
        first = np.unique(self.lengths.columns["point"], return_index=True)[1]
        added = {**self.lengths.selected(first).columns, "tracer": np.array([name] * len(first))}
        return replace(more, lengths=self.lengths.extended(added))

    def of_points(self, rows: Index) -> PlannedPoints:
        """Return the measurement with only these points."""
        fewer = replace(self, points=self.points.selected(rows))
        if self.lengths is None:
            return fewer
        kept = np.isin(self.lengths.columns["point"], fewer.points.columns["point"])
        return replace(fewer, lengths=self.lengths.selected(kept))


@dataclass(frozen=True)
class PlannedNetwork:
    """A planned measurement with the settings and effects of its adjustment."""

    settings: Settings
    planned: PlannedPoints
    distances: Table | None = None
    """Calibrated distances between points"""
    effects: Sequence[RequestedEffect] = ()

    @cached_property
    def network(self) -> TracerNetwork:
        """The network with the expected lengths, free of noise.

        Raises InputError if a name is unknown or a tracer stands at a point.
        """
        points, tracers = self.planned.points, self.planned.tracers
        design = self.planned.design(self.settings.simulation)
        ends = matched(design, "point", points.texts("point"), points.file or "the list of points")
        starts = matched(design, "tracer", tracers.texts("tracer"), tracers.file or "the list of tracers")
        distance = np.linalg.norm(points.stacked("xyz")[ends] - tracers.stacked("xyz")[starts], axis=1)
        for i in np.flatnonzero(distance == 0)[:1]:
            raise InputError(f"tracer {design.texts('tracer')[i]} stands where point {design.texts('point')[i]} is")
        air = air_of(self.settings.environment, design, "tracer")
        read = distance if air is None else distance / air.towards
        lengths = design.changed({"length": read})
        bare = tracers.without("dead_path")
        readings = read_lengths(self.settings, Files(lengths, points, bare))
        listed_at = readings.tracers.listed_at
        places = np.column_stack([listed_at, np.zeros(len(listed_at)), np.ones(len(listed_at))])
        network = network_of(self.settings, readings, places, self.distances)
        return network.with_effects(self.effects)

    @cached_property
    def solution(self) -> Solution:
        """The solution at the planned places, for its covariance."""
        network = self.network
        return covariance_at(network.blocks.values(), [network.lengths, *network.others], network.datum)

    @property
    def names(self) -> list[str]:
        """Names of the points that are read."""
        members, seen = self.network.blocks[t.POINT].members, self.network.seen
        return [name for name, n in zip(members, seen, strict=True) if n]

    @property
    def places(self) -> Array:
        """Planned places of the points that are read, (points, 3); at 20 degC, as the result will give them."""
        nominal = self.network.nominal[self.network.seen > 0]
        return nominal if self.part is None else nominal * self.part.shrinkage

    @cached_property
    def covariances(self) -> Array:
        """Covariance of each point that is read, (points, 3, 3) in mm^2, with the growth of the part."""
        seen = self.network.seen > 0
        each = self.solution.covariance_or_raise().members(t.POINT)[seen]
        return each if self.part is None else self.part.of_points(self.network.nominal[seen], each)[1]

    @property
    def part(self) -> Part | None:
        """The part that carries the points; with probing that is the one probed, not the reflector's places."""
        return None if self.settings.inputs.probing is not None else self.settings.part

    def distance(self, first: int, second: int) -> tuple[float, float]:
        """Return the distance of two points that are read, by their rows, and its standard uncertainty."""
        rows = np.sort([first, second])
        chosen = np.zeros(len(self.network.seen), dtype=bool)
        chosen[np.flatnonzero(self.network.seen > 0)[rows]] = True
        places, pair = self.places[rows], factors(self.solution.covariance_or_raise(), t.POINT, chosen)
        if self.part is not None:
            pair[COMMON], pair[CORE] = self.part.of_factors(places, pair[COMMON], pair[CORE])
        return between_two(places, self.covariances[rows], pair)

    def with_tracer(self, name: str, place: Array) -> PlannedNetwork:
        """Return the layout with one more tracer, whose place, dead path and scale will be unknowns."""
        return replace(self, planned=self.planned.with_tracer(name, place))


def worst_direction(covariances: Array) -> Array:
    """Return the standard uncertainty (n,) of each point in its worst direction, from covariances (n, 3, 3)."""
    return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(covariances)[:, -1], 0.0)))


def root_mean_square(covariances: Array) -> float:
    """Return the root mean square standard uncertainty of all coordinates, from covariances (n, 3, 3)."""
    return float(np.sqrt(max(np.einsum("mii->m", covariances).mean() / 3, 0.0)))


_ACROSS, _BEYOND = 5, 0.5
"""Grid that is tried if no candidates are listed: places along each axis, and share by which it exceeds the volume"""
_CLEAR = 0.1
"""Grid places nearer to the volume than this share of it are left out, since a tracer there is in the way"""
_THICK = 0.2
"""Least thickness assumed for the volume, as a share of its largest side"""
_MOST = 300
"""Largest number of points used to compare candidates"""


@dataclass(frozen=True)
class Ranking:
    """Candidates for one more tracer, the best first."""

    table: Table
    """candidate, x, y, z, rms, worst, gain_rms, gain_worst: uncertainties of the points with it, and relative gains"""
    tried: int
    """Number of candidates compared"""


def ranked(layout: PlannedNetwork, candidates: Table | None) -> Ranking:
    """Rank places for one more tracer by the root mean square uncertainty of the points with it.

    Candidates with which the points stay undetermined are left out. If none are listed, a grid around the points is
    tried.
    """
    if candidates is None:
        names, places = _places(layout)
    else:
        names, places = candidates.texts("candidate"), candidates.stacked("xyz")
    part = _part(layout)
    before = np.array(_worth(part))
    more = [part.with_tracer(f"candidate {name}", place) for name, place in zip(names, places, strict=True)]
    with_it = np.array([_worth(network) for network in more]).reshape(-1, 2)
    order = np.argsort(with_it[:, 0], kind="stable")[: int(np.isfinite(with_it[:, 0]).sum())]
    gain = 1 - with_it[order] / before if np.isfinite(before).all() else np.full((len(order), 2), np.nan)
    columns: dict[str, Values] = {"candidate": np.array(names, dtype=str)[order]}
    columns |= {axis: places[order, i] for i, axis in enumerate("xyz")}
    columns |= {name: with_it[order, i] for i, name in enumerate(("rms", "worst"))}
    columns |= {f"gain_{name}": gain[:, i] for i, name in enumerate(("rms", "worst"))}
    return Ranking(Table(columns, dict.fromkeys(("x", "y", "z", "rms", "worst"), "mm")), len(names))


def _worth(layout: PlannedNetwork) -> tuple[float, float]:
    """Return the uncertainty of the points, root mean square and worst; inf if they are undetermined."""
    if not is_determined(layout.network, layout.solution) or layout.solution.covariance is None:
        return float("inf"), float("inf")
    return root_mean_square(layout.covariances), float(worst_direction(layout.covariances).max())


def _places(layout: PlannedNetwork) -> tuple[list[str], Array]:
    """Return names and places of a grid around the points, without those in the volume."""
    points = layout.planned.points.stacked("xyz")
    low, high = points.min(axis=0), points.max(axis=0)
    side = np.maximum(high - low, _THICK * (high - low).max())
    middle = (low + high) / 2
    steps = np.linspace(-0.5 - _BEYOND, 0.5 + _BEYOND, _ACROSS)
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    outside = grid[np.abs(grid).max(axis=1) > 0.5 + _CLEAR]
    return [f"C{i + 1}" for i in range(len(outside))], middle + outside * side


def _part(layout: PlannedNetwork) -> PlannedNetwork:
    """Return the layout with some of its points, evenly spread over their list, and with all known points."""
    n = len(layout.planned.points)
    if n <= _MOST:
        return layout
    even = np.linspace(0, n - 1, _MOST).astype(np.intp)
    chosen = np.union1d(even, np.flatnonzero(~layout.network.unknown))
    return replace(layout, planned=layout.planned.of_points(chosen))


def distance(result: Result, first: str, second: str) -> Estimate:
    """Return the distance of two points of a result with its standard uncertainty.

    Raises UsageError if the result lacks one of the points, InputError if it lacks the covariance between points.
    """
    if "points" not in result.tables or COMMON not in result.arrays:
        raise InputError("the result does not hold the covariance between points (too many points, or another kind)")
    names = result.tables["points"].texts("point")
    for name in (first, second):
        if name not in names:
            raise UsageError(f"the result has no point '{name}'; {suggestion(name, names)}")
    if first == second:
        raise UsageError(f"a distance is between two points; '{first}' is named twice")
    rows = [names.index(first), names.index(second)]
    places, own = result.tables["points"].stacked("xyz")[rows], result.arrays["points_covariance"][rows]
    length, std = between_two(places, own, {COMMON: result.arrays[COMMON][rows], CORE: result.arrays[CORE]})
    return Estimate(f"{first} - {second}", length, std, "mm")


def between_two(places: Array, own: Array, shared: Mapping[str, Array]) -> tuple[float, float]:
    """Return the distance of two points and its standard uncertainty, from their `factors`.

    `u^2 = e' (Q_aa + Q_bb - Q_ab - Q_ba) e`, e the unit vector between them; places (2, 3), own covariances (2, 3, 3).
    """
    away = places[0] - places[1]
    length = float(np.linalg.norm(away))
    both = shared[COMMON][0] @ shared[CORE] @ shared[COMMON][1].T
    direction = away / length if length else away
    variance = direction @ (own[0] + own[1] - both - both.T) @ direction
    return length, float(np.sqrt(max(variance, 0.0)))
