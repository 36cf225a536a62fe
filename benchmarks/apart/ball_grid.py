"""The ball cube: machine error, artefact error and mountings of four views, without the program's readers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.apart.diagnosed import Diagnosed
from benchmarks.apart.model import Array, Model
from benchmarks.apart.samples import numbers, rewritten, table
from benchmarks.hidden import grids
from benchmarks.hidden.scenes import rotation

_PITCH, _NOISE = 65.0, 5e-3
_QUARTER = np.pi / 2
_VIEWS = {
    "1": ((0.0, 0.0, 0.0), (0, 0, 0)),
    "2": ((0.0, 0.0, _QUARTER), (0, 0, 0)),
    "3": ((_QUARTER, 0.0, 0.0), (0, 0, 0)),
    "4": ((0.0, 0.0, 0.0), (1, 0, 0)),
}
"""Turn and shift of each view"""


def _levers(at: Array) -> Array:
    """Moves of points (n, 3) by three shifts and three small rotations, (3 n, 6)."""
    return np.concatenate([np.concatenate([np.eye(3), np.cross(np.eye(3), p).T], axis=1) for p in at])


def ball_grid(folder: Path, lengths: bool) -> Model:
    """Readings of balls, with calibrated lengths if wanted, which then give the scale."""
    rows = table(folder / "data/views.csv")
    balls = np.stack(np.meshgrid(*[np.arange(-2, 3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    place = {tuple(ball): i for i, ball in enumerate(balls.tolist())}
    view = np.array([list(_VIEWS).index(row["view"]) for row in rows])
    indices = numbers(rows, "i", "j", "k")
    ball = np.array([place[tuple(one)] for one in indices.astype(int).tolist()])
    turns = np.rint(rotation(np.array([turn for turn, _ in _VIEWS.values()])))
    shifts = np.array([shift for _, shift in _VIEWS.values()], dtype=float)
    site = np.array(
        [
            place[tuple(one)]
            for one in (np.einsum("nab,nb->na", turns[view], indices) + shifts[view]).astype(int).tolist()
        ]
    )
    grid, n = _PITCH * balls.astype(float), len(balls)
    bars = table(folder / "data/lengths.csv") if lengths else []
    ends = [[place[(int(row[f"i{e}"]), int(row[f"j{e}"]), int(row[f"k{e}"]))] for e in (1, 2)] for row in bars]

    def parts(x: Array) -> tuple[Array, Array, Array]:
        return x[: 3 * n].reshape(n, 3), x[3 * n : 6 * n].reshape(n, 3), x[6 * n :].reshape(len(_VIEWS), 6)

    def carried(artefact: Array) -> Array:
        return np.einsum("nab,nb->na", turns[view], (grid + artefact)[ball]) + _PITCH * shifts[view]

    rigid = _levers(grid)
    to_rigid, at = np.linalg.pinv(rigid), carried(np.zeros((n, 3)))
    to_mounts = [np.linalg.pinv(_levers(at[view == v])) for v in range(len(_VIEWS))]

    def predict(x: Array) -> Array:
        machine, artefact, mounts = parts(x)
        read = (
            machine[site] + mounts[view, :3] + np.einsum("nab,nb->na", rotation(mounts[:, 3:])[view], carried(artefact))
        )
        known = [float(np.linalg.norm((grid + artefact)[a] - (grid + artefact)[b])) for a, b in ends]
        return np.concatenate([read.ravel(), known])

    def delivered(x: Array) -> Array:
        """Both errors without rigid motion, alike in scale unless that is known, and the mountings with them."""
        machine, artefact, _ = parts(x)
        machine, artefact = (one - (rigid @ (to_rigid @ one.ravel())).reshape(-1, 3) for one in (machine, artefact))
        scale = 0.0 if lengths else ((machine - artefact) * grid).sum() / (2 * (grid**2).sum())
        machine, artefact = machine - scale * grid, artefact + scale * grid
        left = predict(x)[: 3 * len(rows)].reshape(-1, 3) - machine[site] - carried(artefact)
        mounts = [fit @ left[view == v].ravel() for v, fit in enumerate(to_mounts)]
        return np.concatenate([machine.ravel(), artefact.ravel(), *mounts])

    zero = np.zeros(6 * n + 6 * len(_VIEWS))
    # it is linear where all is small
    linear = np.stack([delivered(one) for one in 1e-6 * np.eye(len(zero))], axis=1) / 1e-6
    names = [f"{what} {i},{j},{k}.{a}" for what in ("machine", "artefact") for i, j, k in balls.tolist() for a in "xyz"]
    names += [f"{name}.{one}" for name in _VIEWS for one in ("x", "y", "z", "alpha", "beta", "gamma")]
    quantities = {name: (lambda x, row=row: float(row @ x)) for name, row in zip(names, linear, strict=True)}
    keys = [(row["view"], row["i"], row["j"], row["k"], a) for row in rows for a in "xyz"]
    sigma = np.concatenate([np.full(3 * len(rows), _NOISE), [float(row["sigma_mm"]) for row in bars]])
    return Model(predict, sigma, zero, quantities, {key: i for i, key in enumerate(keys)})


def diagnosed(folder: Path, job: str, model: Model) -> Diagnosed:
    """Return the ball cube without calibrated lengths as it is diagnosed with other readings."""
    rows, grid = table(folder / "data/views.csv"), grids.views("1234")
    view = np.array([grid.names.index(row["view"]) for row in rows])
    indices = numbers(rows, "i", "j", "k").astype(int).tolist()
    ball = np.array([grid.balls.tolist().index(one) for one in indices])
    time = numbers(rows, "t_s")[:, 0]
    seen = grids.Measurement(replace(grid, view=view, ball=ball), time, np.zeros(len(rows)), np.zeros((len(rows), 3)))

    def change(name: str, where: Mapping[str, str], values: Mapping[str, float]) -> Array:
        at = {"view": float(grid.names.index(where["view"])), "axis": float("xyz".index(where.get("axis", "x")))}
        return np.asarray(grids.change(seen, name, at | dict(values)).ravel())

    def write(copy: Path, readings: Array) -> None:
        columns = zip("xyz", readings.reshape(-1, 3).T.tolist(), strict=True)
        rewritten(copy / "data/views.csv", rows, {f"{axis}_mm": values for axis, values in columns})

    def moved(one: Array, other: Array) -> float:
        off = [of(one) - of(other) for name, of in model.quantities.items() if name.startswith("machine")]
        return float(np.linalg.norm(np.array(off).reshape(-1, 3), axis=1).max())

    wanted = ("artefact-expansion", "artefact-bending", "drift-in-view", "axis-expansion")
    parameters = {name: grids.PARAMETERS[name] for name in wanted}
    return Diagnosed("selfcal-grid", "ball-cube views", folder, job, model, write, parameters, change, moved)
