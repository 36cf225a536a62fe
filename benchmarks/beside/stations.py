"""A network of trackers: `metrocli adjust-network`, and a dense adjustment that shares nothing with it."""

from __future__ import annotations

import importlib
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.beside.work import Values, Work

STATIONS = 6
TESTS = Path(__file__).parents[2] / "tests"


def _network(points: int) -> Any:
    sys.path.insert(0, str(TESTS))
    return importlib.import_module("simulated.network").network(np.random.default_rng(5), STATIONS, points)


def ours(points: int) -> Work:
    """metrocli, from the files to the result with all covariances, in its process."""
    from metrocli.formats import hdf5
    from metrocli.project import runner
    from metrocli.project.job import load

    folder = Path(tempfile.mkdtemp())
    job = load(_network(points).write(folder))

    def run() -> Values:
        runner.carry_out(job)
        return [(float(hdf5.read(folder / "result.h5")[0].statistics["chi2"]), 0.0)]

    return run


def dense(points: int) -> Work:
    """The dense adjustment of the tests, from arrays in memory."""
    network = _network(points)
    sys.path.insert(0, str(TESTS / "tasks" / "adjust_network"))
    program = importlib.import_module("dense")
    return lambda: [(float(program.Dense(network).solve()[2]), 0.0)]
