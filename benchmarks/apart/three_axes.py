"""The machine of the sample machine-lengths: 21 errors from lengths of four stations, without the program's readers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.apart.diagnosed import Diagnosed
from benchmarks.apart.model import Array, Model
from benchmarks.apart.samples import numbers, rewritten, stated, table
from benchmarks.apart.statement import Rng, Simulated, Statement, of_value
from benchmarks.hidden import lengths

KNOTS = {"X": np.linspace(0, 600, 7), "Y": np.linspace(-260, 260, 6), "Z": np.linspace(-500, 0, 6)}
TOOLS = {"T1": (0.0, 0.0, 120.0), "T2": (110.0, 20.0, 150.0), "T3": (-30.0, 100.0, 210.0)}
TABLES = [f"E{letter}{axis}" for axis in "XYZ" for letter in "XYZABC"]
_SQUARE = ("A0Z", "B0Z", "C0Y")
_ENDS = np.cumsum([0, *(len(KNOTS[name[2]]) for name in TABLES)])
_CIRCLES = {"XY": (0, 1, 208.0), "YZ": (1, 2, 200.0), "ZX": (2, 0, 200.0)}
"""Axes and radius"""
_CONSTANT, _PROPORTIONAL = 0.3e-3, 0.2e-6


def _tables(x: Array) -> dict[str, Array]:
    """Return the tables at their knots: straightness is 0 at both ends, all others at position 0."""
    found = {}
    for name, begin, end in zip(TABLES, _ENDS, _ENDS[1:], strict=False):
        values, knots = x[begin:end], KNOTS[name[2]]
        straight = name[1] in "XYZ" and name[1] != name[2]
        line = np.interp(knots, knots[[0, -1]], values[[0, -1]]) if straight else np.interp(0.0, knots, values)
        found[name] = values - line
    return found


def errors_at(x: Array, at: Array, tool: Array) -> Array:
    """Return the error of the tool (n, 3) at positions (n, 3): each axis moves what is nearer to the tool."""
    tables, error = _tables(x), np.zeros_like(at)
    for a, axis in enumerate("XYZ"):
        read = {name: np.interp(at[:, a], KNOTS[axis], tables[name]) for name in TABLES if name[2] == axis}
        lever = tool + np.where(np.arange(3) > a, at, 0.0)
        angles = np.stack([read[f"E{letter}{axis}"] for letter in "ABC"], axis=1)
        error += np.stack([read[f"E{letter}{axis}"] for letter in "XYZ"], axis=1) + np.cross(angles, lever)
    a0z, b0z, c0y = x[_ENDS[-1] : _ENDS[-1] + 3]
    _, y, z = at.T
    return np.asarray(error + np.stack([-c0y * y + b0z * z, -a0z * z, 0 * z], axis=1))


def linear_errors(x: Array) -> list[Array]:
    """Return the three linear errors at the knots of each axis, (knots, 3) each."""
    tables = _tables(x)
    return [np.stack([tables[f"E{letter}{axis}"] for letter in "XYZ"], axis=1) for axis in "XYZ"]


def _slope(x: Array, name: str) -> float:
    """Slope of the least-squares line of a straightness table."""
    return float(np.polyfit(KNOTS[name[2]], _tables(x)[name], 1)[0])


def _between_fitted_lines(x: Array, name: str) -> float:
    """Squareness between least-squares lines."""
    a0z, b0z, c0y = x[_ENDS[-1] : _ENDS[-1] + 3]
    if name == "C0Y":
        return float(c0y - _slope(x, "EXY") - _slope(x, "EYX"))
    if name == "B0Z":
        return float(b0z + _slope(x, "EXZ") + _slope(x, "EZX"))
    return float(a0z - _slope(x, "EYZ") - _slope(x, "EZY"))


def circular_deviation(x: Array, plane: str) -> float:
    """Range about the least-squares circle in the middle of the volume [mm]."""
    a, b, radius = _CIRCLES[plane]
    angle = np.linspace(0, 2 * np.pi, 361)[:-1]
    at = np.tile([0.5 * (knots[0] + knots[-1]) for knots in KNOTS.values()], (len(angle), 1))
    at[:, a] += radius * np.cos(angle)
    at[:, b] += radius * np.sin(angle)
    moved = errors_at(x, at, np.array(TOOLS["T1"]))
    radial = moved[:, a] * np.cos(angle) + moved[:, b] * np.sin(angle)
    circle = np.column_stack([np.ones_like(angle), np.cos(angle), np.sin(angle)])
    return float(np.ptp(radial - circle @ np.linalg.lstsq(circle, radial, rcond=None)[0]))


def diagonal(x: Array, name: str) -> Array:
    """Deviation along a body diagonal at eleven targets, from its start [mm]."""
    ends = np.array(
        [[knots[0], knots[-1]][:: 1 if sign == "P" else -1] for knots, sign in zip(KNOTS.values(), name, strict=True)]
    )
    way = (ends[:, 1] - ends[:, 0]) / np.linalg.norm(ends[:, 1] - ends[:, 0])
    at = ends[:, 0] + np.linspace(0, 1, 11)[:, None] * (ends[:, 1] - ends[:, 0])
    along = errors_at(x, at, np.array(TOOLS["T1"])) @ way
    return np.asarray(along - along[0])


def quantities() -> Iterable[tuple[str, Callable[[Array], float]]]:
    """Yield what the report delivers: tables, squareness, circles, diagonals."""
    for name in TABLES:
        for i, at in enumerate(KNOTS[name[2]]):
            yield f"{name} at {at:g}", lambda x, name=name, i=i: float(_tables(x)[name][i])
    for i, name in enumerate(_SQUARE):
        yield name, lambda x, i=i: float(x[_ENDS[-1] + i])
        yield f"{name} of least squares", lambda x, name=name: _between_fitted_lines(x, name)
    for plane in _CIRCLES:
        yield f"G in {plane}", lambda x, plane=plane: circular_deviation(x, plane)
    for name in ("PPP", "NPP", "PNP", "NNP"):
        yield f"E of {name}", lambda x, name=name: float(np.ptp(diagonal(x, name)))


def machine(folder: Path, repeatability: float) -> Model:
    """Lengths to a reflector at three tools: tables, squareness, stations and dead paths are unknown."""
    rows, result = table(folder / "data/lengths.csv"), folder / "results/lengths.h5"
    at, tool = numbers(rows, "x_mm", "y_mm", "z_mm"), np.array([TOOLS[row["tool"]] for row in rows])
    places = stated(result, "stations")
    station = np.array([[one["station"] for one in places].index(row["station"]) for row in rows])
    own = np.array([[one[key] for key in ("x", "y", "z", "dead_path")] for one in places])
    square = {row["error"]: row["end_points"] for row in stated(result, "squareness")}
    values = [row["value"] for name in TABLES for row in stated(result, f"tables/{name}")]
    truth = np.concatenate([values, [square[name] for name in _SQUARE], own.ravel()])

    def paths(x: Array) -> Array:
        stations = x[_ENDS[-1] + 3 :].reshape(-1, 4)
        return np.linalg.norm(at + tool + errors_at(x, at, tool) - stations[station, :3], axis=1)

    def predict(x: Array) -> Array:
        return np.asarray(paths(x) - x[_ENDS[-1] + 3 :].reshape(-1, 4)[station, 3])

    sigma = np.sqrt(_CONSTANT**2 + (_PROPORTIONAL * paths(truth)) ** 2 + repeatability**2)
    keys = {(row["point"], row["station"]): i for i, row in enumerate(rows)}
    return Model(predict, sigma, truth, dict(quantities()), keys)


def volume(kind: str, place: str, model: Model, stated: Iterable[Mapping[str, Any]]) -> Iterable[Statement]:
    """Yield mean and largest error over the volume, freed of shift and rotation, and its standard uncertainty (RMS)."""
    lines = [np.linspace(knots[0], knots[-1], count) for knots, count in zip(KNOTS.values(), (7, 6, 6), strict=True)]
    at = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    moves = np.concatenate(
        [np.concatenate([np.eye(3), np.cross(np.eye(3), p).T], axis=1) for p in at - at.mean(axis=0)]
    )
    rigid = moves @ np.linalg.pinv(moves)

    def free(x: Array, tool: str) -> Array:
        error = errors_at(x, at, np.array(TOOLS[tool])).ravel()
        return np.asarray((error - rigid @ error).reshape(-1, 3))

    def spread(tool: str) -> float:
        _, inverse = model.inverse
        steps = 1e-6 * np.eye(len(model.truth))
        rows = [(free(model.truth + step, tool) - free(model.truth - step, tool)).ravel() / 2e-6 for step in steps]
        return float(np.sqrt(((np.stack(rows, axis=1) @ inverse) ** 2).sum() / len(at)))

    def said(tool: str, claim: str, value: float, of: Callable[[], float]) -> Statement:
        def check(_: Rng) -> Simulated:
            return of_value(1e3 * of(), 1e3 * value)

        return Statement(kind, place, f"{claim} of {tool}", f"{1e3 * value:.4g} um", check)

    for row in stated:
        tool = row["tool"]
        sizes = np.linalg.norm(free(model.truth, tool), axis=1)
        yield said(tool, "mean error over the volume", row["mean_error"], lambda sizes=sizes: float(sizes.mean()))
        yield said(tool, "largest error over the volume", row["largest_error"], lambda sizes=sizes: float(sizes.max()))
        yield said(tool, "uncertainty over the volume", row["uncertainty"], lambda tool=tool: spread(tool))


def diagnosed(folder: Path, job: str, model: Model) -> Diagnosed:
    """Return the machine from lengths as it is diagnosed with other lengths."""
    rows, places = table(folder / "data/lengths.csv"), stated(folder / "results/lengths.h5", "stations")
    names = [row["station"] for row in places]
    at, tools = numbers(rows, "x_mm", "y_mm", "z_mm"), np.array([TOOLS[row["tool"]] for row in rows])
    station = np.array([names.index(row["station"]) for row in rows])
    own, time = np.array([[row[axis] for axis in "xyz"] for row in places]), numbers(rows, "t_s")[:, 0]
    each, still = np.arange(len(rows)), np.zeros(len(rows))
    seen = lengths.Measurement(at + tools, own, at + tools, own, each, station, time, still, still)

    def change(name: str, where: Mapping[str, str], values: Mapping[str, float]) -> Array:
        if "tracer" in where:
            return lengths.signature(name, names.index(where["tracer"]), values)(seen)
        moved, elapsed = np.zeros_like(at), (time - time.min())[:, None]
        if name == "thermal-growth":
            axis = "xyz".index(where["axis"])
            moved[:, axis] = values["rate"] * elapsed[:, 0] * at[:, axis]
        elif name == "load-sag":
            moved[:, 2] = values["c"] * at[:, "xyz".index(where["pair"][0])] * at[:, "xyz".index(where["pair"][1])]
        else:
            moved = elapsed * np.array([values["vx"], values["vy"], values["vz"]])
        return np.asarray((moved * seen.beam).sum(axis=1) / seen.distance)

    def write(copy: Path, readings: Array) -> None:
        rewritten(copy / "data/lengths.csv", rows, {"length_mm": readings.tolist()})

    def moved(one: Array, other: Array) -> float:
        ends = [linear_errors(x) for x in (one, other)]
        return max(float(np.linalg.norm(a - b, axis=1).max()) for a, b in zip(*ends, strict=True))

    parameters = {"thermal-growth": ("rate",), "load-sag": ("c",), "machine-drift": ("vx", "vy", "vz")}
    parameters |= {"tracer-scale": ("scale",), "dead-path-drift": ("rate",), "tracer-drift": ("vx", "vy", "vz")}
    return Diagnosed("calibrate-machine", "machine-lengths", folder, job, model, write, parameters, change, moved)
