"""Pairs of simulated calibrations held against each other: p-values are uniform if the uncertainties are right.

    python -m benchmarks comparison [PAIRS]        # 200 unless given

A machine from lengths, three knots an axis, three tools, four stations with 50 points each; each pair a new machine.
"""

from __future__ import annotations

import sys

import numpy as np

from metrocli.result import Result
from metrocli.simulation import SimulationOptions
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.uncertainty.comparison import compare

from .machine_lengths import settings


def calibrated(job: Settings, made: Table, noise: np.random.Generator) -> Result:
    """The lengths of a simulation without noise, read anew."""
    length = made.numbers("length")
    columns = {**made.columns, "length": length + noise.normal(size=len(length)) * 0.3e-3}
    return calibrate_machine.run(calibrate_machine.TASK.job(job, lengths=Table(columns, made.units)))


def main() -> None:
    pairs = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    from dataclasses import replace

    job = settings((3, 3, 3), 50, None)
    job = replace(job, noise=replace(job.noise, proportional=0.0))
    exact = replace(job, noise=replace(job.noise, constant=1e-12))
    p = []
    for seed in range(pairs):
        made = calibrate_machine.simulate(calibrate_machine.TASK.job(exact), SimulationOptions(seed))
        noise = np.random.default_rng(10_000 + seed)
        one, other = (calibrated(job, made.files["lengths.csv"], noise) for _ in range(2))
        p.append(compare(one, other).p_value)
    ordered, n = np.sort(p), len(p)
    steps = np.arange(1, n + 1) / n
    distance = float(max(np.abs(steps - ordered).max(), np.abs(ordered - steps + 1 / n).max()))
    shares = ", ".join(f"{np.mean(np.array(p) < level):.1%} below {level:g}" for level in (0.05, 0.25, 0.5, 0.75))
    print(f"{n} pairs: {shares}")
    print(f"  Kolmogorov distance from uniform {distance:.3f} (5 % bound {1.358 / np.sqrt(n):.3f})")


if __name__ == "__main__":
    main()
