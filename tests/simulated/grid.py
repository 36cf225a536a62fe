"""Views of a ball grid, simulated with the model written out again, for the tests of selfcal-grid."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from metrocli.table import Table
from metrocli.tasks.selfcal_grid.settings import GridSettings, Inputs, Rotate, Settings, ViewSettings

Array = npt.NDArray[np.float64]
NOWHERE = Path("-")
QUARTER = np.pi / 2
PITCH = 65.0
NOISE = 5e-4
DECLARED = {
    "1": ViewSettings("1"),
    "2": ViewSettings("2", Rotate("z", QUARTER)),
    "3": ViewSettings("3", Rotate("x", QUARTER)),
    "4": ViewSettings("4", shift=(1, 0, 0)),
    "5": ViewSettings("5", shift=(0, 1, 0)),
    "6": ViewSettings("6", shift=(0, 0, 1)),
    "7": ViewSettings("7", shift=(2, 0, 0)),
}
TURNS = {
    "2": np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "3": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
}
SHIFTS = {"4": (1, 0, 0), "5": (0, 1, 0), "6": (0, 0, 1), "7": (2, 0, 0)}


def euler(angles: Array) -> Array:
    """Rz Ry Rx."""
    (a, b, c) = angles
    x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return np.asarray(z @ y @ x)


def in_gauge(places: Array, machine: Array, artefact: Array, scale: bool = True) -> tuple[Array, Array]:
    """Fields without rigid motion, and without a difference of their scales where `scale`."""
    x, y, z = places.T
    o, one = np.zeros_like(x), np.ones_like(x)
    motions = [(one, o, o), (o, one, o), (o, o, one), (o, -z, y), (z, o, -x), (-y, x, o)]
    basis = np.linalg.qr(np.stack([np.stack(motion, axis=1).ravel() for motion in motions], axis=1))[0]
    g, a = (fields.ravel() - basis @ (basis.T @ fields.ravel()) for fields in (machine, artefact))
    r = places.ravel()
    share = (g - a) @ r / (2 * r @ r) if scale else 0.0
    return (g - share * r).reshape(-1, 3), (a + share * r).reshape(-1, 3)


@dataclass(frozen=True)
class Grid:
    """A machine, an artefact and its mountings."""

    n: int
    views: str
    balls: npt.NDArray[np.int64]
    machine: Array
    artefact: Array
    mountings: dict[str, tuple[Array, Array]]
    extra: dict[str, Array] = field(default_factory=dict)

    def settings(self, noise: float = NOISE, **more: object) -> Settings:
        """The job."""
        views = tuple(DECLARED[name] for name in self.views)
        return Settings(Inputs(NOWHERE), GridSettings((self.n,) * 3, PITCH), views, noise, **more)

    def read(self, rng: np.random.Generator, noise: float = NOISE, views: str = "") -> Table:
        """The readings of the views, sites within the grid only."""
        half = self.n // 2
        at = {tuple(ball): k for k, ball in enumerate(self.balls.tolist())}
        names, balls, readings = [], [], []
        for name in views or self.views:
            turn, shift = TURNS.get(name, np.eye(3, dtype=int)), np.array(SHIFTS.get(name, (0, 0, 0)))
            sites = self.balls @ turn.T + shift
            inside = np.flatnonzero((np.abs(sites) <= half).all(axis=1))
            d, angles = self.mountings[name]
            place = (PITCH * self.balls[inside] + self.artefact[inside]) @ turn.T + PITCH * shift
            site = [at[tuple(one)] for one in sites[inside].tolist()]
            readings.append(self.machine[site] + d + place @ euler(angles).T)
            names += [name] * len(inside)
            balls.append(self.balls[inside])
        values = np.concatenate(readings)
        values = values + rng.normal(0, 1, values.shape) * noise
        return table(names, np.concatenate(balls), values)


def table(names: list[str], balls: npt.NDArray[np.int64], values: Array) -> Table:
    """The table of `views.csv`."""
    columns = {
        "view": np.array(names),
        **dict(zip("ijk", balls.T, strict=True)),
        **dict(zip("xyz", values.T, strict=True)),
    }
    return Table(columns, dict.fromkeys("xyz", "mm"), "views.csv", tuple(range(2, len(names) + 2)))


def grid(n: int, views: str = "1234", seed: int = 0, scale: bool = True) -> Grid:
    """A rough machine error (a draw at each site), an artefact five times worse, mountings off by some mrad."""
    rng = np.random.default_rng(seed)
    half = n // 2
    r = np.arange(-half, half + 1)
    balls = np.stack(np.meshgrid(r, r, r, indexing="ij"), axis=-1).reshape(-1, 3)
    machine, artefact = in_gauge(
        balls * PITCH, rng.normal(0, 0.01, balls.shape), rng.normal(0, 0.05, balls.shape), scale
    )
    mountings = {name: (rng.normal(0, 0.2, 3), rng.normal(0, 3e-3, 3)) for name in views}
    return Grid(n, views, balls, machine, artefact, mountings)


def without(table: Table, drop: Array) -> Table:
    """The table without some rows."""
    keep = ~drop
    return replace(
        table,
        columns={name: values[keep] for name, values in table.columns.items()},
        lines=tuple(np.array(table.lines)[keep].tolist()),
    )


def repeated(table: Table) -> Table:
    """The table with each view measured forth and back."""
    views = np.array(table.texts("view"))
    rows = np.concatenate(
        [
            np.concatenate([np.flatnonzero(views == name), np.flatnonzero(views == name)[::-1]])
            for name in dict.fromkeys(views.tolist())
        ]
    )
    turn = np.concatenate([np.repeat(["1", "2"], (views == name).sum()) for name in dict.fromkeys(views.tolist())])
    columns = {name: values[rows] for name, values in table.columns.items()}
    return Table({**columns, "repeat": turn}, table.units, table.file, tuple(range(2, len(rows) + 2)))
