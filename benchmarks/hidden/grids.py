"""Views of a ball grid with something hidden in them: plain formulas, random draws and projection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.hidden.case import Case, Hidden
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.detectability import needed
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.effects.requested import RequestedEffect
from metrocli.table import Table
from metrocli.tasks.selfcal_grid import task as selfcal_grid
from metrocli.tasks.selfcal_grid.settings import GridSettings, Inputs, Rotate, Settings, ViewSettings

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
NOISE, PITCH = 5e-4, 65.0
HALF, SMALL = 2, 1
"""Pitches from the middle ball to the outermost: 5 x 5 x 5 balls, 3 x 3 x 3 in a small case"""
TURNS = {"2": np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), "3": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])}
SHIFTS = {"4": (1, 0, 0), "5": (0, 1, 0), "6": (0, 0, 1)}
NAMES = (
    "artefact-expansion", "artefact-bending", "drift-in-view", "reseated-artefact", "moved-ball", "axis-expansion",
)  # fmt: skip
OUTSIDE = ("_oscillation", "_clamping", "_cubic")
PARAMETERS: dict[str, tuple[str, ...]] = {
    "artefact-expansion": ("scale",),
    "artefact-bending": ("b",),
    "drift-in-view": ("vx", "vy", "vz"),
    "reseated-artefact": ("dx", "dy", "dz"),
    "moved-ball": ("dx", "dy", "dz"),
    "axis-expansion": ("scale",),
}


@dataclass(frozen=True)
class Views:
    """Which ball stands where in which view, row by row: the same for all cases with these views."""

    names: str
    view: Whole
    ball: Whole
    """Number of the ball"""
    balls: Whole
    """Indices of all balls, (125, 3) or (27, 3)"""
    half: int = HALF

    @property
    def turns(self) -> Array:
        """Rotation of each row, (n, 3, 3)."""
        each = np.stack([TURNS.get(name, np.eye(3)) for name in self.names])
        return np.asarray(each[self.view], dtype=float)

    @property
    def in_artefact(self) -> Array:
        """Nominal places of the balls, (n, 3)."""
        return np.asarray(self.balls[self.ball] * PITCH, dtype=float)

    @property
    def hanging(self) -> Array:
        """Places of the balls from the artefact's centre, in the directions of the machine, (n, 3)."""
        return np.einsum("nab,nb->na", self.turns, self.in_artefact)

    @property
    def shifts(self) -> Array:
        """(n, 3)"""
        return np.array([SHIFTS.get(name, (0, 0, 0)) for name in self.names], dtype=float)[self.view] * PITCH

    @property
    def sites(self) -> Whole:
        """Number of the site of each row."""
        place = np.rint((self.hanging + self.shifts) / PITCH).astype(int) + self.half
        size = 2 * self.half + 1
        return np.asarray((place[:, 0] * size + place[:, 1]) * size + place[:, 2])


@cache
def views(names: str, half: int = HALF) -> Views:
    """Return the rows of views, balls whose sites lie outside the grid left out."""
    r = np.arange(-half, half + 1)
    balls = np.stack(np.meshgrid(r, r, r, indexing="ij"), axis=-1).reshape(-1, 3)
    rows = []
    for number, name in enumerate(names):
        sites = balls @ TURNS.get(name, np.eye(3, dtype=int)).T + SHIFTS.get(name, (0, 0, 0))
        inside = np.flatnonzero((np.abs(sites) <= half).all(axis=1))
        rows.append(np.stack([np.full(len(inside), number), inside]))
    view, ball = np.concatenate(rows, axis=1)
    return Views(names, view, ball, balls, half)


@cache
def absorbed(names: str, half: int = HALF) -> Array:
    """Return an orthonormal basis of what machine, artefact and mountings can follow, (3 n, rank)."""
    v = views(names, half)
    n, count = len(v.view), len(v.balls)
    jacobian = np.zeros((n, 3, 6 * count + 6 * len(names)))
    rows = np.arange(n)
    place = v.hanging + v.shifts
    for a in range(3):
        jacobian[rows, a, 3 * v.sites + a] = 1.0
        for b in range(3):
            jacobian[rows, a, 3 * count + 3 * v.ball + b] = v.turns[:, a, b]
        jacobian[rows, a, 6 * count + 6 * v.view + a] = 1.0
        turned = np.cross(np.eye(3)[a], place) / PITCH
        for b in range(3):
            jacobian[rows, b, 6 * count + 6 * v.view + 3 + a] = turned[:, b]
    u, sizes, _ = np.linalg.svd(jacobian.reshape(3 * n, -1), full_matrices=False)
    return np.asarray(u[:, sizes > 1e-9 * sizes[0]])


def visible(v: Views, changes: Array) -> Array:
    """Return what the unknowns leave of changes of the readings (n, 3, k), in standard deviations, (3 n, k)."""
    flat = changes.reshape(-1, changes.shape[-1]) / NOISE
    basis = absorbed(v.names, v.half)
    return np.asarray(flat - basis @ (basis.T @ flat))


@dataclass(frozen=True)
class Measurement:
    """What was read, and when."""

    views: Views
    t: Array
    temp: Array
    readings: Array
    noise: float = 1.0
    """By which the true noise is divided in the job's declaration"""

    def adjusted(self, effects: Sequence[RequestedEffect] = ()) -> AdjustedJob:
        """Return it as the job that a user would give, with the effects that the job has in its model."""
        v = self.views
        balls = v.balls[v.ball]
        columns = {"view": np.array(list(v.names))[v.view], **dict(zip("ijk", balls.T, strict=True))}
        columns |= dict(zip("xyz", self.readings.T, strict=True)) | {"t": self.t, "temp": self.temp}
        table = Table(columns, {"x": "mm", "y": "mm", "z": "mm", "t": "s", "temp": "degC"})
        return selfcal_grid.diagnosed(
            selfcal_grid.TASK.job(job(v.names, NOISE / self.noise, v.half), table, effects=effects)
        )


def job(names: str, noise: float, half: int = HALF) -> Settings:
    """Return the settings of a job with these views."""
    turns = {"2": Rotate("z", np.pi / 2), "3": Rotate("x", np.pi / 2)}
    declared = tuple(ViewSettings(name, turns.get(name, ()), SHIFTS.get(name, (0, 0, 0))) for name in names)
    return Settings(Inputs(Path("-")), GridSettings((2 * half + 1,) * 3, PITCH), declared, noise)


def _rotation(angles: Array) -> Array:
    (ca, cb, cc), (sa, sb, sc) = np.cos(angles), np.sin(angles)
    x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    z = np.array([[cc, -sc, 0], [sc, cc, 0], [0, 0, 1]])
    return np.asarray(z @ y @ x)


def measurement(rng: np.random.Generator, names: str, half: int = HALF, noise: float = NOISE) -> Measurement:
    """Return views of a machine and an artefact at random, with noise; each view in an order of its own."""
    v = views(names, half)
    machine, artefact = rng.normal(0, 0.008, v.balls.shape), rng.normal(0, 0.03, v.balls.shape)
    place = np.einsum("nab,nb->na", v.turns, v.in_artefact + artefact[v.ball]) + v.shifts
    readings = machine[v.sites]
    t = np.empty(len(v.view))
    start = float(rng.uniform(0, 500))
    for number in range(len(names)):
        rows = np.flatnonzero(v.view == number)
        readings[rows] += place[rows] @ _rotation(rng.normal(0, 5e-4, 3)).T + rng.normal(0, 0.3, 3)
        order = rows if rng.random() < 0.5 else rng.permutation(rows)
        t[order] = start + np.arange(len(rows)) * 15.0 + rng.uniform(0, 5, len(rows))
        start += len(rows) * 15.0 + float(rng.uniform(300, 1500))
    temp = 20 + rng.uniform(0.1, 0.4) * np.sin(2 * np.pi * t / rng.uniform(4000, 15000) + rng.uniform(0, 6))
    return Measurement(v, t, temp, readings + rng.normal(0, noise, readings.shape))


Values = Mapping[str, float]


def change(m: Measurement, name: str, values: Values) -> Array:
    """Return by how much an effect of these values changes each reading, (n, 3), from the formulas of the contract."""
    v = m.views
    here = (v.view == values["view"]).astype(float)[:, None]
    t = (m.t - m.t.min())[:, None]
    d = np.array([values.get(key, 0.0) for key in ("dx", "dy", "dz")])
    if name == "artefact-expansion":
        return v.hanging * values["scale"] * here
    if name == "artefact-bending":
        square = (v.hanging[:, :2] ** 2).sum(axis=1)
        mean = float(square[v.view == values["view"]].mean())
        return -values["b"] * (square - mean)[:, None] * np.array([0.0, 0.0, 1.0]) * here
    if name == "drift-in-view":
        return np.array([values["vx"], values["vy"], values["vz"]]) * t * here
    if name == "reseated-artefact":
        return d * (m.t >= values["at"])[:, None] * here
    if name == "moved-ball":
        moved = ((v.ball == values["ball"]) & (v.view >= values["from_view"]))[:, None]
        return np.einsum("nab,b->na", v.turns, d) * moved
    x = (v.hanging + v.shifts) / (PITCH * v.half)
    if name == "axis-expansion":
        along = np.eye(3)[int(values["axis"])]
        return (v.hanging + v.shifts) * along * values["scale"] * here
    c = np.array([values["a"], values["b"], values["c"]])
    outside = {
        "_oscillation": np.sin(2 * np.pi * t / values["period"] + values["phase"]) * c,
        "_clamping": np.stack([x[:, 1] * c[2] + x[:, 2] * c[1], x[:, 0] * c[2], x[:, 0] * c[1]], axis=1) * here,
        "_cubic": x**3 * c * here,
    }
    return outside[name]


def _places(rng: np.random.Generator, m: Measurement, name: str) -> dict[str, float]:
    """Return where an effect acts, drawn at random."""
    count = len(m.views.names)
    view = int(rng.integers(1 if name == "artefact-expansion" else 0, count))
    times = np.sort(m.t[m.views.view == view])
    return {
        "view": view,
        "axis": int(rng.integers(3)),
        "ball": int(rng.integers(len(m.views.balls))),
        "from_view": int(rng.integers(1, count - 1)),
        "at": float(rng.choice(times[len(times) // 5 : -len(times) // 5])) - 1e-3,
        "period": float(rng.uniform(600, 2500)),
        "phase": float(rng.uniform(0, 6)),
    }


def _where(m: Measurement, name: str, places: Values) -> dict[str, str]:
    if name == "moved-ball":
        return {"ball": " ".join(map(str, m.views.balls[int(places["ball"])].tolist()))}
    if name[0] == "_":
        return {}
    view = {"view": m.views.names[int(places["view"])]}
    return view | ({"axis": "xyz"[int(places["axis"])]} if name == "axis-expansion" else {})


@cache
def stated(names: str, half: int, name: str) -> float:
    """Return the size, in standard deviations, at which `diagnose` is to find an effect with 80 % power."""
    adjusted = measurement(np.random.default_rng(5), names, half).adjusted()
    field = measurement_of(adjusted)
    wanted = name if name in PARAMETERS else "drift-in-view"
    number = next(i for i, family in enumerate(field.families) if family.name == wanted)
    return float(np.sqrt(needed(field, number, len(PARAMETERS[wanted]))))


def _nearest(m: Measurement, name: str, places: Values, own: Array) -> float:
    """Return the largest cosine of what is visible of a change with another effect in the same view."""
    spans = []
    for other in NAMES:
        for axis in range(3) if other == "axis-expansion" else (places["axis"],):
            if (other == name and axis == places["axis"]) or other == "moved-ball" or name == "moved-ball":
                continue
            zero: dict[str, float] = {**places, "axis": axis} | dict.fromkeys(PARAMETERS[other], 0.0)
            units = [change(m, other, zero | {key: 1e-5}) for key in PARAMETERS[other]]
            spans.append(np.stack(units, axis=-1))
    most = 0.0
    for span in spans:
        seen = visible(m.views, span)
        size = np.linalg.norm(seen, axis=0)
        u, s, _ = np.linalg.svd(seen[:, size > 0] / size[size > 0], full_matrices=False)
        most = max(most, float(np.linalg.norm(u[:, s > 1e-4].T @ own)))
    return most


def planted(m: Measurement, rng: np.random.Generator, name: str, times: float) -> tuple[Measurement, Hidden]:
    """Return the measurement with an effect of so many times its least detectable size in a random direction."""
    keys = PARAMETERS.get(name, ("a", "b", "c"))
    while True:
        places = _places(rng, m, name)
        direction = rng.normal(size=len(keys))
        values = places | dict(zip(keys, (direction / np.linalg.norm(direction) * 1e-5).tolist(), strict=True))
        seen = visible(m.views, change(m, name, values)[:, :, None])[:, 0]
        whole = float(np.linalg.norm(change(m, name, values))) / NOISE
        # where the unknowns take nearly all of it, its size would be one that nobody has; one sighting is an outlier
        if np.linalg.norm(seen) > 0.02 * whole and not (name == "moved-ball" and _sightings(m, places) < 2):
            break
    factor = times * stated(m.views.names, m.views.half, name) / float(np.linalg.norm(seen))
    values = values | {key: values[key] * factor for key in keys}
    near = _nearest(m, name, places, seen / np.linalg.norm(seen))
    hidden = Hidden(name, _where(m, name, places), values, near)
    return replace(m, readings=m.readings + change(m, name, values)), hidden


def _sightings(m: Measurement, places: Values) -> int:
    """Return how often a ball is seen from the view on from which it is displaced."""
    return int(((m.views.ball == places["ball"]) & (m.views.view >= places["from_view"])).sum())


def spoilt(m: Measurement, rng: np.random.Generator, share: float) -> tuple[Measurement, frozenset[tuple[str, ...]]]:
    """Return the measurement with a share of its readings wrong in one coordinate by 10 to 25 standard deviations."""
    wrong = np.flatnonzero(rng.random(len(m.t)) < share)
    size = rng.uniform(10, 25, len(wrong)) * rng.choice([-1, 1], len(wrong)) * NOISE
    component = rng.integers(3, size=len(wrong))
    off, v = np.zeros(m.readings.shape), m.views
    off[wrong, component] = size
    keys = frozenset(
        (v.names[v.view[i]], *map(str, v.balls[v.ball[i]].tolist()), "xyz"[a])
        for i, a in zip(wrong, component, strict=True)
    )
    return replace(m, readings=m.readings + off), keys


def noisier(m: Measurement, rng: np.random.Generator) -> Measurement:
    """Return the measurement with one view three times as noisy as the others."""
    here = (m.views.view == rng.integers(len(m.views.names)))[:, None]
    return replace(m, readings=m.readings + rng.normal(size=m.readings.shape) * NOISE * np.sqrt(8.0) * here)


def case(number: int, small: bool = False) -> Case:
    """Return one seeded case, or one of a smaller grid."""
    rng = np.random.default_rng([34, number])
    scenario = SCENARIOS[number % len(SCENARIOS)]
    turn = number // len(SCENARIOS) + number
    m = measurement(rng, "1234" if turn % 2 else "123456", SMALL if small else HALF)
    hidden: list[Hidden] = []
    wrong: frozenset[tuple[str, ...]] = frozenset()
    if scenario.endswith("x"):
        m, one = planted(m, rng, NAMES[turn % len(NAMES)], float(scenario.split()[-1][:-1]))
        hidden.append(one)
    if "two effects" in scenario:
        for name in rng.choice(NAMES, 2, replace=False):
            m, one = planted(m, rng, str(name), float(rng.uniform(2, 4)))
            hidden.append(one)
    if "outside" in scenario:
        m, one = planted(m, rng, OUTSIDE[turn % len(OUTSIDE)], float(rng.uniform(2, 3.5)))
        hidden.append(one)
    if "outliers" in scenario:
        m, wrong = spoilt(m, rng, 0.02)
    if "noisier" in scenario:
        m = noisier(m, rng)
    if "half" in scenario or "double" in scenario:
        m = replace(m, noise=2.0 if "half" in scenario else 0.5)
    return Case(scenario, m.adjusted, tuple(hidden), wrong, m.noise)


SCENARIOS = (
    "nothing",
    "an effect of 1x",
    "nothing, 2 % outliers",
    "an effect of 2x",
    "nothing, noise declared half",
    "an effect of 1.5x",
    "outside the table",
    "an effect of 3x",
    "nothing, noise declared double",
    "2 % outliers and an effect of 2x",
    "two effects",
    "nothing, one view noisier",
    "noise declared half and an effect of 2x",
    "an effect of 1.5x",
    "nothing",
    "one view noisier and an effect of 3x",
    "an effect of 1x",
    "two effects",
    "outside the table",
    "nothing",
)
