"""Machines from lengths: coverage of tables and volume, truth of the stated uncertainty, time and memory.

    python -m benchmarks machine_lengths [RUNS]        # RUNS for coverage, 200 unless given
    python -m benchmarks machine_lengths agreement [RUNS]        # 30 unless given

A machine of 600 x 520 x 500 mm with errors of 100 um, five knots an axis, three tools, four stations with 120 points
each; noise 0.3 um and 0.1 um/m. Then 50,000 lengths of one measurement, with 13/11/11 knots.

`agreement` measures each of RUNS machines twice, with independent noise: by lengths, and at standstill by coordinates
of a tracker (1 um along its beam, 2 um and 3 um/m across). Machine and measurements are those of the tests, written
without the engine. What both results predict over the volume, and their tables, differ by their joint uncertainty if
that is right: E_n is below 1 in 95.4 % of all cases, and chi2 is as large as its degrees of freedom.
"""

from __future__ import annotations

import resource
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path as File

import numpy as np
import numpy.typing as npt

sys.path.insert(0, str(File(__file__).parents[1] / "tests"))
from simulated import machine as sim
from simulated import machine_lengths as lengths

from metrocli.result import Result
from metrocli.simulation import SimulationOptions
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.files import Inputs
from metrocli.tasks.calibrate_machine.machine_settings import AxesSettings, AxisSettings, MachineNoise, MachineSettings
from metrocli.tasks.calibrate_machine.settings import MachineSimulation, Settings
from metrocli.tasks.calibrate_machine.volume import rigid_motions
from metrocli.uncertainty.comparison import Comparison, compare
from metrocli.uncertainty.predicted import reached

Array = npt.NDArray[np.float64]
THREE = {"T1": (0.0, 0.0, 120.0), "T2": (110.0, 20.0, 150.0), "T3": (-30.0, 100.0, 210.0)}
SPANS = ((0.0, 600.0), (-260.0, 260.0), (-500.0, 0.0))


def settings(knots: tuple[int, int, int], points: int, repeatability: float | str | None) -> Settings:
    axes = AxesSettings(*(AxisSettings(span, n) for span, n in zip(SPANS, knots, strict=True)))
    noise = MachineNoise(constant=0.3e-3, proportional=1e-7, repeatability=repeatability)
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


@dataclass(frozen=True)
class Agreement:
    """Two results for one machine: differences over expanded uncertainty, and chi2 with its degrees of freedom."""

    volume: Array
    """E_n of each coordinate of the predicted places"""
    volume_chi2: tuple[float, int]
    compared: Comparison
    truth: tuple[Array, Array]
    """The same of each result against the true places"""


def twice(seed: int, points: int = 150, knots: tuple[int, int, int] = (5, 5, 5)) -> tuple[Result, Result, sim.Machine]:
    """Return the results of one machine from lengths and at standstill, and the machine."""
    rng = np.random.default_rng(seed)
    machine = sim.random_machine(rng, knots=knots)
    jobs = (
        calibrate_machine.TASK.job(
            lengths.settings(sim.THREE, knots), lengths=lengths.measured(machine, rng, points, sim.THREE)
        ),
        calibrate_machine.TASK.job(
            sim.settings(tools=sim.THREE, knots=knots), points=sim.points(machine, rng, points, sim.THREE)
        ),
    )
    one, other = (calibrate_machine.run(job) for job in jobs)
    return one, other, machine


def agreement_of(one: Result, other: Result, machine: sim.Machine) -> Agreement:
    """Return how two results for a machine agree at 5 x 5 x 5 places of two tools, and with the truth."""
    line = [np.linspace(low, high, 5) for low, high in zip(sim.LOW, sim.HIGH, strict=True)]
    position = np.tile(np.stack(np.meshgrid(*line, indexing="ij"), axis=-1).reshape(-1, 3), (2, 1))
    tool = np.repeat(["T1", "T3"], len(position) // 2)
    commanded = Table({"tool": tool, **dict(zip("xyz", position.T, strict=True))})
    places = [reached(result, commanded) for result in (one, other)]
    joint = []
    for at in places:
        flat = at.common.reshape(at.values.size, -1)
        joint.append(flat @ at.core @ flat.T)
    vectors = np.array([sim.THREE[name] for name in tool])
    true = position + vectors + sim.displacements(machine, position, vectors)
    off = [(at.values - true).ravel() for at in places]
    whole = joint[0] + joint[1]
    return Agreement(
        en(off[1] - off[0], whole),
        chi2(off[1] - off[0], whole),
        compare(one, other),
        (en(off[0], joint[0]), en(off[1], joint[1])),
    )


def en(difference: Array, covariance: Array) -> Array:
    """Return E_n with k = 2 of the differences that have an uncertainty; the gauge holds the others at zero."""
    std = np.sqrt(np.diag(covariance))
    known = std > 1e-9 * std.max()
    return np.asarray(np.abs(difference[known]) / (2 * std[known]))


def chi2(difference: Array, covariance: Array) -> tuple[float, int]:
    """Return chi2 of a difference, and the rank of its covariance."""
    values, vectors = np.linalg.eigh(covariance)
    good = values > 1e-10 * values[-1]
    scores = (vectors.T @ difference)[good] / np.sqrt(values[good])
    return float(scores @ scores), int(good.sum())


def agreement(runs: int) -> None:
    """Print how results from lengths and at standstill agree over many machines."""
    found = [agreement_of(*twice(seed)) for seed in range(runs)]
    print(f"{runs} machines, each from lengths and at standstill: E_n below 1, chi2/dof")
    mean = np.mean([one.volume_chi2[0] / one.volume_chi2[1] for one in found])
    dof = found[0].volume_chi2[1]
    print(f"  volume: {np.mean([one.volume < 1 for one in found]):.1%}, {mean:.3f} +- {np.sqrt(2 / dof / runs):.3f}")
    inside = np.mean([[each.en < 1 for each in one.compared.compared] for one in found])
    mean, dof = np.mean([one.compared.chi2 / one.compared.dof for one in found]), found[0].compared.dof
    print(f"  tables (compare, {dof} degrees of freedom): {inside:.1%}, {mean:.3f} +- {np.sqrt(2 / dof / runs):.3f}")
    small = sum(one.compared.p_value < 0.05 for one in found)
    print(f"  p below 0.05 in {small} of {runs}")
    for k, name in enumerate(("lengths", "standstill")):
        print(f"  {name} against the truth, volume: {np.mean([one.truth[k] < 1 for one in found]):.1%}")


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
    if sys.argv[1:2] == ["agreement"]:
        agreement(int(sys.argv[2]) if len(sys.argv) > 2 else 30)
        return
    speed()
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    coverage(runs, None)
    coverage(runs // 4, 1e-3)


if __name__ == "__main__":
    main()
