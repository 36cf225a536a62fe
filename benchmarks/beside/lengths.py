"""A network of lengths between 4 tracers and points; the value of an adjustment is the sum of squares that is left."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.beside.work import Values, Work

TRACERS = 4


def ours(points: int) -> Work:
    """`metrocli multilaterate` from text to the result, with the covariance of every point."""
    from benchmarks.network_speed import Problem

    folder = Path(tempfile.mkdtemp())
    Problem.draw(points, TRACERS).write_job(folder)

    def run() -> Values:
        call = [sys.executable, "-m", "metrocli", "multilaterate", str(folder / "job.yaml"), "--quiet", "--force"]
        subprocess.run(call, check=True, capture_output=True)
        if not (folder / "out.h5").stat().st_size:
            raise RuntimeError("there is no result")
        return []

    return run


def engine(points: int) -> Work:
    """metrocli's adjustment alone."""
    from benchmarks.network_speed import Problem
    from metrocli.adjust.adjustment import StoppingRule, adjust

    problem = Problem.draw(points, TRACERS).ours()
    return lambda: [(adjust(**problem, control=StoppingRule(covariance=False)).cost, 0.0)]


def ceres(points: int) -> Work:
    """Ceres' adjustment alone, its fastest form; building the problem is counted."""
    from benchmarks.network_speed import Problem, ceres_program, output

    folder = Path(tempfile.mkdtemp())
    program = ceres_program(folder)
    if program is None:
        raise SystemExit("Ceres: its headers or a compiler are not there")
    Problem.draw(points, TRACERS).write(folder / "problem")
    call = [str(program), str(folder / "problem"), "pairs", "solve", "1e-14"]
    return lambda: [(output(call)["cost"], 0.0)]


def scipy(points: int) -> Work:
    """`scipy.optimize.least_squares` (trf, lsmr) with exact sparse derivatives."""
    from benchmarks.network_speed import Problem, scipy_least_squares

    problem = Problem.draw(points, TRACERS)

    def run() -> Values:
        scipy_least_squares(problem)
        return []

    return run
