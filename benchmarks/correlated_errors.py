"""Networks whose tracers waver: the job as it is, with `noise: structured`, and extended by the errors that are found.

Each of four tracers has a smooth error in time (Matern 3/2, a length of 0.05 to 0.4 of the measurement, 2 to 4 times
the noise) beside white noise. The root mean square errors of the points, and their ratio to the stated uncertainties,
are over the runs, after the best rigid motion.

    python -m benchmarks correlated_errors [RUNS [FIRST]]
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
import numpy.typing as npt

from metrocli.project.diagnosed import carry_out, write_extended
from metrocli.project.job import JobOptions, load
from metrocli.project.runner import content
from metrocli.table import Table
from metrocli.tasks.multilaterate.task import TASK

Array = npt.NDArray[np.float64]
POINTS, NOISE = 60, 5e-4
TRACERS = np.array([[-400.0, -300, -200], [1900, -350, -150], [800, 1700, -100], [750, 500, 1500]])
JOB = """metrocli: 1
job: multilaterate
inputs: {lengths: lengths.csv, points: points.csv, tracers: tracers.csv}
noise: {constant: 0.5 um, proportional: 0 um/m}
"""


def measured(rng: np.random.Generator, folder: Path) -> Array:
    """Write the files of a measurement; return the true places of its points."""
    points = rng.uniform([0, 0, 0], [1500, 1200, 900], (POINTS, 3))
    share = np.linspace(0, 1, POINTS)
    x = np.sqrt(3) * np.abs(share[:, None] - share) / rng.uniform(0.05, 0.4)
    root = np.linalg.cholesky((1 + x) * np.exp(-x) + 1e-9 * np.eye(POINTS))
    lengths = np.linalg.norm(points[:, None] - TRACERS, axis=2) - 100.0
    lengths += NOISE * (rng.uniform(2, 4) * root @ rng.normal(size=(POINTS, 4)) + rng.normal(size=(POINTS, 4)))
    rows = [f"P{i},T{k},{lengths[i, k]:.9f},{30 * i}" for k in range(4) for i in range(POINTS)]
    (folder / "lengths.csv").write_text("\n".join(["point,tracer,length_mm,t_s", *rows, ""]))
    for name, places, head, off in (("point", points, "P", 0.01), ("tracer", TRACERS, "T", 3.0)):
        listed = places + rng.normal(0, off, places.shape)
        rows = [f"{head}{i},{x:.4f},{y:.4f},{z:.4f}" for i, (x, y, z) in enumerate(listed)]
        (folder / f"{name}s.csv").write_text("\n".join([f"{name},x_mm,y_mm,z_mm", *rows, ""]))
    (folder / "job.yaml").write_text(JOB)
    return points


def errors(table: Table, true: Array) -> tuple[Array, Array]:
    """Return the errors of points after the best rigid motion, and over their standard uncertainties, (points, 3)."""
    places, std = table.stacked("xyz"), table.stacked(("sx", "sy", "sz"))
    a, b = places.mean(axis=0), true.mean(axis=0)
    u, _, v = np.linalg.svd((places - a).T @ (true - b))
    off = (places - a) @ (u @ np.diag([1, 1, np.sign(np.linalg.det(u @ v))]) @ v) + b - true
    return off, off / std


def main(arguments: list[str]) -> int:
    """Print a row for each job; return 1 unless 90 % of the extended ones are clean."""
    runs, first = (*map(int, arguments), *(40, 860_000)[len(arguments) :])
    found: dict[str, list[tuple[Array, Array]]] = {"as it is": [], "structured": [], "extended": []}
    stated = clean = 0
    for seed in range(first, first + runs):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            true, job = measured(np.random.default_rng(seed), folder), load(folder / "job.yaml")
            made = write_extended(job, carry_out(job))
            extended = job if made is None else load(made.path)
            stated += any(wanted.correlation for wanted in extended.effects)
            clean += carry_out(extended).verdict in ("clean", "explained")
            structured = load(job.file, JobOptions(overrides=("noise.model=structured",)))
            for how, one in zip(found, (job, structured, extended), strict=True):
                found[how].append(errors(TASK.run(content(one)).tables["points"], true))
    print(f"{stated} of {runs} extended jobs state a correlated error; {clean} are clean or explained")
    for how, pairs in found.items():
        off, ratio = (np.sqrt(np.mean(np.concatenate(part) ** 2)) for part in zip(*pairs, strict=True))
        print(f"{how:12} error {1e3 * off:.2f} um, {ratio:.2f} times the stated uncertainty")
    return int(clean < 0.9 * runs)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
