"""Whether stated uncertainties are true: Monte Carlo runs, and how often 95 % intervals hold the truth.

Each run draws everything anew that the job calls uncertain: image noise, the places of the targets where their list has
a sigma, the poses of a board, and for align-part the whole calibration of its camera on a coordinate measuring machine.
Printed for each parameter: coverage of value +- 1.96 std, and the scatter of the values over the mean stated std (1 is
right); for each job: the Kolmogorov distance of the p-values from uniform, times sqrt(runs) (1.63 is exceeded by 1 %).

    python -m benchmarks.coverage [RUNS]
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from metrocli.result import Result
from metrocli.simulation import SimulationOptions
from metrocli.table import Table
from metrocli.tasks.align_part import settings as part_job
from metrocli.tasks.align_part import task as align_part
from metrocli.tasks.calibrate_camera import settings as camera_job
from metrocli.tasks.calibrate_camera import task as calibrate_camera
from metrocli.tasks.calibrate_camera.multi_camera.truth import CameraSimulation
from metrocli.tasks.calibrate_camera.settings import CameraSettings
from metrocli.tasks.shared.images.settings import CameraFile, Extrinsics, LensValues

Array = npt.NDArray[np.float64]
NOWHERE = Path("-")
SIZE = (2592, 1944)
PIXEL = 2.2e-3
"""Side of a pixel of the spindle camera [mm]"""
TRUE_LENS = {"f": 2813.2, "cx": 1286.8, "cy": 999.0, "k1": 0.2372, "k2": -0.1213, "p1": -1.7e-4, "p2": 9.6e-4}
TRUE_MOUNTING = Extrinsics(x=-2.139, y=0.301, z=-320.3, alpha=-0.003, beta=-0.009, gamma=0.03)
ESTIMATED = ("f", "cx", "cy", "k1", "k2", "p1", "p2")
CMM_SIGMA = 0.01
"""How well the machine that carries the target knows its places [mm]"""


@dataclass(frozen=True)
class Drawn:
    """One run: estimates, their stated std, the truth, and the p-value of the global test."""

    names: tuple[str, ...]
    values: Array
    std: Array
    truth: Array
    p_value: float


@dataclass(frozen=True)
class Coverage:
    """What many runs show."""

    names: tuple[str, ...]
    inside: Array
    """(runs, parameters): whether value +- 1.96 std holds the truth"""
    scatter: Array
    """Root mean square error over root mean square stated std, for each parameter"""
    p_values: Array

    @property
    def share(self) -> Array:
        """Share of runs whose interval holds the truth, for each parameter."""
        return np.asarray(self.inside.mean(axis=0))

    @property
    def distance(self) -> float:
        """Kolmogorov distance of the p-values from uniform, times sqrt(runs)."""
        n = len(self.p_values)
        ordered, steps = np.sort(self.p_values), np.arange(n + 1) / n
        return float(np.sqrt(n) * max((steps[1:] - ordered).max(), (ordered - steps[:-1]).max()))


def drawn(result: Result, truth: dict[str, float]) -> Drawn:
    """Return one run of a result against the truth."""
    values, std = (np.array([getattr(e, name) for e in result.estimates]) for name in ("value", "std"))
    names = tuple(e.name for e in result.estimates)
    p_value = result.statistics["p_value"]
    assert isinstance(p_value, float)
    return Drawn(names, values, std, np.array([truth[name] for name in names]), p_value)


def covered(runs: Iterator[Drawn]) -> Coverage:
    """Return what the runs show together."""
    all_runs = list(runs)
    error = np.array([run.values - run.truth for run in all_runs])
    std = np.array([run.std for run in all_runs])
    scatter = np.sqrt((error**2).mean(axis=0) / (std**2).mean(axis=0))
    return Coverage(
        all_runs[0].names, np.abs(error) <= 1.96 * std, scatter, np.array([run.p_value for run in all_runs])
    )


def board(columns: int = 7, rows: int = 5, pitch: float = 30.0) -> Table:
    """Return a board of targets, exact."""
    x, y = np.meshgrid(np.arange(columns) * pitch, np.arange(rows) * pitch)
    names = np.array([f"T{i}" for i in range(x.size)])
    zero = np.zeros(x.size)
    return Table({"target": names, "x": x.ravel(), "y": y.ravel(), "z": zero}, dict.fromkeys("xyz", "mm"))


def planes(distances: tuple[float, ...] = (395.0, 650.0, 900.0, 1150.0, 1430.0), across: int = 4) -> Table:
    """Return places that fill the image of the spindle camera in several planes, in the taper frame."""
    nodes = np.linspace(-0.85, 0.85, across)
    points = [(x * 0.46 * z, y * 0.345 * z, z + TRUE_MOUNTING.z) for z in distances for x in nodes for y in nodes]
    x, y, z = np.array(points).T
    names, sigma = np.array([f"P{i:03d}" for i in range(len(x))]), np.full(len(x), CMM_SIGMA)
    return Table(
        {"target": names, "x": x, "y": y, "z": z, "sigma": sigma}, dict.fromkeys(("x", "y", "z", "sigma"), "mm")
    )


def camera_settings(rig: str, noise: float = 0.05, images: int = 10) -> camera_job.Settings:
    """Return a calibration job whose simulation has the true lens."""
    return camera_job.Settings(
        rig=rig,
        inputs=camera_job.Inputs(observations=NOWHERE, targets=NOWHERE),
        noise=noise,
        camera=CameraSettings(image_size=SIZE, pixel_size=PIXEL, estimate=ESTIMATED),
        simulation=CameraSimulation(
            lens=LensValues(**TRUE_LENS), extrinsics=TRUE_MOUNTING, images=images, distance=330.0, tilt=0.6
        ),
    )


def calibrated(rig: str, seed: int, targets: Table) -> tuple[Result, dict[str, float]]:
    """Return a calibration of simulated readings and the truth behind them."""
    settings = camera_settings(rig)
    simulation = calibrate_camera.simulate(
        calibrate_camera.TASK.job(settings, targets=targets), SimulationOptions(seed)
    )
    result = calibrate_camera.run(
        calibrate_camera.TASK.job(settings, observations=simulation.files["observations.csv"], targets=targets)
    )
    return result, dict(simulation.truth)


def board_runs(runs: int) -> Iterator[Drawn]:
    """Calibrate with a board in new poses each time."""
    targets = board()
    for seed in range(runs):
        yield drawn(*calibrated("board", seed, targets))


def cmm_runs(runs: int) -> Iterator[Drawn]:
    """Calibrate on a coordinate measuring machine that places the targets anew each time."""
    targets = planes()
    for seed in range(runs):
        yield drawn(*calibrated("cmm", seed, targets))


PART_SIGMA = 0.02
"""How well the part's targets are known [mm]"""
PART = Extrinsics(x=120.0, y=80.0, z=35.0, alpha=2.1e-3, beta=-1.3e-3, gamma=12.4e-3)


def corners(sigma: float = PART_SIGMA) -> Table:
    """Return four targets on a part of 1500 mm x 1000 mm."""
    x, y = np.array([0.0, 1500.0, 1500.0, 0.0]), np.array([0.0, 0.0, 1000.0, 1000.0])
    names, columns = np.array(["M1", "M2", "M3", "M4"]), ("x", "y", "z", "sigma")
    return Table(
        {"target": names, "x": x, "y": y, "z": np.array([0.0, 20.0, 0.0, -20.0]), "sigma": np.full(4, sigma)},
        dict.fromkeys(columns, "mm"),
    )


def poses_over(targets: Table, distance: float = 300.0, aside: float = 90.0) -> Table:
    """Return two positions of the spindle for each target, before and behind it, the camera at `distance` from it."""
    at = targets.stacked("xyz") + np.array([PART.x, PART.y, PART.z])
    step = np.tile([[-aside, -aside / 2, 0.0], [aside, aside / 2, 0.0]], (len(at), 1))
    camera = np.repeat(at, 2, axis=0) + step - np.array([0.0, 0.0, distance])
    x, y, z = (camera - np.array([TRUE_MOUNTING.x, TRUE_MOUNTING.y, TRUE_MOUNTING.z])).T
    names = np.array([f"image{i + 1}" for i in range(len(camera))])
    return Table({"image": names, "x": x, "y": y, "z": z}, dict.fromkeys("xyz", "mm"))


def alignment_settings(noise: float, angle: float, seven: bool = True) -> part_job.Settings:
    """Return an alignment job, 7D or 6D, whose simulation has the true part and this clamping angle."""
    return part_job.Settings(
        inputs=part_job.Inputs(camera=NOWHERE, poses=NOWHERE, targets=NOWHERE, observations=NOWHERE),
        noise=noise,
        estimate=("part-pose", "clamping-angle") if seven else ("part-pose",),
        simulation=part_job.AlignSimulation(part=PART, clamping_angle=angle),
    )


def true_camera() -> CameraFile:
    """Return the spindle camera as it is."""
    return CameraFile(image_size=SIZE, extrinsics=TRUE_MOUNTING, **TRUE_LENS)


def align_runs(runs: int) -> Iterator[Drawn]:
    """Calibrate the camera anew each time, clamp it at another angle, and locate the part with it (7D)."""
    for result, truth in aligned(runs):
        yield drawn(result, truth)


def aligned(runs: int) -> Iterator[tuple[Result, dict[str, float]]]:
    """Yield the alignment of each run and the truth behind it."""
    places, targets = planes((395.0, 900.0, 1430.0), 3), corners()
    poses = poses_over(targets)
    for seed in range(runs):
        camera, _ = calibrated("cmm", 10_000 + seed, places)
        angle = float(np.random.default_rng(seed).uniform(-3.1e-3, 3.1e-3))
        settings = alignment_settings(0.05, angle)
        seen = align_part.simulate(
            align_part.TASK.job(settings, true_camera(), poses, targets), SimulationOptions(20_000 + seed)
        )
        result = align_part.run(
            align_part.TASK.job(settings, camera, poses, targets, observations=seen.files["observations.csv"])
        )
        yield result, dict(seen.truth)


JOBS: dict[str, Callable[[int], Iterator[Drawn]]] = {
    "calibrate-camera, rig board": board_runs,
    "calibrate-camera, rig cmm": cmm_runs,
    "align-part, 7D": align_runs,
}


def main(runs: int = 1000) -> None:
    """Print the table."""
    for name, job in JOBS.items():
        found = covered(job(runs))
        print(f"{name}: {runs} runs; p-values: sqrt(n) D = {found.distance:.2f}")
        print(f"  {'parameter':<10} {'coverage':>9} {'scatter / std':>14}")
        for parameter, share, scatter in zip(found.names, found.share, found.scatter, strict=True):
            print(f"  {parameter:<10} {share:>8.1%} {scatter:>14.3f}")
        print(f"  {'all':<10} {found.inside.mean():>8.1%}")


if __name__ == "__main__":
    main(*(int(text) for text in sys.argv[1:2]))
