"""Networks of lengths: CPU seconds and memory of the adjustment beside Ceres and scipy, on one thread, in one run.

One function is minimised by all from one start: m tracers about a volume of 2 x 1 x 1 m read n points; points off by
20 um, tracers by 5 mm, scales known to 0.5 ppm; weights of the start. metrocli holds the frame by inner constraints on
the points, the others by six conditions on three points; the sum of squares at the end shows that they agree. Ceres
(if its headers and a compiler are there; see benchmarks/network_ceres.cpp) runs with automatic
derivatives, with written ones, and with lengths in pairs, for which it has static sizes; its time is that of building
and solving, with tolerances of 1e-14 and, so that it takes no step more than needed, of 1e-9.
Each of ours runs in a process of its own: the first adjustment of a process, and the best of the next ones.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from metrocli.adjust.adjustment import StoppingRule, adjust
from metrocli.adjust.model.groups import Group, prior
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.solution import Solution, residuals_of
from metrocli.arrays import Array
from metrocli.instruments import tracer

A, B, SCALE = 1e-4, 1e-7, 5e-7
"""Noise 0.1 um and 0.1 um/m; uncertainty of a scale"""
CORNERS = np.array(
    [
        [-0.25, -0.4, -0.1], [1.3, -0.3, 0.3], [0.45, 1.7, -0.3], [0.55, 0.4, 1.9],
        [-0.2, 1.5, 1.2], [1.25, 1.4, 1.3], [0.5, -0.9, 0.7], [0.15, 0.6, -0.7],
    ]
)  # fmt: skip
VOLUME = np.array([2000.0, 1000.0, 1000.0])
LARGE = 100_000
"""Points up to which Ceres is asked"""


@dataclass(frozen=True)
class Problem:
    """Lengths with starting values."""

    lengths: Array
    """(n, m)"""
    sigma: Array
    """(n, m)"""
    points: Array
    tracers: Array
    """(m, 5)"""

    @staticmethod
    def draw(n: int, m: int) -> Problem:
        """Return a network drawn at random."""
        rng = np.random.default_rng(n + m)
        points, places = rng.uniform(0, 1, (n, 3)) * VOLUME, CORNERS[:m] * VOLUME
        paths = np.stack([np.linalg.norm(points - place, axis=1) for place in places], axis=1)
        paths *= 1 + SCALE * rng.standard_normal(m)
        lengths = paths - paths[0] + np.sqrt(A**2 + (B * paths) ** 2) * rng.standard_normal((n, m))
        near, about = points + rng.normal(0, 0.02, (n, 3)), places + rng.normal(0, 3, (m, 3))
        dead = np.linalg.norm(near[0] - about, axis=1) - lengths[0]
        sigma = np.sqrt(A**2 + (B * (lengths + dead)) ** 2)
        return Problem(lengths, sigma, near, np.column_stack([about, dead, np.ones(m)]))

    def ours(self) -> dict[str, Any]:
        """Return it as keywords of `adjust`."""
        n, m = self.lengths.shape
        points = tracer.point_block(self.points, tuple(map(str, range(n))), True, 2000.0)
        tracers = tracer.tracer_block(self.tracers, tuple(map(str, range(m))), np.ones((m, 5), dtype=bool), 2000.0)
        index = {tracer.POINT: np.repeat(np.arange(n), m), tracer.TRACER: np.tile(np.arange(m), n)}
        read = Observations(self.lengths.reshape(1, -1), self.sigma.reshape(1, -1), index)
        scales = prior(tracers, np.arange(m), np.full((m, 1), SCALE), columns=(4,))
        groups = [Group("lengths", tracer.chain(), read), scales]
        return {"blocks": [points, tracers], "groups": groups, "datum": tracer.datum(points, np.ones(n))}

    def write_job(self, folder: Path) -> None:
        """Write it as files of `metrocli multilaterate`."""
        read = ((i, j, length) for i, own in enumerate(self.lengths.tolist()) for j, length in enumerate(own))
        rows = [f"P{i},T{j},{length!r}" for i, j, length in read]
        (folder / "lengths.csv").write_text("\n".join(["point,tracer,length_mm", *rows, ""]))
        places = [f"P{i},{x!r},{y!r},{z!r}" for i, (x, y, z) in enumerate(self.points.tolist())]
        (folder / "points.csv").write_text("\n".join(["point,x_mm,y_mm,z_mm", *places, ""]))
        (folder / "job.yaml").write_text(
            "metrocli: 1\njob: multilaterate\ninputs: {lengths: lengths.csv, points: points.csv}\n"
            "noise: {constant: 0.1 um, proportional: 0.1 um/m}\nscale: {uncertainty: 0.5 um/m}\noutput: out.h5\n"
        )

    def conditions(self) -> Array:
        """Return six conditions on three points far apart that hold the frame, (point, direction), (6, 4)."""
        first = int(np.argmin(self.points.sum(axis=1)))
        away = self.points - self.points[first]
        second = int(np.argmax((away**2).sum(axis=1)))
        e = away[second] / np.linalg.norm(away[second])
        across = away - np.outer(away @ e, e)
        third = int(np.argmax((across**2).sum(axis=1)))
        f = across[third] / np.linalg.norm(across[third])
        directions = np.vstack([np.eye(3), f, np.cross(e, f), np.cross(e, f)])
        return np.column_stack([[first] * 3 + [second] * 2 + [third], directions])

    def write(self, path: Path) -> None:
        """Write it for the program of Ceres."""
        n, m = self.lengths.shape
        with path.open("wb") as file:
            np.array([m, n], dtype=np.int64).tofile(file)
            for values in (
                np.array([SCALE]),
                self.lengths,
                1 / self.sigma,
                self.points,
                self.tracers,
                self.conditions(),
            ):
                np.ascontiguousarray(values).tofile(file)


def timed(task: Callable[[], Solution | None]) -> tuple[Any, float]:
    """Return what a call gives, and its CPU seconds."""
    before = time.process_time()
    found = task()
    return found, time.process_time() - before


def peak() -> float:
    """Return the largest resident memory of this process so far in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def measured(n: int, m: int, runs: int, covariance: bool) -> dict[str, float]:
    """Adjust in this process and return what it took."""
    problem = Problem.draw(n, m).ours()
    seconds = []
    for _ in range(runs):
        solution, used = timed(lambda: adjust(**problem, control=StoppingRule(covariance=False)))
        seconds.append(used)
    taken = {"first": seconds[0], "solve": min(seconds), "cost": solution.cost, "steps": solution.iterations}
    taken["peak"] = peak()
    if covariance:
        whole = min(timed(lambda: with_statistics(problem))[1] for _ in range(runs))
        taken |= {"covariance": whole - taken["solve"], "all": peak()}
    return taken


def with_statistics(problem: dict[str, Any]) -> Solution:
    """Adjust, and find the covariance of every point, redundancy numbers and w-tests."""
    solution = adjust(**problem)
    solution.covariance_or_raise().members(tracer.POINT)
    residuals_of(solution, solution.groups[0])
    return solution


def in_a_process(n: int, m: int, runs: int, covariance: bool = True) -> dict[str, float]:
    """Return what `measured` returns in a process of its own."""
    call = (
        f"import json; from benchmarks.network_speed import measured as f; print(json.dumps(f{n, m, runs, covariance}))"
    )
    return output([sys.executable, "-c", call])


def output(command: list[str]) -> dict[str, float]:
    """Return what a program prints, on one thread."""
    one = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=one)
    return dict(json.loads(done.stdout))


def ceres_program(folder: Path) -> Path | None:
    """Build the program of Ceres; None, saying why, where that cannot be."""
    compiler, program = shutil.which("g++"), folder / "network_ceres"
    if compiler is None:
        print("Ceres: skipped, no g++")
        return None
    flags = ["-O3", "-march=native", "-std=c++17", "-I/usr/include/eigen3"]
    source = str(Path(__file__).with_name("network_ceres.cpp"))
    call = [compiler, *flags, source, "-o", str(program), "-lceres", "-lglog", "-lpthread"]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    if done.returncode:
        print("Ceres: skipped, its program cannot be built:", next(iter(done.stderr.splitlines()), ""))
        return None
    return program


def ceres(program: Path, problem: Problem, mode: str, runs: int = 3, task: str = "solve") -> dict[str, float]:
    """Return the best of several runs of Ceres; a mode may end in its tolerance, 1e-14 else."""
    path = program.with_name("problem")
    problem.write(path)
    how, _, tolerance = mode.partition(" ")
    call = [str(program), str(path), how, task, tolerance or "1e-14"]
    return min((output(call) for _ in range(runs)), key=lambda one: one["solve"])


def scipy_least_squares(problem: Problem) -> float:
    """Return the CPU seconds of scipy.optimize.least_squares (trf, lsmr) with exact sparse derivatives."""
    from scipy.optimize import least_squares
    from scipy.sparse import csr_matrix

    (n, m), weight = problem.lengths.shape, 1 / problem.sigma
    conditions = problem.conditions()
    owners = conditions[:, 0].astype(int)
    i, j = np.divmod(np.arange(n * m), m)
    columns = np.concatenate([3 * i[:, None] + np.arange(3), 3 * n + 5 * j[:, None] + np.arange(5)], axis=1).ravel()
    columns = np.concatenate([columns, 3 * n + 5 * np.arange(m) + 4, (3 * owners[:, None] + np.arange(3)).ravel()])
    rows = np.concatenate(
        [np.repeat(np.arange(n * m), 8), n * m + np.arange(m), np.repeat(n * m + m + np.arange(6), 3)]
    )

    def parts(z: Array) -> tuple[Array, Array, Array, Array]:
        points, tracers = z[: 3 * n].reshape(n, 3), z[3 * n :].reshape(m, 5)
        away = points[:, None] - tracers[:, :3]
        return points, tracers, away, np.linalg.norm(away, axis=2)

    def residual(z: Array) -> Array:
        points, tracers, _, distance = parts(z)
        read = weight * (tracers[:, 4] * distance - problem.lengths - tracers[:, 3])
        held = 1e3 * ((points - problem.points)[owners] * conditions[:, 1:]).sum(axis=1)
        return np.concatenate([read.ravel(), (tracers[:, 4] - 1) / SCALE, held])

    def jacobian(z: Array) -> csr_matrix:
        _, tracers, away, distance = parts(z)
        towards = (weight * tracers[:, 4] / distance)[..., None] * away
        values = np.concatenate([towards, -towards, -weight[..., None], (weight * distance)[..., None]], axis=2).ravel()
        values = np.concatenate([values, np.full(m, 1 / SCALE), 1e3 * conditions[:, 1:].ravel()])
        return csr_matrix((values, (rows, columns)), shape=(n * m + m + 6, 3 * n + 5 * m))

    start = np.concatenate([problem.points.ravel(), problem.tracers.ravel()])
    stop = {"ftol": 1e-15, "xtol": 1e-15, "gtol": 1e-15, "max_nfev": 100}
    lsmr = {"atol": 1e-14, "btol": 1e-14, "conlim": 1e16, "maxiter": 2000}
    how = {"method": "trf", "tr_solver": "lsmr", "x_scale": "jac", "tr_options": lsmr}
    return timed(lambda: least_squares(residual, start, jac=jacobian, **how, **stop))[1]


def command() -> tuple[float, float]:
    """Return wall and CPU seconds of `metrocli multilaterate` on 100 points and 4 tracers, the best of five."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        Problem.draw(100, 4).write_job(folder)
        found = []
        for _ in range(5):
            before, used = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
            call = [sys.executable, "-m", "metrocli", "multilaterate", str(folder / "job.yaml")]
            subprocess.run(call, check=True, capture_output=True)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            found.append(
                (time.perf_counter() - before, after.ru_utime + after.ru_stime - used.ru_utime - used.ru_stime)
            )
    return min(wall for wall, _ in found), min(used for _, used in found)


def compared(m: int, n: int, program: Path | None) -> str:
    """Return the line of the first table for one size."""
    mine = in_a_process(n, m, 3 if n > LARGE else 7, covariance=False)
    text = f"{m:>2} {n:>8} {mine['solve']:>7.3f} {mine['first']:>7.3f} {mine['peak']:>5.0f} {mine['steps']:>5}  "
    if program is None or n > LARGE:
        return text
    for mode in ("auto", "analytic", "pairs", "pairs 1e-9"):
        other = ceres(program, Problem.draw(n, m), mode)
        ratio = (other["build"] + other["solve"]) / mine["solve"]
        above = other["cost"] / mine["cost"] - 1
        text += f" {mode} {other['build']:.2f} + {other['solve']:.2f} ({ratio:.1f}, {other['steps']} steps"
        text += f", {other['peak']:.0f})" if abs(above) < 1e-8 else f", {other['peak']:.0f}, COST {above:+.0e})"
    return text


def main() -> None:
    """Print the tables."""
    with tempfile.TemporaryDirectory() as name:
        program = ceres_program(Path(name))
        print("adjustment, CPU s (best, first of its process), peak memory in MB")
        print("Ceres: build + solve (times ours, steps, MB), and its sum of squares above ours if beyond 1e-8")
        print(f"{'m':>2} {'n':>8} {'ours':>7} {'first':>7} {'MB':>5} {'steps':>5}")
        for m, n in ((4, 1000), (4, 10_000), (4, 100_000), (8, 100_000), (4, 1_000_000)):
            print(compared(m, n, program), flush=True)
        print("covariance of every point, redundancy numbers and w-tests beside it: CPU s, times the adjustment, MB")
        for m, n in ((4, 1000), (4, 100_000), (8, 100_000), (4, 1_000_000)):
            mine = in_a_process(n, m, 2 if n > LARGE else 5)
            ratio = mine["covariance"] / mine["solve"]
            print(f"{m:>2} {n:>8} {mine['covariance']:>7.3f} {ratio:>6.2f} {mine['all']:>6.0f}", flush=True)
        if program:
            seconds = ceres(program, Problem.draw(1000, 4), "pairs", 1, "covariance")["covariance"]
            print(f"Ceres, covariance of every point (SPARSE_QR), m = 4, n = 1000: {seconds:.2f} s")
    seconds = scipy_least_squares(Problem.draw(1000, 4))
    print(f"scipy least_squares (trf, lsmr), m = 4, n = 1000: {seconds:.2f} s")
    wall, used = command()
    print(f"metrocli multilaterate, m = 4, n = 100, reading and writing included: {wall:.2f} s, CPU {used:.2f} s")


if __name__ == "__main__":
    main()
