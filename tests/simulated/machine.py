"""Machines for the tests, written without the engine: exact 4 x 4 transforms along the chain, own random draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from metrocli.table import Table
from metrocli.tasks.calibrate_machine.files import Inputs
from metrocli.tasks.calibrate_machine.machine_settings import (
    AxesSettings,
    AxisSettings,
    LateralNoise,
    MachineNoise,
    MachineSettings,
    VolumeGrid,
)
from metrocli.tasks.calibrate_machine.settings import Settings

Array = npt.NDArray[np.float64]
NOWHERE = Path("-")
LOW, HIGH = np.array([0.0, -260.0, -500.0]), np.array([600.0, 260.0, 0.0])
NAMES = tuple(f"E{d}{a}" for a in "XYZ" for d in "XYZABC")
ONE = {"T1": (0.0, 0.0, 120.0)}
THREE = {"T1": (0.0, 0.0, 120.0), "T2": (110.0, 20.0, 150.0), "T3": (-30.0, 100.0, 210.0)}


@dataclass(frozen=True)
class Machine:
    """Tables at knots (by name), squareness A0Z B0Z C0Y, and the order of the axes from workpiece to tool."""

    order: str = "XYZ"
    knots: tuple[int, int, int] = (5, 5, 5)
    tables: Mapping[str, Array] = field(default_factory=dict)
    squareness: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def positions(self, axis: str) -> Array:
        i = "XYZ".index(axis)
        return np.linspace(LOW[i], HIGH[i], self.knots[i])

    def errors(self, axis: str, x: float) -> Array:
        """The six errors of an axis at a position."""
        knots = self.positions(axis)
        return np.array([np.interp(x, knots, self.tables[f"E{d}{axis}"]) for d in "XYZABC"])

    def first_order(self, p: Array, tool: Array) -> Array:
        """The displacement of the tool by the contract's formula, written out for one point."""
        d = np.zeros(3)
        for n, axis in enumerate(self.order):
            e = self.errors(axis, p["XYZ".index(axis)])
            lever = tool.copy()
            for later in self.order[n + 1 :]:
                lever["XYZ".index(later)] += p["XYZ".index(later)]
            d += e[:3] + np.cross(e[3:], lever)
        a, b, c = self.squareness
        return d + np.array([-c * p[1] + b * p[2], -a * p[2], 0.0])

    def exact(self, p: Array, tool: Array, bed: int = 0) -> Array:
        """The displacement by 4 x 4 transforms, with the first `bed` axes of the chain on the workpiece's side.

        A table turns the workpiece about itself, so its own travel is a lever, which its straightness as measured holds.
        """
        whole = np.eye(4)
        for n, axis in enumerate(self.order):
            whole = whole @ _joint(self, axis, p, n < bed)
        return (whole @ np.append(tool, 1.0))[:3] - (p + tool)


def _unit(axis: str) -> Array:
    return np.eye(3)["XYZ".index(axis)]


def _joint(machine: Machine, axis: str, p: Array, table: bool) -> Array:
    """An axis: it moves along a line turned by squareness, and is shifted and turned by its errors."""
    i = "XYZ".index(axis)
    e = machine.errors(axis, p[i])
    a, b, c = machine.squareness
    along = {"X": np.array([1.0, 0, 0]), "Y": np.array([-c, 1.0, 0]), "Z": np.array([b, -a, 1.0])}[axis]
    turn, shift = np.eye(4), np.eye(4)
    turn[:3, :3] = rotation(e[3:])
    shift[:3, 3] = along * p[i] + e[:3]
    if table:
        shift[:3, 3] -= np.cross(e[3:], _unit(axis) * p[i])
        return turn @ shift
    return shift @ turn


def rotation(vector: Array) -> Array:
    """Rodrigues' formula."""
    angle = float(np.linalg.norm(vector))
    if angle == 0:
        return np.eye(3)
    k = vector / angle
    cross = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def random_machine(
    rng: np.random.Generator, order: str = "XYZ", knots: tuple[int, int, int] = (5, 5, 5), size: float = 0.05
) -> Machine:
    """Random tables in the gauge of the contract: positioning and angles 0 at 0, straightness 0 at both ends."""
    machine = Machine(order, knots)
    tables = {}
    for axis in "XYZ":
        x = machine.positions(axis)
        for d in "XYZABC":
            raw = rng.normal(size=len(x)) * (size if d in "XYZ" else size / 400)
            if d in "XYZ" and d != axis:
                raw -= np.linspace(raw[0], raw[-1], len(raw))
            else:
                raw -= np.interp(0.0 if x[0] <= 0 <= x[-1] else x[0], x, raw)
            tables[f"E{d}{axis}"] = raw
    a, b, c = (rng.normal(size=3) * size / 1000).tolist()
    return Machine(order, knots, tables, (a, b, c))


@dataclass(frozen=True)
class Tracker:
    """Where the tracker stands and how it reads."""

    place: Array
    turn: Array
    beam: float = 1e-3
    constant: float = 2e-3
    proportional: float = 3e-6

    def reads(self, points: Array, rng: np.random.Generator, noise: float = 1.0) -> Array:
        """Points (n, 3) in the tracker's frame, each with noise drawn in distance and two angles."""
        seen = (points - self.place) @ self.turn
        r = np.linalg.norm(seen, axis=1)
        azimuth, elevation = np.arctan2(seen[:, 1], seen[:, 0]), np.arcsin(seen[:, 2] / r)
        lateral = np.sqrt(self.constant**2 + (self.proportional * r) ** 2) * noise
        r = r + rng.normal(size=len(r)) * self.beam * noise
        azimuth = azimuth + rng.normal(size=len(r)) * lateral / (r * np.cos(elevation))
        elevation = elevation + rng.normal(size=len(r)) * lateral / r
        flat = np.cos(elevation)
        return np.stack([r * flat * np.cos(azimuth), r * flat * np.sin(azimuth), r * np.sin(elevation)], axis=1)


def tracker(rng: np.random.Generator, **noise: float) -> Tracker:
    """A tracker beside the machine, turned about its vertical axis and a little tilted."""
    return Tracker(np.array([-900.0, -700.0, 200.0]), rotation(rng.normal(size=3) * [0.1, 0.1, 1.0]), **noise)


def settings(
    method: str = "standstill",
    tools: Mapping[str, Sequence[float]] | None = None,
    knots: tuple[int, int, int] = (5, 5, 5),
    chain: str = "wXbYZt",
    **more: object,
) -> Settings:
    """The settings of a job on such a machine."""
    axes = [AxisSettings((float(LOW[i]), float(HIGH[i])), knots[i]) for i in range(3)]
    keys = {"standstill": ("points",), "on-the-fly": ("path", "track"), "six-dof": ("lines",)}[method]
    vectors = {name: tuple(vector) for name, vector in (tools or ONE).items()}
    machine = MachineSettings(
        chain, AxesSettings(*axes), tools=vectors, tool_uncertainty=more.pop("tool_uncertainty", 0.0)
    )
    noise = more.pop("noise", MachineNoise(beam=1e-3, lateral=LateralNoise(2e-3, 3e-6)))
    more.setdefault("volume", VolumeGrid((4, 4, 4)))
    return Settings(method, machine, Inputs(**dict.fromkeys(keys, NOWHERE)), noise, **more)


def reached(machine: Machine, commanded: Array, tools: Array) -> Array:
    """Where the reflector is, (n, 3)."""
    return commanded + tools + displacements(machine, commanded, tools)


def commands(rng: np.random.Generator, n: int) -> Array:
    """Random positions, and the corners."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    return np.concatenate([LOW + corners * (HIGH - LOW), rng.uniform(LOW, HIGH, (n - 8, 3))])


def points(
    machine: Machine,
    rng: np.random.Generator,
    n: int = 226,
    tools: Mapping[str, Sequence[float]] | None = None,
    noise: float = 1.0,
) -> Table:
    """A standstill measurement."""
    tools = tools or ONE
    position, which = commands(rng, n), rng.integers(len(tools), size=n)
    vectors = np.array(list(tools.values()))[which]
    seen = tracker(rng).reads(reached(machine, position, vectors), rng, noise)
    return point_table(position, seen, np.array(list(tools))[which])


def point_table(position: Array, seen: Array, tool: npt.NDArray[np.str_]) -> Table:
    """Commanded and measured points as a file would have them."""
    columns = {"point": np.array([f"P{i}" for i in range(len(position))]), "tool": tool}
    columns |= dict(zip("xyz", position.T, strict=True)) | dict(zip(("mx", "my", "mz"), seen.T, strict=True))
    return Table(
        columns,
        dict.fromkeys(("x", "y", "z", "mx", "my", "mz"), "mm"),
        "points.csv",
        tuple(range(2, len(position) + 2)),
    )


def truth_of(machine: Machine, name: str) -> Array:
    """The true table or squareness."""
    if name in ("A0Z", "B0Z", "C0Y"):
        return np.array([machine.squareness[("A0Z", "B0Z", "C0Y").index(name)]])
    return machine.tables[name]


def without_motion(moved: Array, at: Array) -> Array:
    """Displacements (n, 3) of points after the best small shift and turn (least squares)."""
    centred = at - at.mean(axis=0)
    columns = [np.tile(unit, (len(at), 1)) for unit in np.eye(3)] + [np.cross(unit, centred) for unit in np.eye(3)]
    design = np.stack([column.ravel() for column in columns], axis=1)
    motion, *_ = np.linalg.lstsq(design, moved.ravel(), rcond=None)
    return moved - (design @ motion).reshape(moved.shape)


def displacements(machine: Machine, positions: Array, tools: Array) -> Array:
    """The first-order displacement of many points, (n, 3)."""
    total = np.zeros_like(positions)
    for n, axis in enumerate(machine.order):
        x = positions[:, "XYZ".index(axis)]
        e = np.stack([np.interp(x, machine.positions(axis), machine.tables[f"E{d}{axis}"]) for d in "XYZABC"], axis=1)
        lever = np.array(np.broadcast_to(tools, positions.shape))
        for later in machine.order[n + 1 :]:
            lever[:, "XYZ".index(later)] += positions[:, "XYZ".index(later)]
        total += e[:, :3] + np.cross(e[:, 3:], lever)
    a, b, c = machine.squareness
    total[:, 0] += -c * positions[:, 1] + b * positions[:, 2]
    total[:, 1] -= a * positions[:, 2]
    return total


def travel(vertices: Array, spacing: float, rng: np.random.Generator) -> Array:
    """Commanded positions along a path: uneven spacing about `spacing`, slower at the vertices, a rest at each."""
    parts = [np.repeat(vertices[:1], 20, axis=0)]
    for start, end in pairwise(vertices):
        length = float(np.linalg.norm(end - start))
        if length == 0:
            continue
        n = max(int(length / spacing), 5)
        share = (np.arange(n) + rng.uniform(0.1, 0.9)) / n
        # ramps at both ends: a cubic that begins and ends with a third of the speed
        share = share + 0.3 * np.sin(2 * np.pi * share) / -(2 * np.pi)
        parts += [start + share[:, None] * (end - start), np.repeat(end[None], 10, axis=0)]
    return np.concatenate(parts)


def walls(rng: np.random.Generator, n: int) -> Array:
    """Random points on the walls of the volume, one after the other on different walls."""
    points, last = [], -1
    while len(points) < n:
        wall = int(rng.integers(6))
        if wall == last:
            continue
        last = wall
        share = rng.uniform(size=3)
        share[wall // 2] = wall % 2
        points.append(np.round(LOW + share * (HIGH - LOW), 3))
    return np.array(points)


@dataclass(frozen=True)
class Flight:
    """A path and a track, as files would have them, with the truth."""

    path: Table
    track: Table
    commanded: Array
    tool: npt.NDArray[np.int64]


def flight(
    machine: Machine,
    vertices: Array,
    rng: np.random.Generator,
    *,
    spacing: float = 1.0,
    noise: float = 1.0,
    tools: Mapping[str, Sequence[float]] | None = None,
) -> Flight:
    """An on-the-fly measurement; with several tools the path is driven once with each."""
    tools = tools or ONE
    eye = tracker(rng, constant=5e-3, proportional=0.0)
    way = [travel(vertices, spacing, rng) for _ in tools]
    tool = np.repeat(np.arange(len(tools)), [len(part) for part in way])
    commanded = np.concatenate(way)
    vectors = np.array(list(tools.values()))[tool]
    seen = eye.reads(commanded + vectors + displacements(machine, commanded, vectors), rng, noise)
    names = np.array(list(tools))
    listed = {"tool": np.repeat(names, len(vertices))} if len(tools) > 1 else {}
    track = {"tool": names[tool]} if len(tools) > 1 else {}
    return Flight(
        coordinate_table("path.csv", np.tile(vertices, (len(tools), 1)), listed),
        coordinate_table("track.csv", seen, track),
        commanded,
        tool,
    )


def coordinate_table(file: str, values: Array, more: Mapping[str, object]) -> Table:
    columns = {**dict(zip("xyz", values.T, strict=True)), **more}
    return Table(columns, dict.fromkeys("xyz", "mm"), file, tuple(range(2, len(values) + 2)))  # type: ignore[arg-type]


def left_in_volume(result_volume: Table, machine: Machine, tool: Sequence[float]) -> tuple[float, float]:
    """Mean length of the true error over a result's grid, and of what its prediction leaves of it, without motion."""
    at = result_volume.stacked("xyz")
    truth = displacements(machine, at, np.array(tool))
    predicted = result_volume.stacked(("ex", "ey", "ez"))
    whole, left = (np.linalg.norm(without_motion(part, at), axis=1).mean() for part in (truth, predicted - truth))
    return float(whole), float(left)


CHANNELS = ("ex", "ey", "ez", "ea", "eb", "ec")
SPAN = HIGH - LOW


def rotations(machine: Machine, positions: Array) -> Array:
    return sum(np.stack([machine.errors(a, p) for p in positions[:, i]])[:, 3:] for i, a in enumerate("XYZ"))  # type: ignore[return-value]


def line(
    machine: Machine, axis: str, rng: np.random.Generator, noise: float = 1.0, n: int = 25, **where: float
) -> dict[str, Array]:
    """One line: the machine's error, an offset in every channel, a slope across the beam, noise."""
    moving = ["xyz".index(letter) for letter in axis]
    length = float(np.linalg.norm(SPAN[moving]))
    distance = np.linspace(0, length, n)
    at = np.zeros((n, 3))
    for letter, value in where.items():
        at[:, "xyz".index(letter)] = value
    along = np.zeros(3)
    along[moving] = SPAN[moving] / length
    at[:, moving] = LOW[moving] + np.outer(distance, along[moving])
    channels = np.concatenate([displacements(machine, at, np.zeros(3)), rotations(machine, at)], axis=1)
    channels += rng.normal(size=6) * ([0.05] * 3 + [2e-4] * 3)
    slope = rng.normal(size=3) * 5e-5
    channels[:, :3] += np.outer(distance, slope - slope @ along * along)
    beam = rng.normal(size=(n, 1)) * 5e-4
    square = rng.normal(size=(n, 3)) * 1e-3
    channels[:, :3] += noise * (square + (beam - square @ along[:, None]) * along)
    channels[:, 3:] += noise * rng.normal(size=(n, 3)) * 1e-6
    shown = at[:, moving[0]] if len(moving) == 1 else distance
    return {
        "axis": np.repeat(axis, n),
        "position": shown,
        **dict(zip(CHANNELS, channels.T, strict=True)),
        **dict(zip("xyz", at.T, strict=True)),
    }


def line_table(lines: list[dict[str, Array]], keep: tuple[str, ...] = ()) -> Table:
    names = np.concatenate([np.repeat(f"L{i}", len(one["position"])) for i, one in enumerate(lines)])
    columns = {"line": names} | {
        name: np.concatenate([one[name] for one in lines]) for name in ("axis", "position", *CHANNELS, *keep)
    }
    units = {
        "position": "mm",
        **dict.fromkeys(("ex", "ey", "ez", *keep), "mm"),
        **dict.fromkeys(("ea", "eb", "ec"), "rad"),
    }
    return Table(columns, units, "lines.csv", tuple(range(2, len(names) + 2)))
