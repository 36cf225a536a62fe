"""Geometric errors of a machine from a tracker's track: accuracy, coverage, what paths are worth, and speed.

A machine of 600 x 520 x 500 mm with errors of 117 um on average, measured on the fly (Sanders et al. 2023: 117 um to
0.95 um on the path, 103 um to 0.87 um on a grid). Path and grid errors are mean lengths of predicted minus true error,
after the best shift and turn; on the path across the legs only.

    python -m benchmarks.machine [RUNS]        # RUNS for coverage, 200 unless given
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path as File

import numpy as np
import numpy.typing as npt

from metrocli.errors import UndeterminedError
from metrocli.formats import csv
from metrocli.instruments.machine_path import Path
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.described import machine_of
from metrocli.tasks.calibrate_machine.files import TRACK, Inputs
from metrocli.tasks.calibrate_machine.machine_settings import AxesSettings, AxisSettings, MachineNoise, MachineSettings
from metrocli.tasks.calibrate_machine.plans.path_search import edges_and_diagonals
from metrocli.tasks.calibrate_machine.plans.planned import planned_problem
from metrocli.tasks.calibrate_machine.rank.identifiability import identify
from metrocli.tasks.calibrate_machine.settings import MachineSimulation, Settings
from metrocli.tasks.calibrate_machine.simulation import simulated
from metrocli.tasks.calibrate_machine.truth import TrueMachine, blocks_of, truth_of
from metrocli.tasks.calibrate_machine.volume import grid_of, rigid_motions

Array = npt.NDArray[np.float64]
NOWHERE = File("-")
UM = 1000.0
LEAST = MachineNoise(beam=1e-9, lateral=1e-9)
THREE = {"T1": (0.0, 0.0, 120.0), "T2": (110.0, 20.0, 150.0), "T3": (-30.0, 100.0, 210.0)}


def settings(
    knots: tuple[int, int, int] = (13, 11, 11), tools: dict[str, tuple[float, ...]] | None = None, **truth: object
) -> Settings:
    axes = AxesSettings(
        *(AxisSettings(span, n) for span, n in zip(((0.0, 600.0), (-260.0, 260.0), (-500.0, 0.0)), knots, strict=True))
    )
    machine = MachineSettings("wXbYZt", axes, tools=tools or {"": (0.0, 0.0, 120.0)})
    noise = MachineNoise(beam=1e-3, lateral=5e-3)
    return Settings(
        "on-the-fly",
        machine,
        Inputs(path=NOWHERE, track=NOWHERE),
        noise,
        simulation=MachineSimulation(error=0.117, **truth),
    )  # type: ignore[arg-type]


def planned(job: Settings) -> Table:
    """The path that `metrocli plan` proposes."""
    table = calibrate_machine.plan(calibrate_machine.TASK.job(job)).files["path.csv"]
    assert isinstance(table, Table)
    return Table({name: values for name, values in table.columns.items() if name != "feed"}, table.units)


def edges(job: Settings) -> Table:
    """The lines of edges and diagonals one after the other, with the moves between them."""
    path = edges_and_diagonals(machine_of(job))
    vertices = np.stack([path.start, path.end], axis=1).reshape(-1, 3)
    return Table(dict(zip("xyz", vertices.T, strict=True)), dict.fromkeys("xyz", "mm"))


@dataclass(frozen=True)
class Measured:
    """A simulated measurement and its result."""

    result: Result
    truth: TrueMachine
    path: Table
    job: Settings

    def left(self) -> tuple[float, float, float, float]:
        """Errors on the path and on the grid, before and after [um]."""
        volume = self.result.tables["volume"]
        position = volume.stacked("xyz").T
        true = self.truth.error(position, np.zeros(position.shape[1], dtype=int))[:3]
        found = volume.stacked(("ex", "ey", "ez")).T
        grid = (mean_length(true, position), mean_length(found - true, position))
        return (*self.on_path(), *grid)

    def on_path(self) -> tuple[float, float]:
        """Mean length of the error across the legs, and of what the prediction leaves of it [um]."""
        path = Path.of(self.path.stacked("xyz"), np.zeros(len(self.path), dtype=int))
        _, leg, position = path.sampled(3000)
        true = self.truth.error(position, np.zeros(position.shape[1], dtype=int))[:3]
        found = tables_as_truth(self.result, self.job).error(position, np.zeros(position.shape[1], dtype=int))[:3]
        across, sizes = path.across[leg], []
        motions = np.einsum("nab,bnk->ank", across, rigid_motions(position).reshape(3, -1, 6)).reshape(-1, 6)
        for error in (true, found - true):
            seen = np.einsum("nab,bn->an", across, error).ravel()
            fit, *_ = np.linalg.lstsq(motions, seen, rcond=None)
            sizes.append(float(np.linalg.norm((seen - motions @ fit).reshape(2, -1), axis=0).mean()) * UM)
        return sizes[0], sizes[1]


def tables_as_truth(result: Result, job: Settings) -> TrueMachine:
    """A machine with the tables of a result; what was not determined is zero."""
    machine = machine_of(job)
    tables = {
        name: np.nan_to_num(table.numbers("value"))
        for key, table in result.tables.items()
        if key.startswith("tables/")
        for name in [key[7:]]
    }
    square = {estimate.name: estimate.value for estimate in result.estimates}
    return TrueMachine(machine, blocks_of(job, machine, tables, square))


def mean_length(error: Array, position: Array) -> float:
    basis = rigid_motions(position)
    flat = error.ravel()
    return float(np.linalg.norm((flat - basis @ (basis.T @ flat)).reshape(3, -1), axis=0).mean()) * UM


def measured(job: Settings, path: Table, seed: int, exact: bool = False) -> Measured:
    made = simulated(calibrate_machine.TASK.job(replace(job, noise=LEAST) if exact else job, path=path), seed)
    assert job.simulation is not None
    truth = truth_of(job, job.simulation, np.random.default_rng(seed))
    return Measured(
        calibrate_machine.run(calibrate_machine.TASK.job(job, path=path, track=made.files["track.csv"])),
        truth,
        path,
        job,
    )


def line(label: str, found: Measured) -> None:
    before, after, grid, left = found.left()
    points = found.result.statistics["points_used"]
    print(f"{label:58s} {points:>7} points  path {before:6.1f} -> {after:8.4f} um   grid {grid:6.1f} -> {left:8.4f} um")


def accuracy() -> None:
    job = settings(sampling=0.02)
    path = planned(job)
    for seed in (1, 2, 3):
        line(f"no noise, knots 13/11/11, planned path, machine {seed}", measured(job, path, seed, exact=True))
    line("no noise, edges and diagonals with the moves between", measured(job, edges(job), 1, exact=True))
    fine = settings((25, 21, 21), smooth=True, sampling=0.02)
    path = planned(fine)
    for seed in (1, 2, 3):
        line(f"smooth truth, knots 25/21/21, planned path, machine {seed}", measured(fine, path, seed, exact=True))
    path = planned(settings())
    for seed in (1, 2, 3):
        job = settings(sampling=0.0008)
        line("noise 1 um along, 5 um square to the beam, whole stream", measured(job, path, seed))
    for seed in (1, 2, 3):
        # as many single points as the paper has after its mean filter, each with the whole noise
        job = settings(sampling=0.0812)
        line("the same noise, as many single points as the paper keeps", measured(job, path, seed))


def paths() -> None:
    print("\nworst ratio of volume error to path misfit")
    for knots in ((11, 11, 11), (13, 11, 11), (25, 21, 21)):
        job = settings(knots)
        machine = machine_of(job)
        proposed = calibrate_machine.plan(calibrate_machine.TASK.job(job))
        vertices = proposed.files["path.csv"].stacked("xyz")  # type: ignore[union-attr]
        for label, path in (
            ("edges and diagonals", edges_and_diagonals(machine)),
            ("planned", Path.of(vertices, np.zeros(len(vertices), dtype=int))),
        ):
            try:
                ratio = f"{identify(planned_problem(job, path)).ratio:.1f}"
            except UndeterminedError as error:
                ratio = str(error).splitlines()[0]
            print(f"{knots!s:14s} {label:20s} {len(path.lengths):3d} legs {path.length / UM:5.1f} m  {ratio}")


def coverage(runs: int) -> None:
    """95 % intervals of tables and of the predicted error over the volume, each run with its own machine and noise."""
    job = settings((7, 6, 6), THREE, sampling=0.1)
    path = planned(job)
    tables, volume, sigma0 = [], [], []
    for seed in range(runs):
        found = measured(job, path, 1000 + seed)
        sigma0.append(found.result.statistics["sigma0"])
        for axis in found.truth.machine.axes:
            for k, name in enumerate(("EX", "EY", "EZ", "EA", "EB", "EC")):
                table = found.result.tables[f"tables/{name}{axis.letter}"]
                std = table.numbers("std")
                true = axis.from_raw[k] @ found.truth.blocks[axis.block].values[:, k]
                known = std > 1e-15
                tables.append((np.abs(table.numbers("value") - true)[known] < 1.96 * std[known]).mean())
        grid = found.result.tables["volume"]
        rows = np.array(grid.texts("tool")) == "T2"
        position = grid.stacked("xyz")[rows].T
        error = found.truth.error(position, np.ones(position.shape[1], dtype=int))[:3]
        predicted, std = (grid.stacked(tuple(f"{p}{a}" for a in "xyz"))[rows].T for p in ("e", "s_e"))
        volume.append((np.abs(predicted - error) < 1.96 * std).mean())
    spread = np.std(volume) / np.sqrt(runs)
    print(
        f"\ncoverage of 95 % intervals over {runs} runs, three tools: tables {np.mean(tables):.1%}, "
        f"volumetric error {np.mean(volume):.1%} (+- {spread:.1%}), sigma0 {np.mean(sigma0):.4f}"
    )


def other_tool() -> None:
    """What the tables of one tool are worth for another."""
    job = settings(sampling=0.02)
    found = measured(job, planned(job), 1, exact=True)
    machine = tables_as_truth(found.result, job)
    position = grid_of(machine.machine, (7, 6, 6))
    print(
        "\ncalibrated with one tool (0, 0, 120), used with another: error left of the error there, refused by metrocli"
    )
    for vector in ((0.0, 0.0, 120.0), (0.0, 0.0, 220.0), (80.0, 0.0, 120.0)):
        errors = []
        for one in (found.truth, machine):
            block = replace(one.blocks["tool"], values=np.array([vector]))
            errors.append(
                TrueMachine(one.machine, {**one.blocks, "tool": block}).error(
                    position, np.zeros(position.shape[1], dtype=int)
                )[:3]
            )
        left, whole = mean_length(errors[1] - errors[0], position), mean_length(errors[0], position)
        print(f"  {vector!s:20s} {left:7.3f} um of {whole:6.1f} um")


def speed() -> None:
    print("\ntrack files, one process each: read, condensed and solved (process time)")
    job = settings()
    path = planned(job)
    with tempfile.TemporaryDirectory() as folder:
        csv.write(File(folder) / "path.csv", path)
        for points in (62_500, 125_000, 250_000, 500_000):
            duration = Path.of(path.stacked("xyz"), np.zeros(len(path), dtype=int)).length / 40.0 + 0.7 * len(path)
            assert job.simulation is not None
            fine = replace(job, simulation=replace(job.simulation, sampling=duration / points))
            made = simulated(calibrate_machine.TASK.job(fine, path=path), 1)
            csv.write(File(folder) / "track.csv", made.files["track.csv"])
            ran = subprocess.run(
                [sys.executable, "-m", "benchmarks.machine", "--read", folder],
                capture_output=True,
                text=True,
                check=True,
            )
            print("  " + ran.stdout.strip())
    dense()


def read(folder: str) -> None:
    """Read a path and a track, and solve; print time and memory."""
    from metrocli.tasks.calibrate_machine.files import PATH

    start = time.process_time()
    path, track = csv.read(File(folder) / "path.csv", PATH), csv.read(File(folder) / "track.csv", TRACK)
    middle = time.process_time()
    result = calibrate_machine.run(calibrate_machine.TASK.job(settings(), path=path, track=track))
    end = time.process_time()
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f"{len(track):7d} points: reading {middle - start:4.2f} s, rest {end - middle:4.2f} s, {memory:4.0f} MB; "
        f"condensed to {result.statistics['condensed_points']}"
    )


def dense() -> None:
    """The pseudo-inverse that the paper writes, of a dense matrix (2 rows a point) for 219 unknowns."""
    rng = np.random.default_rng(0)
    for points in (1000, 2000, 4427):
        matrix = rng.normal(size=(2 * points, 219))
        start = time.process_time()
        np.linalg.pinv(matrix)
        print(
            f"  dense pseudo-inverse, {points} points: {time.process_time() - start:5.2f} s, "
            f"{matrix.nbytes / 2**20:.0f} MB for the matrix ({matrix.nbytes / points * 5e5 / 2**20:.0f} MB at 500,000)"
        )


def main(arguments: list[str]) -> None:
    if arguments[:1] == ["--read"]:
        read(arguments[1])
        return
    accuracy()
    paths()
    other_tool()
    speed()
    coverage(int(arguments[0]) if arguments else 200)


if __name__ == "__main__":
    main(sys.argv[1:])
