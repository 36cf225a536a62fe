"""Simulated measurements of a machine with random errors: standstill points, a track along a path, six-dof lines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.blocks import Array, Block
from metrocli.adjust.observations import Index
from metrocli.errors import InputError
from metrocli.geometry import poses
from metrocli.geometry.rotations import rotation_from_euler
from metrocli.instruments.machine import (
    SQUARENESS_NAMES,
    TOOL,
    Axis,
    Machine,
    errors_of,
    is_angle,
    squareness_block,
)
from metrocli.instruments.machine_path import Path
from metrocli.simulation import Simulation
from metrocli.table import Table
from metrocli.tasks.machine_on_the_fly import path_of
from metrocli.tasks.machine_problem import commanded, error_blocks, machine_of, tools_of
from metrocli.tasks.machine_settings import ON_THE_FLY, STANDSTILL, MachineSimulation, Settings
from metrocli.tasks.machine_six_dof import simulated_lines
from metrocli.tasks.machine_standstill import tracker_noise
from metrocli.tasks.machine_volume import grid_group, grid_of, without_rigid_motion

if TYPE_CHECKING:
    from metrocli.table import Values

_FINE = 401
_HARMONICS = 4
_ACCELERATION = 1000.0
"""Of the simulated machine [mm/s^2]"""
_REST = 0.5
"""The machine stands so long at each vertex [s]"""


@dataclass(frozen=True)
class Truth:
    """A machine with its errors."""

    machine: Machine
    """With as many knots as its errors need"""
    blocks: Mapping[str, Block]

    def error(self, position: Array, tool: Index) -> Array:
        """Return displacement and rotation of tools at commanded positions (3, n), (6, n)."""
        group = grid_group(self.machine, position, tool)
        return group.chain.predict(self.blocks, group.observations)

    def reached(self, position: Array, tool: Index) -> Array:
        """Return where the reflector is (3, n)."""
        return position + self.blocks[TOOL].values[tool].T + self.error(position, tool)[:3]


def truth_of(settings: Settings, simulation: MachineSimulation, rng: np.random.Generator) -> Truth:
    """Return a machine with random errors of the mean size asked for (after the best shift and turn of the volume)."""
    machine = machine_of(settings)
    if simulation.smooth:
        axes = tuple(Axis(axis.letter, np.linspace(axis.knots[0], axis.knots[-1], _FINE)) for axis in machine.axes)
        machine = Machine(machine.order, (axes[0], axes[1], axes[2]))
    lever = float(np.max(machine.high - machine.low)) / 2
    tables = {
        name: _drawn(axis, name, simulation.smooth, rng) for axis in machine.axes for name in errors_of(axis.letter)
    }
    tables = {name: table / (lever if is_angle(name) else 1.0) for name, table in tables.items()}
    square = {name: float(rng.normal()) / lever for name in SQUARENESS_NAMES}
    unit = Truth(machine, _blocks(settings, machine, tables, square))
    grid = grid_of(machine, (6, 6, 6))
    error = without_rigid_motion(unit.error(grid, np.zeros(grid.shape[1], dtype=np.intp)), grid)
    size = simulation.error / float(np.linalg.norm(error, axis=0).mean())
    scaled = {name: table * size for name, table in tables.items()}
    return Truth(machine, _blocks(settings, machine, scaled, {name: value * size for name, value in square.items()}))


def _blocks(
    settings: Settings, machine: Machine, tables: Mapping[str, Array], square: Mapping[str, float]
) -> dict[str, Block]:
    wanted = settings.estimated
    kept = {name: table for name, table in tables.items() if name in wanted}
    axes = {axis.block: axis.block_of(kept, wanted) for axis in machine.axes}
    squareness = squareness_block({name: value for name, value in square.items() if name in wanted}, wanted)
    return {**error_blocks(machine, settings), **axes, squareness.name: squareness}


def _drawn(axis: Axis, name: str, smooth: bool, rng: np.random.Generator) -> Array:
    """Return a random table in the gauge: harmonics, or independent steps between knots."""
    u = (axis.knots - axis.knots[0]) / (axis.knots[-1] - axis.knots[0])
    if smooth:
        order = np.arange(1, _HARMONICS + 1)[:, None]
        phase = rng.uniform(0, 2 * np.pi, (_HARMONICS, 1))
        raw = (rng.normal(size=(_HARMONICS, 1)) / order * np.sin(np.pi * order * u + phase)).sum(axis=0)
    else:
        raw = rng.normal(size=len(u)).cumsum() / np.sqrt(len(u))
    if axis.straightness[errors_of(axis.letter).index(name)]:
        return np.asarray(raw - raw[0] - (raw[-1] - raw[0]) * u)
    return np.asarray(raw - np.interp(axis.reference, axis.knots, raw))


def simulated(settings: Settings, tables: Mapping[str, Table], seed: int) -> Simulation:
    """Return the files of a measurement of a random machine, and its errors."""
    if settings.simulation is None:
        raise InputError("simulate needs the truth: `simulation: {error: 0.1 mm, tracker: [-1 m, -0.8 m, 0.3 m]}`")
    rng = np.random.default_rng(seed)
    truth = truth_of(settings, settings.simulation, rng)
    if settings.method == STANDSTILL:
        files = {"points.csv": _points(settings, truth, tables.get("points"), rng)}
    elif settings.method == ON_THE_FLY:
        files = {"track.csv": _track(settings, truth, tables["path"], rng)}
    else:
        files = {"lines.csv": simulated_lines(settings, truth.error, settings.simulation.step, rng)}
    square = dict(zip(SQUARENESS_NAMES, truth.blocks["squareness"].values[0].tolist(), strict=True))
    return Simulation({**files, "true_errors.csv": true_errors(settings, truth)}, square)


def true_errors(settings: Settings, truth: Truth) -> Table:
    """Return the true tables at the knots of the job."""
    names, at, length, angle = [], [], [], []
    for axis, fine in zip(machine_of(settings).axes, truth.machine.axes, strict=True):
        for k, name in enumerate(errors_of(axis.letter)):
            table = fine.from_raw[k] @ truth.blocks[fine.block].values[:, k]
            values = np.interp(axis.knots, fine.knots, table)
            none = np.full(len(values), np.nan)
            names += [name] * len(values)
            at.append(axis.knots)
            length.append(none if is_angle(name) else values)
            angle.append(values if is_angle(name) else none)
    columns: dict[str, Values] = {
        "error": np.array(names),
        "position": np.concatenate(at),
        "value": np.concatenate(length),
        "turn": np.concatenate(angle),
    }
    return Table(columns, {"position": "mm", "value": "mm", "turn": "rad"})


def _seen(settings: Settings, truth: Truth, reached: Array, rng: np.random.Generator) -> Array:
    """Return what the tracker, turned at random, sees of points (3, n), with its noise."""
    if settings.simulation is None:
        raise InputError("simulate needs `simulation:`")
    turn = rotation_from_euler(rng.normal() * 0.05, rng.normal() * 0.05, rng.uniform(-np.pi, np.pi))
    pose = poses.pose(turn, np.array(settings.simulation.tracker))
    points = poses.apply(poses.inverse(pose), reached.T).T
    return points + tracker_noise(settings).drawn(points, rng)


def _points(settings: Settings, truth: Truth, table: Table | None, rng: np.random.Generator) -> Table:
    """Return points at the listed commanded positions, or at random ones with the corners of the volume."""
    names = list(settings.tools)
    if table is not None:
        position, tool = commanded(machine_of(settings), table), tools_of(table, settings)
    else:
        count = settings.simulation.points if settings.simulation else 0
        low, high = truth.machine.low, truth.machine.high
        position = np.round(rng.uniform(low, high, (count, 3)).T, 3)
        corners = grid_of(truth.machine, (2, 2, 2))[:, :count]
        position[:, : corners.shape[1]] = corners
        tool = rng.integers(len(names), size=count)
    n = position.shape[1]
    seen = _seen(settings, truth, truth.reached(position, tool), rng)
    columns: dict[str, Values] = {"point": np.array([f"P{i + 1:03d}" for i in range(n)])}
    columns |= dict(zip("xyz", position, strict=True))
    columns |= {f"m{axis}": row for axis, row in zip("xyz", seen, strict=True)}
    if names != [""]:
        columns["tool"] = np.array(names)[tool]
    lengths = dict.fromkeys(("x", "y", "z", "mx", "my", "mz"), "mm")
    return Table(columns, lengths)


def _track(settings: Settings, truth: Truth, table: Table, rng: np.random.Generator) -> Table:
    """Return the track of the machine along the path: ramps of speed on each leg, a rest at each vertex."""
    path = path_of(settings, machine_of(settings), table)
    feeds = _feeds(settings, table, path)
    position, tool, time = travelled(path, feeds, settings.simulation.sampling if settings.simulation else 1.0)
    seen = _seen(settings, truth, truth.reached(position, tool), rng)
    columns: dict[str, Values] = {**dict(zip("xyz", seen, strict=True)), "t": time}
    if "tool" in table:
        columns["tool"] = np.array(list(settings.tools))[tool]
    return Table(columns, {**dict.fromkeys("xyz", "mm"), "t": "s"})


def _feeds(settings: Settings, table: Table, path: Path) -> Array:
    if "feed" in table:
        return np.asarray(table.numbers("feed")[path.vertex + 1])
    return np.full(len(path.lengths), settings.simulation.feed if settings.simulation else 1.0)


def travelled(path: Path, feeds: Array, sampling: float) -> tuple[Array, Index, Array]:
    """Return commanded positions (3, n), tools and times of a machine with ramps and rests, at equal steps of time."""
    ramp = np.minimum(feeds / _ACCELERATION, np.sqrt(path.lengths / _ACCELERATION))
    top = ramp * _ACCELERATION
    moving = path.lengths / top + ramp
    begins = np.cumsum(moving + _REST) - moving
    time = np.arange(0.0, begins[-1] + moving[-1] + _REST, sampling)
    leg = np.clip(np.searchsorted(begins, time, side="right") - 1, 0, len(begins) - 1)
    since = np.clip(time - begins[leg], 0.0, moving[leg])
    left = np.minimum(since, moving[leg] - since)
    ramped = np.minimum(left, ramp[leg])
    early = ramped**2 * _ACCELERATION / 2 + np.maximum(left - ramp[leg], 0.0) * top[leg]
    along = np.where(since <= moving[leg] / 2, early, path.lengths[leg] - early)
    return path.at(leg, along), path.tool[leg], time
