"""Aligned poses of a launch unit with something hidden in them: plain formulas, random draws and projection."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.hidden.case import Case, Hidden
from benchmarks.hidden.stated import stated
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.table import Table
from metrocli.tasks.locate_launch_unit import task as locate_launch_unit
from metrocli.tasks.locate_launch_unit.settings import Inputs, LaunchUnitNoise, Settings

Array = npt.NDArray[np.float64]
ENCODER, DISTANCE = 2.4240684e-5, 1e-3
"""5 arcsec and 1 um"""
READINGS = ("phi1", "phi2", "phi3", "phi4", "distance")
PARAMETERS = {
    "encoder-eccentricity": ("c1", "s1"),
    "encoder-harmonic": ("c2", "s2"),
    "encoder-offset": ("offset",),
    "belt-hysteresis": ("width",),
    "base-tilt": ("tx", "ty"),
    "axis-nonorthogonality": ("angle",),
    "beam-offset": ("h",),
    "beam-height": ("v",),
    "distance-offset": ("offset",),
    "distance-scale": ("scale",),
    "machine-scale": ("scale",),
    "machine-squareness": ("angle",),
    "bad-pose": ("dx", "dy", "dz"),
}
OUTSIDE = ("_launch-creep", "_encoder-sine", "_third-harmonic", "_warm-up")
_SIZES = {"angle": 1e-5, "tx": 1e-5, "ty": 1e-5, "c1": 1e-5, "s1": 1e-5, "c2": 1e-5, "s2": 1e-5, "scale": 1e-6}
_STILL = 1e-3
"""Smallest move of an axis [rad] that gives it a direction"""
_ONE = 0.9
"""Cosine above which a change is that of a single reading"""
_DRAWS = 500
"""Draws of an effect after which the measurement is drawn again"""


@dataclass(frozen=True)
class Measurement:
    """What was read in n poses."""

    unit: Array
    """x y z gamma"""
    receivers: Array
    """As the file has them, (n, 3)"""
    psi: Array
    t: Array
    temp: Array
    distances: bool
    read: Array
    """phi1..phi4 [rad] and, with distances, the distance [mm], (4 or 5, n)"""
    noise: float = 1.0
    """By which the true noise is divided in the job's declaration"""

    @property
    def sigma(self) -> Array:
        """True standard deviations, (4 or 5, 1)."""
        return np.array([ENCODER] * 4 + [DISTANCE] * self.distances)[:, None]

    def predicted(self, unit: Array | None = None, receivers: Array | None = None, tilts: Array | None = None) -> Array:
        """Return the readings of units that look at each other; tilts (2, 2) are tx ty of launch unit and receiver."""
        unit = self.unit if unit is None else unit
        beam = (self.receivers if receivers is None else receivers) - unit[:3]
        tilts = np.zeros((2, 2)) if tilts is None else tilts
        out = beam @ _base(tilts[0])
        c, s = np.cos(self.psi), np.sin(self.psi)
        back = np.column_stack([-c * beam[:, 0] - s * beam[:, 1], s * beam[:, 0] - c * beam[:, 1], -beam[:, 2]])
        back = back @ _base(tilts[1])
        rows = [
            np.arctan2(out[:, 1], out[:, 0]) - unit[3],
            np.arctan2(out[:, 2], np.hypot(out[:, 0], out[:, 1])),
            np.arctan2(back[:, 2], np.hypot(back[:, 0], back[:, 1])),
            np.arctan2(back[:, 1], back[:, 0]),
        ]
        return np.array([*rows, np.linalg.norm(beam, axis=1)][: 4 + self.distances])

    def adjusted(self) -> AdjustedJob:
        """Return it as the job that a user would give."""
        angles = (self.read[:4] + np.pi) % (2 * np.pi) - np.pi
        columns = {"pose": poses(self), **dict(zip("xyz", self.receivers.T, strict=True)), "spindle": self.psi}
        columns |= dict(zip(READINGS, [*angles, *self.read[4:]], strict=False))
        table = Table(columns | {"t": self.t, "temp": self.temp}, {})
        noise = LaunchUnitNoise(ENCODER / self.noise, DISTANCE / self.noise)
        return locate_launch_unit.diagnosed(locate_launch_unit.TASK.job(Settings(Inputs(Path("-")), noise), table))


def _base(tilt: Array) -> Array:
    """Return `Rx(tx) Ry(ty)`."""
    (cx, cy), (sx, sy) = np.cos(tilt), np.sin(tilt)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    return about_x @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])


def poses(m: Measurement) -> npt.NDArray[np.str_]:
    """Return the names of the poses."""
    return np.char.add("P", np.arange(len(m.receivers)).astype(str))


def measurement(rng: np.random.Generator, distances: bool) -> Measurement:
    """Return 15 to 40 poses at random around a unit, read with noise."""
    n = int(rng.integers(15, 41))
    unit = np.array([*rng.uniform([700, 300, -400], [1300, 700, -150]), rng.uniform(-np.pi, np.pi)])
    receivers = rng.uniform([0, 0, 50], [2000, 1000, 1000], (n, 3))
    psi = rng.choice([0.0, np.pi / 2, np.pi, -2 * np.pi / 3], n)
    t = np.sort(rng.uniform(0, 3000, n))[rng.permutation(n)]
    swing = rng.uniform(0.3, 0.8) * np.sin(2 * np.pi * t / rng.uniform(2800, 7500) + rng.uniform(0, 6))
    temp = 20 + swing + rng.uniform(-0.5, 0.5) * t / 3000
    blank = Measurement(unit, receivers, psi, t, temp, distances, np.zeros(0))
    exact = blank.predicted()
    return replace(blank, read=exact + rng.normal(size=exact.shape) * blank.sigma)


def places(m: Measurement, name: str) -> list[dict[str, str]]:
    """Return where an effect can be."""
    if name in ("encoder-eccentricity", "encoder-harmonic", "belt-hysteresis"):
        return [{"encoder": f"phi{i}"} for i in (1, 2, 3, 4)]
    if name == "encoder-offset":
        return [{"encoder": f"phi{i}"} for i in (2, 3, 4)]
    if name in ("base-tilt", "axis-nonorthogonality"):
        return [{"unit": "launch"}, {"unit": "receiver"}]
    if name == "machine-scale":
        return [{"axis": axis} for axis in "xyz"]
    if name == "machine-squareness":
        return [{"pair": pair} for pair in ("xy", "xz", "yz")]
    if name == "bad-pose":
        return [{"pose": str(pose)} for pose in poses(m)]
    return [{}]


def change(m: Measurement, name: str, where: Mapping[str, str], values: Mapping[str, float]) -> Array:
    """Return by how much an effect changes each reading, by the formulas of the contract."""
    ideal = m.predicted()
    moved = ideal.copy()
    if "encoder" in where:
        row = READINGS.index(where["encoder"])
        phi = ideal[row]
        moved[row] += values.get("offset", 0.0)
        if name == "belt-hysteresis":
            moved[row] -= values["width"] / 2 * _grew(phi, m.t)
        moved[row] += values.get("c1", 0.0) * np.cos(phi) + values.get("s1", 0.0) * np.sin(phi)
        moved[row] += values.get("c2", 0.0) * np.cos(2 * phi) + values.get("s2", 0.0) * np.sin(2 * phi)
    elif name == "base-tilt":
        tilt = np.array([values["tx"], values["ty"]])
        still = np.zeros(2)
        moved = m.predicted(tilts=np.array([tilt, still] if where["unit"] == "launch" else [still, tilt]))
    elif name == "axis-nonorthogonality":
        base, tilt_row = (0, 1) if where["unit"] == "launch" else (3, 2)
        moved[base] += values["angle"] * np.tan(ideal[tilt_row])
    elif name == "beam-offset":
        level = np.linalg.norm((m.receivers - m.unit[:3])[:, :2], axis=1)
        moved[[0, 3]] -= np.arcsin(values["h"] / level)
    elif name == "beam-height":
        turn = np.arcsin(values["v"] / np.linalg.norm(m.receivers - m.unit[:3], axis=1))
        moved[1], moved[2] = moved[1] - turn, moved[2] + turn
    elif name == "distance-offset":
        moved[4] += values["offset"]
    elif name == "distance-scale":
        moved[4] *= 1 + values["scale"]
    elif name[0] == "_":
        moved = _outside(m, name, values, ideal)
    else:
        moved = m.predicted(receivers=_displaced(m, name, where, values))
    off = moved - ideal
    off[:4] = (off[:4] + np.pi) % (2 * np.pi) - np.pi
    return off


def _grew(phi: Array, t: Array) -> Array:
    """Return 1 where an angle grew since the pose before in time, by the shorter way, -1 where it fell, (n,)."""
    order, found = np.argsort(t), np.zeros(len(t))
    steps = [(b - a + np.pi) % (2 * np.pi) - np.pi for a, b in pairwise(phi[order].tolist())]
    sides = [0.0]
    for step in steps:
        sides.append(sides[-1] if abs(step) < _STILL else float(np.sign(step)))
    first = next((side for side in sides if side), 0.0)
    found[order] = [side or first for side in sides]
    return found


def _displaced(m: Measurement, name: str, where: Mapping[str, str], values: Mapping[str, float]) -> Array:
    receivers = m.receivers.copy()
    if name == "machine-scale":
        receivers[:, "xyz".index(where["axis"])] *= 1 + values["scale"]
    elif name == "machine-squareness":
        first, second = ("xyz".index(axis) for axis in where["pair"])
        receivers[:, first] += values["angle"] * m.receivers[:, second]
    else:
        receivers[list(poses(m)).index(where["pose"])] += [values["dx"], values["dy"], values["dz"]]
    return receivers


def _outside(m: Measurement, name: str, values: Mapping[str, float], ideal: Array) -> Array:
    moved, c, row = ideal.copy(), values["c"], int(values["row"])
    if name == "_launch-creep":
        velocity = np.array([values["vx"], values["vy"], values["vz"]]) * c
        for i, t in enumerate(m.t - m.t.min()):
            moved[:, i] = m.predicted(unit=m.unit + np.array([*(velocity * t), 0.0]))[:, i]
    elif name == "_encoder-sine":
        moved[row] += c * np.sin(2 * np.pi * m.t / values["period"] + values["phase"])
    elif name == "_third-harmonic":
        moved[row] += c * np.cos(3 * ideal[row] + values["phase"])
    else:
        moved[row] += c * np.exp(-(m.t - m.t.min()) / (values["period"] / 4))
    return moved


def visible(m: Measurement, off: Array) -> Array:
    """Return what place and gamma leave of a change, whitened, one row after the other."""
    columns = []
    for step in np.diag([1e-3, 1e-3, 1e-3, 1e-6]):
        by = m.predicted(unit=m.unit + step) - m.predicted(unit=m.unit - step)
        by[:4] = (by[:4] + np.pi) % (2 * np.pi) - np.pi
        columns.append((by / m.sigma).ravel())
    jacobian, white = np.stack(columns, axis=1), (off / m.sigma).ravel()
    basis = np.linalg.qr(jacobian / np.linalg.norm(jacobian, axis=0))[0]
    return np.asarray(white - basis @ (basis.T @ white))


def span(m: Measurement, name: str, where: Mapping[str, str]) -> Array:
    """Return an orthonormal basis of what is visible of an effect."""
    zero = dict.fromkeys(PARAMETERS[name], 0.0)
    columns = [visible(m, change(m, name, where, zero | {p: _SIZES.get(p, 1e-3)})) for p in PARAMETERS[name]]
    u, s, _ = np.linalg.svd(np.stack(columns, axis=1), full_matrices=False)
    return np.asarray(u[:, s > 1e-6 * s[0]])


def nearest(m: Measurement, seen: Array, name: str, where: Mapping[str, str]) -> float:
    """Return the largest cosine of what is seen of a change with another candidate."""
    unit, most = seen / np.linalg.norm(seen), 0.0
    for other in PARAMETERS:
        if other == "bad-pose" or (other.startswith("distance") and not m.distances):
            continue
        for place in places(m, other):
            if (other, place) != (name, dict(where)):
                most = max(most, float(np.linalg.norm(span(m, other, place).T @ unit)))
    return most


def planted(m: Measurement, rng: np.random.Generator, name: str, times: float) -> tuple[Measurement, Hidden]:
    """Return the measurement with an effect of so many times its least detectable size in a random direction.

    One that would be seen in a single reading (a bad pose by its distance) is drawn again, since it is an outlier. A
    measurement in which any would be, such as one with a first pose long before all others, is drawn again as well.
    """
    options = places(m, name) if name in PARAMETERS else [{}]
    names = PARAMETERS.get(name, ("c",))
    seen, where, values, draws = np.ones(1), options[0], dict[str, float](), 0
    while np.abs(seen).max() > _ONE * np.linalg.norm(seen):
        draws += 1
        m = m if draws % _DRAWS else measurement(rng, m.distances)
        where = options[int(rng.integers(len(options)))]
        values = {"row": float(rng.integers(4)), "phase": float(rng.uniform(0, 6))}
        values |= {"period": float(rng.uniform(940, 2250))}
        values |= dict(zip(("vx", "vy", "vz"), rng.normal(size=3).tolist(), strict=True))
        values |= dict(zip(names, (rng.normal(size=len(names)) * 1e-6).tolist(), strict=True))
        seen = visible(m, change(m, name, where, values))
    wanted = times * np.sqrt(stated(m.adjusted(), name if name in PARAMETERS else "base-tilt", len(names)))
    values |= {key: values[key] * wanted / np.linalg.norm(seen) for key in names}
    hidden = Hidden(name, where, values, nearest(m, seen, name, where))
    moved = replace(m, read=m.read + change(m, name, where, values))
    if name == "bad-pose" and not m.distances:
        # nothing sees it along the beam, so that no region of all three is to be had
        hidden = replace(hidden, values={})
    return moved, hidden


def spoilt(m: Measurement, rng: np.random.Generator, share: float) -> tuple[Measurement, frozenset[tuple[str, ...]]]:
    """Return the measurement with a share of its readings wrong by 6 to 25 standard deviations."""
    wrong = rng.random(m.read.shape) < share
    off = rng.uniform(6, 25, m.read.shape) * rng.choice([-1, 1], m.read.shape) * m.sigma * wrong
    keys = frozenset((f"P{pose}", READINGS[row]) for row, pose in np.argwhere(wrong))
    return replace(m, read=m.read + off), keys


def case(number: int, small: bool = False) -> Case:
    """Return one seeded case; all of them are small."""
    rng = np.random.default_rng([44, number])
    scenario = SCENARIOS[number % len(SCENARIOS)]
    turn = number // len(SCENARIOS)
    m = measurement(rng, bool(turn % 2))
    known = [name for name in PARAMETERS if m.distances or not name.startswith("distance")]
    hidden: tuple[Hidden, ...] = ()
    wrong: frozenset[tuple[str, ...]] = frozenset()
    if scenario.endswith("x"):
        m, one = planted(m, rng, known[int(rng.integers(len(known)))], float(scenario.split()[-1][:-1]))
        hidden = (one,)
    if "two effects" in scenario:
        for name in rng.choice(known[:-1], 2, replace=False):
            m, one = planted(m, rng, str(name), rng.uniform(2, 4))
            hidden = (*hidden, one)
    if "outside" in scenario:
        m, one = planted(m, rng, OUTSIDE[turn % len(OUTSIDE)], rng.uniform(2, 3.5))
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
    "outside the table, few poses",
    "outside the table, few poses",
)
