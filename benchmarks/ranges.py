"""Radio ranges of a vehicle to four beacons against the beacons' survey: the common scale in the model, and left out.

The radios read too long in proportion to the distance. Two drives (Plaza, from the examples of GTSAM; BSD);
points of the drive exact, beacons unknown in x and y, 500 mm declared. The data are not part of the project; where
../shared/data is absent the benchmark reports it and ends.

    python -m benchmarks.ranges
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from metrocli.formats import csv
from metrocli.table import TEXT, Column, Columns

Array = npt.NDArray[np.float64]
DATA = Path(__file__).parents[2] / "shared" / "data" / "plaza-ranges"
DRIVES = ("plaza1", "plaza2")
JOB = """metrocli: 1
job: multilaterate
inputs: {{lengths: {data}_lengths.csv, points: {data}_points.csv, tracers: {data}_tracers.csv}}
measures: absolute
noise: {{constant: 500 mm}}
outliers: remove
effects: {effects}
output: beacons.h5
"""
SURVEY = Columns((Column("tracer", TEXT), Column("x", "length"), Column("y", "length")))


@dataclass(frozen=True)
class Beacons:
    """The beacons as a drive lists them."""

    names: tuple[str, ...]
    error: Array
    """Adjusted minus surveyed (beacons, 2) [mm]"""
    std: Array
    """Stated (beacons, 2)"""
    estimates: dict[str, Any]
    statistics: dict[str, Any]


def adjusted(drive: str, effects: str = "[{name: length-scale}]") -> Beacons:
    """Run the job on a drive."""
    survey = csv.read(DATA / f"{drive}_surveyed_tracers.csv", SURVEY)
    with tempfile.TemporaryDirectory() as folder:
        job = Path(folder) / "job.yaml"
        job.write_text(JOB.format(data=DATA / drive, effects=effects))
        command = [sys.executable, "-m", "metrocli", "multilaterate", str(job), "--json"]
        ran = subprocess.run(command, check=False, capture_output=True, text=True)
        if ran.returncode not in (0, 6):  # 6: doubtful, which is the point of the comparison without the scale
            raise RuntimeError(ran.stderr)
        summary = json.loads(ran.stdout)
    names = tuple(survey.texts("tracer"))
    found = [[summary["estimates"][f"{name}.{axis}"] for axis in "xy"] for name in names]
    value, std = (np.array([[one[key] for one in row] for row in found]) for key in ("value", "std"))
    return Beacons(names, value - survey.stacked("xy"), std, summary["estimates"], summary["statistics"])


def main() -> None:
    """Print the table."""
    if not DATA.is_dir():
        print(f"no measured data at {DATA}")
        return
    for drive in DRIVES:
        for what, effects in (("no scale", "[]"), ("length-scale", "[{name: length-scale}]")):
            found = adjusted(drive, effects)
            worst = np.abs(found.error / found.std).max()
            print(
                f"{drive}, {what:12}: sigma0 {found.statistics['sigma0']:.2f}, beacons off by "
                f"{np.linalg.norm(found.error, axis=1).max():.0f} mm at most, {worst:.1f} standard uncertainties"
            )
            for name, one in found.estimates.items():
                if name.startswith("length-scale"):
                    print(f"  {name} {one['value']:.5f} +- {one['std']:.5f}")
            for name, error, std in zip(found.names, found.error, found.std, strict=True):
                print(f"  {name}  x {error[0]:+6.0f} +- {std[0]:.0f} mm   y {error[1]:+6.0f} +- {std[1]:.0f} mm")


if __name__ == "__main__":
    main()
