"""A small measurement of each kind of job with effects, for the laws that every effect obeys.

To bring a kind under the laws, add a function that returns its model at the truth, with conditions in it and its places
named, to `MEASURED`. It is asked for each effect, since some are seen only in a measurement of their own sort.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from laws.effects_of_images import alignment, calibration
from simulated import five_axis as simulated_five_axes
from simulated import grid as simulated_grid
from simulated import launch as simulated_launch
from simulated import lengths as simulated_lengths
from simulated import machine as simulated_machine
from simulated import machine_lengths as simulated_lengths_of_machine
from simulated import network as simulated_network

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.dense_jacobian import unit_noise
from metrocli.effects.effect import Effect
from metrocli.effects.extension import with_conditions
from metrocli.effects.model import Model
from metrocli.geometry.poses import pose_from_euler, rotation_of
from metrocli.instruments.tracker import FACE
from metrocli.project.inputs import read_inputs
from metrocli.project.job import load
from metrocli.table import Table
from metrocli.tasks.adjust_network import problem as network_problem
from metrocli.tasks.adjust_network import readings as network_readings
from metrocli.tasks.adjust_network.settings import DistanceNoise, InstrumentNoise, NetworkInstrument
from metrocli.tasks.adjust_network.settings import Files as NetworkFiles
from metrocli.tasks.adjust_network.settings import Settings as NetworkSettings
from metrocli.tasks.adjust_network.starts import search as network_start
from metrocli.tasks.calibrate_machine.effects.tracker import OF_THE_LASER
from metrocli.tasks.calibrate_machine.effects.turning import OF_ROTARY_AXES
from metrocli.tasks.calibrate_machine.files import Files as MachineFiles
from metrocli.tasks.calibrate_machine.machine_settings import (
    AxesSettings,
    MachineNoise,
    MachineSettings,
    RotarySettings,
)
from metrocli.tasks.calibrate_machine.methods.lengths import lengths as machine_lengths
from metrocli.tasks.calibrate_machine.methods.probing import probing
from metrocli.tasks.calibrate_machine.methods.six_dof import six_dof
from metrocli.tasks.calibrate_machine.methods.standstill import standstill
from metrocli.tasks.fit_points.problem import problem_of as pairs_of
from metrocli.tasks.fit_points.settings import Files as FitFiles
from metrocli.tasks.fit_points.settings import Inputs as FitInputs
from metrocli.tasks.fit_points.settings import Settings as FitSettings
from metrocli.tasks.locate_launch_unit import problem as launch_problem
from metrocli.tasks.locate_launch_unit import readings as launch_readings
from metrocli.tasks.multilaterate.problem import build
from metrocli.tasks.multilaterate.settings import Files
from metrocli.tasks.selfcal_grid import problem as grid_problem
from metrocli.tasks.selfcal_grid import readings as grid_readings
from metrocli.tasks.selfcal_grid.settings import views_of
from metrocli.tasks.shared.length_effects import LENGTH_EFFECTS


@dataclass(frozen=True)
class Measured:
    """A small measurement of one kind."""

    model: Callable[[Effect], Model]
    """At the truth, without noise; one in which this effect can be seen"""
    scanned: Mapping[str, float]
    """Values for scanned parameters, by name"""


def multilaterate(effect: Effect) -> Model:
    """25 points and five tracers, all known to 1 um; times and temperatures at random; absolute for a length offset."""
    net = simulated_lengths.network(25, 5, noise=0.0)
    rng = np.random.default_rng(4)
    if effect.name == "length-offset":
        net = replace(net, dead=np.zeros(5), readings=net.readings + net.dead)
    lengths = net.lengths()
    t = rng.uniform(100.0, 2000.0, len(lengths))
    temp = 20 + rng.uniform(0, 1, len(lengths))
    table = replace(lengths, columns={**lengths.columns, "t": t, "temp": temp})
    points = replace(net, nominal=net.points).point_table(sigma=np.full(25, 0.001))
    measures = "absolute" if effect.name == "length-offset" else "changes"
    tracers = net.tracer_table(0.0, sigma=np.full(5, 0.001))
    network = build(simulated_lengths.settings(measures=measures), Files(table, points, tracers))
    model = network.model
    true = np.column_stack([net.tracers, net.dead, net.scale])
    return with_conditions(model.with_blocks({**model.blocks, "tracer": model.blocks["tracer"].with_values(true)}))


def locate_launch_unit(effect: Effect) -> Model:
    """25 poses with distances around a unit; times and temperatures at random."""
    exact = simulated_launch.anywhere(25, 7, distances=True)
    rng = np.random.default_rng(5)
    table = exact.table(t=rng.uniform(100.0, 2000.0, 25), temp=20 + rng.uniform(0, 1, 25))
    model = launch_problem.build(launch_readings.read(table), simulated_launch.NOISE).model
    true = model.blocks["launch unit"].with_values(exact.truth[None])
    return with_conditions(model.with_blocks({**model.blocks, "launch unit": true}))


def selfcal_grid(effect: Effect) -> Model:
    """A grid of 3 x 3 x 3 in six views, each ball measured forth and back; temperatures at random."""
    one = simulated_grid.grid(3, "123456", seed=3)
    rng = np.random.default_rng(6)
    table = simulated_grid.repeated(one.read(rng, noise=0.0))
    table = replace(
        table, columns={**table.columns, "t": 20.0 * np.arange(len(table)), "temp": 20 + rng.uniform(0, 1, len(table))}
    )
    settings = one.settings()
    readings = grid_readings.read(views_of(settings), settings.grid.half, table)
    model = grid_problem.build(readings, (settings.grid.half, settings.grid.pitch), settings.noise).model_with_datum
    values = {"machine_error": one.machine, "artefact_error": one.artefact}
    mountings = np.array([np.concatenate(one.mountings[name]) for name in one.views])
    values["view"] = pose_from_euler(mountings[:, :3], mountings[:, 3:])
    return with_conditions(
        model.with_blocks({name: block.with_values(values[name]) for name, block in model.blocks.items()})
    )


def calibrate_machine(effect: Effect) -> Model:
    """Points, lines, lengths to points, or a machine with rotary axes: the sort in which the effect is seen."""
    if effect in LENGTH_EFFECTS or effect.throughout:
        return machine_from_lengths(effect.throughout, effect.name not in ("length-offset", "reflector-incidence"))
    if effect in OF_THE_LASER:
        return axis_alone() if effect.name == "indexer-drift" else machine_from_lines()
    if effect in OF_ROTARY_AXES:
        return machine_with_tables("head-table" if effect.among == ("b",) else "table-table")
    return machine_from_points(in_faces=effect.needs == (FACE,))


@cache
def machine_from_points(in_faces: bool) -> Model:
    """120 points with three tools known to 1 um, from all sides, times and speeds at random."""
    rng = np.random.default_rng(6)
    tools = simulated_machine.THREE
    machine = simulated_machine.random_machine(rng)
    table = simulated_machine.points(machine, rng, 120, tools, noise=0.0)
    more = {f"from_{axis}": rng.choice([-1.0, 1.0], 120) for axis in "xyz"} | {"t": rng.uniform(100.0, 2000.0, 120)}
    more |= {"face": rng.choice([1.0, 2.0], 120)} if in_faces else {}
    table = replace(table, columns={**table.columns, **more})
    settings = simulated_machine.settings(tools=tools, tool_uncertainty=0.001)
    problem = standstill(settings, table)
    speeds = {f"speed_{axis}": rng.uniform(-50, 50, 120) for axis in "xyz"}
    speeds |= {f"since_{axis}": rng.uniform(0, 100, 120) for axis in "xyz"}
    seen = problem.readings.observations
    moving = replace(problem.readings, observations=replace(seen, conditions={**seen.conditions, **speeds}))
    problem = problem.with_model(problem.model.with_group(unit_noise(moving, 0.002)))
    solved = adjust(problem.blocks.values(), problem.groups)
    return with_conditions(problem.model.with_blocks(solved.blocks))


@cache
def machine_from_lengths(of_stops: bool, free: bool) -> Model:
    """80 points with three tools from five stations, which read at once where an effect is `of_stops`.

    The stations are `free`, unless these would absorb the effect.
    """
    rng = np.random.default_rng(16)
    machine = simulated_machine.random_machine(rng, knots=(3, 3, 3))
    none = MachineNoise(constant=0.0)
    table = simulated_lengths_of_machine.measured(
        machine, rng, 80, simulated_machine.THREE, simulated_lengths_of_machine.STATIONS, none
    )
    columns = {**table.columns, "t": rng.uniform(100.0, 2000.0, 400), "temp": 20 + rng.uniform(0, 1, 400)}
    if of_stops:
        columns["t"] = 10.0 * np.unique(table.texts("point"), return_inverse=True)[1]
    settings = simulated_lengths_of_machine.settings(simulated_machine.THREE, (3, 3, 3))
    problem = machine_lengths(settings, replace(table, columns=columns))
    solved = adjust(problem.blocks.values(), problem.groups)
    stations = solved.blocks["tracer"]
    stations = replace(stations, free=stations.free & free)
    return with_conditions(problem.model.with_blocks({**solved.blocks, "tracer": stations}))


@cache
def machine_with_tables(kind: str) -> Model:
    """Three balls probed 100 times with a known probe, on a table A that carries a table C, or with a head B; all sides."""
    rng = np.random.default_rng(18)
    machine = simulated_five_axes.drawn(simulated_five_axes.KINDS[kind], rng, linear=False)
    machine.tables = {}
    with TemporaryDirectory() as folder:
        path = simulated_five_axes.probed(Path(folder), machine, rng, 100, 0.0, "locations")
        job = load(path)
        tables = read_inputs(job)
    sides = {f"from_{axis}": rng.choice([-1.0, 1.0], 100) for axis in "abc"}
    table = replace(tables["probing"], columns={**tables["probing"].columns, **sides})
    problem = probing(job.settings, table, MachineFiles(balls=tables["balls"]))
    solved = adjust(problem.blocks.values(), problem.groups)
    return with_conditions(problem.model.with_blocks(solved.blocks))


@cache
def machine_from_lines() -> Model:
    """Lines along the axes and the face diagonals; times and temperatures at random."""
    rng = np.random.default_rng(17)
    machine = simulated_machine.random_machine(rng)
    table = simulated_machine.line_table(
        [simulated_machine.line(machine, axis, rng, 0.0) for axis in ("x", "y", "z", "xy", "yz", "xz")]
    )
    columns = {"t": rng.uniform(100.0, 2000.0, len(table)), "temp": 20 + rng.uniform(0, 1, len(table))}
    noise = MachineNoise(displacement=5e-4, straightness=1e-3, angle=1e-6)
    settings = simulated_machine.settings("six-dof", tools={"": (0.0, 0.0, 0.0)}, noise=noise)
    problem = six_dof(settings, replace(table, columns={**table.columns, **columns}))
    problem = problem.with_model(problem.model.with_group(unit_noise(problem.readings, 1e-5)))
    return with_conditions(problem.model.with_blocks(adjust(problem.blocks.values(), problem.groups).blocks))


@cache
def axis_alone() -> Model:
    """A rotary axis read to and fro at 24 targets, twice, with times at random and an error of 5 urad once a turn."""
    rng = np.random.default_rng(19)
    way = np.tile(np.append(np.linspace(0, 2 * np.pi, 24), np.linspace(2 * np.pi, 0, 24)), 2)
    names = {"line": ["L1"] * len(way), "axis": ["c"] * len(way)}
    table = Table.of({**names, "c ec [rad]": np.stack([way, 5e-6 * np.sin(way)], axis=1)})
    table = table.joined({"t [s]": rng.uniform(100.0, 2000.0, len(way))})
    axes = AxesSettings(c=RotarySettings((0.0, 2 * np.pi), 13))
    settings = replace(simulated_machine.settings("six-dof"), machine=MachineSettings(axes=axes), estimate="all")
    problem = six_dof(replace(settings, noise=MachineNoise(angle=1e-6)), table)
    problem = problem.with_model(problem.model.with_group(unit_noise(problem.readings, 1e-6)))
    return with_conditions(problem.model.with_blocks(adjust(problem.blocks.values(), problem.groups).blocks))


def adjust_network(effect: Effect) -> Model:
    """Two trackers at four stations, two interferometers, bars, heights and given points, or stations over marks."""
    over = effect.name in ("target-height", "station-height")
    exact = "exact list of {point}" in effect.needs
    files = marks_as_files() if over else network_as_files(exact)
    if any(one.name == "from_station" for one in effect.scanned):
        files |= {name: untimed(files[name]) for name in ("readings", "lengths")}
    settings = network_settings(over, ("I", "J", "A", "B") if effect.name == "tracer-scale" else ("A", "B", "I", "J"))
    found = network_readings.read(settings, NetworkFiles(**files))
    network = network_problem.build(settings, found, network_start.start(found))
    solved = adjust(network.blocks.values(), network.model.groups, network.datum)
    assert solved.outcome.good, solved.undetermined
    return with_conditions(network.model.with_blocks(solved.blocks))


def untimed(table: Table) -> Table:
    """A table without its times."""
    return replace(table, columns={name: one for name, one in table.columns.items() if name != "t"})


def network_settings(over: bool, order: tuple[str, ...]) -> NetworkSettings:
    """Two trackers or total stations and two interferometers, in an order."""
    noise = InstrumentNoise(azimuth=2e-6, elevation=2e-6, lateral=0.004, distance=DistanceNoise(0.002, 3e-7))
    length = InstrumentNoise(distance=DistanceNoise(3e-4))
    kind = "total-station" if over else "tracker"
    devices = {name: NetworkInstrument(type=kind, noise=noise) for name in ("A", "B")}
    devices |= {name: NetworkInstrument(type="interferometer", noise=length) for name in ("I", "J")}
    return NetworkSettings(inputs=None, instruments={name: devices[name] for name in order})


def network_as_files(exact: bool = False) -> dict[str, Table]:
    """Readings without noise in both faces, with times; all points are known to 0.01 mm, or the second one exactly."""
    net = simulated_network.network(np.random.default_rng(21), 4, 12, 2, 0.0, mixed=True)
    names = np.array(net.names)
    n = len(net.station)
    rng = np.random.default_rng(22)
    readings = {
        "station [text]": np.array([f"S{i}" for i in net.station]),
        "point [text]": names[net.point],
        "face": net.face.astype(float),
        "az el [rad]": net.seen[:, :2],
        "d [mm]": net.seen[:, 2],
        "t [s]": rng.uniform(100.0, 2000.0, n),
        "temp [degC]": rng.uniform(20, 21, n),
    }
    stations = {"station [text]": [*(f"S{i}" for i in range(4)), "I0", "I1"], "instrument [text]": list("AABBIJ")}
    i, k = np.indices(net.lengths.shape).reshape(2, -1)
    lengths = {
        "station [text]": np.array([f"I{one}" for one in i]),
        "point [text]": names[k],
        "length [mm]": net.lengths.ravel(),
        "t [s]": rng.uniform(100.0, 2000.0, len(i)),
    }
    a, b, bar = (np.array(one) for one in zip(*net.bars, strict=True))
    bars = {
        "bar [text]": ["B1", "B2"],
        "from [text]": names[a],
        "to [text]": names[b],
        "length sigma [mm]": np.column_stack([bar, np.full(2, 0.005)]),
    }
    ends = np.array([(p, q) for p in range(6) for q in range(p + 1, 6)])
    rise = net.points[ends[:, 1], 2] - net.points[ends[:, 0], 2]
    heights = {
        "from [text]": names[ends[:, 0]],
        "to [text]": names[ends[:, 1]],
        "dh sigma [mm]": np.column_stack([rise, np.full(len(ends), 0.02)]),
        "t [s]": rng.uniform(100.0, 2000.0, len(ends)),
        "method [text]": np.array(["early", "late"])[np.arange(len(ends)) % 2],
    }
    sigma = np.where(exact & (np.arange(len(names)) == 1), 0.0, 0.01)
    points = {"point [text]": names, "x y z sigma [mm]": np.column_stack([net.points, sigma])}
    tables = {
        "readings": readings,
        "stations": stations,
        "lengths": lengths,
        "bars": bars,
        "heights": heights,
        "points": points,
    }
    return {name: Table.of(columns) for name, columns in tables.items()}


def marks_as_files() -> dict[str, Table]:
    """Levelled stations over marks, with known heights of instruments and targets."""
    x, height, target, seen = simulated_network.marks(np.random.default_rng(23))
    names = np.array([f"P{i}" for i in range(len(x))])
    i, k = np.nonzero(np.isfinite(seen[:, :, 0]))
    setups = np.array([f"T{one}" for one in range(len(x))])
    readings = {
        "station [text]": np.array([f"S{one}" for one in i]),
        "point [text]": names[k],
        "setup [text]": setups[k],
        "az el [rad]": seen[i, k, :2],
        "d [mm]": seen[i, k, 2],
    }
    stations = {
        "station [text]": [f"S{one}" for one in range(4)],
        "instrument [text]": list("AABB"),
        "over [text]": names[4:8],
        "height sigma_height [mm]": np.column_stack([height, np.zeros(4)]),
    }
    points = {"point [text]": names, "x y z sigma [mm]": np.column_stack([x, np.full(len(x), 0.01)])}
    tables = {"readings": readings, "stations": stations, "points": points}
    tables["setups"] = {"setup [text]": setups, "height sigma [mm]": np.column_stack([target, np.zeros(len(x))])}
    return {name: Table.of(columns) for name, columns in tables.items()}


def fit_points(effect: Effect) -> Model:
    """30 points of a part of about a metre, as measured by a turned machine, exact to 1 um."""
    rng = np.random.default_rng(8)
    measured = rng.uniform(-500.0, 500.0, (30, 3))
    pose = np.array([120.0, -300.0, 80.0, 0.2, -0.4, 1.1])
    nominal = measured @ rotation_of(pose).T + pose[:3]
    lists = [Table.of({"point": [f"P{i}" for i in range(30)], "x y z [mm]": places}) for places in (measured, nominal)]
    settings = FitSettings(FitInputs(points=Path("-"), nominal=Path("-")), noise=0.001)
    pairs = pairs_of(settings, FitFiles(*lists))
    return with_conditions(replace(pairs, start=(pose[None], np.ones(1))).model())


MEASURED: dict[str, Measured] = {
    "fit-points": Measured(fit_points, {}),
    "calibrate-camera": Measured(lambda effect: with_conditions(calibration(effect)), {}),
    "align-part": Measured(lambda effect: with_conditions(alignment(effect)), {}),
    "calibrate-machine": Measured(calibrate_machine, {"period": 37.0, "periods": 40.0, "length": 30.0, "at": 900.0}),
    "multilaterate": Measured(multilaterate, {"at": 900.0}),
    "locate-launch-unit": Measured(locate_launch_unit, {}),
    "adjust-network": Measured(adjust_network, {"at": 900.0, "method": 1.0, "from_station": 2.0}),
    "selfcal-grid": Measured(selfcal_grid, {"at": 1600.0, "from_view": 2.0}),
}


def instance_of(model: Model, effect: Effect) -> tuple[str, ...]:
    """A place where the effect can act: the second of each kind, or the only one."""
    all_names = (model.places[key].names for key in effect.where if key != "by")
    among = [[name for name in names if name in (effect.among or names)] for names in all_names]
    return tuple(names[min(1, len(names) - 1)] for names in among)


def size(effect: Effect) -> dict[str, float]:
    """A plausible size of each parameter, different for each."""
    return {p.name: p.plausible * (0.7 - 0.4 * at) for at, p in enumerate(effect.parameters)}
