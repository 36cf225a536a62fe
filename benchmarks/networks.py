"""Networks at random: whether points are off by what their covariances say, and how the time grows with their number.

    python -m benchmarks networks [COUNT]        # networks of five make-ups, 100 unless given

A fifth as many have trackers three times as noisy as declared, and `noise: estimated` beside bars and given points.

z is an error of a point in units of its standard uncertainty, after what the datum leaves open is removed: in inner
constraints the true points are laid onto the list as the adjusted ones are. The networks are those of the tests,
written without the engine. Bars: z rms 0.95 to 1.05; 40 stations x 5,000 points in 20 s of CPU and 2 GB; the time grows
with the number of points to the power 1.1 at most.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from simulated.network import BAR, GIVEN, Array, Network, network, sigmas

from benchmarks.bars import Number
from metrocli.formats import hdf5
from metrocli.project import runner
from metrocli.project.job import load

MAKES: dict[str, dict[str, Any]] = {
    "trackers, one face": {},
    "trackers, both faces": {"faces": 2},
    "one station on its side": {"rolled": True},
    "levelled": {"levelled": True},
    "interferometers, bars, heights": {"mixed": True},
}
ESTIMATED = "noise three times the declared one, estimated beside bars and given points"
LARGE = ((40, 1250), (40, 2500), (40, 5000))
"""Stations and points"""


def noisier(rng: np.random.Generator) -> Network:
    """Return a network whose trackers have three times the declared noise; bars and given points have their own."""
    net = network(rng)
    near = net.near.copy()
    near[:4] = net.points[:4] + rng.normal(0, GIVEN, (4, 3))
    bars = tuple(
        (a, b, float(np.linalg.norm(net.points[a] - net.points[b]) + rng.normal(0, BAR))) for a, b in ((4, 5), (6, 7))
    )
    more = np.sqrt(8) * rng.normal(size=net.seen.shape) * sigmas(net.seen)
    return replace(net, near=near, given=(0, 1, 2, 3), bars=bars).with_effect(more)


def solved(net: Network, folder: Path, more: str = "") -> tuple[Array, Array]:
    """Return points and their joint covariance."""
    runner.carry_out(load(net.write(folder, more)))
    result = hdf5.read(folder / "result.h5")[0]
    order = [result.tables["points"].texts("point").index(name) for name in net.names]
    n = len(order)
    joint = result.arrays["points_joint_covariance"].reshape(n, 3, n, 3)[order][:, :, order].reshape(3 * n, 3 * n)
    return result.tables["points"].stacked("xyz")[order], joint


def in_datum(net: Network, points: Array) -> Array:
    """Return the true points moved so that they meet the inner constraints, to first order."""
    if net.given:
        return points
    axes = [2] if net.levelled else [0, 1, 2]
    moves = [np.broadcast_to(np.eye(3)[k], points.shape) for k in range(3)]
    moves += [np.cross(np.eye(3)[k], net.near) for k in axes]
    g = np.stack([one.ravel() for one in moves], axis=1)
    off = (points - net.near).ravel()
    return points - (g @ np.linalg.solve(g.T @ g, g.T @ off)).reshape(points.shape)


def z_of(net: Network, folder: Path, more: str = "") -> float:
    """Return the mean square of the errors in units of their joint covariance."""
    points, joint = solved(net, folder, more)
    error = (points - in_datum(net, net.points)).ravel()
    values, vectors = np.linalg.eigh(joint)
    kept = values > 1e-9 * values[-1]
    return float(((vectors[:, kept].T @ error) ** 2 / values[kept]).mean())


def main(arguments: list[str]) -> int:
    """Print z rms by make-up, then time and memory of large networks; return 1 where a bar is not met."""
    count, squares = int(arguments[0]) if arguments else 100, []
    with tempfile.TemporaryDirectory() as where:
        folder = Path(where)
        for make, more in MAKES.items():
            own = [
                z_of(network(np.random.default_rng([k, len(make)]), **more), folder) for k in range(count // len(MAKES))
            ]
            squares += own
            print(Number(f"z rms, {make}", f"{len(own)} networks", float(np.sqrt(np.mean(own)))), flush=True)
        own = [z_of(noisier(np.random.default_rng([k, 7])), folder, "noise: estimated\n") for k in range(count // 5)]
        squares += own
        print(Number(f"z rms, {ESTIMATED}", f"{len(own)} networks", float(np.sqrt(np.mean(own)))), flush=True)
        whole = Number("z rms of all points", f"{len(squares)} networks", float(np.sqrt(np.mean(squares))), 0.95, 1.05)
        print(whole, flush=True)
        took = [_time_of(stations, points, folder) for stations, points in LARGE]
    power = float(np.log(took[-1] / took[-2]) / np.log(LARGE[-1][1] / LARGE[-2][1]))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"growth with the number of points: power {power:.2f} (at most 1.1); {memory:.2f} GB", flush=True)
    return int(not (whole.met and took[-1] <= 20 and power <= 1.1 and memory <= 2))


def _time_of(stations: int, points: int, folder: Path) -> float:
    job = network(np.random.default_rng(5), stations, points).write(folder)
    begin = time.process_time()
    runner.carry_out(load(job))
    took = time.process_time() - begin
    print(f"{stations} stations x {points} points: {took:.2f} s of CPU", flush=True)
    return took


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
