"""Cameras in a spindle, calibrated in the taper, and their images of a part: drawn by numpy alone.

Left and right are fixed to each other; wide is alone, and its lens has a shape that no polynomial has.

The camera in the machine is at `R_CNC R_S d_cal + d_CNC`, turned by `R_CNC R_S R_cal`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.apart.model import Array

SIZES = {"left": (1280, 960), "right": (1600, 1200), "wide": (960, 720)}
LENSES = {"left": (1100.0, 645.0, 470.0, -0.2), "right": (1400.0, 790.0, 605.0, -0.15)}
LENSES["wide"] = (750.0, 485.0, 350.0, -0.2)
"""f, cx, cy, k1"""
HELD = {
    "left": (Rotation.from_rotvec([0.01, -0.02, 0.3]), np.array([-60.0, 4.0, -310.0])),
    "right": (Rotation.from_rotvec([-0.03, -0.25, 0.28]), np.array([85.0, -3.0, -300.0])),
    "wide": (Rotation.from_rotvec([0.01, -0.02, 0.3]), np.array([-6.0, 4.0, -310.0])),
}
"""In the taper"""
PART, SHIFT, CLAMPED = Rotation.from_euler("xyz", [0.02, -0.03, 0.4]), np.array([40.0, -30.0, 250.0]), 0.012
TRUTH = {"x": 40.0, "y": -30.0, "z": 250.0, "alpha": 0.02, "beta": -0.03, "gamma": 0.4, "gamma_s": CLAMPED}
TARGETS = np.random.default_rng(4).uniform([-110, -90, -40], [110, 90, 40], (9, 3))
SPINDLE = {f"{i}": ((25.0 * i - 50, 10.0 * i * (-1) ** i, -9.0 * i), (0, 0, (0, 90, 0, 180, 0)[i])) for i in range(5)}
"""Place and angles a, b, c [deg] at each exposure"""
NOISE = 0.1
HEADS = {"seen": "image,target,u_px,v_px", "targets": "target,x_mm,y_mm,z_mm"}
HEADS["poses"] = "image,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg"
CALIBRATION = """metrocli: 1
job: calibrate-camera
rig: cmm
inputs: {observations: cal.csv, targets: field.csv}
noise: 0.1 px
%s
output: cam.h5
"""
WIDE = "camera: {image_size: [960, 720], model: spline}"
CAMERAS = """cameras:
  left: {images: "left*.png", image_size: [1280, 960], estimate: [f, cx, cy, k1]}
  right: {images: "right*.png", image_size: [1600, 1200], estimate: [f, cx, cy, k1]}"""
JOB = """metrocli: 1
job: align-part
inputs: {camera: cam.h5, poses: poses.csv, targets: targets.csv, observations: obs.csv}
noise: 0.1 px
output: part.h5
"""


def _bump(uv: Array) -> Array:
    """Return the shape of the wide lens, a shift of about 0.4 px."""
    wave = np.stack([np.sin(uv[:, 1] / 80), np.cos(uv[:, 0] / 100)], axis=1) * 0.25
    off = uv - [300, 450]
    hill: Array = wave + np.exp(-(off**2).sum(axis=1, keepdims=True) / 2 / 100**2) * off / 110
    return hill


def _rows(
    image: str, points: Array, lens: Sequence[float], rng: np.random.Generator | None, fisheye: bool = False
) -> list[str]:
    """Return what an image shows of points (n, 3) in its camera."""
    f, cx, cy, k1 = lens
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    if fisheye:
        tangent = np.hypot(x, y)
        x, y = x * np.arctan(tangent) / tangent, y * np.arctan(tangent) / tangent
    radial = 1 + k1 * (x * x + y * y)
    uv = np.stack([f * x * radial + cx, f * y * radial + cy], axis=1)
    uv += _bump(uv) if image.startswith("wide") else 0
    uv += 0 if rng is None else rng.normal(0, NOISE, uv.shape)
    size = SIZES[image.rstrip("0123456789")]
    inside = ((uv > 0) & (uv < np.array(size) - 1)).all(axis=1)
    return [f"{image}.png,T{i},{uv[i, 0]:.9f},{uv[i, 1]:.9f}" for i in np.flatnonzero(inside)]


def write(path: Path, kind: str, rows: Sequence[str]) -> None:
    """Write rows below the head of their kind."""
    path.write_text("\n".join([HEADS[kind], *rows]) + "\n")


def _listed(points: Array) -> list[str]:
    return [f"T{i},{x},{y},{z}" for i, (x, y, z) in enumerate(points.tolist())]


def write_jobs(
    folder: Path, rng: np.random.Generator | None, names: Sequence[str] = ("left", "right"), fisheye: str = ""
) -> None:
    """Write the jobs cam.yaml and job.yaml with their files; without a generator there is no noise.

    `names` are the cameras that see the part: left, right or both, which are calibrated together, or wide. One of left
    and right may be a `fisheye`.
    """
    wide = "wide" in names
    field = np.random.default_rng(7).uniform([-200, -160, -50], [200, 160, 200], (900 if wide else 70, 3))
    calibrated, seen = list[str](), list[str]()
    for name in names if wide else ("left", "right"):
        turn, place = HELD[name]
        calibrated += _rows(f"{name}1", turn.inv().apply(field - place), LENSES[name], rng, name == fisheye)
    c, s = np.cos(CLAMPED), np.sin(CLAMPED)
    clamped = Rotation.from_matrix([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    points = PART.apply(TARGETS) + SHIFT
    for exposure, (at, angles) in SPINDLE.items():
        spindle = Rotation.from_euler("xyz", angles, degrees=True)
        for name in names:
            turn, place = HELD[name]
            if (exposure, name) != ("3", "left"):
                centre = (spindle * clamped).apply(place) + at
                in_camera = (spindle * clamped * turn).inv().apply(points - centre)
                seen += _rows(f"{name}{exposure}", in_camera, LENSES[name], rng, name == fisheye)
    write(folder / "cal.csv", "seen", calibrated)
    write(folder / "field.csv", "targets", _listed(field))
    write(folder / "obs.csv", "seen", seen)
    write(folder / "targets.csv", "targets", _listed(TARGETS))
    named = {f"wide{i}.png" if wide else i: pose for i, pose in SPINDLE.items()}
    write(folder / "poses.csv", "poses", [",".join(map(str, (i, *at, *angles))) for i, (at, angles) in named.items()])
    cameras = CAMERAS.replace(f'"{fisheye}*.png",', f'"{fisheye}*.png", model: fisheye,') if fisheye else CAMERAS
    (folder / "cam.yaml").write_text(CALIBRATION % (WIDE if wide else cameras))
    (folder / "job.yaml").write_text(JOB)
