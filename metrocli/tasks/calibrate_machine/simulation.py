"""Simulate measurements of a machine with random errors: standstill points, a track along a path, six-dof lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.effects.estimates import true_values
from metrocli.effects.extension import extended
from metrocli.effects.model import Model
from metrocli.effects.requested import RequestedEffect
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.geometry.rotations import rotation_from_euler
from metrocli.instruments.axes.kinematics import reach
from metrocli.instruments.machine import POSITION, SQUARENESS, SQUARENESS_NAMES, Machine
from metrocli.instruments.machine_path import SINCE, Path, travelled
from metrocli.instruments.six_dof import CHANNELS, COLUMNS, LINE, line_block, line_chain
from metrocli.instruments.tracer import AIR, POINT, STOP, TRACER, beams, tracer_block
from metrocli.instruments.tracer import chain as length_chain
from metrocli.instruments.tracker import TRACKER, point_chain, tracker_block
from metrocli.simulation import Simulation
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.described import commanded, machine_of
from metrocli.tasks.calibrate_machine.files import Files
from metrocli.tasks.calibrate_machine.methods.lengths import first_read, stop_names, visits
from metrocli.tasks.calibrate_machine.methods.lines import MeasuredLines, approach, line_conditions, lines_of
from metrocli.tasks.calibrate_machine.methods.on_the_fly import path_of
from metrocli.tasks.calibrate_machine.methods.poses import STATIONS, around, clock, in_degrees, sides_of
from metrocli.tasks.calibrate_machine.methods.simulated_poses import simulated_turning
from metrocli.tasks.calibrate_machine.plans.stops import columns_of, proposed_lines
from metrocli.tasks.calibrate_machine.problem import SIDES, tool_column, tools_of
from metrocli.tasks.calibrate_machine.settings import (
    LENGTHS,
    ON_THE_FLY,
    SIX_DOF,
    STANDSTILL,
    TURNING,
    MachineSimulation,
    Settings,
)
from metrocli.tasks.calibrate_machine.truth import Flow, TrueMachine, true_errors, truth_of, warmed
from metrocli.tasks.calibrate_machine.volume import grid_of
from metrocli.tasks.job import Job
from metrocli.tasks.shared.environment import air_of
from metrocli.tasks.shared.lengths import PathNoise, shared_at_stops, stops_of
from metrocli.tasks.shared.statistics import CONDITIONS, heading

_MISALIGNED = np.array([0.01] * 3 + [1e-4] * 5)
"""Standard deviations of the simulated misalignment of a line: three offsets [mm], five angles [rad]"""


def simulated(job: Job[Settings, Files], seed: int) -> Simulation:
    """Simulate the measurement of a machine with random errors and the job's effects; return files and true values.

    Raises InputError if the job has no section `simulation`, or if the method needs a path and the job has none.
    """
    settings = job.settings
    if settings.simulation is None:
        raise InputError("simulate needs the truth: `simulation: {error: 0.1 mm, tracker: [-1 m, -0.8 m, 0.3 m]}`")
    rng = np.random.default_rng(seed)
    if settings.machine.turns and settings.method in TURNING:
        return simulated_turning(job, settings.simulation, rng)
    truth = truth_of(settings, settings.simulation, rng)
    file, make = {
        STANDSTILL: ("points.csv", _points),
        ON_THE_FLY: ("track.csv", _track),
        SIX_DOF: ("lines.csv", _lines),
        LENGTHS: ("lengths.csv", _lengths),
    }[settings.method]
    measurement = _Measurement(settings, settings.simulation, job.files, tuple(job.effects))
    table, model = make(measurement, warmed(truth, settings.scales, rng), rng)
    square = dict(zip(SQUARENESS_NAMES, truth.blocks[SQUARENESS].values[0].tolist(), strict=True))
    return Simulation({file: table, "true_errors.csv": true_errors(settings, truth)}, square | true_values(model))


@dataclass(frozen=True)
class _Measurement:
    settings: Settings
    simulation: MachineSimulation
    files: Files
    effects: tuple[RequestedEffect, ...]

    def read(self, model: Model) -> tuple[Array, Model]:
        """Return the readings of a model extended by the effects, without noise, and the extended model."""
        model = extended(model, self.effects)
        return model.groups[0].chain.predict(model.blocks, model.groups[0].observations), model


def _seen(job: _Measurement, truth: TrueMachine, flow: Flow, rng: np.random.Generator) -> tuple[Array, Model]:
    """Return points measured by a randomly turned tracker, with its noise, (3, n), and the model."""
    turn = rotation_from_euler(rng.normal() * 0.05, rng.normal() * 0.05, rng.uniform(-np.pi, np.pi))
    pose = poses.pose(turn, np.array(job.simulation.tracker))
    points, model = job.read(truth.model(point_chain(reach(truth.machine)), {TRACKER: tracker_block(pose)}, flow))
    return points + job.settings.noise.of_tracker.drawn(points, rng), model


def _points(job: _Measurement, truth: TrueMachine, rng: np.random.Generator) -> tuple[Table, Model]:
    """Return points at the commanded positions of the job, or at random positions and the corners of the volume."""
    flow = _stops(job, truth.machine, rng)
    seen, model = _seen(job, truth, flow, rng)
    names = [f"P{i + 1:03d}" for i in range(seen.shape[1])]
    table = Table.of({"point": names, "x y z [mm]": flow.position.T, "mx my mz [mm]": seen.T, **_written(flow)})
    return table.joined(tool_column(job.settings, flow.tool)), model


def _written(flow: Flow) -> dict[str, Array]:
    """Return the conditions that have columns in a file; the way since a turn follows from the positions."""
    ways = {SINCE.format(axis=axis) for axis in POSITION}
    return {heading(name): values for name, values in flow.conditions.items() if name not in ways}


def _stops(job: _Measurement, machine: Machine, rng: np.random.Generator) -> Flow:
    table, names = job.files.points, list(job.settings.tools)
    if table is not None:
        position, tool = commanded(machine_of(job.settings), table), tools_of(table, job.settings)
    else:
        count = job.simulation.points
        position = np.round(rng.uniform(machine.low, machine.high, (count, 3)).T, 3)
        corners = grid_of(machine, (2, 2, 2))[:, :count]
        position[:, : corners.shape[1]] = corners
        position = position[:, rng.permutation(count)]
        tool = rng.integers(len(names), size=count)
    given = clock(job.simulation, position.shape[1])
    if table is not None:
        given |= table.conditions("t", *SIDES)
    given = given | sides_of(SIDES, position, given["t"]) | given
    return Flow.of(position, tool, given)


def _lengths(job: _Measurement, truth: TrueMachine, rng: np.random.Generator) -> tuple[Table, Model]:
    """Return the lengths of a job's file made again, or those of all points read from one station after the other.

    Lengths to a point at one time share a stop; the reading of a station is zero at its first point.
    """
    names, station, flow, points = _readings_of_stations(job, truth.machine, rng)
    corners = np.stack([truth.machine.low, truth.machine.high], axis=1)
    listed = job.files.listed_stations
    places = around(corners, len(names)) if listed is None else listed.stacked("xyz")
    block = tracer_block(
        np.column_stack([places, np.zeros(len(names)), np.ones(len(names))]), names, np.array(True), 1.0
    )
    noise = PathNoise.of(job.settings.noise.of_lengths)
    returns = 0.0 if noise.std is not None else noise.repeatability
    table = Table.of({"point": points, "station": np.array(names)[station], **_written(flow)})
    air, blocks = air_of(job.settings.environment, table, "station"), {TRACER: block}
    members, point = np.unique(points, return_inverse=True)
    stops = stops_of(visits(flow.position, flow.tool, point), flow.conditions.get("t"))
    flow = replace(
        flow,
        index={TRACER: station, POINT: point, STOP: stops},
        points=tuple(members.tolist()),
        stops=tuple(stop_names(stops, points, flow.conditions.get("t"))),
    )
    if air is not None:
        flow = replace(flow, conditions={**flow.conditions, AIR: air.ratio})
        blocks[AIR] = air.block.with_values(rng.normal(size=(1, 1)) * air.std)
    chain = length_chain(reach(truth.machine), in_air=air is not None)
    read, model = job.read(truth.model(chain, blocks, flow))
    path = read[0]
    beam = beams(reach(truth.machine), model.blocks, model.groups[0].observations) / path
    missed = rng.normal(size=beam.shape) * returns
    missed = shared_at_stops(missed.T, stops, returns, rng).T if returns else missed
    deviation = (beam * missed).sum(axis=0)
    sigma = np.sqrt(noise.constant**2 + (noise.proportional * path) ** 2)
    length = path + deviation + rng.normal(size=len(path)) * sigma - first_read(path, station)
    read_as = length if air is None else length / air.towards
    return table.joined(
        {"x y z [mm]": flow.position.T, "length [mm]": read_as, **tool_column(job.settings, flow.tool)}
    ), model


def _readings_of_stations(
    job: _Measurement, machine: Machine, rng: np.random.Generator
) -> tuple[list[str], Index, Flow, np.typing.NDArray[np.str_]]:
    """Return the names of the stations, the station of each length, its commanded position, and its point."""
    table, listed = job.files.lengths, job.files.listed_stations
    if table is not None:
        names = list(dict.fromkeys(table.texts("station")))
        station = np.array([names.index(name) for name in table.texts("station")])
        points = np.array(table.texts("point"), dtype=str)
        given = table.conditions(*CONDITIONS, *SIDES)
        flow = Flow.of(commanded(machine_of(job.settings), table), tools_of(table, job.settings), given)
        return names, station, flow, points
    once, n = _stops(job, machine, rng), job.simulation.points
    names = [f"S{i + 1}" for i in range(STATIONS)] if listed is None else listed.texts("station")
    order = np.tile(np.arange(n), len(names))
    position, given = once.position[:, order], clock(job.simulation, len(order))
    given |= sides_of(SIDES, position, given["t"])
    flow = Flow.of(position, once.tool[order], given)
    return names, np.repeat(np.arange(len(names)), n), flow, np.array([f"P{i + 1:03d}" for i in range(n)])[order]


def _track(job: _Measurement, truth: TrueMachine, rng: np.random.Generator) -> tuple[Table, Model]:
    """Return the track of the machine along the path, with ramps of speed on each leg and a rest at each vertex."""
    listed = job.files.path
    if listed is None:
        raise InputError("simulate needs the path: `inputs: {path: path.csv}`")
    path = path_of(job.settings, machine_of(job.settings), listed)
    leg, along, time = travelled(path, _feeds(job, listed, path), job.simulation.sampling)
    given = {"t": time, **{name: signs[leg] for name, signs in zip(SIDES, path.last_moves(), strict=True)}}
    given |= path.since_turns(leg, along) | path.axis_speeds(leg, path.speeds(leg, along, time))
    seen, model = _seen(job, truth, Flow(path.at(leg, along), path.tool[leg], given), rng)
    table = Table.of({"x y z [mm]": seen.T, "t [s]": time})
    return table.joined(tool_column(job.settings, path.tool[leg]) if "tool" in listed else {}), model


def _feeds(job: _Measurement, table: Table, path: Path) -> Array:
    if "feed" in table:
        return np.asarray(table.numbers("feed")[path.vertex + 1])
    return np.full(len(path.lengths), job.simulation.feed)


def _lines(job: _Measurement, truth: TrueMachine, rng: np.random.Generator) -> tuple[Table, Model]:
    """Return the lines of the job, or along the axes to and fro and three face diagonals, each randomly misaligned.

    Of a job that reads the positioning alone, five runs to and fro along each of its axes.
    """
    table, machine, alone = job.files.lines, machine_of(job.settings), job.settings.reads_positioning
    lines = proposed_lines(job.settings) if table is None else lines_of(machine, table)
    block = line_block(lines.names)
    block = block.with_values(rng.normal(size=block.values.shape) * _MISALIGNED)
    given = clock(job.simulation, len(lines.of)) if table is None else table.conditions("t", "temp")
    more = line_conditions(machine, lines) | approach(machine, lines)
    flow = Flow(lines.position, np.zeros(len(lines.of), dtype=np.intp), given | more, {LINE: lines.of})
    readings, model = job.read(truth.model(line_chain(truth.machine, alone), {LINE: block}, flow))
    noise, when = job.settings.noise.of_laser, {heading(name): column for name, column in given.items()}
    named = columns_of(machine, lines)
    if alone:
        read = readings[0] + rng.normal(size=len(lines.of)) * (noise.angle if machine.turns else noise.displacement)
        return in_degrees(Table.of(named | _own_channels(lines, read) | when)), model
    root = np.linalg.cholesky(np.moveaxis(noise.covariance(lines.along[lines.of].T), -1, 0))
    readings = readings + np.einsum("nab,bn->an", root, rng.normal(size=readings.shape))
    channels = {" ".join(CHANNELS[:3]) + " [mm]": readings[:3].T, " ".join(CHANNELS[3:]) + " [rad]": readings[3:].T}
    places = (
        {} if table is None else {f"{axis} [mm]": lines.position[i] for i, axis in enumerate(POSITION) if axis in table}
    )
    return Table.of({**named, **channels, **when, **places}), model


def _own_channels(lines: MeasuredLines, read: Array) -> dict[str, Array]:
    """Return the columns of the deviations of each direction, empty at lines of others."""
    columns = {}
    for direction in dict.fromkeys(lines.axis):
        name = f"e{direction}"
        unit = "rad" if COLUMNS.index(name) > 2 else "mm"
        columns[f"{name} [{unit}]"] = np.where(np.array(lines.axis)[lines.of] == direction, read, np.nan)
    return columns
