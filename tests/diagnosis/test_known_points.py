"""Distances from known points to beacons: every unknown is of one beacon, and few effects are of all."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from metrocli.diagnosis.findings import Diagnosis
from metrocli.project.diagnosed import carry_out
from metrocli.project.job import load

BEACONS = np.array([[-40.0, 55.0], [45.0, 60.0], [5.0, -50.0]])
NOISE = 0.5
JOB = """metrocli: 1
job: multilaterate
inputs: {lengths: lengths.csv, points: points.csv, tracers: tracers.csv}
measures: absolute
noise: {constant: 500 mm}
output: beacons.h5
"""


def diagnosed(folder: Path, scale: float, smooth: float, count: int) -> Diagnosis:
    """Diagnose distances [m] of a drive in loops, with a scale and an error of each beacon that varies with time."""
    rng = np.random.default_rng(0)
    t = np.arange(float(count))
    place = np.stack([40 * np.sin(2 * np.pi * t / 97), 30 * np.cos(2 * np.pi * t / 61)], axis=1)
    beacon = np.arange(count) % len(BEACONS)
    phase = rng.uniform(0, 2 * np.pi, len(BEACONS))[beacon]
    length = np.linalg.norm(place - BEACONS[beacon], axis=1) * scale + NOISE * rng.normal(size=count)
    length += smooth * np.sin(2 * np.pi * 3 * t / count + phase)
    rows = {
        "points": ["point,x_m,y_m,z_m,sigma_m", *(f"P{i},{x!r},{y!r},0,0" for i, (x, y) in enumerate(place.tolist()))],
        "tracers": [
            "tracer,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m",
            *(f"B{i},{x + 2},{y - 2},0,,,0" for i, (x, y) in enumerate(BEACONS.tolist())),
        ],
        "lengths": [
            "point,tracer,length_m,t_s",
            *(f"P{i},B{beacon[i]},{one!r},{i}" for i, one in enumerate(length.tolist())),
        ],
    }
    for name, lines in rows.items():
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "job.yaml").write_text(JOB, encoding="utf-8")
    return carry_out(load(folder / "job.yaml"))


def test_the_only_name_of_all_beacons_is_left_out_in_turn_beside_errors_of_each(tmp_path: Path) -> None:
    found = diagnosed(tmp_path, scale=1.07, smooth=1.0, count=300)
    assert [one.effect.alternative.effect.name for one in found.findings] == ["length-scale"]
    assert found.correlated_errors
