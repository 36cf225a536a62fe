"""Small jobs of about 100 readings: simulated ones, and samples of which some rows are kept."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from metrocli.formats import csv, hdf5
from metrocli.table import Table

_MACHINE = """metrocli: 1
job: calibrate-machine
machine:
  chain: wXbYZt
  axes:
    x: {range: [0 mm, 600 mm], knots: 3}
    y: {range: [-260 mm, 260 mm], knots: 3}
    z: {range: [-500 mm, 0 mm], knots: 3}
  tool: [0 mm, 0 mm, 120 mm]
output: result.h5
"""
SIMULATED = {
    "selfcal-grid": """metrocli: 1
job: selfcal-grid
inputs: {views: views.csv}
grid: {size: [3, 3, 1], pitch: 65 mm}
views:
  - {name: "1"}
  - {name: "2", rotate: {axis: z, angle: 90 deg}}
  - {name: "3", rotate: {axis: z, angle: 180 deg}}
  - {name: "4", shift: [1, 0, 0]}
noise: 5 um
simulation: {machine_error: 17 um, artefact_error: 0.2 mm, shift: 0.2 mm, tilt: 1 mrad}
output: result.h5
""",
    "calibrate-machine, lengths": _MACHINE
    + """method: lengths
inputs: {lengths: lengths.csv}
noise: {constant: 0.3 um, proportional: 0.2 um/m, repeatability: estimated}
simulation: {error: 20 um, points: 25}
""",
    "calibrate-machine, standstill": _MACHINE
    + """method: standstill
inputs: {points: points.csv}
noise: {beam: 1 um, lateral: 5 um}
simulation: {error: 20 um, points: 34}
""",
    "calibrate-machine, six-dof": _MACHINE
    + """method: six-dof
inputs: {lines: lines.csv}
noise: {displacement: 0.5 um, straightness: 1 um, angle: 1 urad}
simulation: {error: 20 um}
""",
    "calibrate-machine, on-the-fly": _MACHINE
    + """method: on-the-fly
inputs: {path: path.csv, track: track.csv}
noise: {beam: 1 um, lateral: 5 um}
simulation: {error: 20 um, sampling: 1 s, feed: 6000 mm/min}
""",
}
"""Jobs with what they simulate, by kind and method"""
_VERTICES, _TARGETS = 14, 8


def written(folder: Path, samples: Path) -> dict[str, Path]:
    """Write the small jobs below a folder, from the samples with their results, and return their paths."""
    jobs = {kind: folder / kind.replace(", ", "-") / "job.yaml" for kind in SIMULATED}
    for kind, job in jobs.items():
        job.parent.mkdir(parents=True)
        job.write_text(SIMULATED[kind])
        if "on-the-fly" in kind:
            _kept(samples / "otf-tracker/data/path.csv", job.parent / "path.csv", lambda path: np.arange(_VERTICES))
        made = job.parent / "simulated"
        command = [sys.executable, "-m", "metrocli", "simulate", str(job), "--seed", "1", "--out", str(made)]
        subprocess.run(command, check=True, capture_output=True)
        for file in made.glob("*.csv"):
            shutil.copy(file, job.parent)
    lines = jobs["calibrate-machine, six-dof"].parent / "lines.csv"
    _kept(lines, lines, _ends_and_middles)
    return jobs | {"align-part": _aligned(folder / "align", samples), "fit-part": _fitted(folder / "fit", samples)}


def _kept(source: Path, target: Path, rows: Callable[[Table], np.typing.NDArray[np.intp]]) -> None:
    """Write some rows of a CSV file, as they stand."""
    head, *lines = [line for line in source.read_text().splitlines() if not line.startswith("#")]
    cells = np.array([line.split(",") for line in lines])
    table = Table(dict(zip(head.split(","), cells.T, strict=True)))
    target.write_text("\n".join([head, *(lines[row] for row in rows(table))]) + "\n")


def _ends_and_middles(lines: Table) -> np.typing.NDArray[np.intp]:
    """Return a row at each end and in the middle of each line."""
    names, position = np.asarray(lines.columns["line"]), np.asarray(lines.columns["position_mm"], dtype=float)
    chosen = []
    for name in np.unique(names):
        rows = np.flatnonzero(names == name)
        places = np.unique(position[rows], return_index=True)[1]
        chosen += rows[places[[0, len(places) // 2, -1]]].tolist()
    return np.array(sorted(chosen), dtype=np.intp)


def _aligned(folder: Path, samples: Path) -> Path:
    """Write the alignment of the raw part with every third image, and return its path."""
    raw_part = samples / "raw-part"
    for name in ("machine", "results"):
        shutil.copytree(raw_part / name, folder / name)
    observations = folder / "machine/observations.csv"

    def rows(table: Table) -> np.typing.NDArray[np.intp]:
        images = table.texts("image")
        chosen = list(dict.fromkeys(images))[::3]
        return np.flatnonzero(np.isin(images, chosen))

    _kept(observations, observations, rows)
    job = folder / "job.yaml"
    job.write_text((raw_part / "jobs/align.yaml").read_text().replace("../", ""))
    return job


def _fitted(folder: Path, samples: Path) -> Path:
    """Write the fit of the raw part to every fourth point of a surface and some targets, and return its path."""
    raw_part = samples / "raw-part"
    folder.mkdir()
    points = hdf5.read(raw_part / "results/photogrammetry.h5")[0].tables["points"]
    names = np.array(points.texts("point"))
    targets = np.flatnonzero(np.char.startswith(names, "T"))[:_TARGETS]
    numbers = np.array([int(name.rpartition("-")[2]) if "-" in name else 0 for name in names.tolist()])
    surface = np.flatnonzero((numbers % 4 == 1) & ~np.char.startswith(names, "T"))
    rows = np.concatenate([surface, targets])
    kept = {name: np.asarray(points.columns[name])[rows] for name in ("point", "x", "y", "z")}
    csv.write(folder / "points.csv", replace(points, columns=kept, units=dict.fromkeys("xyz", "mm"), file=""))
    shutil.copy(raw_part / "part.yaml", folder)
    text = (raw_part / "jobs/fit.yaml").read_text()
    text = text.replace("../results/photogrammetry.h5", "points.csv").replace("../", "")
    (folder / "job.yaml").write_text(text + "noise: 0.02 mm\n")
    return folder / "job.yaml"
