"""Points of a machine seen by a tracker at standstill, with something hidden in them: plain formulas and projection."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.hidden.case import Case, Hidden
from benchmarks.hidden.stated import stated
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.effects.requested import RequestedEffect
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.files import Inputs
from metrocli.tasks.calibrate_machine.machine_settings import (
    AxesSettings,
    AxisSettings,
    LateralNoise,
    MachineNoise,
    MachineSettings,
)
from metrocli.tasks.calibrate_machine.settings import Settings

Array = npt.NDArray[np.float64]
LOW, HIGH = np.array([0.0, -260.0, -500.0]), np.array([600.0, 260.0, 0.0])
TOOLS = {"T1": (0.0, 0.0, 120.0), "T2": (110.0, 20.0, 150.0), "T3": (-30.0, 100.0, 210.0)}
BEAM, CONSTANT, PROPORTIONAL = 1e-3, 2e-3, 3e-6
LENGTH = 60.0
"""Way over which hysteresis builds up, where it is held against other effects"""
SIZE, SMALL = (6, 220), (3, 80)
"""Knots of each axis and points; in a small case fewer"""
PARAMETERS = {
    "backlash": ("width",),
    "backlash-growth": ("growth",),
    "hysteresis": ("width",),
    "screw-pitch-error": ("amplitude", "phase"),
    "thermal-growth": ("rate",),
    "machine-drift": ("vx", "vy", "vz"),
    "load-sag": ("c",),
    "straightness-reversal": ("width",),
    "angular-reversal": ("rx", "ry", "rz"),
    "tracker-eccentricity": ("c1", "s1"),
    "tracker-scale": ("scale",),
    "tracker-range-zero": ("r0",),
    "tracker-beam-offset": ("h", "v"),
    "tracker-transit-tilt": ("angle",),
    "tracker-mirror-tilt": ("angle",),
    "tracker-vertical-index": ("angle",),
    "tracker-azimuth-harmonic": ("c2", "s2"),
    "tracker-vertical-eccentricity": ("c1", "s1"),
    "tracker-vertical-harmonic": ("c2", "s2"),
    "tracker-air-gradient": ("gradient",),
    "tracker-drift": ("vx", "vy", "vz"),
}
OUTSIDE = ("_swing", "_warm-up", "_fourfold")
"""A sine in time of 3 to 8 turns, a warm-up along one direction, and an error of the fourth harmonic of the azimuth"""


@dataclass(frozen=True)
class Measurement:
    """Commanded points, and what the tracker read."""

    at: Array
    """(n, 3)"""
    tool: npt.NDArray[np.intp]
    came: Array
    """Sides from which the axes came, (n, 3)"""
    t: Array
    place: Array
    turn: Array
    """Axes of the tracker in the machine, (3, 3)"""
    read: Array
    knots: int = SIZE[0]
    """Of each axis"""
    noise: float = 1.0

    @property
    def reflector(self) -> Array:
        """Where it would be without errors (n, 3)."""
        return self.at + np.array(list(TOOLS.values()))[self.tool]

    @cached_property
    def seen(self) -> Array:
        """The same in the tracker's frame."""
        return np.asarray((self.reflector - self.place) @ self.turn)

    @cached_property
    def white(self) -> Array:
        """Matrices that whiten a change in the tracker's frame, (n, 3, 3)."""
        r = np.linalg.norm(self.seen, axis=1)
        b = self.seen / r[:, None]
        lateral = np.sqrt(CONSTANT**2 + (PROPORTIONAL * r) ** 2)
        along = b[:, :, None] * b[:, None, :] * (1 / BEAM - 1 / lateral)[:, None, None]
        return np.asarray(np.eye(3) / lateral[:, None, None] + along)

    @cached_property
    def absorbed(self) -> Array:
        """Orthonormal basis of what tables, squareness and the tracker's frame can do, whitened, (3n, k)."""
        columns = [*_tables(self), *_squareness(self), *(np.tile(unit, (len(self.at), 1)) for unit in np.eye(3))]
        columns += [np.cross(unit, self.reflector - self.place) for unit in np.eye(3)]
        whitened = np.stack([self.whitened(column @ self.turn) for column in columns], axis=1)
        u, s, _ = np.linalg.svd(whitened / np.linalg.norm(whitened, axis=0), full_matrices=False)
        return np.asarray(u[:, s > 1e-9 * s[0]])

    def whitened(self, change: Array) -> Array:
        """Return a change (n, 3) in the tracker's frame in standard deviations, (3n,)."""
        return np.asarray(np.einsum("nab,nb->na", self.white, change).ravel())

    def visible(self, change: Array) -> Array:
        """Return what the unknowns leave of it."""
        white = self.whitened(change)
        return np.asarray(white - self.absorbed @ (self.absorbed.T @ white))

    def adjusted(self, effects: Sequence[RequestedEffect] = ()) -> AdjustedJob:
        """Return it as the job that a user would give, with the effects that the job has in its model."""
        columns = {"point": names(self), "tool": np.array(list(TOOLS))[self.tool], "t": self.t}
        columns |= dict(zip("xyz", self.at.T, strict=True)) | dict(zip(("mx", "my", "mz"), self.read.T, strict=True))
        columns |= {f"from_{axis}": side for axis, side in zip("xyz", self.came.T, strict=True)}
        axes = AxesSettings(*(AxisSettings((low, high), self.knots) for low, high in zip(LOW, HIGH, strict=True)))
        noise = MachineNoise(
            beam=BEAM / self.noise, lateral=LateralNoise(CONSTANT / self.noise, PROPORTIONAL / self.noise)
        )
        settings = Settings("standstill", MachineSettings("wXbYZt", axes, tools=TOOLS), Inputs(Path("-")), noise)
        return calibrate_machine.diagnosed(
            calibrate_machine.TASK.job(settings, points=Table(columns, {}), effects=effects)
        )


def names(m: Measurement) -> npt.NDArray[np.str_]:
    """Return the names of the points."""
    return np.char.add("P", np.arange(len(m.at)).astype(str))


def _tables(m: Measurement) -> Iterator[Array]:
    """Yield the displacement by each knot of each table, chain XYZ."""
    for i in range(3):
        lever = _lever(m, i)
        knots = np.linspace(LOW[i], HIGH[i], m.knots)
        for hat in np.eye(m.knots):
            share = np.interp(m.at[:, i], knots, hat)[:, None]
            yield from (share * unit for unit in np.eye(3))
            yield from (share * np.cross(unit, lever) for unit in np.eye(3))


def _lever(m: Measurement, axis: int) -> Array:
    """Return the tool vector with the positions of the axes between an axis and the tool, (n, 3)."""
    lever = np.array(list(TOOLS.values()))[m.tool]
    lever[:, axis + 1 :] += m.at[:, axis + 1 :]
    return lever


def _true_tables(rng: np.random.Generator, count: int) -> Iterator[float]:
    """Yield random tables knot by knot: positioning and angles 0 at 0, straightness 0 at both ends.

    Tool vectors are exact in this gauge; another one would turn them.
    """
    for i in range(3):
        knots = np.linspace(LOW[i], HIGH[i], count)
        tables = rng.normal(size=(6, count)) * np.array([0.03] * 3 + [1e-4] * 3)[:, None]
        for k, table in enumerate(tables):
            if k < 3 and k != i:
                table -= np.linspace(table[0], table[-1], count)
            else:
                table -= np.interp(0.0, knots, table)
        yield from tables.T.ravel().tolist()


def _squareness(m: Measurement) -> Iterator[Array]:
    zero = np.zeros(len(m.at))
    yield np.stack([zero, -m.at[:, 2], zero], axis=1)
    yield np.stack([m.at[:, 2], zero, zero], axis=1)
    yield np.stack([-m.at[:, 1], zero, zero], axis=1)


def measurement(rng: np.random.Generator, size: tuple[int, int] = SIZE, noise: float = 1.0) -> Measurement:
    """Return a machine with errors of some 50 um, read with so many times the declared noise."""
    knots, count = size
    at = np.concatenate(
        [LOW + np.indices((2, 2, 2)).reshape(3, -1).T * (HIGH - LOW), rng.uniform(LOW, HIGH, (count - 8, 3))]
    )
    at = at[rng.permutation(count)]
    came = np.sign(np.diff(at, axis=0, prepend=at[:1] - 1)) + 0.0
    came[came == 0] = 1.0
    t = np.cumsum(rng.uniform(3, 6, count))
    angle = rng.uniform(0, 2 * np.pi)
    place = np.array([300 + 1200 * np.cos(angle), 1100 * np.sin(angle), rng.uniform(-500, 0)])
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)) * 0.1 + _about_z(rng.uniform(0, 6)))
    turn = turn * np.sign(np.linalg.det(turn))
    m = Measurement(at, rng.integers(len(TOOLS), size=count), came, t, place, turn, np.zeros((count, 3)), knots)
    error = sum(column * value for column, value in zip(_tables(m), _true_tables(rng, knots), strict=True))
    exact = (m.reflector + error - place) @ turn
    return noisy(replace(m, read=exact), rng, noise)


def noisy(m: Measurement, rng: np.random.Generator, noise: float = 1.0) -> Measurement:
    """Return the measurement with noise added to what was read."""
    white = rng.normal(size=(len(m.at), 3, 1)) * noise
    return replace(m, read=m.read + np.linalg.solve(m.white, white)[:, :, 0])


def _about_z(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def places(name: str) -> list[dict[str, str]]:
    """Return where an effect can be."""
    if name in ("backlash", "backlash-growth", "hysteresis", "screw-pitch-error", "thermal-growth", "angular-reversal"):
        return [{"axis": axis} for axis in "xyz"]
    if name == "straightness-reversal":
        return [{"reversal": turned + shifted} for turned, shifted in permutations("xyz", 2)]
    return [{"pair": pair} for pair in ("xy", "xz", "yz")] if name == "load-sag" else [{}]


def change(m: Measurement, name: str, where: Mapping[str, str], v: Mapping[str, float]) -> Array:
    """Return by how much an effect changes each reading in the tracker's frame, by the formulas of the contract."""
    elapsed, moved = m.t - m.t.min(), np.zeros_like(m.at)
    x, y, _ = m.seen.T
    azimuth = np.arctan2(y, x)
    if "axis" in where:
        i = "xyz".index(where["axis"])
        if name == "backlash":
            moved[:, i] = v["width"] / 2 * m.came[:, i]
        elif name == "backlash-growth":
            moved[:, i] = v["growth"] * m.at[:, i] / 2 * m.came[:, i]
        elif name == "hysteresis":
            moved[:, i] = -v["width"] * m.came[:, i] * np.exp(-_way(m, i) / v["length"])
        elif name == "angular-reversal":
            moved = np.cross(np.array([v["rx"], v["ry"], v["rz"]]) * m.came[:, i, None] / 2, _lever(m, i))
        elif name == "thermal-growth":
            moved[:, i] = v["rate"] * elapsed * m.at[:, i]
        else:
            moved[:, i] = v["amplitude"] * np.sin(2 * np.pi * m.at[:, i] / v["period"] + v["phase"])
    elif name == "straightness-reversal":
        a, b = ("xyz".index(axis) for axis in where["reversal"])
        moved[:, b] = v["width"] / 2 * m.came[:, a]
    elif name == "load-sag":
        a, b = ("xyz".index(axis) for axis in where["pair"])
        moved[:, 2] = v["c"] * m.at[:, a] * m.at[:, b]
    elif name in ("machine-drift", "tracker-drift"):
        sign = 1 if name == "machine-drift" else -1
        moved = sign * elapsed[:, None] * np.array([v["vx"], v["vy"], v["vz"]])
    elif name in ("_swing", "_warm-up"):
        wave = (
            np.sin(2 * np.pi * elapsed / v["period"] + v["phase"]) if name == "_swing" else np.exp(-elapsed / v["tau"])
        )
        moved = v["c"] * wave[:, None] * np.array([v["vx"], v["vy"], v["vz"]])
    if name == "tracker-scale":
        return m.seen * v["scale"]
    if name in ("tracker-eccentricity", "_fourfold"):
        four = v.get("c", 0.0) * np.cos(4 * azimuth + v.get("phase", 0.0))
        by = four if name == "_fourfold" else v["c1"] * np.cos(azimuth) + v["s1"] * np.sin(azimuth)
        return np.stack([-y * by, x * by, 0 * by], axis=1)
    if name.startswith("tracker-") and name != "tracker-drift":
        return _misread(m.seen, name, v)
    return moved @ m.turn


def _way(m: Measurement, axis: int) -> Array:
    """Return how far an axis went since it turned, (n,), in the order of the points; inf before its first turn."""
    ways, way = [], float("inf")
    for k in range(len(m.at)):
        way = 0.0 if k and m.came[k, axis] != m.came[k - 1, axis] else way
        way += abs(m.at[k, axis] - m.at[max(k - 1, 0), axis])
        ways.append(way)
    return np.array(ways)


def _misread(seen: Array, name: str, v: Mapping[str, float]) -> Array:
    """Return the change of points (n, 3) by an error in distance, azimuth or elevation, by the pages of the effects."""
    x, y, z = seen.T
    r, azimuth, elevation = np.sqrt(x * x + y * y + z * z), np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
    level = np.hypot(x, y)
    longer, turn, lift = np.zeros((3, len(r)))
    if name == "tracker-range-zero":
        longer = longer + v["r0"]
    elif name == "tracker-beam-offset":
        turn, lift = v["h"] / level, v["v"] / r
    elif name == "tracker-transit-tilt":
        turn = v["angle"] * z / level
    elif name == "tracker-mirror-tilt":
        turn = v["angle"] * r / level
    elif name == "tracker-air-gradient":
        longer, lift = v["gradient"] * r * z / 2, -v["gradient"] * level / 2
    elif name == "tracker-vertical-index":
        lift = lift + v["angle"]
    elif name == "tracker-azimuth-harmonic":
        turn = v["c2"] * np.cos(2 * azimuth) + v["s2"] * np.sin(2 * azimuth)
    elif name == "tracker-vertical-eccentricity":
        lift = (v["c1"] * level + v["s1"] * z) / r
    else:
        lift = v["c2"] * np.cos(2 * elevation) + v["s2"] * np.sin(2 * elevation)
    r, azimuth, elevation = r + longer, azimuth + turn, elevation + lift
    new = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    return np.asarray((r * new).T - seen)


def nearest(m: Measurement, seen: Array, name: str, where: Mapping[str, str]) -> float:
    """Return the largest cosine of what is seen of a change with another candidate, periods of the screw left out."""
    unit, most = seen / np.linalg.norm(seen), 0.0
    for other in PARAMETERS:
        for place in places(other):
            if (other, place) == (name, dict(where)) or other == "screw-pitch-error":
                continue
            zero = dict.fromkeys(PARAMETERS[other], 0.0) | {"length": LENGTH}
            columns = np.stack(
                [m.visible(change(m, other, place, zero | {p: 1e-6})) for p in PARAMETERS[other]], axis=1
            )
            u, s, _ = np.linalg.svd(columns, full_matrices=False)
            most = max(most, float(np.linalg.norm(u[:, s > 1e-6 * s[0]].T @ unit)))
    return most


def planted(m: Measurement, rng: np.random.Generator, name: str, times: float) -> tuple[Measurement, Hidden]:
    """Return the measurement with an effect of so many times its least detectable size in a random direction."""
    options = places(name)
    where = options[int(rng.integers(len(options)))]
    count = PARAMETERS.get(name, ("c",))
    v = {"period": float(rng.uniform(4, 40)) if name[0] != "_" else float(rng.uniform(120, 350))}
    v |= {"phase": float(rng.uniform(0, 6)), "tau": float(rng.uniform(80, 250)), "length": float(rng.uniform(30, 120))}
    v |= dict(zip(("vx", "vy", "vz"), rng.normal(size=3).tolist(), strict=True))
    sizes = ("amplitude",) if name == "screw-pitch-error" else count
    v |= dict(zip(sizes, (rng.normal(size=len(sizes)) * 1e-6).tolist(), strict=True))
    seen = m.visible(change(m, name, where, v))
    wanted = times * np.sqrt(stated(m.adjusted(), name if name in PARAMETERS else "machine-drift", len(count)))
    v |= {key: v[key] * wanted / np.linalg.norm(seen) for key in sizes}
    # a phase and the sign of an amplitude say the same thing, and period and length are scanned: no region is tested
    known = {} if name in ("screw-pitch-error", "hysteresis") else {key: v[key] for key in count}
    hidden = Hidden(name, where, known, nearest(m, seen, name, where))
    return replace(m, read=m.read + change(m, name, where, v)), hidden


def spoilt(m: Measurement, rng: np.random.Generator, share: float) -> tuple[Measurement, frozenset[tuple[str, ...]]]:
    """Return the measurement with a share of its points wrong by 8 to 25 standard deviations."""
    wrong = rng.random(len(m.at)) < share
    way = rng.normal(size=m.read.shape)
    way *= (rng.uniform(8, 25, len(m.at)) * wrong / np.linalg.norm(way, axis=1))[:, None]
    off = np.linalg.solve(m.white, way[:, :, None])[:, :, 0]
    return replace(m, read=m.read + off), frozenset((f"P{i}",) for i in np.flatnonzero(wrong))


def case(number: int, small: bool = False) -> Case:
    """Return one seeded case, or one of fewer knots and points."""
    rng = np.random.default_rng([66, number])
    scenario = SCENARIOS[number % len(SCENARIOS)]
    m = measurement(rng, SMALL if small else SIZE)
    hidden: tuple[Hidden, ...] = ()
    wrong: frozenset[tuple[str, ...]] = frozenset()
    known = list(PARAMETERS)
    if scenario.endswith("x"):
        m, one = planted(m, rng, known[int(rng.integers(len(known)))], float(scenario.split()[-1][:-1]))
        hidden = (one,)
    if scenario == "two effects":
        for name in rng.choice(known[:-1], 2, replace=False):
            m, one = planted(m, rng, str(name), rng.uniform(2, 4))
            hidden = (*hidden, one)
    if scenario == "outside the table":
        m, one = planted(m, rng, OUTSIDE[int(rng.integers(len(OUTSIDE)))], rng.uniform(2, 3.5))
        hidden = (one,)
    if "outliers" in scenario:
        m, wrong = spoilt(m, rng, 0.02)
    if "half" in scenario or "double" in scenario:
        m = replace(m, noise=2.0 if "half" in scenario else 0.5)
    return Case(scenario, m.adjusted, hidden, wrong, m.noise)


SCENARIOS = (
    "nothing",
    "nothing, 2 % outliers",
    "nothing, noise declared half",
    "nothing, noise declared double",
    "nothing",
    "an effect of 1x",
    "an effect of 1.5x",
    "an effect of 2x",
    "an effect of 3x",
    "2 % outliers and an effect of 2x",
    "noise declared half and an effect of 2x",
    "an effect of 2x",
    "two effects",
    "outside the table",
)
