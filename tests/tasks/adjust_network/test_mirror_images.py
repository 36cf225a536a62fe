"""Stations and points that lengths alone place are refused where a mirror image fits, unless a list decides."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

Metrocli = Callable[..., Any]
Array = npt.NDArray[np.float64]
JOB = """metrocli: 1
job: adjust-network
inputs: {lengths: lengths.csv, stations: stations.csv, points: points.csv}
instruments: {IF: {type: interferometer, measures: absolute, noise: {distance: {constant: 20 um, proportional: 0 um/m}}}}
output: net.h5
"""
STATIONS = np.array([[-3000, -1000, 900], [3500, -800, 2200], [200, 4000, 1500], [-2500, 3500, 1400.0]])


def written(folder: Path, height: float, listed: float | None) -> Path:
    """Write lengths to points known to 10 um, at heights up to a limit; stations are listed so far off, or not at all."""
    rng = np.random.default_rng(4)
    points = rng.uniform([-1500, -1500, 0], [1500, 1500, height], (25, 3))
    lengths = np.linalg.norm(points - STATIONS[:, None], axis=2) + rng.normal(0, 0.02, (4, 25))
    rows = (f"P{i},{x:.4f},{y:.4f},{z:.4f},0.01\n" for i, (x, y, z) in enumerate(points))
    (folder / "points.csv").write_text("point,x_mm,y_mm,z_mm,sigma_mm\n" + "".join(rows))
    rows = (f"S{j},P{i},{lengths[j, i]:.4f}\n" for j in range(4) for i in range(25))
    (folder / "lengths.csv").write_text("station,point,length_mm\n" + "".join(rows))
    places = [",".join(f"{v + listed:.0f}" for v in at) if listed is not None else ",," for at in STATIONS]
    head = "station,instrument,x_mm,y_mm,z_mm\n" if listed is not None else "station,instrument\n"
    rows = (f"S{j},IF" + (f",{places[j]}\n" if listed is not None else "\n") for j in range(4))
    (folder / "stations.csv").write_text(head + "".join(rows))
    (folder / "job.yaml").write_text(JOB)
    return folder / "job.yaml"


def test_stations_beside_points_in_a_plane_are_refused(tmp_path: Path, metrocli: Metrocli) -> None:
    ran = metrocli("adjust-network", written(tmp_path, 0.0, None))
    assert ran.code == 4 and "two places fit the lengths alike" in ran.err and "`inputs: stations`" in ran.err
    assert not (tmp_path / "net.h5").exists()


def test_a_list_of_stations_decides_and_the_result_says_so(tmp_path: Path, metrocli: Metrocli) -> None:
    ran = metrocli("adjust-network", written(tmp_path, 0.0, -150.0))
    assert ran.code == 0 and "its list decides, since a mirror image fits as well: station S0" in ran.out


def test_points_off_a_plane_decide_by_themselves(tmp_path: Path, metrocli: Metrocli) -> None:
    ran = metrocli("adjust-network", written(tmp_path, 400.0, None), "--json")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)["estimates"]
    assert all(
        abs(found[f"S{j}.{axis}"]["value"] - STATIONS[j, a]) < 1.0 for j in range(4) for a, axis in enumerate("xyz")
    )


@pytest.mark.parametrize("listed", [True, False])
def test_a_point_beside_stations_in_one_plane(listed: bool, tmp_path: Path, metrocli: Metrocli) -> None:
    job = written(tmp_path, 400.0, None)
    stations = STATIONS * [1, 1, 0] + [0, 0, 1200]
    points = np.array(
        [[float(v) for v in row.split(",")[1:4]] for row in (tmp_path / "points.csv").read_text().split()[1:]]
    )
    points = np.vstack([points, [300.0, -200.0, 700.0]])
    rng = np.random.default_rng(7)
    rows = [
        f"S{j},P{i},{np.linalg.norm(points[i] - stations[j]) + rng.normal(0, 0.02):.4f}\n"
        for j in range(4)
        for i in range(26)
    ]
    (tmp_path / "lengths.csv").write_text("station,point,length_mm\n" + "".join(rows))
    if listed:
        (tmp_path / "points.csv").write_text((tmp_path / "points.csv").read_text() + "P25,310,-190,750,\n")
    ran = metrocli("adjust-network", job)
    assert ran.code == (0 if listed else 4), ran.err
    assert ("its list decides" in ran.out) if listed else ("P25" in ran.err)
