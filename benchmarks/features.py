"""Ideal features: time of the fits of 1,000 points, and how minimum zones scatter against what is stated.

Each shape has 25 points in a zone of 10 um, measured 60 times with noise in each coordinate. Scatter over stated is
that of each number that the shape has; the form is compared with that of the points without noise. The last column is
how often value +- 1.96 std, of each measurement, holds the number of the points without noise.

    python -m benchmarks features [MEASUREMENTS [CLOUDS]] [SHAPE]
    python -m benchmarks features proven [POINTS [CLOUDS]] [SHAPE]

With CLOUDS the points are drawn so many times, and the coverage is the mean, with the least and largest of a cloud.
`proven` counts the clouds of POINTS each whose minimum zone has a proof; the others end with exit code 5.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import numpy.typing as npt

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from simulated.features import cloud

from metrocli.errors import NotConvergedError
from metrocli.tasks.shared.features.fit import FeatureFit, least_squares
from metrocli.tasks.shared.features.ideal import IdealFeature
from metrocli.tasks.shared.features.minimum_zone import minimum_zone

Array = npt.NDArray[np.float64]
ZONE, POINTS, MANY, FIRST = 0.005, 25, 1000, 2
"""Half the zone [mm], points, points of the times, and the seed of the first cloud"""


def numbers(fit: FeatureFit, points: Array) -> Array:
    """Return place, direction, radius, half angle and form of a feature."""
    return np.append(np.real(fit.ideal.numbers(points.mean(axis=0))), fit.form)


def times(shape: IdealFeature) -> tuple[float, float]:
    """Return the CPU times of both fits [s]."""
    points = cloud(shape, MANY, ZONE, np.random.default_rng(1))
    found = []
    for fit in (least_squares, minimum_zone):
        start = time.process_time()
        fit(shape, points)
        found.append(time.process_time() - start)
    return found[0], found[1]


def scatter(shape: IdealFeature, noise: float, measurements: int, seed: int) -> tuple[Array, float, float]:
    """Return scatter over stated of each number, by how many of them the form is too large, and the coverage."""
    rng = np.random.default_rng(seed)
    points = cloud(shape, POINTS, ZONE, rng)
    true, found, spread = minimum_zone(shape, points), [], []
    derivative = true.by_points(points).reshape(9, -1)
    for _ in range(measurements):
        measured = points + noise * rng.normal(size=points.shape)
        fit = minimum_zone(shape, measured)
        found.append(numbers(fit, measured))
        spread.append(noise * np.sqrt((fit.by_points(measured).reshape(9, -1) ** 2).sum(axis=1)))
    stated = noise * np.sqrt((derivative**2).sum(axis=1))
    known = stated > 1e-9 * noise
    ratios = np.std(found, axis=0, ddof=1)[known] / stated[known]
    off = np.abs(np.array(found) - numbers(true, points))[:, known]
    inside = float((off < 1.96 * np.array(spread)[:, known]).mean())
    return ratios, float((np.mean(found, axis=0)[8] - true.form) / stated[8]), inside


def proven(number: int, clouds: int, shapes: list[IdealFeature]) -> None:
    """Print how many clouds have a proven minimum zone, and the seeds of those that have none."""
    for shape in shapes:
        without, began = [], time.process_time()
        for seed in range(clouds):
            try:
                minimum_zone(shape, cloud(shape, number, ZONE, np.random.default_rng(seed)))
            except NotConvergedError:
                without.append(seed)
        took = time.process_time() - began
        print(f"{shape}, {number} points: {clouds - len(without)} of {clouds} are proven, {took:.0f} s CPU", *without)


def main(measurements: int, clouds: int, shapes: list[IdealFeature]) -> None:
    """Print both tables."""
    print(f"{MANY} points, CPU s: least squares, minimum zone")
    for shape in shapes:
        print(f"  {shape:10s} {times(shape)[0]:6.3f} {times(shape)[1]:6.3f}")
    print(f"{POINTS} points in zones of {2e3 * ZONE:g} um, {measurements} measurements of {clouds} clouds:")
    print("  noise, shape, scatter over stated, form, inside 95 %")
    for noise in (0.0002, 0.001):
        for shape in shapes:
            found = [scatter(shape, noise, measurements, FIRST + cloud) for cloud in range(clouds)]
            ratios = np.concatenate([one for one, _, _ in found])
            form, inside = np.mean([one[1] for one in found]), np.array([one[2] for one in found])
            spread = f"{ratios.min():5.2f} to {ratios.max():5.2f}"
            each = f" ({inside.min():.1%} to {inside.max():.1%})" if clouds > 1 else ""
            print(f"  {1e3 * noise:3.1f} um {shape:10s} {spread} {form:+6.2f} {inside.mean():6.1%}{each}")


if __name__ == "__main__":
    given = sys.argv[1:]
    counts = [int(word) for word in given if word.isdigit()]
    chosen = [shape for shape in IdealFeature if shape in given] or list(IdealFeature)
    if "proven" in given:
        proven(counts[0] if counts else POINTS, counts[1] if len(counts) > 1 else 100, chosen)
    else:
        main(counts[0] if counts else 60, counts[1] if len(counts) > 1 else 1, chosen)
