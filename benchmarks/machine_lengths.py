"""Machines from lengths: coverage of tables and volume, truth of the stated uncertainty, time and memory.

    python -m benchmarks machine_lengths [RUNS]        # RUNS for coverage, 200 unless given

A machine of 600 x 520 x 500 mm with errors of 100 um, five knots an axis, three tools, four stations with 120 points
each; noise 0.3 um and 0.1 um/m. Then 50,000 lengths of one measurement, with 13/11/11 knots.
"""

from __future__ import annotations

import resource
import sys
import time
from dataclasses import replace
from pathlib import Path as File

import numpy as np
import numpy.typing as npt

from metrocli.simulation import SimulationOptions
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.files import Inputs
from metrocli.tasks.calibrate_machine.settings import (
    AxesSettings,
    AxisSettings,
    MachineSettings,
    MachineSimulation,
    Noise,
    Settings,
)
from metrocli.tasks.calibrate_machine.volume import rigid_motions

Array = npt.NDArray[np.float64]
THREE = {"T1": (0.0, 0.0, 120.0), "T2": (110.0, 20.0, 150.0), "T3": (-30.0, 100.0, 210.0)}
SPANS = ((0.0, 600.0), (-260.0, 260.0), (-500.0, 0.0))


def settings(knots: tuple[int, int, int], points: int, repeatability: float | str | None) -> Settings:
    axes = AxesSettings(*(AxisSettings(span, n) for span, n in zip(SPANS, knots, strict=True)))
    noise = Noise(constant=0.3e-3, proportional=1e-7, repeatability=repeatability)
    machine = MachineSettings("wXbYZt", axes, tools=THREE)
    simulation = MachineSimulation(error=0.1, points=points)
    return Settings("lengths", machine, Inputs(lengths=File("-")), noise, simulation=simulation)


def coverage(runs: int, repeatability: float | None) -> None:
    """Print how often 95 % intervals contain the truth, and the ratio of true to stated uncertainty over the volume."""
    job = settings((5, 5, 5), 120, repeatability)
    tables, volume, ratio = [], [], []
    fitted = job if repeatability is None else replace(job, noise=replace(job.noise, repeatability="estimated"))
    for seed in range(runs):
        made = calibrate_machine.simulate(calibrate_machine.TASK.job(job), SimulationOptions(seed))
        result = calibrate_machine.run(calibrate_machine.TASK.job(fitted, lengths=made.files["lengths.csv"]))
        truth = true_tables(made.files["true_errors.csv"])
        for name, values in truth.items():
            found = result.tables[f"tables/{name}"]
            std, off = found.numbers("std"), found.numbers("value") - values
            tables.append((np.abs(off) < 1.96 * std)[std > 1e-15])
        table = result.tables["volume"]
        at = np.array(table.texts("tool")) == "T1"
        position = table.stacked("xyz")[at]
        true = displacement(truth, made.truth, position, np.array(THREE["T1"]))
        miss, std = table.stacked(("ex", "ey", "ez"))[at] - true, table.stacked(("s_ex", "s_ey", "s_ez"))[at]
        volume.append(np.abs(miss) < 1.96 * std)
        basis = rigid_motions(position.T)
        flat = miss.T.ravel()
        left = (flat - basis @ (basis.T @ flat)).reshape(3, -1)
        stated = result.tables["volumetric"].numbers("uncertainty")[0]
        ratio.append((left**2).sum(axis=0).mean() / stated**2)
    inside, there = np.concatenate(tables).mean(), np.mean(volume)
    kind = "" if repeatability is None else ", repeatability 1 um estimated"
    print(f"{runs} runs{kind}: 95 % intervals contain {inside:.1%} of the tables, {there:.1%} of the volume")
    print(f"  true over stated uncertainty of the volume: {np.sqrt(np.mean(ratio)):.3f}")


def true_tables(table: Table) -> dict[str, Array]:
    names = np.array(table.texts("error"))
    values = np.where(np.isnan(table.numbers("value")), table.numbers("turn"), table.numbers("value"))
    return {str(name): values[names == name] for name in np.unique(names)}


def displacement(tables: dict[str, Array], square: dict[str, float], at: Array, tool: Array) -> Array:
    """The contract's formula for the chain XYZ, (n, 3)."""
    total = np.zeros_like(at)
    for i, axis in enumerate("XYZ"):
        knots = np.linspace(*SPANS[i], len(tables[f"EX{axis}"]))
        error = np.stack([np.interp(at[:, i], knots, tables[f"E{d}{axis}"]) for d in "XYZABC"], axis=1)
        lever = np.tile(tool, (len(at), 1))
        lever[:, i + 1 :] += at[:, i + 1 :]
        total += error[:, :3] + np.cross(error[:, 3:], lever)
    total[:, 0] += -square["C0Y"] * at[:, 1] + square["B0Z"] * at[:, 2]
    total[:, 1] -= square["A0Z"] * at[:, 2]
    return total


def speed() -> None:
    """Print CPU time and memory of 50,000 lengths."""
    job = settings((13, 11, 11), 12_500, None)
    made = calibrate_machine.simulate(calibrate_machine.TASK.job(job), SimulationOptions(1))
    before = time.process_time()
    result = calibrate_machine.run(calibrate_machine.TASK.job(job, lengths=made.files["lengths.csv"]))
    took = time.process_time() - before
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{result.statistics['readings']} lengths: {took:.1f} s CPU, {memory:.0f} MB")


def main() -> None:
    speed()
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    coverage(runs, None)
    coverage(runs // 4, 1e-3)


if __name__ == "__main__":
    main()
