"""The samples' measurements as plain functions: what their files and job files say, without the program's readers."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from benchmarks.apart.diagnosed import Diagnosed
from benchmarks.apart.model import Array, Model
from benchmarks.hidden import launch, lengths
from benchmarks.hidden.launch import Measurement
from benchmarks.hidden.scenes import pixels, rotation

_FIVE_SECONDS = 5 / 3600 * np.pi / 180


def table(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file without its comments."""
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def stated(result: Path, name: str) -> list[dict[str, Any]]:
    """Return the rows of a table of a result file, texts as str."""
    with h5py.File(result) as file:
        rows = file[name][:]
    return [
        {
            key: value.decode() if isinstance(value, bytes) else float(value)
            for key, value in zip(rows.dtype.names, row, strict=True)
        }
        for row in rows.tolist()
    ]


def numbers(rows: list[dict[str, str]], *keys: str) -> Array:
    """Return columns of rows as numbers (n, k)."""
    return np.array([[float(row[key]) for key in keys] for row in rows])


def _aligned(points: Array, to: Array) -> Array:
    """Return points shifted and turned so that they lie as close as possible to others (Kabsch 1976)."""
    here, there = points.mean(axis=0), to.mean(axis=0)
    u, _, v = np.linalg.svd((points - here).T @ (to - there))
    return np.asarray((points - here) @ (u @ v) + there)


def gear(folder: Path) -> Model:
    """Lengths of four tracers to replayed points: places, dead paths and scales about 1 +- 0.1 um/m are unknown."""
    read = table(folder / "data/lengths.csv")
    result = folder / "results/tip3.h5"
    tracers, found = stated(result, "tracers"), stated(result, "points")
    names = [row["point"] for row in table(folder / "data/points.csv")]
    nominal = numbers(table(folder / "data/points.csv"), "x_mm", "y_mm", "z_mm")
    point = np.array([names.index(row["point"]) for row in read])
    tracer = np.array([[one["tracer"] for one in tracers].index(row["tracer"]) for row in read])
    n, k = len(names), len(tracers)
    start = np.array([[one[key] for key in "xyz"] for one in found]).ravel()
    own = np.array([[one["x"], one["y"], one["z"], one["dead_path"], 0.0] for one in tracers])

    def predict(x: Array) -> Array:
        points, each = x[: 3 * n].reshape(n, 3), x[3 * n :].reshape(k, 5)
        paths = np.linalg.norm(points[point] - each[tracer, :3], axis=1)
        return np.concatenate([paths * (1 + 1e-6 * each[tracer, 4]) - each[tracer, 3], each[:, 4]])

    truth = np.concatenate([start, own.ravel()])
    paths = predict(truth)[: len(read)] + own[tracer, 3]
    sigma = np.concatenate([np.sqrt(1e-4**2 + (1e-7 * paths) ** 2), np.full(k, 0.1)])

    def place(i: int, a: int) -> Callable[[Array], float]:
        return lambda x: float(_aligned(x[: 3 * n].reshape(n, 3), nominal)[i, a])

    quantities = {f"{name}.{axis}": place(i, a) for i, name in enumerate(names) for a, axis in enumerate("xyz")}
    rows: dict[tuple[str, ...], int] = {(row["point"], row["tracer"]): i for i, row in enumerate(read)}
    return Model(predict, sigma, truth, quantities, rows)


def launch_unit(folder: Path) -> Model:
    """Two encoders each of two units that look at each other, and distances where they were read."""
    poses = table(folder / "data/table.csv")
    receivers, psi = numbers(poses, "x_mm", "y_mm", "z_mm"), numbers(poses, "spindle_rad")[:, 0]
    has = [bool(row["distance_mm"]) for row in poses]
    truth = np.array([one["value"] for one in stated(folder / "results/table.h5", "parameters")])
    m = Measurement(truth, receivers, psi, psi, psi, True, np.zeros(0))
    names = [(row["pose"], f"phi{i}") for i in range(1, 5) for row in poses]
    names += [(row["pose"], "distance") for row, one in zip(poses, has, strict=True) if one]
    kept = np.concatenate([np.ones(4 * len(poses), dtype=bool), has])
    sigma = np.array([_FIVE_SECONDS] * (4 * len(poses)) + [5e-3] * sum(has))
    quantities: dict[str, Callable[[Array], float]] = {
        name: (lambda x, i=i: float(x[i])) for i, name in enumerate(("x", "y", "z", "gamma"))
    }
    rows: dict[tuple[str, ...], int] = {name: i for i, name in enumerate(names)}
    return Model(lambda x: m.predicted(x).ravel()[kept], sigma, truth, quantities, rows)


LENS = ("f", "cx", "cy", "k1", "k2", "p1", "p2")


def camera(folder: Path) -> Model:
    """Image points of a dot that a measuring machine carries to places that it knows within a sigma."""
    seen, places = table(folder / "cmm/observations.csv"), table(folder / "cmm/targets.csv")
    target = np.array([[one["target"] for one in places].index(row["target"]) for row in seen])
    listed, known = numbers(places, "x_mm", "y_mm", "z_mm"), numbers(places, "sigma_mm")
    found = {one["name"]: one["value"] for one in stated(folder / "results/camera.h5", "parameters")}
    names = [*LENS, *(name for name in found if name not in LENS)]
    k = len(names)

    def predict(x: Array) -> Array:
        points = listed + x[k:].reshape(-1, 3)
        turn = rotation(x[10:13])
        uv = pixels(((points - x[7:10]) @ turn)[target], dict(zip(LENS, x[:7].tolist(), strict=True)))
        return np.concatenate([uv.ravel(), x[k:]])

    truth = np.concatenate([[found[name] for name in names], np.zeros(3 * len(listed))])
    sigma = np.concatenate([np.full(2 * len(seen), 0.02), np.repeat(known[:, 0], 3)])
    quantities: dict[str, Callable[[Array], float]] = {
        name: (lambda x, i=i: float(x[i])) for i, name in enumerate(names)
    }
    rows: dict[tuple[str, ...], int] = {
        (row["image"], row["target"], axis): 2 * i + a for i, row in enumerate(seen) for a, axis in enumerate("uv")
    }
    return Model(predict, sigma, truth, quantities, rows)


def diagnosed_gear(folder: Path, job: str, model: Model) -> Diagnosed:
    """Return the network of the gear as it is diagnosed with other lengths."""
    rows = table(folder / "data/lengths.csv")
    names = [row["point"] for row in table(folder / "data/points.csv")]
    tracers = [row["tracer"] for row in table(folder / "data/tracers.csv")]
    n, k = len(names), len(tracers)
    point = np.array([names.index(row["point"]) for row in rows])
    tracer = np.array([tracers.index(row["tracer"]) for row in rows])
    points, own = model.truth[: 3 * n].reshape(n, 3), model.truth[3 * n :].reshape(k, 5)[:, :3]
    still = np.zeros(len(rows))
    seen = lengths.Measurement(points, own, points, own, point, tracer, still, still, still)

    def change(name: str, where: Mapping[str, str], values: Mapping[str, float]) -> Array:
        changed = lengths.signature(name, tracers.index(where["tracer"]), values)(seen)
        return np.concatenate([changed, np.zeros(k)])

    def write(copy: Path, readings: Array) -> None:
        rewritten(copy / "data/lengths.csv", rows, {"length_mm": readings[: len(rows)].tolist()})

    def moved(one: Array, other: Array) -> float:
        ends = [_aligned(x[: 3 * n].reshape(n, 3), points) for x in (one, other)]
        return float(np.linalg.norm(ends[0] - ends[1], axis=1).max())

    parameters = {"tracer-scale": ("scale",), "sphere-form": ("c2", "s2")}
    return Diagnosed("multilaterate", "gear-m3d3", folder, job, model, write, parameters, change, moved)


def diagnosed_launch_unit(folder: Path, job: str, model: Model) -> Diagnosed:
    """Return the launch unit on a table as it is diagnosed with other readings."""
    poses = table(folder / "data/table.csv")
    receivers, psi = numbers(poses, "x_mm", "y_mm", "z_mm"), numbers(poses, "spindle_rad")[:, 0]
    has = np.array([bool(row["distance_mm"]) for row in poses])
    kept = np.concatenate([np.ones(4 * len(poses), dtype=bool), has])
    seen = Measurement(model.truth, receivers, psi, psi, psi, True, np.zeros(0))

    def change(name: str, where: Mapping[str, str], values: Mapping[str, float]) -> Array:
        return np.asarray(launch.change(seen, name, where, values).ravel()[kept])

    def write(copy: Path, readings: Array) -> None:
        angles = (readings[: 4 * len(poses)].reshape(4, -1) + np.pi) % (2 * np.pi) - np.pi
        columns: dict[str, list[Any]] = {f"phi{i + 1}_rad": row.tolist() for i, row in enumerate(angles)}
        distances = iter(readings[4 * len(poses) :].tolist())
        columns["distance_mm"] = [next(distances) if one else "" for one in has]
        rewritten(copy / "data/table.csv", poses, columns)

    def moved(one: Array, other: Array) -> float:
        return float(np.linalg.norm((one - other)[:3]))

    parameters = {name: names for name, names in launch.PARAMETERS.items() if name != "bad-pose"}
    return Diagnosed("locate-launch-unit", "xm60 table", folder, job, model, write, parameters, change, moved)


def rewritten(path: Path, rows: list[dict[str, str]], columns: Mapping[str, list[Any]]) -> None:
    """Write rows with other values in some columns."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        for number, row in enumerate(rows):
            writer.writerow(row | {key: values[number] for key, values in columns.items()})
