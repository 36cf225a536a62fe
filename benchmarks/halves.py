"""Are the standard uncertainties of a camera calibration right where readings of one image share errors?

Each measured set is halved at random by images, and each half is calibrated on its own. The difference of two halves
over the root of the sum of their variances, z, then has a root mean square of about 1. Simulations with a smooth random
error in each image count how often the 95 % intervals contain the truth.

python -m benchmarks halves [HALVINGS [RUNS]]
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt
from scipy.special import stdtrit

from benchmarks.bars import Number
from benchmarks.references import DATA, NOWHERE, network_job
from metrocli.errors import MetrocliError
from metrocli.formats import csv, images
from metrocli.result import Result
from metrocli.table import Table
from metrocli.targets.find import find
from metrocli.targets.pattern import Pattern, pattern_points
from metrocli.tasks.calibrate_camera import task as calibrate_camera
from metrocli.tasks.calibrate_camera.settings import CameraSettings, Files, Inputs, Settings
from metrocli.tasks.job import Job
from metrocli.tasks.shared.images.sightings import OBSERVATIONS
from metrocli.tasks.shared.images.target_list import TARGETS

Array = npt.NDArray[np.float64]

COMPARED = ("f", "cx", "cy")
FEWEST = 5
"""Fewest images of a half"""
DETECTED = {
    "left": ("opencv-chessboards/left*.jpg", Pattern("chessboard", 9, 6, 25.0)),
    "right": ("opencv-chessboards/right*.jpg", Pattern("chessboard", 9, 6, 25.0)),
    "sony-circles": ("sony-circles/image*.jpg", Pattern("circles", 8, 10, 25.0, diameter=15.0)),
}
READ = {
    "left (OpenCV's corners)": "opencv-chessboards/left",
    "left_SB (OpenCV's corners)": "opencv-chessboards/left_SB",
    "sony-chess (OpenCV's corners)": "sony-chess/points",
}
SIGMA, FOCAL, SIZE, LENGTH = 0.05, 2000.0, (2592, 1944), 600.0
"""Simulation: noise [px], focal length [px], image size [px], and length of the smooth error [px]"""
TRUE = {"f": FOCAL, "cx": 1296.0, "cy": 972.0, "k1": -0.1, "k2": 0.05, "p1": 0.0, "p2": 0.0}


@dataclass(frozen=True)
class Fitted:
    """Some parameters with their standard uncertainties."""

    values: Array
    std: Array


def board_job(observations: Table, targets: Table, size: tuple[int, int]) -> Job[Settings, Files]:
    """Return the calibration of a board."""
    settings = Settings(
        rig="board",
        inputs=Inputs(observations=NOWHERE, targets=NOWHERE),
        noise="estimated",
        camera=CameraSettings(image_size=size),
    )
    return calibrate_camera.TASK.job(settings, observations=observations, targets=targets)


def detected(pattern: Pattern, files: str) -> tuple[Table, Table]:
    """Return the targets that are found in images, and the list of targets."""
    rows: list[tuple[str, str, float, float]] = []
    for path in sorted(DATA.glob(files)):
        found = find(pattern, images.read(path))
        rows += [(path.name, name, u, v) for name, (u, v) in zip(found.targets, found.uv.tolist(), strict=True)]
    image, target, u, v = (np.array(column) for column in zip(*rows, strict=True))
    listed, points = pattern_points(pattern)
    x, y, z = points.T
    return (
        Table({"image": image, "target": target, "u": u, "v": v}, {"u": "px", "v": "px"}),
        Table({"target": np.array(listed), "x": x, "y": y, "z": z}, dict.fromkeys("xyz", "mm")),
    )


def fitted(job: Job[Settings, Files], noise: str, targets: str = "listed") -> Fitted:
    """Return the compared parameters of a calibration."""
    result = calibrate_camera.run(replace(job, settings=replace(job.settings, noise=noise, targets=targets)))
    known = {one.name: one for one in result.estimates}
    return Fitted(*(np.array([getattr(known[name], key) for name in COMPARED]) for key in ("value", "std")))


def by_opencv(job: Job[Settings, Files]) -> Fitted:
    """Return the compared parameters of OpenCV with its standard deviations."""
    seen, listed = job.files.observations, job.files.targets
    assert seen is not None and listed is not None and job.settings.camera.image_size is not None
    place = {name: at for at, name in enumerate(listed.texts("target"))}
    points = listed.stacked("xyz").astype(np.float32)
    at = np.array([place[name] for name in seen.texts("target")])
    pixels, image = seen.stacked("uv").astype(np.float32), np.array(seen.texts("image"))
    parts = [np.flatnonzero(image == name) for name in np.unique(image)]
    flags = cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_FIX_K3
    _, matrix, _, _, _, std, _, _ = cv2.calibrateCameraExtended(
        [points[at[part]] for part in parts],
        [pixels[part] for part in parts],
        job.settings.camera.image_size,
        np.eye(3),
        np.zeros(5),
        flags=flags,
    )
    return Fitted(matrix[[1, 0, 1], [1, 2, 2]], std.ravel()[[1, 2, 3]])


ESTIMATORS: dict[str, Callable[[Job[Settings, Files]], Fitted]] = {
    "structured": lambda job: fitted(job, "structured"),
    "with targets": lambda job: fitted(job, "structured", "estimate"),
    "estimated": lambda job: fitted(job, "estimated"),
    "OpenCV": by_opencv,
}


def selected(table: Table, rows: npt.NDArray[np.bool_]) -> Table:
    """Return some rows of a table."""
    return Table({name: values[rows] for name, values in table.columns.items()}, table.units)


def halves(job: Job[Settings, Files], rng: np.random.Generator) -> tuple[Job[Settings, Files], Job[Settings, Files]]:
    """Return the job with a random half of its images, and with the others."""
    seen = job.files.observations
    assert seen is not None
    image = np.array(seen.texts("image"))
    each = rng.permutation(np.unique(image))
    first = np.isin(image, each[: len(each) // 2])
    one, other = (replace(job, files=replace(job.files, observations=selected(seen, part))) for part in (first, ~first))
    return one, other


def compared(title: str, job: Job[Settings, Files], count: int, estimators: tuple[str, ...]) -> None:
    """Print the root mean square of z over halvings, by parameter and over all, for each estimator."""
    seen = job.files.observations
    assert seen is not None
    number = len(np.unique(seen.texts("image")))
    if number < 2 * FEWEST:
        print(f"{title}: {number} images are too few to be halved")
        return
    rng = np.random.default_rng(2024)
    found: dict[str, list[Array]] = {name: [] for name in estimators}
    for _ in range(count):
        pair = halves(job, rng)
        for name in estimators:
            try:
                one, other = (ESTIMATORS[name](half) for half in pair)
            except MetrocliError as error:
                print(f"{title}: a half has no result: {str(error).splitlines()[0]}")
                continue
            found[name].append((one.values - other.values) / np.hypot(one.std, other.std))
    for name, values in found.items():
        z = np.array(values)
        by_parameter = "".join(f"{value:8.2f}" for value in np.sqrt((z**2).mean(axis=0)))
        print(
            f"{title:<30}{number:>4}  {name:<12}{by_parameter}{np.sqrt((z**2).mean()):>8.2f}{abs(z).max():>8.1f}",
            flush=True,
        )
        if name == "structured":
            rms = float(np.sqrt((z**2).mean()))
            print(Number(f"z rms between halves, {title}", f"{len(z)} halvings", rms, 0.7, 1.3), flush=True)


def turned(angles: Array) -> Array:
    """Return the rotation by three angles about x, y and z."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles), np.sin(angles)
    about_x, about_y = [[1, 0, 0], [0, cx, -sx], [0, sx, cx]], [[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]]
    return np.asarray(np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]]) @ about_y @ about_x)


def simulated(rng: np.random.Generator, views: int, process: float) -> Job[Settings, Files]:
    """Return a board of 13 x 9 targets, with a smooth random error of `process` sigma in each image."""
    x, y = (part.ravel() for part in np.meshgrid(np.arange(13) * 20.0, np.arange(9) * 20.0))
    board, pixels = np.stack([x, y, 0 * x], axis=1), []
    for _ in range(views):
        turn = turned(np.append(rng.normal(0, 0.35, 2), rng.uniform(0, 6)))
        seen = (board - [120.0, 80.0, 0.0]) @ turn.T + [*rng.uniform(-40, 40, 2), rng.uniform(480, 750)]
        ideal = seen[:, :2] / seen[:, 2:]
        r2 = (ideal**2).sum(axis=1, keepdims=True)
        at = FOCAL * ideal * (1 + TRUE["k1"] * r2 + TRUE["k2"] * r2**2) + [TRUE["cx"], TRUE["cy"]]
        near = np.exp(-((at[:, None] - at) ** 2).sum(axis=2) / (2 * LENGTH**2)) + 1e-9 * np.eye(len(at))
        smooth = np.linalg.cholesky(near) @ rng.normal(size=at.shape)
        pixels.append(at + SIGMA * (rng.normal(size=at.shape) + process * smooth))
    u, v = np.concatenate(pixels).T
    target = np.array([f"T{i}" for i in range(len(board))])
    image = np.repeat([f"i{i:02d}" for i in range(views)], len(board))
    observations = Table({"image": image, "target": np.tile(target, views), "u": u, "v": v}, {"u": "px", "v": "px"})
    targets = Table({"target": target, "x": x, "y": y, "z": 0 * x}, dict.fromkeys("xyz", "mm"))
    return board_job(observations, targets, SIZE)


def dof_of(result: Result, name: str) -> float:
    """Return the degrees of freedom of an estimate."""
    stated = result.details.get(name, {}).get("dof", result.statistics["dof"])
    assert isinstance(stated, int | float)
    return float(stated)


def inside(result: Result) -> Iterator[bool]:
    """Yield for each estimate whether its 95 % interval contains the truth."""
    for one in result.estimates:
        yield abs(one.value - TRUE[one.name]) <= stdtrit(dof_of(result, one.name), 0.975) * one.std


def coverage(views: int, process: float, runs: int) -> None:
    """Print how many of the 95 % intervals contain the truth."""
    rng = np.random.default_rng([2025, views, round(10 * process)])
    jobs = [simulated(rng, views, process) for _ in range(runs)]
    shares, growth = [], 0.0
    for noise in ("structured", "estimated"):
        results = [calibrate_camera.run(replace(job, settings=replace(job.settings, noise=noise))) for job in jobs]
        shares.append(100 * np.mean([list(inside(result)) for result in results]))
        growth = max(growth, float(np.mean([float(str(r.statistics.get("inflation", 0))) for r in results])))
    print(f"{views:>6}{process:>10.1f}{shares[0]:>12.1f} %{shares[1]:>12.1f} %{growth:>12.2f}", flush=True)
    title = f"95 % intervals, {views} images, smooth errors of {process:g} times the noise"
    print(Number(title, f"{runs} draws", shares[0], 92, 98, "%"), flush=True)


def main(count: int = 20, runs: int = 100) -> None:
    """Print the tables."""
    print(f"{'set':<30}{'img':>4}  {'noise':<12}" + "".join(f"{name:>8}" for name in (*COMPARED, "all", "max")))
    if not DATA.is_dir():
        print(f"no measured data at {DATA}")
    else:
        for title, stem in READ.items():
            tables = [
                csv.read(DATA / f"{stem}.{name}.csv", columns)
                for name, columns in (("observations", OBSERVATIONS), ("targets", TARGETS))
            ]
            compared(title, board_job(tables[0], tables[1], (640, 480)), count, tuple(ESTIMATORS))
        for title, (files, pattern) in DETECTED.items():
            observations, targets = detected(pattern, files)
            compared(title, board_job(observations, targets, (640, 480)), count, tuple(ESTIMATORS))
        compared("aicon-network", network_job(), count, ("structured", "estimated"))
    print(f"\n{'images':>6}{'process':>10}{'structured':>14}{'estimated':>14}{'inflation':>12}   (95 % intervals)")
    for views in (8, 14):
        for process in (0.0, 0.3, 0.5, 1.0):
            coverage(views, process, runs)


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:]))
