"""The result of a solved network."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from metrocli.adjust.model.groups import Group
from metrocli.adjust.robust import minimal_detectable
from metrocli.adjust.solution import Residuals, Solution
from metrocli.arrays import Array
from metrocli.effects.estimates import estimates, free_blocks
from metrocli.effects.estimates import tables as effect_results
from metrocli.instruments import tracer as t
from metrocli.result import Result, ShownTable
from metrocli.table import Table
from metrocli.tasks.adjust_network import KIND
from metrocli.tasks.adjust_network.groups import BARS, GIVEN_POINTS, HEIGHTS, OF_INSTRUMENT, is_sighting
from metrocli.tasks.adjust_network.placed import covariances_of_points, placed_stations, true_places
from metrocli.tasks.adjust_network.solve import AdjustedNetwork
from metrocli.tasks.adjust_network.suspects import SuspectedReading
from metrocli.tasks.adjust_network.unknowns import seen_points
from metrocli.tasks.shared.lists import unless_without_noise
from metrocli.tasks.shared.noise import JobNoise
from metrocli.tasks.shared.statistics import (
    REMOVE,
    Statistics,
    basic_statistics,
    beyond_bound,
    condition_columns,
    job_noise_notes,
    left_out,
    noise_notes,
    noise_warnings,
    point_shift,
    with_job_noise,
    with_tests,
)
from metrocli.words import counted, listed

_ONCE = 5


def report(solved: AdjustedNetwork, noise: JobNoise) -> Result:
    """Return the result of a solved network."""
    solution, added = noise.solution, solved.network.effects
    placed = placed_stations(solved.network, solution)
    delivered = (*placed.estimates, *estimates(added, solution))
    blocks = free_blocks(added)
    points, arrays = _points(solved, solution)
    effect_tables, effect_arrays = effect_results(added, solution)
    tables = {
        "points": points,
        "stations": placed.table,
        "residuals": _residuals(solved),
        "groups": _groups(solved),
        "two_face": _two_face(solved),
        "suspects": _listed(solved.suspects),
        "rejected": _listed(solved.rejected),
        **effect_tables,
    }
    return Result(
        kind=KIND.name,
        title="",
        estimates=delivered,
        covariance=placed.joint(solution, blocks),
        statistics=with_job_noise(_statistics(solved, solution), noise),
        tables=tables,
        arrays=arrays | effect_arrays,
        warnings=tuple(_warnings(solved, solution)),
        shown=tuple(_shown(solved)),
        notes=(
            *job_noise_notes(noise),
            *noise_notes(solution, cures=(REMOVE,)),
            *_datum_note(solved),
            *(f"its list decides, since a mirror image fits as well: {place.words}" for place in solved.second[:_ONCE]),
        ),
        details=noise.details([estimate.name for estimate in delivered]),
        list_offset=solved.list_offset,
    )


def _points(solved: AdjustedNetwork, solution: Solution) -> tuple[Table, dict[str, Array]]:
    network, names = solved.network, np.array(solution.blocks[t.POINT].members)
    # a listed point that no reading concerns is no unknown: its uncertainty would be stated as 0
    seen = seen_points(network.readings)
    arrays = covariances_of_points(network, solution, seen)
    std = np.sqrt(np.maximum(np.einsum("mii->mi", arrays["points_covariance"]), 0.0))
    places = true_places(solution.blocks, network.effects)
    table = Table.of({"point": names[seen], "x y z [mm]": places[seen], "sx sy sz [mm]": std})
    return table.joined({"shots": _shots(solved)[seen]}), arrays


def _shots(solved: AdjustedNetwork) -> Array:
    """Return how many readings concern each point."""
    count = np.zeros(len(solved.solution.blocks[t.POINT].members), dtype=int)
    for group in solved.groups:
        index = np.atleast_2d(group.observations.index[t.POINT])
        index = index[:1] if is_sighting(group) else index
        count += np.bincount(index.ravel(), minlength=len(count))
    return count


def _keys(group: Group, names: Sequence[str]) -> dict[str, Array]:
    keys = group.observations.keys
    return {f"{name} [text]": np.array(keys.get(name, ("",) * group.observations.count)) for name in names}


def _residuals(solved: AdjustedNetwork) -> Table:
    """Return /residuals: a row for each component of each reading, with its reliability."""
    names = [
        n
        for n in ("station", "point", "face", "round", "bar", "from", "to", "line")
        if any(n in g.observations.keys for g in solved.groups)
    ]
    parts = [_rows(solved, group, solved.residuals[group.name], names) for group in solved.groups]
    return Table.stack(parts) if parts else Table({})


def _rows(solved: AdjustedNetwork, group: Group, residuals: Residuals, names: Sequence[str]) -> Table:
    observations = group.observations
    noise = max(1.0, float(np.nan_to_num(solved.solution.sigma0, nan=1.0)))
    d, n = observations.readings.shape
    numbers = {
        "reading": observations.readings,
        "residual": residuals.values,
        "sigma": observations.deviations,
        "normalised [1]": residuals.normalised,
        "redundancy [1]": residuals.redundancy,
        "detectable": minimal_detectable(residuals, solved.critical, noise),
    }
    numbers["moves_point [mm]"] = _moves(solved, group, numbers["detectable"])
    when, none = condition_columns(observations), np.full(n, np.nan)
    times = {name: np.repeat(when.get(name, none), d) for name in ("t [s]", "temp [degC]") if _timed(solved, name)}
    keys = {name: np.repeat(index, d) for name, index in _keys(group, names).items()}
    quantity = np.tile(np.array(observations.components), n)
    if d > 1:  # given coordinates with a joint covariance: components are named by point and axis
        named = [text.rpartition(" ") for text in observations.components]
        keys["point [text]"] = np.array([point for point, _, _ in named])
        quantity = np.array([axis for _, _, axis in named])
    what = {"quantity [text]": quantity, "unit [text]": (observations.unit,) * (d * n)}
    return Table.of({**keys, **what, **{name: number.T.ravel() for name, number in numbers.items()}, **times})


def _moves(solved: AdjustedNetwork, group: Group, least: Array) -> Array:
    """Return how far the minimal detectable errors (d, n) move the point of a reading [mm]; nan for given points."""
    if len(least) > 1:
        return np.full(least.shape, np.nan)
    shift = point_shift(solved.solution, group)
    # what moves nothing does so for errors that nothing detects as well: 0 times infinity
    return np.multiply(shift, least, out=np.zeros_like(least), where=shift != 0)


def _timed(solved: AdjustedNetwork, name: str) -> bool:
    return any(name in condition_columns(group.observations) for group in solved.groups)


def _groups(solved: AdjustedNetwork) -> Table:
    """Return RMS, redundancy and variance factor of each instrument and quantity."""
    names = list(solved.network.readings.instruments)
    rows: dict[tuple[str, str, str], list[tuple[Array, ...]]] = {}
    for group in solved.groups:
        residuals, observations = solved.residuals[group.name], group.observations
        whole = (residuals.values.ravel(), residuals.redundancy.ravel(), residuals.normalised.ravel())
        instrument = observations.index.get(OF_INSTRUMENT)
        what = observations.components[0] if len(observations.components) == 1 else "x y z", observations.unit
        for number in (-1,) if instrument is None else np.unique(instrument).tolist():
            here = slice(None) if instrument is None else instrument == number
            name = group.name if instrument is None else names[number]
            rows.setdefault((name, *what), []).append(tuple(values[here] for values in whole))
    return Table.of_rows(
        (
            "instrument [text]",
            "quantity [text]",
            "unit [text]",
            "readings",
            "rms",
            "redundancy [1]",
            "variance_factor [1]",
        ),
        [(*key, *_figures(parts)) for key, parts in rows.items()],
    )


def _figures(parts: Sequence[tuple[Array, ...]]) -> tuple[object, ...]:
    """Return the figures of readings; the variance factor is `v'Pv / sum r` (Förstner 1979)."""
    values, redundancy, w = (np.concatenate(figures) for figures in zip(*parts, strict=True))
    total = float(redundancy.sum())
    factor = float((redundancy * w**2).sum() / total) if total > 1e-6 else float("nan")
    return len(values), float(np.sqrt((values**2).mean())), total, factor


def _two_face(solved: AdjustedNetwork) -> Table:
    """Return half the differences of face 1 less face 2 of each point at each station, across and along the beam [mm].

    The azimuth is times `d cos e`, the elevation times d, with the mean distance and elevation.
    """
    seen, readings = solved.network.readings.sightings, solved.network.readings
    pairs, number = np.unique(np.stack([seen.station, seen.point]), axis=1, return_inverse=True)
    number, count = number.ravel(), pairs.shape[1]
    near = np.zeros((3, count))
    near[:, number[::-1]] = seen.values[:, ::-1]
    away = seen.values - near[:, number]
    away[0] = np.remainder(away[0] + np.pi, 2 * np.pi) - np.pi
    both = np.full((2, 3, count), np.nan)
    with np.errstate(invalid="ignore"):
        for k, here in enumerate((seen.face > 0, seen.face < 0)):
            for q in range(3):
                kept = here & np.isfinite(away[q])
                both[k, q] = np.bincount(number[kept], away[q, kept], count) / np.bincount(
                    number[kept], minlength=count
                )
    half = (both[0] - both[1]) / 2
    half[0] *= near[2] * np.cos(near[1])
    half[1] *= near[2]
    rows = np.flatnonzero(np.isfinite(half).any(axis=0))
    names = (readings.stations.names, readings.points.names)
    station, point = ([pair[i] for i in index[rows]] for pair, index in zip(names, pairs, strict=True))
    return Table.of(
        {"station [text]": station, "point [text]": point, "azimuth elevation distance [mm]": half[:, rows].T}
    )


def _listed(chosen: Sequence[SuspectedReading]) -> Table:
    """Return a table of readings: their keys, quantity and test."""
    names = list(dict.fromkeys(name for suspect in chosen for name in suspect.keys))
    rows = [(*(suspect.keys.get(name, "") for name in names), suspect.test) for suspect in chosen]
    return Table.of_rows((*(f"{name} [text]" for name in names), "w"), rows)


def _named(chosen: Sequence[SuspectedReading]) -> list[str]:
    return with_tests([suspect.name for suspect in chosen], [suspect.test for suspect in chosen])


def _statistics(solved: AdjustedNetwork, solution: Solution) -> Statistics:
    rms = {}
    for unit in ("rad", "mm"):
        values = [solved.residuals[group.name].values for group in solved.groups if group.observations.unit == unit]
        if values:
            rms[unit] = float(np.sqrt(np.mean(np.concatenate([value.ravel() for value in values]) ** 2)))
    return basic_statistics(solution, rms) | {"rejected": len(solved.rejected), "critical_w": solved.critical}


def _shown(solved: AdjustedNetwork) -> Iterator[ShownTable]:
    yield ShownTable("points", ("point", "x", "y", "z", "sx", "sy", "sz"))
    yield ShownTable("groups")
    if solved.suspects:
        yield ShownTable("suspects")


def _datum_note(solved: AdjustedNetwork) -> Iterator[str]:
    network, solution = solved.network, solved.solution
    if network.datum is None or not solution.conditions:
        return
    where = "on their listed places" if network.first < 0 else "on their adjusted places"
    count = int(network.datum.members.sum())
    yield f"datum: inner constraints on {count} points {where}; {solution.conditions} motions are open"
    if network.first >= 0:
        name = network.readings.stations.names[network.first]
        yield f"without a list of points station {name} stands at the origin"


def _warnings(solved: AdjustedNetwork, solution: Solution) -> Iterator[str]:
    yield from solved.network.readings.warnings
    yield from unless_without_noise(solved.network.readings.stuck, solution.sigma0)
    yield from noise_warnings(solution, (REMOVE,), len(solved.rejected))
    yield from left_out(_named(solved.rejected))
    if solved.suspects:
        yield beyond_bound(_named(solved.suspects), solved.critical)
    block = solved.solution.blocks[t.POINT]
    if unread := [block.members[i] for i in np.flatnonzero(~seen_points(solved.network.readings))]:
        yield f"{counted(len(unread), 'point', 'have')} no reading, and no row in /points: {listed(unread)}"
    once = _seen_once(solved)
    if once:
        named = listed(once, _ONCE)
        yield f"{counted(len(once), 'point', 'are')} determined, but not checked: {named}; a second station would"


def _seen_once(solved: AdjustedNetwork) -> list[str]:
    """Return the points whose readings have no redundancy together."""
    block = solved.solution.blocks[t.POINT]
    total, count = np.zeros(len(block.members)), np.zeros(len(block.members))
    for group in solved.groups:
        if group.name in (BARS, HEIGHTS) or group.name.startswith(GIVEN_POINTS):
            continue
        index = group.observations.index[t.POINT]
        index = index[0] if index.ndim > 1 else index
        total += np.bincount(index, solved.residuals[group.name].redundancy.max(axis=0), len(total))
        count += np.bincount(index, minlength=len(count))
    weak = (count > 0) & (total < 1e-6) & block.free.any(axis=1)
    return [block.members[i] for i in np.flatnonzero(weak)]
