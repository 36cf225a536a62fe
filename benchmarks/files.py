"""What starting, reading and writing cost, in CPU time: help, CSV, result files, a project with nothing to do."""

from __future__ import annotations

import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from metrocli.formats import csv, hdf5
from metrocli.record import Record
from metrocli.result import Result
from metrocli.table import TEXT, Column, Columns, Table

if TYPE_CHECKING:
    from metrocli.table import Values

ROWS = 300_000
COLUMNS = Columns(
    (Column("image", TEXT), Column("target", TEXT), Column("u", "pixel"), Column("v", "pixel")), ("image", "target")
)
JOBS = 50
JOB = """metrocli: 1
job: calibrate-camera
rig: board
inputs: {observations: ../observations.csv, targets: ../targets.csv}
camera: {image_size: [640, 480]}
noise: 0.1 px
"""


def costs_of(command: list[str], cache: Path) -> list[float]:
    """Return the CPU seconds of several runs of a command, compiled before as after an installation."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    environment["PYTHONPYCACHEPREFIX"] = str(cache)
    costs = []
    for _ in range(12):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        costs.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return costs[1:]


def cpu_of(command: list[str], cache: Path) -> float:
    """Return the median CPU time of a command in milliseconds."""
    return 1e3 * statistics.median(costs_of(command, cache))


def timed(work: Callable[[], object]) -> float:
    """Return the CPU seconds of one call."""
    start = time.process_time()
    work()
    return time.process_time() - start


def readings() -> Table:
    """Return a table as an image measurement has it."""
    random = np.random.default_rng(0)
    rows = np.arange(ROWS)
    columns: dict[str, Values] = {
        "image": np.char.add("I", (rows // 100).astype(str)),
        "target": np.char.add("T", (rows % 100).astype(str)),
        "u": random.uniform(0, 2000, ROWS),
        "v": random.uniform(0, 2000, ROWS),
    }
    return Table(columns, {"u": "px", "v": "px"})


def idle_project(folder: Path) -> Path:
    """Write a project of many jobs whose results are up to date."""
    from metrocli import __version__
    from metrocli.project.fingerprint import of_job
    from metrocli.project.inputs import read_with_files
    from metrocli.project.job import load

    (folder / "jobs").mkdir()
    (folder / "observations.csv").write_text("image,target,u_px,v_px\na,1,2,3\n")
    (folder / "targets.csv").write_text("target,x_mm,y_mm,z_mm\n1,0,0,0\n")
    names = [f"jobs/job{number}.yaml" for number in range(JOBS)]
    (folder / "metrocli.yaml").write_text(f"jobs: [{', '.join(names)}]\n")
    empty = Result("calibrate-camera", "", (), np.zeros((0, 0)), {})
    for name in names:
        (folder / name).write_text(JOB)
        job = load(folder / name)
        _, files = read_with_files(job)
        hdf5.write(job.output, empty, Record(job.text, files, __version__, "", meaning=of_job(job)))
    return folder


def main() -> None:
    """Print one line a cost."""
    program = [sys.executable, "-m", "metrocli"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cache = folder / "cache"
        for arguments in (["--help"], ["--version"], ["align-part", "--help"], ["check", "--help"]):
            print(f"metrocli {' '.join(arguments):20} {cpu_of(program + arguments, cache):6.0f} ms CPU")
        table = readings()
        print(f"CSV written  {ROWS / timed(lambda: csv.write(folder / 'r.csv', table)):10.0f} rows/s")
        print(f"CSV read     {ROWS / timed(lambda: csv.read(folder / 'r.csv', COLUMNS)):10.0f} rows/s")
        result = Result("x", "", (), np.zeros((0, 0)), {}, {"residuals": table})
        record = Record("", (), "", "")
        print(f"HDF5 written {ROWS / timed(lambda: hdf5.write(folder / 'r.h5', result, record)):10.0f} rows/s")
        print(f"HDF5 read    {ROWS / timed(lambda: hdf5.read(folder / 'r.h5')):10.0f} rows/s")
        (folder / "project").mkdir()
        idle = str(idle_project(folder / "project"))
        print(f"run of {JOBS} jobs, nothing to do {cpu_of([*program, 'run', idle, '--quiet'], cache):6.0f} ms CPU")


if __name__ == "__main__":
    main()
