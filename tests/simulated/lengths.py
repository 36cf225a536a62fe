"""Networks of lengths for the tests, written without the engine: plain formulas, own random draws."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from metrocli.table import Table
from metrocli.tasks.multilaterate.settings import Inputs, Settings
from metrocli.tasks.shared.lengths import LengthNoise, Scale

Array = npt.NDArray[np.float64]
NOWHERE = Path("-")
RNG = np.random.default_rng(3)
NOISE = LengthNoise(1e-4, 1e-7)
"""0.1 um and 0.1 um/m"""
VOLUME = np.array([1000.0, 600.0, 500.0])
CORNERS = np.array(
    [
        [-0.4, -0.5, 0.1], [1.4, -0.4, -0.2], [0.5, 1.7, 0.0], [0.6, 0.4, 2.2],
        [1.5, 1.5, 1.2], [-0.5, 1.3, 1.4], [-0.3, -0.6, 1.8], [1.7, 0.6, 0.5],
    ]
)  # fmt: skip
"""Places of tracers around the volume, as shares of it; any four of them span space"""


@dataclass(frozen=True)
class Network:
    """A network of lengths with its truth."""

    points: Array
    nominal: Array
    tracers: Array
    dead: Array
    scale: Array
    readings: Array
    """(points, tracers); nan where a tracer does not see a point"""

    @property
    def names(self) -> list[str]:
        return [f"P{i}" for i in range(len(self.points))]

    @property
    def stations(self) -> list[str]:
        return [f"T{j}" for j in range(len(self.tracers))]

    def lengths(self) -> Table:
        """What the tracers read, as a file would have it."""
        i, j = np.nonzero(np.isfinite(self.readings))
        columns = {
            "point": np.array(self.names)[i],
            "tracer": np.array(self.stations)[j],
            "length": self.readings[i, j],
        }
        return Table(columns, {"length": "mm"}, "lengths.csv", tuple(range(2, len(i) + 2)))

    def point_table(self, **more: Array) -> Table:
        """The mover's readings."""
        columns = {"point": np.array(self.names), **dict(zip("xyz", self.nominal.T, strict=True)), **more}
        return Table(columns, dict.fromkeys("xyz", "mm"), "points.csv", tuple(range(2, len(self.points) + 2)))

    def tracer_table(self, off: float = 5.0, **more: Array) -> Table:
        """Where the tracers are said to be."""
        at = self.tracers + np.random.default_rng(9).normal(0, off, self.tracers.shape)
        columns = {"tracer": np.array(self.stations), **dict(zip("xyz", at.T, strict=True)), **more}
        return Table(columns, dict.fromkeys("xyz", "mm"), "tracers.csv", tuple(range(2, len(at) + 2)))

    def read(self, rng: np.random.Generator, factor: float = 1.0) -> Network:
        """The same network read anew."""
        return replace(self, readings=readings(self, rng, factor))

    def at(self, points: Array, tracers: Array) -> Network:
        """The network with other places, read without noise."""
        moved = replace(self, points=points, tracers=tracers)
        return replace(moved, readings=readings(moved, np.random.default_rng(0), 0.0))


def readings(network: Network, rng: np.random.Generator, factor: float = 1.0) -> Array:
    """`s |x - x0| - l0` with noise `factor` times sqrt(a^2 + b^2 d^2)."""
    distance = np.linalg.norm(network.points[:, None] - network.tracers, axis=2)
    sigma = factor * np.sqrt(NOISE.constant**2 + (NOISE.proportional * distance) ** 2)
    return network.scale * distance - network.dead + rng.normal(size=distance.shape) * sigma


def network(n: int, m: int, seed: int = 0, scale: float = 0.0, noise: float = 1.0) -> Network:
    """Return points at random in a volume, read by tracers around it; the mover is off by 20 um, scales by `scale`."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 1, (n, 3)) * VOLUME
    tracers = (CORNERS[:m] + rng.normal(0, 0.05, (m, 3))) * VOLUME
    # the interferometer was set to zero somewhere
    dead = rng.uniform(200, 900, m)
    empty = Network(
        points, points + rng.normal(0, 0.02, (n, 3)), tracers, dead, 1 + rng.normal(0, 1, m) * scale, np.zeros((n, m))
    )
    return empty.read(rng, noise)


def on_plane(m: int) -> Network:
    """Tracers in one plane."""
    net = network(30, m, seed=m)
    tracers = net.tracers.copy()
    tracers[:, 2] = 100 + 0.2 * tracers[:, 0] - 0.1 * tracers[:, 1]
    return replace(net, tracers=tracers).read(RNG)


def on_line(m: int) -> Network:
    """Points on one line."""
    net = network(30, m, seed=m)
    points = np.linspace(0, 1, 30)[:, None] * VOLUME
    return replace(net, points=points, nominal=points + RNG.normal(0, 0.02, points.shape)).read(RNG)


def all_in_one_plane() -> Network:
    """Points and tracers in one plane."""
    net = network(30, 5, seed=5)
    points, tracers = net.points * [1, 1, 0], net.tracers * [1, 1, 0]
    return replace(net, points=points, nominal=points + RNG.normal(0, 0.02, points.shape), tracers=tracers).read(RNG)


def close_together() -> Network:
    """Two of four tracers at one place."""
    net = network(30, 4, seed=4)
    tracers = net.tracers.copy()
    tracers[1] = tracers[0] + [1.0, 0.5, 0.0]
    return replace(net, tracers=tracers).read(RNG)


def settings(
    scale: float | None = None, measures: str = "changes", datum: str | None = None, outliers: str = "report"
) -> Settings:
    """The settings of a job on such a network."""
    inputs = Inputs(lengths=NOWHERE, points=NOWHERE)
    uncertainty = None if scale is None else Scale(scale)
    return Settings(inputs, NOISE, measures=measures, scale=uncertainty, datum=datum, outliers=outliers)


def without_motion(points: Array, reference: Array) -> Array:
    """Points after the best shift and turn onto the reference (Kabsch)."""
    centre, target = points.mean(axis=0), reference.mean(axis=0)
    u, _, vt = np.linalg.svd((points - centre).T @ (reference - target))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return (points - centre) @ turn + target


def places(result_table: Table) -> Array:
    """Points of a result, (n, 3)."""
    return result_table.stacked("xyz")
