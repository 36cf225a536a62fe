"""Points and stations of an adjusted network: places, angles and heights with uncertainties."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array, Index, Mask
from metrocli.effects.links.stations import ExactListedWrongly
from metrocli.effects.model import Added
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments import stations as s
from metrocli.instruments import tracer as t
from metrocli.result import Estimate
from metrocli.table import Table
from metrocli.tasks.adjust_network.problem import Network
from metrocli.tasks.shared.joint_covariance import factors, factors_less

_ANGLES = ("alpha", "beta", "gamma")
_LARGEST_JOINT = 2000
"""Most points whose joint covariance the result holds as one matrix"""


def true_places(blocks: Mapping[str, Block], effects: Sequence[Added]) -> Array:
    """Return where points are, (n, 3): the exact coordinates of a list less the errors that effects give them."""
    values = blocks[t.POINT].values.copy()
    for point, name in _wrong_lists(blocks, effects):
        values[point] -= blocks[name].values[0]
    return values


def _wrong_lists(blocks: Mapping[str, Block], effects: Sequence[Added]) -> Iterator[tuple[int, str]]:
    """Yield points whose exact listed coordinates an effect takes for wrong, with the block of their errors."""
    for one in effects:
        where = dict(zip(one.effect.keys, one.instances[0], strict=True))
        if one.effect.link is not None and isinstance(one.effect.link(one.block, where), ExactListedWrongly):
            yield blocks[t.POINT].members.index(where["point"]), one.block


def covariances_of_points(network: Network, solution: Solution, seen: Mask) -> dict[str, Array]:
    """Return the covariance of each point that is `seen`, and what the points share, for the result."""
    known, wrong = solution.covariance_or_raise(), [*_wrong_lists(solution.blocks, network.effects)]
    each, joint = known.members(t.POINT)[seen], None
    shared, rows = factors(known, t.POINT, seen), np.repeat(seen, 3)
    if seen.sum() <= _LARGEST_JOINT:
        joint = known.of(t.POINT)[np.ix_(rows, rows)]
    if wrong:
        at = np.concatenate([np.eye(len(rows))[:, 3 * point : 3 * point + 3] for point, _ in wrong], axis=1)[rows]
        by = np.concatenate([known.between(t.POINT, name) for _, name in wrong], axis=1)[rows]
        own = np.block([[known.between(a, b) for _, b in wrong] for _, a in wrong])
        shared = factors_less(shared, at, by, own)
        crossed, ats = (part.reshape(-1, 3, len(own)) for part in (by, at))
        both = np.einsum("nia,nja->nij", crossed, ats)
        each = each - both - np.swapaxes(both, 1, 2) + ats @ own @ np.swapaxes(ats, 1, 2)
        joint = None if joint is None else joint - by @ at.T - at @ by.T + at @ own @ at.T
    return {"points_covariance": each, **shared} | ({} if joint is None else {"points_joint_covariance": joint})


@dataclass(frozen=True)
class _Row:
    """One estimate: its value, and its derivatives by entries of blocks."""

    name: str
    value: float
    unit: str
    by: tuple[tuple[str, int, float], ...]
    """Block, flat entry, derivative"""


@dataclass(frozen=True)
class StationEstimates:
    """Estimates of the stations, and what they are made of."""

    rows: tuple[_Row, ...]
    estimates: tuple[Estimate, ...]
    table: Table
    covariance: Array

    def joint(self, solution: Solution, more: Sequence[str]) -> Array:
        """Return the covariance of the estimates, followed by the free entries of some blocks."""
        if not more:
            return self.covariance
        free = [(name, int(entry), 1.0) for name in more for entry in np.flatnonzero(solution.blocks[name].free)]
        scale = [solution.by_step(name).ravel()[entry] for name, entry, _ in free]
        rows = [
            *(row.by for row in self.rows),
            *(((name, entry, by),) for (name, entry, _), by in zip(free, scale, strict=True)),
        ]
        return _covariance(solution, rows)


def placed_stations(network: Network, solution: Solution) -> StationEstimates:
    """Return the stations of a solved network."""
    rows = [*_rows(network, solution)]
    covariance = _covariance(solution, [row.by for row in rows])
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    estimates = tuple(
        Estimate(row.name, row.value, float(spread), row.unit) for row, spread in zip(rows, std, strict=True)
    )
    free = [i for i, row in enumerate(rows) if row.by]
    kept = tuple(estimates[i] for i in free)
    table = _table(network, dict(zip((row.name for row in rows), estimates, strict=True)))
    return StationEstimates(tuple(rows[i] for i in free), kept, table, covariance[np.ix_(free, free)])


def _rows(network: Network, solution: Solution) -> list[_Row]:
    """Return the estimates of all stations and set-ups, in the order of the list."""
    blocks = solution.blocks
    rows: list[_Row] = []
    for number, name in enumerate(network.readings.stations.names):
        if s.STATION in blocks and name in blocks[s.STATION].members:
            rows += _pose(solution, name)
        elif s.LEVELLED in blocks and name in blocks[s.LEVELLED].members:
            rows += _coordinates(solution, s.LEVELLED, name)
        elif s.OVER in blocks and name in blocks[s.OVER].members:
            rows += _over(network, solution, number, name)
        elif t.TRACER in blocks and name in blocks[t.TRACER].members:
            rows += _coordinates(solution, t.TRACER, name)
            rows += _entry(solution, t.TRACER, name, 3, f"{name}.dead_path")
        rows += _rounds(network, solution, number, name)
    for name in blocks[s.SETUP].members[1:] if s.SETUP in blocks else ():
        rows += _entry(solution, s.SETUP, name, 0, f"{name}.height")
    return rows


def _entry(solution: Solution, block: str, member: str, column: int, name: str) -> list[_Row]:
    placed = solution.blocks[block]
    row = placed.members.index(member)
    entry = row * placed.size + column
    by = ((block, entry, 1.0),) if placed.free[row, column] else ()
    return [_Row(name, float(placed.values[row, column]), "mm", by)]


def _coordinates(solution: Solution, block: str, name: str) -> list[_Row]:
    return [row for k, axis in enumerate("xyz") for row in _entry(solution, block, name, k, f"{name}.{axis}")]


def _pose(solution: Solution, name: str) -> list[_Row]:
    block = solution.blocks[s.STATION]
    row = block.members.index(name)
    values, by_step = poses.euler_form(block.values[row]), poses.euler_form_by_step(block.values[row])
    return [
        _Row(
            f"{name}.{column}",
            float(values[k]),
            "mm" if k < 3 else "rad",
            tuple((s.STATION, row * 6 + i, float(by_step[k, i])) for i in np.flatnonzero(by_step[k]).tolist()),
        )
        for k, column in enumerate(poses.EULER)
    ]


def _over(network: Network, solution: Solution, number: int, name: str) -> list[_Row]:
    """Return the place of a station over a point, `P + L o`, and its height."""
    offsets, points = solution.blocks[s.OVER], solution.blocks[t.POINT]
    row, point = offsets.members.index(name), int(network.readings.stations.over[number])
    wrong = [error for at, error in _wrong_lists(solution.blocks, network.effects) if at == point]
    mark = true_places(solution.blocks, network.effects)[point]
    lean = _lean(network, mark)
    place = mark + lean @ offsets.values[row]
    rows = []
    for k, axis in enumerate("xyz"):
        by = [(t.POINT, 3 * point + k, 1.0)] if points.free[point, k] else []
        by += [(error, k, -1.0) for error in wrong if solution.blocks[error].free[0, k]]
        by += [(s.OVER, 3 * row + i, float(lean[k, i])) for i in range(3) if offsets.free[row, i] and lean[k, i]]
        rows.append(_Row(f"{name}.{axis}", float(place[k]), "mm", tuple(by)))
    return [*rows, *_entry(solution, s.OVER, name, 2, f"{name}.height")]


def _lean(network: Network, place: Array) -> Array:
    """Return the rotation from the levelled frame at a place to the network."""
    from metrocli.geometry.rotations import rotation_from_vector

    vertical = network.settings.vertical
    if vertical is None:
        return np.eye(3)
    return rotation_from_vector(np.array([-place[1], place[0], 0.0]) / vertical.radius)


def _rounds(network: Network, solution: Solution, number: int, name: str) -> list[_Row]:
    block = solution.blocks.get(s.ORIENTATION)
    if block is None:
        return []
    own = [
        i for i, (station, _) in enumerate(network.readings.sightings.rounds) if station == number and block.free[i, 0]
    ]
    several = len(own) > 1
    return [
        _Row(
            f"{name}.gamma.{network.readings.sightings.rounds[i][1]}" if several else f"{name}.gamma",
            float(np.remainder(block.values[i, 0] + np.pi, 2 * np.pi) - np.pi),
            "rad",
            ((s.ORIENTATION, i, 1.0),),
        )
        for i in own
    ]


def _covariance(solution: Solution, rows: Sequence[tuple[tuple[str, int, float], ...]]) -> Array:
    """Return the covariance of linear combinations of unknowns."""
    known = solution.covariance_or_raise()
    names = list(dict.fromkeys(block for row in rows for block, _, _ in row))
    covariance = np.zeros((len(rows), len(rows)))
    matrices: dict[str, tuple[Index, Array]] = {}
    for name in names:
        entries = np.unique([entry for row in rows for block, entry, _ in row if block == name])
        place = {int(entry): i for i, entry in enumerate(entries)}
        by = np.zeros((len(rows), len(entries)))
        for i, row in enumerate(rows):
            for block, entry, derivative in row:
                if block == name:
                    by[i, place[entry]] += derivative
        matrices[name] = entries.astype(np.intp), by
    for a in names:
        for b in names:
            (first, by_a), (second, by_b) = matrices[a], matrices[b]
            covariance += by_a @ known.between(a, b)[np.ix_(first, second)] @ by_b.T
    return (covariance + covariance.T) / 2


def _table(network: Network, by_name: dict[str, Estimate]) -> Table:
    """Return /stations: instrument, pose with standard uncertainties, and number of shots."""
    readings = network.readings
    names, instruments = readings.stations.names, list(readings.instruments)
    columns = ("x", "y", "z", *_ANGLES, "height", "dead_path")
    shots = np.bincount(readings.sightings.station, minlength=len(names))
    if readings.lengths is not None:
        shots = shots + np.bincount(readings.lengths.first, minlength=len(names))
    rows = []
    for number, name in enumerate(names):
        row = [by_name.get(f"{name}.{column}") for column in columns]
        values = [float("nan") if e is None else e.value for e in row]
        std = [float("nan") if e is None else e.std for e in row]
        pairs = [both for pair in zip(values, std, strict=True) for both in pair]
        rows.append((name, instruments[readings.stations.instrument[number]], *pairs, int(shots[number])))
    units = ("mm",) * 3 + ("rad",) * 3 + ("mm",) * 2
    headings = [
        text
        for column, unit in zip(columns, units, strict=True)
        for text in (f"{column} [{unit}]", f"s_{column} [{unit}]")
    ]
    return Table.of_rows(("station [text]", "instrument [text]", *headings, "shots"), rows)
