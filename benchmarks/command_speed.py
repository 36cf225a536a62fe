"""Whole commands, from text files to the result file: least CPU seconds of several runs, each in a process of its own.

Python alone and numpy show how busy the machine is: the times of all commands grow with it. So the last column has them
in imports of numpy. The modules are compiled before, as after an installation; with PYTHONDONTWRITEBYTECODE=1 each
start compiles all of them again, which takes longer than the rest of a small job. Each run writes its result anew.
First come jobs of about 100 readings of each kind, then larger samples. n is the number of their readings with those
of the priors.

    python -m benchmarks command_speed [POINTS]
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks import camera_speed
from benchmarks.network_speed import CORNERS, VOLUME
from benchmarks.projects import small_jobs
from metrocli.formats import csv, hdf5
from metrocli.table import Table
from metrocli.tasks.shared.images.sightings import Sighted

RUNS = 5
SAMPLES = {
    "align-part": ("spindle-camera/jobs/align.yaml", "raw-part/jobs/align.yaml"),
    "selfcal-grid": ("ball-cube/jobs/views.yaml",),
    "calibrate-machine": ("machine-lengths/jobs/one-tool.yaml", "otf-tracker/jobs/feed-2500.yaml"),
    "fit-part": ("raw-part/jobs/fit.yaml",),
}
"""Jobs of the sample projects"""
COMPARED = ("gear-m3d3/results/tip3.h5", "gear-m3d3/results/tip4.h5")
FEW = ("--set", "monte_carlo.trials=10000")
DOUBTFUL = 6
"""Exit code of a job whose result is doubtful"""


def cpu(arguments: list[str], compiled: str, result: Path | None = None) -> float:
    """Return the CPU seconds of Python with these arguments; raises CalledProcessError if it fails.

    `compiled` is a folder for the compiled modules, `result` a file that is removed before each run.
    """
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPYCACHEPREFIX": compiled}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    seconds = []
    for _ in range(1 + RUNS):
        if result is not None:
            result.unlink(missing_ok=True)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run([sys.executable, *arguments], capture_output=True, env=environment)
        if done.returncode not in (0, DOUBTFUL):
            done.check_returncode()
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(seconds)


def network(folder: Path, n: int, m: int = 4) -> Path:
    """Write a job of n points that m tracers read, and return its path."""
    rng = np.random.default_rng(n)
    points, tracers = rng.uniform(0, 1, (n, 3)) * VOLUME, CORNERS[:m] * VOLUME
    paths = np.linalg.norm(points[:, None] - tracers, axis=2)
    lengths = paths - paths[0] + rng.normal(size=paths.shape) * np.sqrt(1e-8 + (1e-7 * paths) ** 2)
    nominal = np.round(points + rng.normal(0, 0.02, points.shape), 5)
    names, stations = np.array([f"P{i:06d}" for i in range(n)]), np.array([f"LT{j + 1}" for j in range(m)])
    folder.mkdir()
    mm = dict.fromkeys("xyz", "mm")
    csv.write(folder / "points.csv", Table({"point": names, **dict(zip("xyz", nominal.T, strict=True))}, mm))
    about = tracers + rng.normal(0, 2, tracers.shape)
    csv.write(folder / "tracers.csv", Table({"tracer": stations, **dict(zip("xyz", about.T, strict=True))}, mm))
    columns = {"point": np.repeat(names, m), "tracer": np.tile(stations, n), "length": np.round(lengths, 7).ravel()}
    csv.write(folder / "lengths.csv", Table(columns, {"length": "mm"}))
    job = folder / "job.yaml"
    job.write_text(
        "metrocli: 1\njob: multilaterate\n"
        "inputs: {lengths: lengths.csv, points: points.csv, tracers: tracers.csv}\n"
        "noise: {constant: 0.1 um, proportional: 0.1 um/m}\noutput: result.h5\n"
    )
    return job


def camera(folder: Path, views: int, share: float, of: int = 1) -> Path:
    """Write a job of `views` images of 100 targets, a share of them wrong, and return its path.

    Of the targets every `of`-th is kept.
    """
    sighted = camera_speed.scene(views, views)[0]
    readings = sighted.observations.readings
    size = np.array(camera_speed.SIZE)[:, None]
    inside = ((readings > 20) & (readings < size - 20)).all(axis=0)
    whole = np.bincount(sighted.view, inside) == 100
    number = np.unique(sighted.observations.keys["target"], return_inverse=True)[1]
    kept = sighted.observations.selected(whole[sighted.view] & (number % of == 0))
    spoilt = camera_speed.spoilt(Sighted(sighted.images, sighted.targets, kept), share, views)[0].observations
    folder.mkdir()
    columns = {name: np.array(values) for name, values in spoilt.keys.items()}
    columns |= {"u": spoilt.readings[0], "v": spoilt.readings[1]}
    csv.write(folder / "observations.csv", Table(columns, {"u": "px", "v": "px"}))
    targets = sighted.targets
    places = dict(zip("xyz", targets.points.T, strict=True))
    csv.write(folder / "targets.csv", Table({"target": np.array(targets.names), **places}, dict.fromkeys("xyz", "mm")))
    job = folder / "job.yaml"
    job.write_text(
        "metrocli: 1\njob: calibrate-camera\nrig: board\n"
        "inputs: {observations: observations.csv, targets: targets.csv}\n"
        f"camera: {{image_size: {list(camera_speed.SIZE)}, estimate: [{', '.join(camera_speed.TRUTH)}]}}\n"
        "noise: estimated\noutliers: remove\noutput: result.h5\n"
    )
    return job


def main(points: int = 100_000) -> None:
    """Print a line for each command."""

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        numpy = cpu(["-c", "import numpy"], name)
        print(f"{'':<64} {'CPU s':>8} {'in imports of numpy':>20}")

        def line(text: str, *arguments: str, result: Path | None = None) -> None:
            seconds = cpu(list(arguments), str(folder / "compiled"), result)
            print(f"{text:<64} {seconds:>8.3f} {seconds / numpy:>20.1f}", flush=True)

        def job(text: str, kind: str, path: Path, *settings: str) -> None:
            result = path.parent / "result.h5"
            command = ["-m", "metrocli", kind, str(path), "--quiet", "--output", str(result), *settings]
            subprocess.run([sys.executable, *command], capture_output=True)
            line(f"{text}{readings(result)}", *command, result=result)

        line("python alone", "-c", "pass")
        line("python with numpy", "-c", "import numpy")
        line("metrocli --help", "-m", "metrocli", "--help")
        projects = folder / "samples"
        shutil.copytree(Path(__file__).parents[1] / "sample_projects", projects)
        for project in projects.iterdir():  # jobs that take over results need those first
            if project.is_dir():
                subprocess.run([sys.executable, "-m", "metrocli", "run", str(project)], capture_output=True)
        print("small jobs")
        job("multilaterate: 25 points, 4 tracers", "multilaterate", network(folder / "tiny", 25))
        job("calibrate-camera: 5 images", "calibrate-camera", camera(folder / "tiny camera", 8, 0.0, 9))
        job("report-uncertainty", "report-uncertainty", projects / "gauge-block/jobs/gum.yaml", *FEW)
        job("locate-launch-unit", "locate-launch-unit", projects / "xm60-launch-unit/jobs/table.yaml")
        for name, path in small_jobs.written(folder / "small jobs", projects).items():
            job(name, name.partition(",")[0], path)
        compared = [str(projects / one) for one in COMPARED]
        line("compare: 157 points", "-m", "metrocli", "compare", *compared)
        print("larger jobs")
        for kind, paths in SAMPLES.items():
            for path in paths:
                job(f"{kind}: {path}", kind, projects / path)
        job("multilaterate: 100 points, 4 tracers", "multilaterate", network(folder / "small", 100))
        job("calibrate-camera: 5 images", "calibrate-camera", camera(folder / "few", 8, 0.0))
        job(f"multilaterate: {points:,} points, 4 tracers", "multilaterate", network(folder / "large", points))
        job("calibrate-camera: outliers removed", "calibrate-camera", camera(folder / "many", 250, 0.02))


def readings(path: Path) -> str:
    """Return the number of readings of a result in words, "" if it has none."""
    statistics = hdf5.read(path)[0].statistics if path.exists() else {}
    return f", n {statistics['observations']}" if "observations" in statistics else ""


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
