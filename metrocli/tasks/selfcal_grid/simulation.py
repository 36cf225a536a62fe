"""Simulated views of a ball grid with errors, measured on a machine with errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.effects.estimates import true_values
from metrocli.effects.extension import extended
from metrocli.effects.requested import RequestedEffect
from metrocli.errors import Fault, InputError
from metrocli.geometry.poses import EULER, pose_from_euler
from metrocli.instruments.ball_grid import ARTEFACT, MACHINE, VIEW, View, numbers_at, rigid
from metrocli.simulation import Simulation
from metrocli.table import Table
from metrocli.tasks.selfcal_grid.problem import LENGTHS, build
from metrocli.tasks.selfcal_grid.readings import read
from metrocli.tasks.selfcal_grid.settings import GridSimulation, Settings, views_of

_FILE_UNITS = {"x": "mm", "y": "mm", "z": "mm", "t": "s", "temp": "degC"}


def balls_of(half: Index) -> Index:
    """Return all balls of a grid, (n, 3)."""
    axes = [np.arange(-n, n + 1) for n in half.tolist()]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def balls_on(view: View, half: Index) -> Index:
    """Return the balls whose sites lie on the grid in this view, (n, 3)."""
    balls = balls_of(half)
    return balls[(np.abs(view.sites(balls)) <= half).all(axis=1)]


def views_on_the_grid(settings: Settings) -> list[View]:
    """Return the nominal mountings; raises InputError if one of them brings no ball to a site of the grid."""
    views = views_of(settings)
    lost = [view.name for view in views if not len(balls_on(view, settings.grid.half))]
    if lost:
        raise InputError([Fault(f"view '{name}' brings no ball to a site of the grid") for name in lost])
    return views


def simulated(
    settings: Settings,
    views: Table | None,
    effects: Sequence[RequestedEffect],
    rng: np.random.Generator,
    lengths: Table | None = None,
) -> Simulation:
    """Return the readings of each view, with random errors of machine, artefact and mountings, and with effects.

    The machine error is smooth, a polynomial of third order. The errors contain no rigid motion and no scale, like
    those of the result. Sites outside the grid have no error. New calibrated lengths are drawn between the same balls.
    """
    truth, half, pitch = settings.simulation or GridSimulation(), settings.grid.half, settings.grid.pitch
    balls = balls_of(half)
    machine, artefact = _drawn(np.asarray(balls * pitch, dtype=float), truth, rng)
    readings = read(views_of(settings), half, _design(settings, truth) if views is None else views)
    problem = build(readings, (half, pitch), settings.declared, lengths)
    count = len(problem.views)
    mountings = np.column_stack([rng.normal(0.0, truth.shift, (count, 3)), rng.normal(0.0, truth.tilt, (count, 3))])
    fields = ((MACHINE, problem.grid.sites, machine), (ARTEFACT, problem.grid.balls, artefact))
    values = {VIEW: pose_from_euler(mountings[:, :3], mountings[:, 3:])}
    values |= {name: _at(balls, indices, field) for name, indices, field in fields}
    model = problem.model
    model = model.with_blocks({name: block.with_values(values[name]) for name, block in model.blocks.items()})
    model = extended(model, effects)
    group = model.readings[0]
    exact = group.chain.predict(model.blocks, group.observations).T
    files = {"views.csv": _read(readings.table, exact + rng.normal(0.0, 1.0, exact.shape) * settings.declared)}
    files |= {"true_machine_error.csv": _errors(balls, machine), "true_artefact_error.csv": _errors(balls, artefact)}
    if lengths is not None:
        known = model.group(LENGTHS)
        exact = known.chain.predict(model.blocks, known.observations)[0]
        length = exact + rng.normal(0.0, 1.0, len(lengths)) * lengths.numbers("sigma")
        files["lengths.csv"] = Table(dict(lengths.columns) | {"length": length}, {"length": "mm", "sigma": "mm"})
    names = [f"{view.name}.{name}" for view in problem.views for name in EULER]
    return Simulation(files, dict(zip(names, mountings.ravel().tolist(), strict=True)) | true_values(model))


def _drawn(places: Array, truth: GridSimulation, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return random errors of machine and artefact at places (n, 3), each (n, 3)."""
    artefact = rng.normal(0.0, 1.0, places.shape) * truth.artefact_error
    machine = _shape(places, smooth_error(places / np.abs(places).max(), rng))
    largest = max(float(np.linalg.norm(machine, axis=1).max()), 1e-300)
    return machine * (truth.machine_error / largest), _shape(places, artefact)


def _shape(places: Array, field: Array) -> Array:
    """Return a field (n, 3) without rigid motion and scale, so that it has the datum of the result."""
    motions = np.concatenate([rigid(places), places[:, :, None]], axis=2).reshape(-1, 7)
    return np.asarray(field - (motions @ np.linalg.lstsq(motions, field.ravel(), rcond=None)[0]).reshape(-1, 3))


def _at(balls: Index, indices: Index, field: Array) -> Array:
    """Return the values at sites of a field that is given on the grid; 0 outside the grid."""
    at = numbers_at(balls, indices)
    return np.where((at >= 0)[:, None], field[np.maximum(at, 0)], 0.0)


def _design(settings: Settings, truth: GridSimulation) -> Table:
    """Return the nominal readings: view by view, the balls whose sites are on the grid."""
    views = views_on_the_grid(settings)
    each = [np.tile(balls_on(view, settings.grid.half), (truth.repeats, 1)) for view in views]
    count, ball = [len(balls) for balls in each], np.concatenate(each)
    places = np.concatenate([view.sites(balls) for view, balls in zip(views, each, strict=True)]) * settings.grid.pitch
    names = {"view": np.repeat([view.name for view in views], count), "i j k": ball.astype(np.int64)}
    table = Table.of({**names, "x y z [mm]": places.astype(float)})
    if truth.repeats > 1:
        turns = [np.repeat(np.arange(1, truth.repeats + 1), n // truth.repeats) for n in count]
        table = table.joined({"repeat": np.concatenate(turns).astype(np.str_)})
    return table.joined({"t [s]": np.arange(len(ball)) * truth.interval})


def _read(design: Table, readings: Array) -> Table:
    """Return a table with its readings replaced."""
    columns = dict(design.columns) | {name: np.ascontiguousarray(readings[:, n]) for n, name in enumerate("xyz")}
    return Table(columns, {name: unit for name, unit in _FILE_UNITS.items() if name in columns})


def smooth_error(scaled: Array, rng: np.random.Generator) -> Array:
    """Return a random smooth error field (n, 3), a polynomial of third order of coordinates scaled to -1 ... 1."""
    powers = [(p, q, r) for p in range(4) for q in range(4) for r in range(4) if 0 < p + q + r <= 3]
    terms = np.stack([scaled[:, 0] ** p * scaled[:, 1] ** q * scaled[:, 2] ** r for p, q, r in powers], axis=1)
    return np.asarray(terms @ rng.normal(0.0, 1.0, (len(powers), 3)))


def _errors(indices: Index, values: Array) -> Table:
    return Table.of({"i j k": indices.astype(np.int64), "ex ey ez [mm]": values})
