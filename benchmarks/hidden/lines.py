"""Lines of a laser with six degrees of freedom with something hidden in them: plain formulas and projection."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.hidden.case import Case, Hidden
from benchmarks.hidden.stated import stated
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.files import Inputs
from metrocli.tasks.calibrate_machine.machine_settings import AxesSettings, AxisSettings, MachineNoise, MachineSettings
from metrocli.tasks.calibrate_machine.settings import Settings

Array = npt.NDArray[np.float64]
LOW, HIGH, KNOTS = np.array([0.0, -260.0, -500.0]), np.array([600.0, 260.0, 0.0]), 5
DIRECTIONS = {"x": (0,), "y": (1,), "z": (2,), "xy": (0, 1), "yz": (1, 2), "xz": (0, 2)}
SIGMA = np.array([5e-4] * 3 + [1e-6] * 3)
"""0.5 um of displacement and straightness, 1 urad"""
TARGETS, RUNS = 15, 2
"""Targets on a line, and runs to and fro along it"""
PARAMETERS = {
    "laser-dead-path-drift": ("rate",),
    "laser-refraction-drift, t": ("rate",),
    "laser-refraction-drift, T": ("rate",),
    "backlash": ("width",),
    "thermal-growth": ("rate",),
    "machine-drift": ("vx", "vy", "vz"),
}
OUTSIDE = ("_swing", "_step-of-line")


@dataclass(frozen=True)
class Measurement:
    """Readings of six channels along lines, in the order of time, (n, 6)."""

    at: Array
    """Commanded positions, (n, 3)"""
    line: npt.NDArray[np.intp]
    distance: Array
    """From the lowest position of the line, (n,)"""
    sense: Array
    """Of travel, (n,)"""
    t: Array
    temp: Array
    read: Array
    noise: float = 1.0

    @property
    def along(self) -> Array:
        """Unit vector along the line of each reading, (n, 3)."""
        size = (HIGH - LOW) * [np.isin(np.arange(3), moving) for moving in DIRECTIONS.values()]
        return np.asarray((size / np.linalg.norm(size, axis=1, keepdims=True))[self.line])

    @cached_property
    def absorbed(self) -> Array:
        """Orthonormal basis of what tables, squareness and the misalignment of lines can do, whitened, (6n, k)."""
        columns = np.stack([(one / SIGMA).ravel() for one in (*_tables(self), *_misaligned(self))], axis=1)
        norm = np.linalg.norm(columns, axis=0)
        u, s, _ = np.linalg.svd(columns[:, norm > 0] / norm[norm > 0], full_matrices=False)
        return np.asarray(u[:, s > 1e-9 * s[0]])

    def visible(self, change: Array) -> Array:
        """Return what the unknowns leave of a change (n, 6), in standard deviations."""
        white = (change / SIGMA).ravel()
        return np.asarray(white - self.absorbed @ (self.absorbed.T @ white))

    def adjusted(self) -> AdjustedJob:
        """Return it as the job that a user would give."""
        axis = np.array(list(DIRECTIONS))[self.line]
        starts = np.array([LOW[moving[0]] if len(moving) == 1 else 0.0 for moving in DIRECTIONS.values()])
        columns = {"line": names(self), "axis": axis, "position": self.distance + starts[self.line]}
        columns |= dict(zip(("ex", "ey", "ez", "ea", "eb", "ec"), self.read.T, strict=True))
        columns |= {"t": self.t, "temp": self.temp}
        axes = AxesSettings(*(AxisSettings((low, high), KNOTS) for low, high in zip(LOW, HIGH, strict=True)))
        noise = MachineNoise(displacement=5e-4 / self.noise, straightness=5e-4 / self.noise, angle=1e-6 / self.noise)
        machine = MachineSettings("wXbYZt", axes, tools={"": (0.0, 0.0, 0.0)})
        settings = Settings("six-dof", machine, Inputs(lines=Path("-")), noise)
        return calibrate_machine.diagnosed(calibrate_machine.TASK.job(settings, lines=Table(columns, {})))


def names(m: Measurement) -> npt.NDArray[np.str_]:
    """Return the name of the line of each reading."""
    return np.char.add("L", m.line.astype(str))


def _tables(m: Measurement) -> Iterator[Array]:
    """Yield the readings (n, 6) of each knot of each table, and of each squareness; chain XYZ, tool at zero."""
    zero = np.zeros((len(m.at), 3))
    for i in range(3):
        lever = np.where(np.arange(3) > i, m.at, 0.0)
        for hat in np.eye(KNOTS):
            share = np.interp(m.at[:, i], np.linspace(LOW[i], HIGH[i], KNOTS), hat)[:, None]
            for unit in np.eye(3):
                yield np.hstack([share * unit, zero])
                yield np.hstack([share * np.cross(unit, lever), share * unit])
    for moved, along in ((1, 2), (0, 2), (0, 1)):
        sheared = zero.copy()
        sheared[:, moved] = m.at[:, along]
        yield np.hstack([sheared, zero])


def _misaligned(m: Measurement) -> Iterator[Array]:
    """Yield the readings of an offset of each channel of each line, and of a slope of its beam across it."""
    for number in range(len(DIRECTIONS)):
        here = (m.line == number).astype(float)[:, None]
        yield from (here * unit for unit in np.eye(6))
        across = np.eye(3) - np.outer(m.along[m.line == number][0], m.along[m.line == number][0])
        yield from (np.hstack([here * m.distance[:, None] * unit, 0 * m.at]) for unit in across)


def measurement(rng: np.random.Generator) -> Measurement:
    """Return a machine with errors of some 20 um, read with noise on lines that are run to and fro."""
    parts, clock = [], 0.0
    for number, moving in enumerate(DIRECTIONS.values()):
        size = (HIGH - LOW) * np.isin(np.arange(3), moving)
        share = np.linspace(0, 1, TARGETS)
        way = np.concatenate([share if run % 2 == 0 else share[::-1] for run in range(RUNS)])
        start = np.where(size > 0, LOW, [0.0, 0.0, 0.0])
        t = clock + np.cumsum(rng.uniform(6, 10, len(way)))
        clock = t[-1] + 600
        sense = np.repeat([1.0, -1.0] * (RUNS // 2), TARGETS)
        parts.append((start + way[:, None] * size, np.full(len(way), number), way * np.linalg.norm(size), sense, t))
    at, line, distance, sense, t = (np.concatenate(one) for one in zip(*parts, strict=True))
    temp = 20 + rng.uniform(0.5, 1.0) * np.sin(2 * np.pi * t / rng.uniform(1500, 2500) + rng.uniform(0, 6))
    m = Measurement(at, line, distance, sense, t, temp, np.zeros((len(t), 6)))
    errors = sum(column * rng.normal() * _usual(column) for column in (*_tables(m), *_misaligned(m)))
    return replace(m, read=errors + rng.normal(size=m.read.shape) * SIGMA)


def _usual(column: Array) -> float:
    """Return the size of a random error: 20 urad of an angle, 30 urad of a slope, 5 um of anything else."""
    if column[:, 3:].any():
        return 2e-5
    return 3e-5 if np.abs(column).max() > 2 else 5e-3


def places(name: str) -> list[dict[str, str]]:
    """Return where an effect can be."""
    if name == "laser-dead-path-drift":
        return [{"line": f"L{number}"} for number in range(len(DIRECTIONS))]
    return [{"axis": axis} for axis in "xyz"] if name in ("backlash", "thermal-growth") else [{}]


def change(m: Measurement, name: str, where: Mapping[str, str], v: Mapping[str, float]) -> Array:
    """Return by how much an effect changes each reading, (n, 6), by the pages of the effects."""
    elapsed, warmer = m.t - m.t.min(), m.temp - m.temp[np.argmin(m.t)]
    moved, longer = np.zeros_like(m.at), np.zeros(len(m.t))
    if name == "laser-dead-path-drift":
        longer = v["rate"] * elapsed * (names(m) == where["line"])
    elif name.startswith("laser-refraction-drift"):
        longer = v["rate"] * (warmer if name.endswith("T") else elapsed) * m.distance
    elif name == "machine-drift":
        moved = elapsed[:, None] * np.array([v["vx"], v["vy"], v["vz"]])
    elif name == "_swing":
        longer = v["c"] * np.sin(2 * np.pi * elapsed / v["period"] + v["phase"])
    elif name == "_step-of-line":
        longer = v["c"] * (m.distance > v["part"] * m.distance.max()) * (m.sense > 0)
    else:
        i = "xyz".index(where["axis"])
        side = np.sign(m.along[:, i]) * m.sense
        moved[:, i] = v["width"] / 2 * side if name == "backlash" else v["rate"] * elapsed * m.at[:, i]
    return np.hstack([moved + longer[:, None] * m.along, np.zeros_like(m.at)])


def nearest(m: Measurement, seen: Array, name: str, where: Mapping[str, str]) -> float:
    """Return the largest cosine of what is seen of a change with another candidate."""
    unit, most = seen / np.linalg.norm(seen), 0.0
    for other, parameters in PARAMETERS.items():
        for place in places(other):
            if (other, place) != (name, dict(where)):
                zero = dict.fromkeys(parameters, 0.0)
                columns = [m.visible(change(m, other, place, zero | {one: 1e-6})) for one in parameters]
                u, s, _ = np.linalg.svd(np.stack(columns, axis=1), full_matrices=False)
                most = max(most, float(np.linalg.norm(u[:, s > 1e-6 * s[0]].T @ unit)))
    return most


def planted(m: Measurement, rng: np.random.Generator, name: str, times: float) -> tuple[Measurement, Hidden]:
    """Return the measurement with an effect of so many times its least detectable size in a random direction."""
    options = places(name)
    where = options[int(rng.integers(len(options)))]
    sizes = PARAMETERS.get(name, ("c",))
    v = {
        "period": float(rng.uniform(300, 800)),
        "phase": float(rng.uniform(0, 6)),
        "part": float(rng.uniform(0.3, 0.7)),
    }
    v |= dict(zip(sizes, (rng.normal(size=len(sizes)) * 1e-6).tolist(), strict=True))
    seen, (cause, _, form) = m.visible(change(m, name, where, v)), name.partition(", ")
    wanted = times * np.sqrt(stated(m.adjusted(), cause if name in PARAMETERS else "machine-drift", len(sizes)))
    v |= {key: v[key] * wanted / np.linalg.norm(seen) for key in sizes}
    hidden = Hidden(cause, where, {key: v[key] for key in sizes}, nearest(m, seen, name, where), form)
    return replace(m, read=m.read + change(m, name, where, v)), hidden


def case(number: int, small: bool = False) -> Case:
    """Return one seeded case; all of them are small."""
    rng = np.random.default_rng([67, number])
    scenario = SCENARIOS[number % len(SCENARIOS)]
    m, known, hidden = measurement(rng), list(PARAMETERS), list[Hidden]()
    wanted: list[tuple[str, float]] = []
    if scenario.endswith("x"):
        wanted = [(known[int(rng.integers(len(known)))], float(scenario.split()[-1][:-1]))]
    elif scenario == "two effects":
        chosen = [known[i] for i in rng.choice([0, 1, 3, 4], 2, replace=False)]
        wanted = [(name, float(rng.uniform(2, 4))) for name in chosen]
    elif scenario == "outside the table":
        wanted = [(OUTSIDE[int(rng.integers(len(OUTSIDE)))], float(rng.uniform(2, 3.5)))]
    for name, times in wanted:
        m, one = planted(m, rng, name, times)
        hidden.append(one)
    if "half" in scenario or "double" in scenario:
        m = replace(m, noise=2.0 if "half" in scenario else 0.5)
    return Case(scenario, m.adjusted, tuple(hidden), frozenset(), m.noise)


SCENARIOS = (
    "nothing",
    "nothing, noise declared half",
    "nothing, noise declared double",
    "nothing",
    "an effect of 1x",
    "an effect of 1.5x",
    "an effect of 2x",
    "an effect of 3x",
    "noise declared half and an effect of 2x",
    "an effect of 2x",
    "two effects",
    "outside the table",
)
