"""Networks of trackers, total stations and interferometers for the tests: plain formulas, own random draws, CSV files."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
ANGLE, LATERAL, CONSTANT, PROPORTIONAL = 2e-6, 0.004, 0.002, 3e-7
"""Noise of the trackers: rad, mm, mm, 1"""
NOISE = "{azimuth: 2 urad, elevation: 2 urad, lateral: 4 um, distance: {constant: 2 um, proportional: 0.3 um/m}}"
INTERFEROMETER, BAR, HEIGHT, GIVEN = 3e-4, 0.005, 0.02, 0.01
SIZE = np.array([8000.0, 5000.0, 2600.0])


def turned(alpha: float, beta: float, gamma: float) -> Array:
    """Rz(gamma) Ry(beta) Rx(alpha)."""
    ca, sa, cb, sb, cg, sg = (f(a) for a in (alpha, beta, gamma) for f in (np.cos, np.sin))
    x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    z = np.array([[cg, -sg, 0], [sg, cg, 0], [0, 0, 1]])
    return np.asarray(z @ y @ x)


def polar(points: Array) -> Array:
    """Azimuth, elevation and distance of points (n, 3) in the frame of an instrument, (n, 3)."""
    x, y, z = points.T
    return np.stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y)), np.linalg.norm(points, axis=1)], axis=1)


def sigmas(seen: Array) -> Array:
    """Standard deviations of azimuth, elevation and distance (n, 3)."""
    e, d = seen[:, 1], seen[:, 2]
    return np.stack(
        [
            np.hypot(ANGLE, LATERAL / (d * np.cos(e))),
            np.hypot(ANGLE, LATERAL / d),
            np.hypot(CONSTANT, PROPORTIONAL * d),
        ],
        axis=1,
    )


@dataclass(frozen=True)
class Network:
    """A network with its truth and its readings."""

    points: Array
    near: Array
    """What the list of points says"""
    places: Array
    """Of the stations of trackers or total stations, (m, 3)"""
    rotations: Array
    levelled: bool
    listed: bool
    station: Array
    point: Array
    face: Array
    seen: Array
    """Azimuth, elevation and distance read, as in face 1, (n, 3)"""
    tracers: Array = field(default_factory=lambda: np.zeros((0, 4)))
    """Place and dead path of interferometers"""
    lengths: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """(tracers, points)"""
    bars: tuple[tuple[int, int, float], ...] = ()
    heights: tuple[tuple[int, int, float], ...] = ()
    given: tuple[int, ...] = ()
    times: bool = False

    @property
    def names(self) -> list[str]:
        return [f"P{i + 1:03d}" for i in range(len(self.points))]

    def with_effect(self, change: Array) -> Network:
        """The network whose readings (n, 3) are off."""
        return replace(self, seen=self.seen + change)

    def write(self, folder: Path, more: str = "", header: str = "az_rad,el_rad,d_mm") -> Path:
        """Write job and inputs; return the job."""
        p = self.names
        read = ["station,point,face," + header + (",t_s" if self.times else "")]
        for i, (s, k, f) in enumerate(zip(self.station, self.point, self.face, strict=True)):
            values = ",".join("" if np.isnan(v) else f"{v:.13g}" for v in self.seen[i])
            read.append(f"S{s + 1},{p[k]},{f},{values}" + (f",{7 * i}" if self.times else ""))
        kind = "total-station" if self.levelled else "tracker"
        instruments = {"A": f"{{type: {kind}, noise: {NOISE}}}"}
        stations = ["station,instrument", *(f"S{i + 1},A" for i in range(len(self.places)))]
        inputs = {"readings": read, "stations": stations}
        if len(self.tracers):
            instruments["I"] = f"{{type: interferometer, noise: {{distance: {{constant: {INTERFEROMETER} mm}}}}}}"
            stations += [f"I{i + 1},I" for i in range(len(self.tracers))]
            rows = [f"I{i + 1},{p[k]},{v:.13g}" for (i, k), v in np.ndenumerate(self.lengths)]
            inputs["lengths"] = ["station,point,length_mm", *rows]
        if self.listed:
            sigma = [str(GIVEN) if i in self.given else "" for i in range(len(p))]
            rows = [f"{p[i]},{x:.13g},{y:.13g},{z:.13g},{sigma[i]}" for i, (x, y, z) in enumerate(self.near)]
            inputs["points"] = ["point,x_mm,y_mm,z_mm,sigma_mm", *rows]
        if self.bars:
            rows = [f"B{n + 1},{p[a]},{p[b]},{v:.13g},{BAR}" for n, (a, b, v) in enumerate(self.bars)]
            inputs["bars"] = ["bar,from,to,length_mm,sigma_mm", *rows]
        if self.heights:
            inputs["heights"] = [
                "from,to,dh_mm,sigma_mm",
                *(f"{p[a]},{p[b]},{v:.13g},{HEIGHT}" for a, b, v in self.heights),
            ]
        for name, lines in inputs.items():
            (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")
        listed = ", ".join(f"{name}: {name}.csv" for name in inputs)
        job = folder / "job.yaml"
        devices = "\n".join(f"  {name}: {one}" for name, one in instruments.items())
        job.write_text(
            f"metrocli: 1\njob: adjust-network\ninputs: {{{listed}}}\ninstruments:\n{devices}\n{more}output: result.h5\n"
        )
        return job


def network(
    rng: np.random.Generator,
    stations: int = 3,
    points: int = 12,
    faces: int = 1,
    noise: float = 1.0,
    levelled: bool = False,
    rolled: bool = False,
    listed: bool = True,
    mixed: bool = False,
) -> Network:
    """A network in a hall; `mixed` with two interferometers, two bars, three height differences and four given points."""
    x = rng.uniform(0, 1, (points, 3)) * SIZE
    places = (0.15 + 0.7 * rng.uniform(0, 1, (stations, 3))) * SIZE
    tilt = 0.0 if levelled else 0.05
    rotations = np.array([turned(*rng.normal(0, tilt, 2), rng.uniform(-3, 3)) for _ in range(stations)])
    if rolled:
        rotations[-1] = turned(1.5, 0.02, 0.4)
    station, point, face = (
        one.ravel() for one in np.meshgrid(range(stations), range(points), range(1, faces + 1), indexing="ij")
    )
    local = np.einsum("nab,na->nb", rotations[station], x[point] - places[station])
    seen = polar(local)
    seen = seen + noise * rng.normal(size=seen.shape) * sigmas(seen)
    near = x + rng.normal(0, 0.5, x.shape)
    found = Network(x, near, places, rotations, levelled, listed, station, point, face, seen)
    if not mixed:
        return found
    tracers = np.column_stack([rng.uniform(0, 1, (2, 3)) * SIZE, rng.uniform(300, 900, 2)])
    away = np.linalg.norm(x - tracers[:, None, :3], axis=2) - tracers[:, 3:]
    bars = [(a, b, float(np.linalg.norm(x[a] - x[b]) + noise * rng.normal() * BAR)) for a, b in ((0, 1), (2, 3))]
    heights = [(a, b, float(x[b, 2] - x[a, 2] + noise * rng.normal() * HEIGHT)) for a, b in ((0, 4), (4, 5), (5, 6))]
    near[:4] = x[:4] + noise * rng.normal(0, GIVEN, (4, 3))
    lengths = away + noise * rng.normal(0, INTERFEROMETER, away.shape)
    return replace(
        found, near=near, tracers=tracers, lengths=lengths, bars=tuple(bars), heights=tuple(heights), given=(0, 1, 2, 3)
    )


def marks(rng: np.random.Generator, count: int = 14) -> tuple[Array, Array, Array, Array]:
    """Points, heights of instruments and targets over them, and what four levelled stations over marks read.

    Returns points (n, 3), heights of the stations (4,), heights of the targets (n,), and azimuth, elevation and distance
    (4, n, 3); station i stands over point 4 + i, and does not see it.
    """
    x = rng.uniform(0, 1, (count, 3)) * SIZE * 5
    height, target = rng.uniform(1500, 1700, 4), rng.uniform(50, 150, count)
    seen = np.full((4, count, 3), np.nan)
    for i in range(4):
        away = x + np.array([0.0, 0.0, 1.0]) * target[:, None] - x[4 + i] - [0.0, 0.0, height[i]]
        others = np.arange(count) != 4 + i
        seen[i, others] = polar(away[others] @ turned(0.0, 0.0, 0.3 * i))
    return x, height, target, seen
