"""Folders with small jobs of both kinds that have no faults, for tests that spoil them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks import coverage
from metrocli.formats import csv
from metrocli.simulation import SimulationOptions
from metrocli.table import Table
from metrocli.tasks.align_part import task as align_part
from metrocli.tasks.calibrate_camera import settings as camera_job
from metrocli.tasks.calibrate_camera import task as calibrate_camera

_CAMERA = "camera: {image_size: [2592, 1944], pixel_size: 2.2 um, estimate: [f, cx, cy, k1, k2, p1, p2]}\n"
_FILES = "inputs: {observations: observations.csv, targets: targets.csv}\n"
CAMERA_FILE = """image_size: [2592, 1944]
f: 2813.2 px
cx: 1286.8 px
cy: 999.0 px
k1: 0.2372
k2: -0.1213
p1: -1.7e-4
p2: 9.6e-4
extrinsics: {x: -2.139 mm, y: 0.301 mm, z: -320.3 mm, alpha: -0.003 rad, beta: -0.009 rad, gamma: 0.03 rad}
"""


def calibration(folder: Path, rig: str, targets: Table, settings: camera_job.Settings | None = None) -> Path:
    """Write a calibration job with simulated readings."""
    settings = settings or coverage.camera_settings(rig, images=6)
    simulation = calibrate_camera.simulate(calibrate_camera.TASK.job(settings, targets=targets), SimulationOptions(1))
    csv.write(folder / "targets.csv", targets)
    csv.write(folder / "observations.csv", simulation.files["observations.csv"])
    job = folder / "job.yaml"
    job.write_text(
        f"metrocli: 1\njob: calibrate-camera\nrig: {rig}\n{_FILES}{_CAMERA}noise: 0.05 px\noutput: camera.h5\n"
    )
    return job


def board(folder: Path) -> Path:
    """Write a calibration with a board in 6 views."""
    return calibration(folder, "board", coverage.board())


def cmm(folder: Path) -> Path:
    """Write a calibration with targets placed by a coordinate measuring machine."""
    return calibration(folder, "cmm", coverage.planes((395.0, 900.0, 1430.0), 3))


def network(folder: Path) -> Path:
    """Write a network of unknown points with a scale bar."""
    board = coverage.board(5, 4, 60.0)
    lifted = Table({**board.columns, "z": board.numbers("x") * board.numbers("y") / 400.0}, board.units)
    job = calibration(folder, "network", lifted)
    text = (folder / "targets.csv").read_text().splitlines()
    rows = [text[0] + ",sigma_mm", *(row + "," for row in text[1:])]
    (folder / "targets.csv").write_text("\n".join(rows) + "\n")
    (folder / "bars.csv").write_text("from,to,length_mm,sigma_mm\nT0,T4,240.0,0.005\n")
    job.write_text(job.read_text().replace("targets.csv}", "targets.csv, scale_bars: bars.csv}"))
    return job


def parallel_views(folder: Path) -> Path:
    """Write a calibration with a board that is parallel to the image in all views."""
    settings = coverage.camera_settings("board", images=6)
    assert settings.simulation is not None
    flat = replace(settings, simulation=replace(settings.simulation, tilt=1e-9))
    return calibration(folder, "board", coverage.board(), flat)


def one_plane(folder: Path) -> Path:
    """Write a calibration with exact targets in one plane that is parallel to the image."""
    settings = coverage.camera_settings("cmm")
    assert settings.simulation is not None
    straight = replace(coverage.TRUE_MOUNTING, alpha=0.0, beta=0.0)
    targets = coverage.planes((900.0,), 6)
    exact = Table({**targets.columns, "sigma": np.zeros(len(targets))}, targets.units)
    straightened = replace(settings, simulation=replace(settings.simulation, extrinsics=straight))
    return calibration(folder, "cmm", exact, straightened)


def alignment(folder: Path, targets: Table, poses: Table) -> Path:
    """Write a 7D alignment with the camera in a file."""
    settings = coverage.alignment_settings(0.05, 1e-3)
    seen = align_part.simulate(
        align_part.TASK.job(settings, coverage.true_camera(), poses, targets), SimulationOptions(1)
    )
    for name, table in (("targets", targets), ("poses", poses), ("observations", seen.files["observations.csv"])):
        csv.write(folder / f"{name}.csv", table)
    (folder / "camera.yaml").write_text(CAMERA_FILE)
    job = folder / "job.yaml"
    job.write_text(
        "metrocli: 1\njob: align-part\n"
        "inputs: {camera: camera.yaml, poses: poses.csv, targets: targets.csv, observations: observations.csv}\n"
        "estimate: [part-pose, clamping-angle]\nnoise: 0.05 px\noutput: part.h5\n"
    )
    return job


def align(folder: Path) -> Path:
    """Write an alignment with two images of each of four targets."""
    targets = coverage.corners(0.0)
    return alignment(folder, targets, coverage.poses_over(targets))


def one_position(folder: Path, images: int = 3, step: float = 0.0) -> Path:
    """Write an alignment of a small part seen from one position of the spindle, or from positions `step` mm apart."""
    rows = [(0, 0, 0), (80, 0, 5), (80, 60, 0), (0, 60, -5), (40, 30, 10), (20, 50, 0)]
    points = np.array(rows, dtype=float)
    names, columns = np.array([f"M{i + 1}" for i in range(len(points))]), dict(zip("xyz", points.T, strict=True))
    targets = Table({"target": names, **columns}, dict.fromkeys("xyz", "mm"))
    part, mounting = coverage.PART, coverage.TRUE_MOUNTING
    at = np.array([part.x + 40 - mounting.x, part.y + 30 - mounting.y, part.z - 300 - mounting.z])
    spindle = at + np.arange(images)[:, None] * np.array([step, 0.0, 0.0])
    poses = Table(
        {"image": np.array([f"image{i + 1}" for i in range(images)]), **dict(zip("xyz", spindle.T, strict=True))},
        dict.fromkeys("xyz", "mm"),
    )
    return alignment(folder, targets, poses)


def turned(folder: Path) -> Path:
    """Write an alignment of six targets over 300 mm, seen from twelve poses with the spindle turned, with times."""
    rows = [(0, 0, 0), (80, 0, 25), (80, 60, 0), (0, 60, -25), (40, 30, 40), (20, 50, 0)]
    points = np.array(rows, dtype=float)
    names, columns = np.array([f"C{i + 1}" for i in range(len(points))]), dict(zip("xyz", points.T, strict=True))
    targets = Table({"target": names, **columns}, dict.fromkeys("xyz", "mm"))
    part, turn = coverage.PART, np.tile([0.0, np.pi / 2, np.pi, -np.pi / 2], 3)
    rng = np.random.default_rng(3)
    x, y = np.array([[part.x + 40], [part.y + 30]]) + rng.uniform(-60, 60, (2, 12))
    z = part.z - coverage.TRUE_MOUNTING.z - np.repeat([260.0, 330.0, 400.0], 4)
    zero = np.zeros(12)
    held = {"x": x, "y": y, "z": z, "a": zero, "b": zero, "c": turn, "t": 40.0 * np.arange(12)}
    units = {**dict.fromkeys("xyz", "mm"), **dict.fromkeys("abc", "rad"), "t": "s"}
    poses = Table({"image": np.array([f"image{i + 1}" for i in range(12)]), **held}, units)
    job = alignment(folder, targets, poses)
    at = ", ".join(
        f"{name}: {getattr(part, name)} {'rad' if len(name) > 1 else 'mm'}"
        for name in ("x", "y", "z", "alpha", "beta", "gamma")
    )
    job.write_text(f"{job.read_text()}simulation: {{part: {{{at}}}, clamping_angle: 1 mrad}}\n")
    return job


JOBS: dict[str, Callable[[Path], Path]] = {
    "board": board,
    "cmm": cmm,
    "network": network,
    "align": align,
    "parallel": parallel_views,
    "plane": one_plane,
    "position": one_position,
}
