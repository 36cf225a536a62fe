"""Pairs of simulated calibrations held against each other: p-values are uniform if the uncertainties are right.

    python -m benchmarks comparison [PAIRS]        # 200 unless given

A machine from lengths, three knots an axis, three tools, four stations with 50 points each; each pair a new machine.
Then pairs of alignments with one camera, each pair with a new calibration of it: its error is in both.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from metrocli.result import Result
from metrocli.simulation import SimulationOptions
from metrocli.table import Table
from metrocli.tasks.align_part import task as align_part
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.uncertainty.comparison import SHARED, compare

from .coverage import alignment_settings, corners, planes, poses_over, true_camera
from .coverage import calibrated as calibrated_camera
from .machine_lengths import settings


def calibrated(job: Settings, made: Table, noise: np.random.Generator) -> Result:
    """The lengths of a simulation without noise, read anew."""
    length = made.numbers("length")
    columns = {**made.columns, "length": length + noise.normal(size=len(length)) * 0.3e-3}
    return calibrate_machine.run(calibrate_machine.TASK.job(job, lengths=Table(columns, made.units)))


def shared_cameras(pairs: int) -> None:
    """Print the p-values of alignments with the same camera, counted once, and as independent."""
    places, targets = planes((395.0, 900.0, 1430.0), 3), corners(0.0)
    poses, job = poses_over(targets), alignment_settings(0.05, 1e-3)
    once, twice = [], []
    for seed in range(pairs):
        camera, _ = calibrated_camera("cmm", 30_000 + seed, places)
        made = align_part.TASK.job(job, true_camera(), poses, targets)
        results = []
        for k in range(2):
            seen = align_part.simulate(made, SimulationOptions(50_000 + 2 * seed + k)).files["observations.csv"]
            results.append(align_part.run(align_part.TASK.job(job, camera, poses, targets, observations=seen)))
        found = compare(*results)
        assert found.counted_once == ("camera",)
        once.append(found.p_value)
        alone = [replace(one, tables={n: t for n, t in one.tables.items() if n != SHARED}) for one in results]
        twice.append(compare(*alone).p_value)
    show(once, "alignments with one camera, counted once")
    show(twice, "the same, as independent")


def show(p: list[float], what: str) -> None:
    """Print how p-values are distributed."""
    ordered, n = np.sort(p), len(p)
    steps = np.arange(1, n + 1) / n
    distance = float(max(np.abs(steps - ordered).max(), np.abs(ordered - steps + 1 / n).max()))
    shares = ", ".join(f"{np.mean(np.array(p) < level):.1%} below {level:g}" for level in (0.05, 0.25, 0.5, 0.75))
    print(f"{n} pairs, {what}: {shares}")
    print(f"  Kolmogorov distance from uniform {distance:.3f} (5 % bound {1.358 / np.sqrt(n):.3f})", flush=True)


def main() -> None:
    pairs = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    shared_cameras(pairs)
    job = settings((3, 3, 3), 50, None)
    job = replace(job, noise=replace(job.noise, proportional=0.0))
    exact = replace(job, noise=replace(job.noise, constant=1e-12))
    p = []
    for seed in range(pairs):
        made = calibrate_machine.simulate(calibrate_machine.TASK.job(exact), SimulationOptions(seed))
        noise = np.random.default_rng(10_000 + seed)
        one, other = (calibrated(job, made.files["lengths.csv"], noise) for _ in range(2))
        p.append(compare(one, other).p_value)
    show(p, "machines from lengths")


if __name__ == "__main__":
    main()
