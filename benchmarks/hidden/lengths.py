"""Lengths of tracking interferometers with something hidden in them: plain formulas, random draws and projection."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.hidden.case import Case, Hidden
from benchmarks.hidden.stated import stated
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.effects.requested import RequestedEffect
from metrocli.table import Table
from metrocli.tasks.multilaterate import task as multilaterate
from metrocli.tasks.multilaterate.settings import Inputs, Settings
from metrocli.tasks.shared.lengths import LengthNoise

Array = npt.NDArray[np.float64]
NOISE = (1e-4, 1e-7)
"""0.1 um and 0.1 um/m, in mm"""
VOLUME = np.array([2000.0, 1000.0, 1000.0])
PLACES = np.array(
    [[-0.3, -0.5, -0.2], [1.4, -0.8, 0.25], [1.3, 1.6, -0.1], [-0.4, 1.5, 0.95], [0.5, -1.0, 1.5], [0.4, 1.9, 1.2]]
)
"""Tracers around the volume, as shares of it"""
EVERYWHERE = ("refraction-drift",)
AT_ONE = ("tracer-scale", "dead-path-drift", "dead-path-jump", "tracer-drift", "sphere-form")
OUTSIDE = ("_three-lobe", "_time-sine", "_common-sine", "_length-square", "_elevation-cube", "_warm-up")


@dataclass(frozen=True)
class Measurement:
    """What was read, when, and in which air; a row for each reading."""

    points: Array
    tracers: Array
    nominal: Array
    said: Array
    point: npt.NDArray[np.intp]
    tracer: npt.NDArray[np.intp]
    t: Array
    temp: Array
    length: Array
    noise: float = 1.0
    """By which the true noise is divided in the job's declaration"""

    @property
    def beam(self) -> Array:
        """Vectors from tracers to points, (n, 3)."""
        return self.points[self.point] - self.tracers[self.tracer]

    @property
    def distance(self) -> Array:
        """(n,)"""
        return np.asarray(np.linalg.norm(self.beam, axis=1))

    @property
    def sigma(self) -> Array:
        """True standard deviation of readings, (n,)."""
        return np.sqrt(NOISE[0] ** 2 + (NOISE[1] * self.distance) ** 2)

    def adjusted(self, effects: Sequence[RequestedEffect] = ()) -> AdjustedJob:
        """Return it as the job that a user would give, with the effects that the job has in its model."""
        names, stations = _names("P", len(self.points)), _names("T", len(self.tracers))
        lengths = {"point": names[self.point], "tracer": stations[self.tracer], "length": self.length}
        table = Table({**lengths, "t": self.t, "temp": self.temp}, {"length": "mm", "t": "s", "temp": "degC"})
        points = Table({"point": names, **dict(zip("xyz", self.nominal.T, strict=True))}, dict.fromkeys("xyz", "mm"))
        tracers = Table({"tracer": stations, **dict(zip("xyz", self.said.T, strict=True))}, dict.fromkeys("xyz", "mm"))
        declared = LengthNoise(NOISE[0] / self.noise, NOISE[1] / self.noise)
        return multilaterate.diagnosed(
            multilaterate.TASK.job(
                Settings(Inputs(Path("-"), Path("-")), declared), table, points, tracers, effects=effects
            )
        )


def _names(letter: str, count: int) -> npt.NDArray[np.str_]:
    return np.char.add(letter, np.arange(count).astype(str))


def measurement(rng: np.random.Generator, n: int) -> Measurement:
    """Return a network at random with its noise: n points in a random order, six tracers that read at once."""
    points = rng.uniform(0, 1, (n, 3)) * VOLUME
    tracers = (PLACES + rng.normal(0, 0.05, PLACES.shape)) * VOLUME
    m = len(tracers)
    point, tracer = np.divmod(np.arange(n * m), m)
    t = np.sort(rng.uniform(0, 1600, n))[rng.permutation(n)]
    swing = rng.uniform(0.3, 0.8) * np.sin(2 * np.pi * t / rng.uniform(1500, 4000) + rng.uniform(0, 6))
    temp = 20 + swing + rng.uniform(-0.5, 0.5) * t / 1600
    blank = Measurement(
        points,
        tracers,
        points + rng.normal(0, 0.01, points.shape),
        tracers + rng.normal(0, 15.0, tracers.shape),
        point,
        tracer,
        t[point],
        temp[point],
        np.zeros(n * m),
    )
    dead = rng.uniform(200, 900, m)
    read = blank.distance - dead[tracer] + rng.normal(size=n * m) * blank.sigma
    return replace(blank, length=read)


Signature = Callable[[Measurement], Array]


def signature(name: str, at: int, values: Mapping[str, float]) -> Signature:
    """Return by how much an effect of these values changes each reading, (n,), from the formulas of the contract."""

    def change(m: Measurement) -> Array:
        here = (m.tracer == at).astype(float)
        t, warm = m.t - m.t.min(), m.temp - m.temp[np.argmin(m.t)]
        b, d = m.beam, m.distance
        if name == "tracer-scale":
            return values["scale"] * d * here
        if name == "refraction-drift":
            return np.asarray(values["rate"] * (warm if values["by"] else t) * d)
        if name == "dead-path-drift":
            return values["rate"] * t * here
        if name == "dead-path-jump":
            return values["step"] * (m.t >= values["at"]) * here
        if name == "tracer-drift":
            moved = b - t[:, None] * np.array([values["vx"], values["vy"], values["vz"]])
            return (np.linalg.norm(moved, axis=1) - d) * here
        azimuth = np.arctan2(b[:, 1], b[:, 0])
        if name == "sphere-form":
            return (values["c2"] * np.cos(2 * azimuth) + values["s2"] * np.sin(2 * azimuth)) * here
        c = values["c"]
        own = here
        unknown = {
            "_three-lobe": c * np.cos(3 * azimuth + values["phase"]) * own,
            "_time-sine": c * np.sin(2 * np.pi * t / values["period"] + values["phase"]) * own,
            "_common-sine": c * np.sin(2 * np.pi * t / values["period"] + values["phase"]) * d / d.mean(),
            "_length-square": c * (d / d.mean()) ** 2 * own,
            "_elevation-cube": c * (b[:, 2] / d) ** 3 * own,
            "_warm-up": c * np.exp(-t / (values["period"] / 4)) * own,
        }
        return np.asarray(unknown[name])

    return change


_PARAMETERS = {
    "tracer-scale": ("scale",),
    "refraction-drift": ("rate",),
    "dead-path-drift": ("rate",),
    "dead-path-jump": ("step",),
    "tracer-drift": ("vx", "vy", "vz"),
    "sphere-form": ("c2", "s2"),
}


def absorbed_by(m: Measurement) -> Array:
    """Return an orthonormal basis of what points, tracers and dead paths take up, in standard deviations (n, k)."""
    u = m.beam / m.distance[:, None]
    n, k = len(m.points), len(m.tracers)
    rows = np.arange(len(m.t))
    jacobian = np.zeros((len(m.t), 3 * n + 4 * k))
    for a in range(3):
        jacobian[rows, 3 * m.point + a] = u[:, a]
        jacobian[rows, 3 * n + 4 * m.tracer + a] = -u[:, a]
    jacobian[rows, 3 * n + 4 * m.tracer + 3] = -1.0
    left, values, _ = np.linalg.svd(jacobian / m.sigma[:, None], full_matrices=False)
    return np.asarray(left[:, values > 1e-11 * values[0]])


def visible(m: Measurement, taken: Array, changes: Array) -> Array:
    """Return what the unknowns leave of changes (n, k), in standard deviations."""
    whitened = changes / m.sigma[:, None]
    return np.asarray(whitened - taken @ (taken.T @ whitened))


def size_beside(m: Measurement, change: Array, covariance: Array) -> float:
    """Return `sqrt(d'S^-1 d - d'S^-1 J (J'S^-1 J)^- J'S^-1 d)` of a change d (n,), S = I + covariance."""
    lower = np.linalg.cholesky(np.eye(len(m.t)) + covariance)
    taken, _ = np.linalg.qr(np.linalg.solve(lower, absorbed_by(m)))
    whitened = np.linalg.solve(lower, change / m.sigma)
    return float(np.linalg.norm(whitened - taken @ (taken.T @ whitened)))


def nearest(m: Measurement, taken: Array, hidden: tuple[str, int], change: Array) -> float:
    """Return the largest cosine of what is visible of a change with another known effect on the same tracer."""
    name, at = hidden
    spans = {other: _span(m, other, at) for other in _PARAMETERS if other != name}
    alone = _span(m, "refraction-drift", at)
    spans |= {f"refraction by {i}": alone[:, [i]] for i in range(2) if name != "refraction-drift"}
    spans.pop("refraction-drift", None)
    jumps = spans.pop("dead-path-jump", np.zeros((len(m.t), 0)))
    spans |= {f"jump {i}": jumps[:, [i]] for i in range(jumps.shape[1])}
    seen = visible(m, taken, np.column_stack([change, *spans.values()]))
    mine, place, most = seen[:, 0] / np.linalg.norm(seen[:, 0]), 1, 0.0
    for span in spans.values():
        basis, _ = np.linalg.qr(seen[:, place : place + span.shape[1]])
        most, place = max(most, float(np.linalg.norm(basis.T @ mine))), place + span.shape[1]
    return most


def _span(m: Measurement, name: str, at: int) -> Array:
    """Return the changes by each parameter of an effect at some size, (n, k); jumps at 20 times."""
    if name == "dead-path-jump":
        times = np.quantile(m.t, np.linspace(0.05, 0.95, 20))
        return np.stack([signature(name, at, {"step": 1e-3, "at": float(t)})(m) for t in times], axis=1)
    if name == "refraction-drift":
        return np.stack([signature(name, at, {"rate": 1e-8, "by": by})(m) for by in (1.0, 0.0)], axis=1)
    keys = _PARAMETERS[name]
    size = {"tracer-scale": 1e-6, "sphere-form": 1e-3}.get(name, 1e-7)
    units = [{key: size * (key == one) for key in keys} for one in keys]
    return np.stack([signature(name, at, one)(m) for one in units], axis=1)


def planted(
    m: Measurement, rng: np.random.Generator, name: str, times: float, beside: Array | None = None
) -> tuple[Measurement, Hidden]:
    """Return the measurement with an effect of so many times its least detectable size in a random direction.

    The size is that beside white noise; with a covariance of a further error (n, n), in squared standard deviations of
    the noise, it is that beside both.
    """
    at = int(rng.integers(len(m.tracers)))
    values = {
        "at": float(rng.choice(np.sort(m.t)[len(m.t) // 8 : -len(m.t) // 8])) + 1e-3,
        "by": float(rng.integers(2)),
    }
    values |= {"phase": float(rng.uniform(0, 6)), "period": float(rng.uniform(500, 1200)), "c": 1e-3}
    names = _PARAMETERS.get(name, ("c",))
    direction = rng.normal(size=len(names))
    values |= dict(zip(names, (direction / np.linalg.norm(direction) * 1e-6).tolist(), strict=True))
    wanted = times * np.sqrt(stated(m.adjusted(), name, len(names)))
    taken, unit = absorbed_by(m), signature(name, at, values)(m)
    size = float(np.linalg.norm(visible(m, taken, unit[:, None]))) if beside is None else size_beside(m, unit, beside)
    factor = wanted / size
    values |= {key: values[key] * factor for key in names}
    change = signature(name, at, values)(m)
    where = {"tracer": f"T{at}"} if name not in EVERYWHERE else {}
    form = "" if name != "refraction-drift" else "T" if values["by"] else "t"
    hidden = Hidden(name, where, values, nearest(m, taken, (name, at), change), form)
    return replace(m, length=m.length + change), hidden


def spoilt(m: Measurement, rng: np.random.Generator, share: float) -> tuple[Measurement, frozenset[tuple[str, ...]]]:
    """Return the measurement with a share of its readings wrong by 6 to 25 standard deviations."""
    wrong = rng.random(len(m.t)) < share
    off = rng.uniform(6, 25, len(m.t)) * rng.choice([-1, 1], len(m.t)) * m.sigma * wrong
    keys = frozenset((f"P{m.point[i]}", f"T{m.tracer[i]}") for i in np.flatnonzero(wrong))
    return replace(m, length=m.length + off), keys


def noisier(m: Measurement, rng: np.random.Generator) -> Measurement:
    """Return the measurement with one tracer three times as noisy as the others."""
    here = m.tracer == rng.integers(len(m.tracers))
    return replace(m, length=m.length + rng.normal(size=len(m.t)) * m.sigma * np.sqrt(8.0) * here)


def case(number: int, small: bool = False) -> Case:
    """Return one seeded case, or one of 25 points."""
    rng = np.random.default_rng([33, number])
    scenario = SCENARIOS[number % len(SCENARIOS)]
    turn = number // len(SCENARIOS)
    m = measurement(rng, 20 if "20 points" in scenario else 25 if small else int(rng.integers(60, 101)))
    hidden: tuple[Hidden, ...] = ()
    wrong: frozenset[tuple[str, ...]] = frozenset()
    known = (*EVERYWHERE, *AT_ONE)
    if scenario.endswith("x"):
        times = float(scenario.split()[-1][:-1])
        m, one = planted(m, rng, known[turn % len(known)], times)
        hidden = (one,)
    if "two effects" in scenario:
        first, second = rng.choice(len(known), 2, replace=False)
        m, one = planted(m, rng, known[first], rng.uniform(2, 4))
        m, two = planted(m, rng, known[second], rng.uniform(2, 4))
        hidden = (one, two)
    if "outside" in scenario:
        m, one = planted(m, rng, OUTSIDE[turn % len(OUTSIDE)], rng.uniform(2, 3.5))
        hidden = (one,)
    if "outliers" in scenario:
        m, wrong = spoilt(m, rng, 0.02)
    if "noisier" in scenario:
        m = noisier(m, rng)
    if "half" in scenario or "double" in scenario:
        m = replace(m, noise=2.0 if "half" in scenario else 0.5)
    return Case(scenario, m.adjusted, hidden, wrong, m.noise)


SCENARIOS = (
    "nothing",
    "nothing, 20 points",
    "nothing, 2 % outliers",
    "nothing, noise declared half",
    "nothing, noise declared double",
    "nothing, one tracer noisier",
    "nothing",
    "an effect of 1x",
    "an effect of 1.5x",
    "an effect of 2x",
    "an effect of 3x",
    "2 % outliers and an effect of 2x",
    "noise declared half and an effect of 2x",
    "one tracer noisier and an effect of 3x",
    "20 points and an effect of 2x",
    "two effects",
    "two effects",
    "outside the table",
    "outside the table",
    "outside the table",
)
