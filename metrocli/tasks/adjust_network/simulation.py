"""Simulated readings of a network whose points and stations are those of its files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from types import MappingProxyType

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.arrays import Array
from metrocli.effects.estimates import true_values
from metrocli.effects.extension import extended
from metrocli.effects.model import Model
from metrocli.effects.requested import RequestedEffect
from metrocli.errors import InputError
from metrocli.geometry import poses
from metrocli.instruments import stations as s
from metrocli.instruments import tracer as t
from metrocli.instruments.tracker import AZIMUTH, DISTANCE, ELEVATION
from metrocli.simulation import Simulation
from metrocli.table import Table
from metrocli.tasks.adjust_network.groups import BARS, GIVEN_POINTS, HEIGHTS, LENGTHS, ROW, is_sighting
from metrocli.tasks.adjust_network.noise import component
from metrocli.tasks.adjust_network.placed import true_places
from metrocli.tasks.adjust_network.problem import Network, build, weighed_at
from metrocli.tasks.adjust_network.readings import read
from metrocli.tasks.adjust_network.settings import INTERFEROMETER, Files, NetworkSimulation, Settings
from metrocli.tasks.adjust_network.starts.agreement import NetworkStart
from metrocli.tasks.shared.lists import listed_places
from metrocli.words import listed

_TILT = 0.02
"""Standard deviation of the tilt of a simulated tracker, about each axis [rad]"""
_PACE = 10.0
"""Time from one sighting to the next of stations that are added to a file [s]"""
_DEAD = (300.0, 900.0)
"""Range of simulated dead paths [mm]"""


def designed(settings: Settings, files: Files, truth: NetworkSimulation) -> Files:
    """Return the files with readings of nothing: those of the file, and all points from the stations without any."""
    chosen = [settings.instruments.get(name) for name in files.stations.texts("instrument")]
    polar = np.array([instrument is not None and instrument.type != INTERFEROMETER for instrument in chosen])
    stations = np.array(files.stations.texts("station"))
    points = _names(files)
    read_already = set(files.sightings.texts("station")) if len(files.sightings) else set()
    lacking = [name for name in stations[polar].tolist() if name not in read_already]
    if lacking:
        files = replace(files, readings=_joined(files.sightings, _shots(lacking, points, files, truth)))
    if files.lengths is None and not polar.all():
        pairs = list(product(stations[~polar], points))
        begin = len(files.sightings) * (truth.interval or 0.0)
        times = {"t [s]": begin + truth.interval * np.arange(len(pairs))} if truth.interval else {}
        length = {"length [mm]": np.ones(len(pairs))}
        names = {"station [text]": [a for a, _ in pairs], "point [text]": [b for _, b in pairs]}
        files = replace(files, lengths=Table.of({**names, **length, **times}))
    return files


def _names(files: Files) -> list[str]:
    if not isinstance(files.points, Table) or not len(files.points):
        raise InputError("simulate and plan need the true points: `inputs: {points: points.csv}`")
    return files.points.texts("point")


def _shots(stations: Iterable[str], points: Sequence[str], files: Files, truth: NetworkSimulation) -> Table:
    """Return sightings of all points, forth in face 1 and back in face 2; a station does not see its own mark."""
    over = files.stations.texts("over", "")
    below = dict(zip(files.stations.texts("station"), over, strict=True))
    rows = []
    for station in stations:
        seen = [point for point in points if point != below[station]]
        rows += [(station, point, 1.0) for point in seen]
        rows += [(station, point, 2.0) for point in reversed(seen)] if truth.faces == 2 else []
    nothing = np.ones(len(rows))
    shots = Table.of_rows(("station [text]", "point [text]", "face"), rows)
    times = {"t [s]": truth.interval * np.arange(len(rows))} if truth.interval else {}
    return shots.joined({"az [rad]": nothing, "el [rad]": nothing / 2, "d [mm]": nothing, **times})


def _joined(old: Table, new: Table) -> Table:
    """Return the rows of two tables of sightings, with the columns of the first if it has rows."""
    if not len(old):
        return new
    rows = {"hz": new.columns["az"], "zd": new.columns["el"], **new.columns}
    if "t" in old and "t" not in new:
        rows["t"] = float(np.max(old.columns["t"])) + _PACE * np.arange(1.0, len(new) + 1)
    return old.extended(rows)


def true_network(
    settings: Settings, files: Files, rng: np.random.Generator, rolled: Mapping[str, float] = MappingProxyType({})
) -> Network:
    """Return the network at its truth: listed points and stations; orientations and dead paths are drawn.

    `rolled` has the stations that stand on their side, each with its gamma: their standing axis lies near
    (sin gamma, -cos gamma, 0).
    """
    readings = read(settings, files)
    stations = readings.stations
    place, n = stations.listed.copy(), len(stations.names)
    over = stations.over >= 0
    place[over] = readings.points.listed[stations.over[over]] + np.outer(stations.height[over], [0.0, 0.0, 1.0])
    every = {"point": (readings.points.names, readings.points.listed), "station": (stations.names, place)}
    for what, (names, places) in every.items():
        if lost := [names[i] for i in np.flatnonzero(np.isnan(places).any(axis=1))]:
            raise InputError(f"simulate and plan need x, y, z of each {what}; these have none: {listed(lost)}")
    tilt = rng.normal(0.0, _TILT, (n, 2)) * ~readings.levelled[:, None]
    turn = np.where(np.isnan(stations.gamma), rng.uniform(-np.pi, np.pi, n), stations.gamma)
    for name, gamma in rolled.items():
        tilt[stations.names.index(name), 0] += np.pi / 2
        turn[stations.names.index(name)] = gamma
    pose = poses.pose_from_euler(place, np.column_stack([tilt, turn]))
    of_rounds = turn[readings.sightings.station_of_round]
    network = build(settings, readings, NetworkStart(readings.points.listed, pose, of_rounds))
    blocks = dict(network.blocks)
    if t.TRACER in blocks:
        values = blocks[t.TRACER].values.copy()
        rows = [stations.names.index(name) for name in blocks[t.TRACER].members]
        values[:, :3] = place[rows]
        values[:, 3] = rng.uniform(*_DEAD, len(rows)) * blocks[t.TRACER].free[:, 3]
        blocks[t.TRACER] = blocks[t.TRACER].with_values(values)
    return _at(network, blocks)


def _at(network: Network, blocks: Mapping[str, Block]) -> Network:
    """Return a network at other values, with readings of no noise and standard deviations of its geometry."""
    model = replace(network.model, blocks=dict(blocks))
    groups = []
    for group in model.groups:
        if group.name in model.measured:
            group = weighed_at(group.simulated(model.blocks), network.noise, model.blocks)
        groups.append(group)
    return network.with_model(replace(model, groups=tuple(groups)))


def simulated(
    settings: Settings,
    files: Files,
    truth: NetworkSimulation,
    effects: Sequence[RequestedEffect],
    rng: np.random.Generator,
) -> Simulation:
    """Return what the instruments read of the points of the files, with effects and noise, and a list of points."""
    files = designed(settings, files, truth)
    network = true_network(settings, files, rng)
    model = extended(network.model, effects)
    read_ = {group.name: _read(group, model, rng) for group in model.readings}
    readings = network.readings
    tables: dict[str, Table] = {}
    if len(files.sightings):
        tables["readings.csv"] = _sightings(files.sightings, model, read_)
    for name, table, column in (
        (LENGTHS, files.lengths, "length"),
        (BARS, files.bars, "length"),
        (HEIGHTS, files.heights, "dh"),
    ):
        if table is not None and name in read_:
            tables[f"{name}.csv"] = table.without(column).changed({column: read_[name][0]})
    names, places = readings.points.names, readings.points.listed
    tables["points.csv"] = _list_of_points(
        network, files, read_, places, rng.normal(0.0, truth.point_error, places.shape)
    )
    tables["true_points.csv"] = listed_places("point", names, true_places(model.blocks, model.added))
    return Simulation(tables, _truth(model) | true_values(model))


def _list_of_points(network: Network, files: Files, read_: Mapping[str, Array], places: Array, errors: Array) -> Table:
    """Return the list of points at places (n, 3) mm: known coordinates as their sigmas state, others with `errors`."""
    known = np.isfinite(network.readings.points.sigma)
    at = places + np.where(known, 0.0, errors)
    for axis in range(3):
        if (name := f"{GIVEN_POINTS} {'xyz'[axis]}") in read_:
            group = next(group for group in network.model.readings if group.name == name)
            # it reads the difference of the list from the truth
            at[group.observations.index[t.POINT].ravel(), axis] += read_[name].ravel()
    if not known.any() or not isinstance(files.points, Table):
        return listed_places("point", network.readings.points.names, at)
    return files.points.changed(dict(zip("xyz", at[: len(files.points)].T, strict=True)))


def _read(group: Group, model: Model, rng: np.random.Generator) -> Array:
    """Return the readings of a group with noise."""
    observations = group.observations
    exact = group.chain.predict(model.blocks, observations)
    if observations.covariance is not None:
        return exact
    return np.asarray(exact + rng.normal(0.0, 1.0, exact.shape) * observations.stds)


def _sightings(design: Table, model: Model, read_: dict[str, Array]) -> Table:
    """Return the sightings in the order of their design, as in face 1."""
    values = np.full((3, len(design)), np.nan)
    for group in model.readings:
        if is_sighting(group):
            values[component(group), group.observations.index[ROW]] = read_[group.name][0]
    values[AZIMUTH] = np.remainder(values[AZIMUTH], 2 * np.pi)
    kept = ("station", "point", "face", "round", "setup", "th", "t", "temp")
    columns = {name: design.columns[name] for name in kept if name in design}
    units = {name: unit for name, unit in design.units.items() if name in kept}
    polar = {"az": values[AZIMUTH], "el": values[ELEVATION], "d": values[DISTANCE]}
    return Table({**columns, **polar}, {**units, "az": "rad", "el": "rad", "d": "mm"})


def _truth(model: Model) -> dict[str, float]:
    """Return the true stations by the names of their estimates."""
    truth: dict[str, float] = {}
    for name, columns in ((s.STATION, poses.EULER), (s.LEVELLED, ("x", "y", "z")), (t.TRACER, t.COLUMNS[:4])):
        if name in model.blocks:
            block = model.blocks[name]
            values = poses.euler_form(block.values) if name == s.STATION else block.values
            truth |= {
                f"{member}.{column}": float(row[k])
                for member, row in zip(block.members, values, strict=True)
                for k, column in enumerate(columns)
            }
    return truth
