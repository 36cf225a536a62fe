"""Repeatability of a part's alignment with a camera that is clamped anew each time (Mendikute's tables 2 and 3).

One simulated calibration of the camera, kept; then repeats on a part of 1500 mm x 1000 mm with 4 targets, 2 images of
each from 300 mm; between repeats the clamping angle is drawn uniformly within +-3.1 mm/m. Rows: 6D takes the angle as
0; 7D estimates it; the limits have the same image noise, but 7D no change of angle, and 6D the true angle given.

Where the spindle stood is not published. Here the two images of a target are taken (102, -10) mm and (-78, 90) mm
from above it, both 16 mm towards the part's middle: with that the 6D job varies in X and gamma as the published one.
The image noise, 0.1 px, makes the 7D job vary in alpha, beta and gamma as the published one.

    python -m benchmarks.alignment [REPEATS]
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from benchmarks.coverage import (
    PART,
    TRUE_MOUNTING,
    alignment_settings,
    calibrated,
    corners,
    planes,
    true_camera,
)
from metrocli.geometry.poses import EULER
from metrocli.result import Result
from metrocli.simulation import SimulationOptions
from metrocli.table import Table
from metrocli.tasks.align_part import task as align_part

Array = npt.NDArray[np.float64]
NOISE = 0.1
"""Standard deviation of an image coordinate [px]"""
CLAMPING = 3.1e-3
"""Half width of the clamping angle's distribution [rad]"""
DISTANCE = 300.0
ASIDE = ((102.0, -10.0), (-78.0, 90.0))
INWARD = 16.0
"""Where the camera stands for the two images of a target, from above it [mm]"""
NAMES = (*EULER, "gamma_s")
PAPER = {
    "6D": (0.136, 0.056, 0.026, 0.039, 0.056, 0.070),
    "7D": (0.032, 0.030, 0.020, 0.028, 0.024, 0.010, 3.840),
}
"""k = 2, in mm and mm/m"""
PAPER_FACTOR = (4.2, 1.9, 1.3, 1.4, 2.3, 7.0)


@dataclass(frozen=True)
class Row:
    """One way of measuring: 6D or 7D, with which spread of the clamping angle, and whether the angle is known."""

    seven: bool
    spread: float = CLAMPING
    known: bool = False


ROWS = {
    "6D": Row(seven=False),
    "7D": Row(seven=True),
    "limit 7D": Row(seven=True, spread=0.0),
    "limit 6D": Row(seven=False, known=True),
}


def positions(targets: Table) -> Table:
    """Return the spindle's positions: two images of each target."""
    at = targets.stacked("xyz")
    inward = at[:, :2].mean(axis=0) - at[:, :2]
    inward *= INWARD / np.linalg.norm(inward, axis=1, keepdims=True)
    steps = (inward[:, None] + np.array(ASIDE)).reshape(-1, 2)
    camera = np.repeat(at + np.array([PART.x, PART.y, PART.z - DISTANCE]), 2, axis=0)
    camera[:, :2] += steps
    x, y, z = (camera - np.array([TRUE_MOUNTING.x, TRUE_MOUNTING.y, TRUE_MOUNTING.z])).T
    names = np.array([f"image{i + 1}" for i in range(len(camera))])
    return Table({"image": names, "x": x, "y": y, "z": z}, dict.fromkeys("xyz", "mm"))


def repeated(row: Row, camera: Result, repeats: int) -> Array:
    """Return the estimates (repeats, 6 or 7) of repeats that share image noise between rows."""
    targets = corners(0.0)
    poses = positions(targets)
    found = []
    for seed in range(repeats):
        angle = float(np.random.default_rng(seed).uniform(-1.0, 1.0)) * row.spread
        settings = alignment_settings(NOISE, angle, row.seven)
        seen = align_part.simulate(
            align_part.TASK.job(settings, true_camera(), poses, targets), SimulationOptions(1000 + seed)
        )
        turned = turned_by(poses, -angle) if row.known else poses
        result = align_part.run(
            align_part.TASK.job(settings, camera, turned, targets, observations=seen.files["observations.csv"])
        )
        found.append([estimate.value for estimate in result.estimates])
    return np.array(found)


def turned_by(poses: Table, angle: float) -> Table:
    """Return poses with the spindle turned by an angle: R_S(gamma) is a turn by -gamma about the spindle's axis."""
    return Table({**poses.columns, "c": np.full(len(poses), angle)}, {**poses.units, "c": "rad"})


def repeatability(repeats: int) -> dict[str, Array]:
    """Return for each row twice the standard deviation of the estimates, in mm and mm/m."""
    camera, _ = calibrated("cmm", 1, planes())
    scale = np.array([1.0] * 3 + [1e3] * 4)
    found = {name: repeated(row, camera, repeats) for name, row in ROWS.items()}
    return {name: 2 * values.std(axis=0, ddof=1) * scale[: values.shape[1]] for name, values in found.items()}


def seconds(runs: int = 20) -> float:
    """Return the least CPU seconds of a 7D job with covariance, from image points to the result."""
    camera, _ = calibrated("cmm", 1, planes())
    targets = corners()
    poses, settings = positions(targets), alignment_settings(NOISE, 1e-3)
    seen = align_part.simulate(
        align_part.TASK.job(settings, true_camera(), poses, targets), SimulationOptions(1)
    ).files["observations.csv"]
    spent = []
    for _ in range(runs):
        before = time.process_time()
        align_part.run(align_part.TASK.job(settings, camera, poses, targets, observations=seen))
        spent.append(time.process_time() - before)
    return min(spent)


def main(repeats: int = 500) -> None:
    """Print the tables."""
    found = repeatability(repeats)
    print(f"repeatability (k = 2) of {repeats} repeats; mm, mm/m")
    print(f"{'':<16}" + "".join(f"{name:>9}" for name in NAMES))
    for name, values in found.items():
        print(f"{name:<16}" + "".join(f"{value:>9.3f}" for value in values))
    for name, paper in PAPER.items():
        print(f"{name + ', paper':<16}" + "".join(f"{value:>9.3f}" for value in paper))
    for name, factors in (
        ("factor", found["6D"] / found["7D"][:6]),
        ("factor, paper", PAPER_FACTOR),
        ("7D / limit 7D", found["7D"][:6] / found["limit 7D"][:6]),
        ("7D / limit 6D", found["7D"][:6] / found["limit 6D"]),
    ):
        print(f"{name:<16}" + "".join(f"{value:>9.2f}" for value in factors))
    print(f"align-part 7D with covariance, without image work: {seconds() * 1e3:.1f} ms CPU")


if __name__ == "__main__":
    main(*(int(text) for text in sys.argv[1:2]))
