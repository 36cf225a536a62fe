"""Set-ups that a list places only together: each sees too few of its points, all of them enough."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

Metrocli = Callable[..., Any]
JOB = """metrocli: 1
job: adjust-network
inputs: {readings: readings.csv, stations: stations.csv, points: points.csv}
instruments:
  LT: {type: tracker, noise: {azimuth: 1 arcsec, elevation: 1 arcsec, distance: {constant: 5 um}}}
output: net.h5
"""
LISTED, SEEN = (0, 4, 8), {"A": range(8), "B": range(1, 9)}
"""A sees the first two points of the list, B the last two: three are needed to place one of them"""


def test_trackers_that_stand_askew_are_placed_on_a_list_together(tmp_path: Path, metrocli: Metrocli) -> None:
    rng = np.random.default_rng(71)
    points = rng.uniform(-2500, 2500, (9, 3))
    stands = {"A": ([4200.0, -600, 300], [0.2, -0.1, 1.8]), "B": ([-3900.0, 2100, 500], [-0.15, 0.2, -1.1])}
    rows = ["station,point,az_deg,el_deg,d_mm"]
    for station, (place, turn) in stands.items():
        for i in SEEN[station]:
            x, y, z = Rotation.from_euler("xyz", turn).inv().apply(points[i] - place)
            distance = np.linalg.norm([x, y, z])
            angles = np.degrees([np.arctan2(y, x), np.arcsin(z / distance)]) + rng.normal(0, 1 / 3600, 2)
            rows.append(f"{station},P{i},{angles[0]:.8f},{angles[1]:.8f},{distance + rng.normal(0, 0.005):.5f}")
    (tmp_path / "readings.csv").write_text("\n".join(rows) + "\n")
    (tmp_path / "stations.csv").write_text("station,instrument\nA,LT\nB,LT\n")
    listed = (f"P{i},{x:.4f},{y:.4f},{z:.4f}\n" for i, (x, y, z) in enumerate(points) if i in LISTED)
    (tmp_path / "points.csv").write_text("point,x_mm,y_mm,z_mm\n" + "".join(listed))
    (tmp_path / "job.yaml").write_text(JOB)
    ran = metrocli("adjust-network", tmp_path / "job.yaml", "--json")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)["estimates"]
    at = np.array([[found[f"{station}.{axis}"]["value"] for axis in "xyz"] for station in stands])
    np.testing.assert_allclose(at, [place for place, _ in stands.values()], atol=0.5)
