"""Uncertainties: speed beside plain numpy and at the command line, memory, a volume, and a table that must hold.

The table is one like Mendikute's Table 4, of simulated measurements: each repeat calibrates the camera anew, clamps it
anew, locates the part (7D), takes the covariance to the corners of 1500 mm x 1000 mm x 500 mm, and adds the expansion
of a part whose temperature is uniform within +-1 K. Printed: U (k = 2) and how often it holds the error of the corners.

    python -m benchmarks.uncertainty [REPEATS]
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.coverage import PART, aligned
from metrocli.expressions.expression import parse
from metrocli.geometry import poses
from metrocli.result import Estimate, Result
from metrocli.settings import LocatedValue
from metrocli.tasks.report_uncertainty import volume_problem
from metrocli.tasks.report_uncertainty.entries import Contributor, Expansion, MonteCarlo, VolumeEntry
from metrocli.tasks.report_uncertainty.settings import Settings
from metrocli.uncertainty import monte_carlo
from metrocli.uncertainty.distributions import Arcsine, CurvilinearTrapezoid, Normal, Uniform
from metrocli.uncertainty.inputs import InputQuantity, Inputs, join
from metrocli.uncertainty.trials import plan_of
from metrocli.uncertainty.volume import extremes
from metrocli.uncertainty.workers import Workers

Array = npt.NDArray[np.float64]
ALPHA, WARMTH = 11.0e-6, 1.0
GAUGE = "Ls + D + d1 + d2 - Ls*(da*(t0 + Delta) + as_*dt) - 50000000"
"""JCGM 101, 9.5, in nm and K"""
JOB = f"""metrocli: 1
job: report-uncertainty
quantities:
  Ls: {{value: 50000623, std: 25, dof: 18}}
  D: {{value: 215, std: 6, dof: 24}}
  d1: {{value: 0, std: 4, dof: 5}}
  d2: {{value: 0, std: 7, dof: 8}}
  as_: {{value: 11.5e-6, half_width: 2e-6}}
  t0: {{value: -0.1, std: 0.2}}
  Delta: {{value: 0, half_width: 0.5, distribution: arcsine}}
  da: {{value: 0, half_width: 1e-6, inexactness: 1e-7}}
  dt: {{value: 0, half_width: 0.05, inexactness: 0.025}}
measurands: {{l: {{model: "{GAUGE}"}}}}
coverage: {{probability: 0.99}}
monte_carlo: {{trials: TRIALS, seed: 1}}
"""


def gauge() -> Inputs:
    """Return the inputs of JCGM 101, 9.5."""
    known = [("Ls", 50000623.0, 25.0, 18), ("D", 215.0, 6.0, 24), ("d1", 0.0, 4.0, 5), ("d2", 0.0, 7.0, 8)]
    quantities = [InputQuantity(name, value, Normal(std), dof) for name, value, std, dof in known]
    quantities += [InputQuantity("as_", 11.5e-6, Uniform(2e-6)), InputQuantity("t0", -0.1, Normal(0.2))]
    quantities += [
        InputQuantity("Delta", 0.0, Arcsine(0.5)),
        InputQuantity("da", 0.0, CurvilinearTrapezoid(1e-6, 1e-7)),
    ]
    return join([*quantities, InputQuantity("dt", 0.0, CurvilinearTrapezoid(0.05, 0.025))])


def plain_numpy(trials: int) -> tuple[float, float, float]:
    """Return standard deviation and shortest 99 % interval as a script of a dozen lines computes them."""
    rng = np.random.default_rng(1)
    ls, d = 50000623 + 25 * rng.standard_t(18, trials), 215 + 6 * rng.standard_t(24, trials)
    d1, d2 = 4 * rng.standard_t(5, trials), 7 * rng.standard_t(8, trials)
    alpha = rng.uniform(9.5e-6, 13.5e-6, trials)
    t0, delta = rng.normal(-0.1, 0.2, trials), 0.5 * np.cos(np.pi * rng.random(trials))
    da = rng.uniform(0.9e-6, 1.1e-6, trials) * rng.uniform(-1, 1, trials)
    dt = rng.uniform(0.025, 0.075, trials) * rng.uniform(-1, 1, trials)
    y = np.sort(ls + d + d1 + d2 - ls * (da * (t0 + delta) + alpha * dt) - 50000000)
    inside = round(0.99 * trials)
    first = int(np.argmin(y[inside:] - y[:-inside]))
    return float(y.std()), float(y[first]), float(y[first + inside])


def ours(trials: int, workers: int = 1) -> tuple[float, float, float]:
    """Return the same by metrocli's kernel, draws, intervals and covariance included."""
    plan = plan_of({"l": parse(GAUGE)}, gauge(), 1, 0.99, trials)
    outcome = monte_carlo.run(plan, Workers(workers))
    low, high = outcome.samples[0].shortest(0.99)
    return float(outcome.covariance[0, 0] ** 0.5), low + outcome.centres[0], high + outcome.centres[0]


def cpu(task: Callable[[], object], runs: int = 5) -> float:
    """Return the least CPU seconds of several runs."""
    seconds = []
    for _ in range(runs):
        before = time.process_time()
        task()
        seconds.append(time.process_time() - before)
    return min(seconds)


@dataclass(frozen=True)
class Command:
    """What a command took."""

    wall_s: float
    cpu_s: float
    peak_mb: float


def command(trials: int) -> Command:
    """Carry out a job at the command line."""
    with tempfile.TemporaryDirectory() as folder:
        job = Path(folder) / "gauge.yaml"
        job.write_text(JOB.replace("TRIALS", str(trials)), encoding="utf-8")
        peak = "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
        code = f"import resource; from metrocli.cli.main import main\ntry: main()\nfinally: {peak}"
        spent = resource.getrusage(resource.RUSAGE_CHILDREN)
        before = time.perf_counter()
        arguments = [sys.executable, "-c", code, "report-uncertainty", str(job), "--quiet"]
        ran = subprocess.run(arguments, capture_output=True, text=True, check=True)
        wall = time.perf_counter() - before
        now = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = now.ru_utime + now.ru_stime - spent.ru_utime - spent.ru_stime
    return Command(wall, seconds, int(ran.stdout.split()[-1]) / 1024)


def large_volume(points: int = 50, contributors: int = 20, parameters: int = 12) -> float:
    """Return the CPU seconds of a volume with many contributors, one of them through a full covariance."""
    rng = np.random.default_rng(0)
    names = [f"e{n}" for n in range(parameters)]
    root = rng.normal(size=(parameters, parameters)) * 1e-3
    units = ["mm"] * 3 + ["rad"] * (parameters - 3)
    estimates = tuple(Estimate(name, float(rng.normal()), 0.0, unit) for name, unit in zip(names, units, strict=True))
    result = Result("align-part", "", estimates, root @ root.T, {})
    turns = [[f"m.e{n}*{'XYZ'[(n + axis) % 3]}" for n in range(3, parameters)] for axis in range(3)]
    sums = [" + ".join([f"m.e{axis}", *terms]) for axis, terms in enumerate(turns)]
    from metrocli.expressions.written import WrittenExpression
    from metrocli.nodes import Node, Source

    nowhere = Node("scalar", Source("", (), Path()))
    models = tuple(WrittenExpression(parse(text), nowhere) for text in sums)
    parts = [Contributor("m", model=models)]  # type: ignore[arg-type]
    parts += [Contributor(f"c{n}", std=(1e-3, 2e-3, 3e-3)) for n in range(contributors - 2)]
    parts += [Contributor("warmth", expansion=Expansion(ALPHA, WARMTH))]
    settings = Settings(
        volume=VolumeEntry((0.0, 0.0, 0.0), (1500.0, 1000.0, 500.0), (points,) * 3),
        contributors=tuple(LocatedValue(part, nowhere) for part in parts),
    )

    def once() -> None:
        problem = volume_problem.build(settings, {"m": result})
        assert len(extremes(problem.contributions, problem.points).each) == points**3

    return cpu(once, 3)


@dataclass(frozen=True)
class Repeats:
    """What a table of maxima came to, and how often it held."""

    largest: Array
    """(2, 3): mean of the maxima of part and temperature [mm]"""
    expanded: Array
    """(3,): mean U, k = 2 [mm]"""
    held: Array
    """(8, 3): share of repeats in which U of the volume held the error of each corner"""
    held_pointwise: Array
    """(8, 3): the same for U of that corner alone"""


def repeats(count: int) -> Repeats:
    """Measure, state and compare with the truth many times."""
    from metrocli.nodes import Node, Source

    nowhere = Node("scalar", Source("", (), Path()))
    parts = (Contributor("part", result="part"), Contributor("temperature", expansion=Expansion(ALPHA, WARMTH)))
    settings = Settings(
        volume=VolumeEntry((0.0, 0.0, 0.0), (1500.0, 1000.0, 500.0), (2, 2, 2)),
        contributors=tuple(LocatedValue(part, nowhere) for part in parts),
        monte_carlo=MonteCarlo(trials=0),
    )
    truth = poses.pose_from_euler(np.array([PART.x, PART.y, PART.z]), np.array([PART.alpha, PART.beta, PART.gamma]))
    largest, expanded, held, own = [], [], [], []
    warmth = np.random.default_rng(77).uniform(-WARMTH, WARMTH, count)
    for (result, _), kelvin in zip(aligned(count), warmth, strict=True):
        problem = volume_problem.build(settings, {"part": result})
        found = extremes(problem.contributions, problem.points)
        values = np.array([estimate.value for estimate in result.estimates[:6]])
        stated = poses.apply(poses.pose_from_euler(values[:3], values[3:]), problem.points)
        is_there = poses.apply(truth, problem.points * (1 + ALPHA * kelvin))
        error = np.abs(stated - is_there)
        largest.append(found.largest)
        expanded.append(2 * found.by_contributor)
        held.append(error <= 2 * found.by_contributor)
        own.append(error <= 2 * found.each)
    return Repeats(np.mean(largest, axis=0), np.mean(expanded, axis=0), np.mean(held, axis=0), np.mean(own, axis=0))


def main(count: int = 1000) -> None:
    """Print everything."""
    numpy_s, ours_s = cpu(lambda: plain_numpy(1_000_000)), cpu(lambda: ours(1_000_000))
    print("gauge block of JCGM 101, 9.5, 10^6 trials, shortest 99 % interval: std, interval, CPU s on one thread")
    for name, task, seconds in (("plain numpy", plain_numpy, numpy_s), ("metrocli", ours, ours_s)):
        std, low, high = task(1_000_000)
        print(f"  {name:<12} {std:7.2f}   [{low:.1f}, {high:.1f}]   {seconds:.3f}")
    print(f"  ratio {ours_s / numpy_s:.2f}")
    for trials in (1_000_000, 10_000_000, 100_000_000):
        took = command(trials)
        spent = f"{took.wall_s:.2f} s wall, {took.cpu_s:.2f} s CPU, {took.peak_mb:.0f} MB"
        print(f"  command line, {trials:>9} trials: {spent}")
    print(f"volume of 50 x 50 x 50 points, 20 contributors, 12 parameters with covariance: {large_volume():.2f} s CPU")
    found = repeats(count)
    print(f"table of maxima of {count} simulated measurements (um): x, y, z")
    for name, row in zip(("part", "temperature"), found.largest, strict=True):
        print(f"  u {name:<12}" + "".join(f"{1e3 * value:8.1f}" for value in row))
    print("  U (k = 2)     " + "".join(f"{1e3 * value:8.1f}" for value in found.expanded))
    for name, held in (("least of all corners", found.held.min(axis=0)), ("mean", found.held.mean(axis=0))):
        print(f"  U held the error of a corner, {name}:" + "".join(f"{value:8.1%}" for value in held))
    own = found.held_pointwise.mean(axis=0)
    print("  U of each corner held its own error, mean:" + "".join(f"{value:8.1%}" for value in own))


if __name__ == "__main__":
    main(*(int(text) for text in sys.argv[1:2]))
