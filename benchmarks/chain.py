"""The chain of the sample raw-part: what each link adds to the uncertainty of a point in the machine.

The part is aligned again with one link after the other taken as exact; variances are differences of two such runs.

    python -m benchmarks chain
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import numpy.typing as npt

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from simulated.castings import turn

from metrocli.formats import hdf5
from metrocli.result import Result

Array = npt.NDArray[np.float64]
SAMPLE = Path(__file__).parents[1] / "sample_projects" / "raw-part"
CORNERS = np.array([[x, y, z] for x in (0, 1500) for y in (0, 1000) for z in (0, 400)], dtype=float)
STEPS = np.array([1e-3, 1e-3, 1e-3, 1e-6, 1e-6, 1e-6])


def run(folder: Path, *words: str) -> None:
    """Run a command in the project."""
    subprocess.run([sys.executable, "-m", "metrocli", *words], cwd=folder, check=True, capture_output=True)


def largest(folder: Path, file: str) -> Array:
    """Return the largest variances of the corners of the part in the machine, (3,) um^2."""
    result = hdf5.read(folder / file)[0]
    pose = np.array([one.value for one in result.estimates[:6]])

    def corners(at: Array) -> Array:
        return np.asarray(CORNERS @ turn(at[3:]).T + at[:3])

    by = np.stack([(corners(pose + h) - corners(pose - h)) / (2 * h.sum()) for h in np.diag(STEPS)], axis=2)
    return np.asarray(1e6 * np.einsum("nka,ab,nkb->nk", by, result.covariance[:6, :6], by).max(axis=0))


def write_exact(fit: Result, file: Path) -> None:
    """Write the targets of a fit as a list of exact ones."""
    table = fit.tables["targets"]
    rows = zip(table.texts("target"), table.stacked("xyz").tolist(), strict=True)
    lines = [f"{name},{x:.6f},{y:.6f},{z:.6f}" for name, (x, y, z) in rows]
    file.write_text("\n".join(["target,x_mm,y_mm,z_mm", *lines, ""]))


def write_camera(camera: Result, file: Path) -> None:
    """Write a calibrated camera as a file without uncertainties."""
    place = {one.name: one.value for one in camera.estimates}
    lens = camera.tables["camera"]
    lines = ["image_size: [2592, 1944]"]
    for name, value, unit in zip(lens.texts("parameter"), lens.numbers("value"), lens.texts("unit"), strict=True):
        lines.append(f"{name}: {float(value)!r}{' px' if unit == 'px' else ''}")
    at = [f"{name}: {place[name]!r} mm" for name in "xyz"]
    at += [f"{name}: {place[name]!r} rad" for name in ("alpha", "beta", "gamma")]
    file.write_text("\n".join([*lines, f"extrinsics: {{{', '.join(at)}}}", ""]))


def main() -> None:
    """Print what each link adds, U of the whole chain, and its share of the tolerance."""
    with TemporaryDirectory() as place:
        folder = Path(place) / "raw-part"
        shutil.copytree(SAMPLE, folder)
        run(folder, "run")
        fit, camera = (hdf5.read(folder / "results" / f"{name}.h5")[0] for name in ("fit", "camera"))
        write_exact(fit, folder / "exact.csv")
        write_camera(camera, folder / "camera.yaml")
        variances = [largest(folder, "results/align.h5")]
        given: list[str] = []
        for change in ("targets=../exact.csv", "camera=../camera.yaml"):
            given = [one for one in given if one.split("=")[0] != change.split("=")[0]] + [change]
            words = [word for one in given for word in ("--set", f"inputs.{one}")]
            run(folder, "align-part", "jobs/align.yaml", *words, "--output", "results/other.h5", "--force")
            variances.append(largest(folder, "results/other.h5"))
        links = ("targets in the fitted frame", "camera", "image noise, clamping")
        steps = [*(before - after for before, after in pairwise(variances)), variances[-1]]
        print("standard uncertainty at the worst corner [um]:      x      y      z")
        for name, one in zip(links, steps, strict=True):
            print(f"{name:46s}", "".join(f"{value:7.1f}" for value in np.sqrt(np.maximum(one, 0))))
        print(f"{'pose in the machine, together':46s}", "".join(f"{value:7.1f}" for value in np.sqrt(variances[0])))
        shown = subprocess.run(
            [sys.executable, "-m", "metrocli", "show", "results/uncertainty.h5"],
            cwd=folder,
            check=True,
            capture_output=True,
            text=True,
        )
        print(shown.stdout.partition("largest in the volume")[2])


if __name__ == "__main__":
    main()
