"""Pages of large results: CPU seconds of `metrocli report`, the least of several runs, and size of the page.

A network of 100 images by 100 points shows ten figures; the bars are 3 s and 1.5 MB. A result with 1,000,000 residuals
has 10 s and 2 MB. Its worst reading is planted, and must be in the page.

    python -m benchmarks pages
"""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.command_speed import cpu
from metrocli.formats import hdf5
from metrocli.record import Record
from metrocli.result import Estimate, Result
from metrocli.table import Table

RECORD = Record("metrocli: 1\njob: calibrate-camera\n", (), "0.1.0", "2026-11-22T00:00:00Z")
LENS = ("f", "cx", "cy", "k1", "k2", "p1", "p2")
BARS = {100: (3.0, 1.5e6), 5000: (10.0, 2e6)}


def network(images: int, points: int) -> Result:
    """Return a network whose readings have pure noise, and one wrong reading of 9 standard deviations."""
    rng = np.random.default_rng(images)
    n = images * points
    w = rng.normal(size=(n, 2))
    w[n // 3] = [9.0, 0.0]
    image = np.array([f"image{i:04d}" for i in range(images)])
    point = np.array([f"P{i:04d}" for i in range(points)])
    columns = {
        "image": np.repeat(image, 2 * points),
        "target": np.tile(np.repeat(point, 2), images),
        "component": np.tile(["u", "v"], n),
        "reading": (rng.random((n, 2)) * [4096, 3000]).ravel(),
        "residual": 0.05 * w.ravel(),
        "sigma": np.full(2 * n, 0.05),
        "normalised": w.ravel(),
        "redundancy": np.ones(2 * n),
        "t": np.repeat(np.arange(images) * 20.0, 2 * points),
        "temp": np.repeat(20 + np.cumsum(rng.normal(size=images)) * 0.01, 2 * points),
    }
    units = {"reading": "px", "residual": "px", "sigma": "px", "t": "s", "temp": "degC"}
    mm = dict.fromkeys(("x", "y", "z", "sx", "sy", "sz"), "mm")
    at, eyes = rng.random((points, 3)) * 2000, rng.random((images, 3)) * 4000
    spread = {name: np.full(points, size) for name, size in (("sx", 0.01), ("sy", 0.01), ("sz", 0.02))}
    tables = {
        "residuals": Table(columns, units),
        "points": Table({"point": point, **dict(zip("xyz", at.T, strict=True)), **spread}, mm),
        "views": Table({"image": image, **dict(zip("xyz", eyes.T, strict=True))}, mm),
    }
    root = rng.normal(size=(7, 7))
    covariance = root @ root.T
    statistics = {"rig": "network", "image_width": 4096, "image_height": 3000, "sigma0": 1.0, "dof": 2 * n}
    stds = np.sqrt(np.diag(covariance)).tolist()
    estimates = tuple(Estimate(name, 1.0, std, "px") for name, std in zip(LENS, stds, strict=True))
    return Result("calibrate-camera", "Network", estimates, covariance, statistics, tables)


def main() -> None:
    """Print CPU seconds, size and number of figures; raise SystemExit if a bar is missed."""
    missed = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        python = cpu(["-c", "pass"], str(folder / "compiled"))
        print(f"python alone: {python:.2f} s CPU")
        for images, (seconds, size) in BARS.items():
            path = folder / f"{images}.h5"
            hdf5.write(path, network(images, 100), RECORD)
            taken = cpu(["-m", "metrocli", "report", str(path), "--quiet"], str(folder / "compiled"))
            page = path.with_suffix(".html").read_text(encoding="utf-8")
            figures = len(re.findall('<figure id="figure-', page))
            worst = "|w| = 9.00 standard deviations" in page
            print(
                f"{2 * images * 100} residuals: {taken:.2f} s CPU (bar {seconds:g}), {len(page) / 1e6:.2f} MB "
                f"(bar {size / 1e6:g}), {figures} figures, worst reading {'named' if worst else 'MISSING'}"
            )
            if taken > seconds or len(page) > size or not worst:
                missed.append(str(images))
    if missed:
        raise SystemExit(f"bars missed: {', '.join(missed)} images")


if __name__ == "__main__":
    main()
