"""Files of jobs that no sample project has, drawn by formulas of their own."""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
F, CENTRE = 690.0, np.array([325.0, 233.0])
_JOB = """metrocli: 1
job: calibrate-camera
rig: board
inputs: {observations: observations.csv, targets: targets.csv}
camera: {image_size: [640, 480], pixel_size: 6 um, estimate: [f, cx, cy, k1, k2]}
noise: 0.05 px
output: camera.h5
"""


def turned(a: float, b: float, c: float) -> Array:
    x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    return np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]]) @ y @ x


def image_points(places: Array, k1: float) -> Array:
    x = places[:, :2] / places[:, 2:]
    return np.asarray(F * x * (1 + k1 * (x**2).sum(axis=1, keepdims=True)) + CENTRE)


@cache
def board(k1: float = -0.2, distance: float = 450.0) -> dict[str, str]:
    """Eight tilted views of a board of 9 x 6 points, every second one turned by 90 degrees."""
    rng = np.random.default_rng(250)
    points = np.array([[25.0 * i, 25.0 * j, 0.0] for j in range(6) for i in range(9)])
    names = [f"{chr(65 + j)}{i}" for j in range(6) for i in range(9)]
    lines = ["image,target,u_px,v_px"]
    for view in range(8):
        tilt = (0.45 * np.cos(view * 2.3), 0.45 * np.sin(view * 2.3), np.pi / 2 * (view % 2))
        places = (points - points.mean(axis=0)) @ turned(*tilt).T + [*rng.uniform(-25, 25, 2), distance + 25 * view]
        uv = image_points(places, k1) + rng.normal(0, 0.05, (54, 2))
        lines += [f"view{view}.png,{name},{u:.3f},{v:.3f}" for name, (u, v) in zip(names, uv.tolist(), strict=True)]
    targets = ["target,x_mm,y_mm,z_mm", *(f"{n},{x:g},{y:g},{z:g}" for n, (x, y, z) in zip(names, points, strict=True))]
    return {"job.yaml": _JOB, "observations.csv": "\n".join(lines) + "\n", "targets.csv": "\n".join(targets) + "\n"}


STATIONS = {
    "job.yaml": """metrocli: 1
job: multilaterate
inputs: {lengths: lengths.csv, points: points.csv, tracers: tracers.csv}
measures: absolute
noise: {constant: 1 mm}
output: r.h5
""",
    "points.csv": "point,x_mm,y_mm,z_mm,sigma_mm\nP,10,20,5,\n",
    "tracers.csv": "tracer,x_mm,y_mm,z_mm,sigma_mm\nA,1000,0,0,0\nB,-1000,0,0,0\nC,0,1000,0,0\nD,0,0,1000,0\nE,0,-1000,0,0\n",
    "lengths.csv": "point,tracer,length_mm\nP,A,1000.3\nP,B,999.8\nP,C,1000.1\nP,D,1000.2\nP,E,1000.4\n",
}

LEVELLED = """metrocli: 1
job: adjust-network
inputs: {readings: readings.csv, stations: stations.csv, heights: heights.csv}
instruments:
  TS: {type: total-station, noise: {azimuth: 3 arcsec, elevation: 3 arcsec, distance: {constant: 1 mm}}}
noise: {height: 0.3 mm}
output: net.h5
"""

BUDGET = """metrocli: 1
job: report-uncertainty
quantities:
  a: {value: 100 mm, std: 1 um, dof: DOF}
  b: {value: 1, std: STD}
measurands: {y: {model: "MODEL", unit: mm}}
monte_carlo: {trials: 100000, seed: 1}
output: y.h5
"""


def budget(model: str, dof: str = "1000", std: str = "1e-6") -> str:
    return BUDGET.replace("MODEL", model).replace("DOF", dof).replace("STD", std)
