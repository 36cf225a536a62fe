"""Simulated views of a ball grid, on a machine with errors, of an artefact with larger ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.blocks import Array
from metrocli.adjust.observations import Index
from metrocli.geometry.rotations import rotation_from_euler
from metrocli.instruments.ball_grid import View, numbers_at, rigid
from metrocli.simulation import Simulation
from metrocli.table import Table
from metrocli.tasks.grid_settings import GridSimulation, Settings, views_of

if TYPE_CHECKING:
    from metrocli.table import Values

_SECONDS = 20.0
"""Between two balls"""


def balls_of(half: Index) -> Index:
    """Return all balls of a grid, (n, 3)."""
    axes = [np.arange(-n, n + 1) for n in half.tolist()]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def on_the_grid(view: View, balls: Index, half: Index) -> Index:
    """Return the balls whose sites lie on the grid in this view."""
    return balls[(np.abs(view.sites(balls)) <= half).all(axis=1)]


def simulated(settings: Settings, truth: GridSimulation, rng: np.random.Generator) -> Simulation:
    """Return the readings of each view with errors drawn for machine, artefact and mountings.

    The machine's error is smooth: positioning, straightness, angles and squareness with low polynomials. Errors are
    free of rigid motion and of common scale, as the result states them.
    """
    half, pitch = settings.grid.half, settings.grid.pitch
    balls = balls_of(half)
    places: Array = np.asarray(balls * pitch, dtype=float)
    artefact = rng.normal(0.0, 1.0, places.shape) * truth.artefact_error
    machine = smooth_error(places / (half.max() * pitch), rng)
    machine *= truth.machine_error / max(float(np.linalg.norm(machine, axis=1).max()), 1e-300)
    machine, artefact = in_gauge(places, machine, artefact)
    fields = (machine, artefact, balls, pitch)
    rows = [_view(view, on_the_grid(view, balls, half), fields, (truth, rng)) for view in views_of(settings)]
    count = [len(one[0]) for one in rows]
    readings = np.concatenate([one[1] for one in rows])
    readings = readings + rng.normal(0.0, 1.0, readings.shape) * settings.noise
    files = {"views.csv": _table(settings, count, np.concatenate([one[0] for one in rows]), (readings, truth.repeats))}
    files |= {"true_machine_error.csv": _errors(balls, machine), "true_artefact_error.csv": _errors(balls, artefact)}
    names = ("x", "y", "z", "alpha", "beta", "gamma")
    values = {
        f"{view.name}.{name}": float(value)
        for view, one in zip(settings.views, rows, strict=True)
        for name, value in zip(names, one[2], strict=True)
    }
    return Simulation(files, values)


def smooth_error(scaled: Array, rng: np.random.Generator) -> Array:
    """Return a smooth error field with second and third order terms of random size, (n, 3); scaled is -1 ... 1."""
    powers = [(p, q, r) for p in range(4) for q in range(4) for r in range(4) if 0 < p + q + r <= 3]
    terms = np.stack([scaled[:, 0] ** p * scaled[:, 1] ** q * scaled[:, 2] ** r for p, q, r in powers], axis=1)
    return np.asarray(terms @ rng.normal(0.0, 1.0, (len(powers), 3)))


def in_gauge(places: Array, machine: Array, artefact: Array) -> tuple[Array, Array]:
    """Return both fields free of rigid motion and with `sum G.r = sum A.r`."""
    motions = rigid(places).reshape(-1, 6)
    free = [_without(motions, field.ravel()).reshape(field.shape) for field in (machine, artefact)]
    scale = float((free[0] * places).sum() - (free[1] * places).sum()) / (2 * float((places**2).sum()))
    return free[0] - scale * places, free[1] + scale * places


def _without(motions: Array, field: Array) -> Array:
    return np.asarray(field - motions @ np.linalg.lstsq(motions, field, rcond=None)[0])


def _view(
    view: View, balls: Index, fields: tuple[Array, Array, Index, float],
    drawn: tuple[GridSimulation, np.random.Generator],
) -> tuple[Index, Array, Array]:  # fmt: skip
    """Return balls, readings without noise, and the mounting of one view; repeats one after the other."""
    machine, artefact, everywhere, pitch = fields
    truth, rng = drawn
    shift, angles = rng.normal(0.0, truth.shift, 3), rng.normal(0.0, truth.tilt, 3)
    rotation = rotation_from_euler(*angles)
    n, q = numbers_at(everywhere, balls), numbers_at(everywhere, view.sites(balls))
    mounted = (balls * pitch + artefact[n]) @ view.turn.T + view.shift * pitch
    readings = machine[q] + mounted @ rotation.T + shift
    return np.tile(balls, (truth.repeats, 1)), np.tile(readings, (truth.repeats, 1)), np.array([*shift, *angles])


def _table(settings: Settings, count: Sequence[int], balls: Index, read: tuple[Array, int]) -> Table:
    readings, repeats = read
    columns: dict[str, Values] = {"view": np.repeat(np.array([view.name for view in settings.views]), count)}
    columns |= {name: balls[:, n].astype(np.int64) for n, name in enumerate("ijk")}
    columns |= {name: readings[:, n] for n, name in enumerate("xyz")}
    if repeats > 1:
        each = [np.repeat(np.arange(1, repeats + 1), n // repeats) for n in count]
        columns["repeat"] = np.concatenate(each).astype(np.str_)
    columns["t"] = np.asarray(np.arange(len(balls)) * _SECONDS, dtype=float)
    return Table(columns, {"x": "mm", "y": "mm", "z": "mm", "t": "s"})


def _errors(indices: Index, values: Array) -> Table:
    columns: dict[str, Values] = {name: indices[:, n].astype(np.int64) for n, name in enumerate("ijk")}
    columns |= {f"e{name}": values[:, n] for n, name in enumerate("xyz")}
    return Table(columns, dict.fromkeys(("ex", "ey", "ez"), "mm"))
