"""Whether 95 % intervals contain the truth where readings share errors, for each kind but those of images.

Each measurement has white noise and an error that readings taken together share: a smooth process in time of each
tracer (multilaterate), of each axis (calibrate-machine), or of each view and axis (selfcal-grid). In locate-launch-unit
the receiver of each pose stands elsewhere than listed. Images are in `python -m benchmarks halves`. The measurements
are those of tests/simulated, which know nothing of the adjustments.

    python -m benchmarks shared_errors [KIND ...] [RUNS [DRAWING]]
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.special import stdtrit

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from simulated import grid, launch, lengths, machine

from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.locate_launch_unit import task as locate_launch_unit
from metrocli.tasks.multilaterate import task as multilaterate
from metrocli.tasks.selfcal_grid import task as selfcal_grid

Array = npt.NDArray[np.float64]
MODELS = ("structured", "estimated")
SIZES = (0.0, 0.3, 0.5, 1.0)
"""Standard deviation of the shared error, in those of the white noise"""
DRAW = 2026
"""First number of the seed"""
_FEW = 4
"""Most parameters that are shown one by one"""
SHARE = 1 / 16
"""Length of a smooth process, as a share of the time of its measurement"""


@dataclass(frozen=True)
class Checked:
    """One result against the truth."""

    inside: tuple[bool, ...]
    """Whether the 95 % interval of each estimate contains the truth"""
    z: Array
    """Errors over their standard uncertainties"""
    growth: float
    """By how much standard uncertainties grew; 1 for white noise"""


@cache
def _root(n: int) -> Array:
    t = np.arange(n)
    covariance = np.exp(-(((t[:, None] - t) / (SHARE * n)) ** 2) / 2)
    return np.asarray(np.linalg.cholesky(covariance + 1e-8 * np.eye(n)))


def process(rng: np.random.Generator, n: int, count: int) -> Array:
    """Return smooth random processes of n values, (n, count), of standard deviation 1."""
    return np.asarray(_root(n) @ rng.normal(size=(n, count)))


def in_rows(places: Array, width: float) -> npt.NDArray[np.intp]:
    """Return an order of places (n, 3) in rows along z, as a machine travels, so that successive ones are near."""
    return np.lexsort((places[:, 2], np.floor(places[:, 1] / width), np.floor(places[:, 0] / width)))


def checked(result: Result, values: Sequence[float], std: Sequence[float], truth: Sequence[float]) -> Checked:
    """Return estimates against the truth, with the degrees of freedom that the result states."""
    stated = next(iter(result.details.values()), {}).get("dof", result.statistics["dof"])
    assert isinstance(stated, int | float)
    growth = result.statistics.get("inflation", 1.0)
    assert isinstance(growth, int | float)
    z = (np.array(values) - np.array(truth)) / np.array(std)
    return Checked(tuple((np.abs(z) <= stdtrit(float(stated), 0.975)).tolist()), z, float(growth))


def of_lengths(rng: np.random.Generator, size: float) -> Iterator[Checked]:
    """Yield the tracers' places of a network of 64 points and 6 tracers, one result for each model."""
    net = lengths.network(64, 6, seed=6)
    points = net.points[in_rows(net.points, 250.0)]
    net = replace(net, points=points, nominal=points).read(rng)
    distance = np.linalg.norm(points[:, None] - net.tracers, axis=2)
    sigma = np.sqrt(lengths.NOISE.constant**2 + (lengths.NOISE.proportional * distance) ** 2)
    net = replace(net, readings=net.readings + size * sigma * process(rng, 64, 6))
    names = [f"T{j}.{axis}" for j in range(6) for axis in "xyz"]
    for model in MODELS:
        settings = lengths.settings()
        settings = replace(settings, noise=replace(settings.noise, model=model))
        job = multilaterate.TASK.job(settings, net.lengths(), net.point_table(), net.tracer_table())
        result = multilaterate.run(job)
        known = {one.name: one for one in result.estimates}
        values, std = ([getattr(known[name], key) for name in names] for key in ("value", "std"))
        yield checked(result, values, std, net.tracers.ravel().tolist())


def of_poses(rng: np.random.Generator, size: float) -> Iterator[Checked]:
    """Yield the launch unit from 14 poses at which the receiver stood elsewhere than listed."""
    read = launch.anywhere(14, int(rng.integers(1 << 30)))
    apart = np.linalg.norm(read.receivers - read.unit, axis=1, keepdims=True)
    moved = read.receivers + size * launch.NOISE.encoder * apart * rng.normal(size=(14, 3))
    read = replace(launch.poses(read.unit, read.gamma, moved, read.psi).noisy(rng), receivers=read.receivers)
    for model in MODELS:
        job = locate_launch_unit.TASK.job(launch.settings(noise=replace(launch.NOISE, model=model)), read.table())
        result = locate_launch_unit.run(job)
        values, std = ([getattr(one, key) for one in result.estimates] for key in ("value", "std"))
        values[3] = read.gamma + (values[3] - read.gamma + np.pi) % (2 * np.pi) - np.pi
        yield checked(result, values, std, read.truth.tolist())


def of_machine(rng: np.random.Generator, size: float) -> Iterator[Checked]:
    """Yield tables and squareness of a machine from 120 points, read by a tracker whose readings creep."""
    true = machine.random_machine(np.random.default_rng(3), knots=(3, 3, 3))
    at = machine.commands(np.random.default_rng(4), 120)
    at = at[in_rows(at, 150.0)]
    vectors, which = np.array(list(TOOLS.values())), np.arange(120) % 3
    eye = machine.tracker(np.random.default_rng(5))
    seen = eye.reads(machine.reached(true, at, vectors[which]), rng)
    seen = seen + size * eye.constant * process(rng, 120, 3)
    table = machine.point_table(at, seen, np.array(list(TOOLS))[which])
    for model in MODELS:
        settings = machine.settings(tools=TOOLS, knots=(3, 3, 3))
        settings = replace(settings, noise=replace(settings.noise, model=model))
        result = calibrate_machine.run(calibrate_machine.TASK.job(settings, points=table))
        found: list[tuple[float, float, float]] = []
        for name, values in true.tables.items():
            one = result.tables[f"tables/{name}"]
            found += zip(one.numbers("value").tolist(), one.numbers("std").tolist(), values.tolist(), strict=True)
        known = {one.name: one for one in result.estimates}
        found += [
            (known[name].value, known[name].std, value)
            for name, value in zip(("A0Z", "B0Z", "C0Y"), true.squareness, strict=True)
        ]
        # entries that are zero by the gauge have no uncertainty
        yield checked(result, *zip(*(one for one in found if one[1] > 0), strict=True))


TOOLS = {"T1": (0.0, 0.0, 120.0), "T2": (110.0, 20.0, 150.0), "T3": (-30.0, 100.0, 210.0)}


def of_grid(rng: np.random.Generator, size: float) -> Iterator[Checked]:
    """Yield the machine's error at the sites of a grid of 5 x 5 x 5 balls in five views."""
    true = grid.grid(5, "12345", seed=2)
    table = true.read(rng)
    views, values = np.array(table.texts("view")), table.stacked("xyz")
    for view in np.unique(views):
        rows = np.flatnonzero(views == view)
        values[rows] += size * grid.NOISE * process(rng, len(rows), 3)
    table = Table({**table.columns, **dict(zip("xyz", values.T, strict=True))}, table.units, table.file, table.lines)
    for model in MODELS:
        settings = true.settings(noise=model, leave_one_out="no")
        result = selfcal_grid.run(selfcal_grid.TASK.job(settings, table))
        field = result.tables["machine_error"]
        error, std = field.stacked(["ex", "ey", "ez"]), field.stacked(["s_ex", "s_ey", "s_ez"])
        rows = [tuple(ball) for ball in true.balls.tolist()]
        order = [rows.index(tuple(ball)) for ball in field.stacked("ijk").astype(int).tolist()]
        yield checked(result, error.ravel().tolist(), std.ravel().tolist(), true.machine[order].ravel().tolist())


KINDS: dict[str, Callable[[np.random.Generator, float], Iterator[Checked]]] = {
    "multilaterate": of_lengths,
    "locate-launch-unit": of_poses,
    "calibrate-machine": of_machine,
    "selfcal-grid": of_grid,
}


@dataclass(frozen=True)
class Coverage:
    """Many results against the truth."""

    found: tuple[tuple[Checked, ...], ...]
    """For each run the results of all models"""

    @property
    def shares(self) -> dict[str, tuple[float, float]]:
        """Share of intervals that contain the truth for each model.

        With each share stands its standard uncertainty [%]: the intervals of one run share its errors, so that runs
        count.
        """
        inside = {
            model: 100 * np.array([np.mean(one.inside) for one in results])
            for model, results in zip(MODELS, zip(*self.found, strict=True), strict=True)
        }
        return {model: (float(one.mean()), float(one.std(ddof=1) / np.sqrt(len(one)))) for model, one in inside.items()}

    @property
    def growth(self) -> float:
        """Mean growth."""
        return float(np.mean([one[0].growth for one in self.found]))

    @property
    def by_parameter(self) -> str:
        """Share of intervals and root mean square of z of each parameter, with the first model."""
        inside = 100 * np.mean([one[0].inside for one in self.found], axis=0)
        z = np.sqrt(np.mean([one[0].z ** 2 for one in self.found], axis=0))
        return ", ".join(f"{share:.1f} % (z {size:.2f})" for share, size in zip(inside, z, strict=True))


def coverage(kind: str, size: float, runs: int, draw: int = DRAW) -> Coverage:
    """Return the results of many measurements of one kind."""
    rng = np.random.default_rng([draw, list(KINDS).index(kind), round(10 * size)])
    return Coverage(tuple(tuple(KINDS[kind](rng, size)) for _ in range(runs)))


def main(*arguments: str) -> None:
    """Print the table, and each parameter where they are few."""
    kinds = [argument for argument in arguments if argument in KINDS] or list(KINDS)
    numbers = [int(argument) for argument in arguments if argument.isdigit()]
    runs, draw = (*numbers, *(100, DRAW)[len(numbers) :])[:2]
    print(f"{'kind':<20}{'shared error':>14}{'structured':>18}{'estimated':>18}{'inflation':>12}   (95 % intervals)")
    for kind in kinds:
        for size in SIZES:
            found = coverage(kind, size, runs, draw)
            shown = "".join("{:>10.1f} +- {:.1f} %".format(*found.shares[model]) for model in MODELS)
            print(f"{kind:<20}{size:>8.1f} sigma{shown}{found.growth:>12.2f}", flush=True)
            if len(found.found[0][0].inside) <= _FEW:
                print(f"{'':<20}each parameter: {found.by_parameter}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
