"""Are the standard uncertainties of beacons right where radio ranges share errors along a drive?

Each drive (Plaza, see benchmarks/ranges.py) is halved at random, by single points in time or by stretches of it, and
each half places the beacons by itself, with the scale of all ranges estimated. The difference of two halves over the
root of the sum of their variances, z, has a root mean square of about 1 where the uncertainties are right. Halves of
single points interleave: what varies slowly is the same in both, and no difference shows it.

    python -m benchmarks halved_drives [HALVINGS]
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.ranges import DATA, DRIVES
from metrocli.errors import MetrocliError
from metrocli.formats import csv
from metrocli.project.job import load
from metrocli.project.runner import compute
from metrocli.table import TEXT, Column, Columns, Table

Array = npt.NDArray[np.float64]
STRETCHES = 32
"""Stretches of equally many ranges into which a drive is cut, half of which make a half"""
JOB = """metrocli: 1
job: multilaterate
inputs: {{lengths: lengths.csv, points: points.csv, tracers: {tracers}}}
measures: absolute
noise: {{constant: 500 mm, model: {noise}}}
outliers: remove
effects: [{{name: length-scale}}]
output: beacons.h5
"""
LENGTHS = Columns((Column("point", TEXT), Column("tracer", TEXT), Column("length", "length"), Column("t", "time")))
POINTS = Columns((Column("point", TEXT), *(Column(axis, "length") for axis in (*"xyz", "sigma"))))


def beacons(drive: str, lengths: Table, noise: str) -> tuple[Array, Array]:
    """Return the places of the beacons from some ranges of a drive, with their standard uncertainties [mm]."""
    points = csv.read(DATA / f"{drive}_points.csv", POINTS)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        csv.write(folder / "lengths.csv", lengths)
        csv.write(folder / "points.csv", selected(points, np.isin(points.texts("point"), lengths.texts("point"))))
        (folder / "job.yaml").write_text(JOB.format(tracers=DATA / f"{drive}_tracers.csv", noise=noise))
        result, _ = compute(load(folder / "job.yaml"))
    found = [one for one in result.estimates if one.name.endswith((".x", ".y"))]
    return np.array([one.value for one in found]), np.array([one.std for one in found])


def selected(table: Table, rows: npt.NDArray[np.bool_]) -> Table:
    """Return some rows of a table."""
    return Table({name: values[rows] for name, values in table.columns.items()}, table.units)


def of_points(count: int, rng: np.random.Generator) -> npt.NDArray[np.bool_]:
    """Return a random half of single ranges."""
    return rng.permutation(count) < count // 2


def of_stretches(count: int, rng: np.random.Generator) -> npt.NDArray[np.bool_]:
    """Return a random half of the stretches of a drive."""
    return np.asarray(of_points(STRETCHES, rng)[np.arange(count) * STRETCHES // count])


WAYS: dict[str, Callable[[int, np.random.Generator], npt.NDArray[np.bool_]]] = {
    "points": of_points,
    "stretches": of_stretches,
}


def main(halvings: int = 20) -> None:
    """Print the root mean square of z."""
    if not DATA.is_dir():
        print(f"no measured data at {DATA}")
        return
    for drive in DRIVES:
        lengths = csv.read(DATA / f"{drive}_lengths.csv", LENGTHS)
        for way, half in WAYS.items():
            for noise in ("structured", "estimated"):
                rng, found = np.random.default_rng(2024), []
                for _ in range(halvings):
                    first = half(len(lengths), rng)
                    try:
                        (one, u), (other, v) = (
                            beacons(drive, selected(lengths, own), noise) for own in (first, ~first)
                        )
                    except MetrocliError as error:
                        print(f"{drive}: a half has no result: {str(error).splitlines()[0]}")
                        continue
                    found.append((one - other) / np.hypot(u, v))
                z = np.array(found)
                print(f"{drive}, halves of {way:9}  {noise:10} rms of z {np.sqrt((z**2).mean()):.2f}", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
