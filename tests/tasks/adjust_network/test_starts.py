"""Set-ups that a list places only together: each sees too few of its points, all of them enough."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from metrocli.tasks.adjust_network.starts.angles import resected

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


NET = """metrocli: 1
job: adjust-network
inputs: {readings: readings.csv, stations: stations.csv%s}
instruments:
  TS: {type: %s, noise: {azimuth: 1 arcsec, elevation: 1 arcsec, distance: {constant: 0.5 mm}}}
output: net.h5
"""
HALL = {"A": ([0.0, 0, 1600], 0.4), "B": ([14000.0, 3000, 1200], 2.9)}


def write_hall(folder: Path, silent: str, listed: bool = False, kind: str = "total-station") -> None:
    """Write readings without noise of eight points by two upright stations, of which some read no distances."""
    rng = np.random.default_rng(72)
    points = rng.uniform([3000, -6000, 0], [11000, 9000, 4000], (8, 3))
    rows = ["station,point,az_deg,el_deg,d_mm"]
    for station, (place, turn) in HALL.items():
        for i, away in enumerate(points - place):
            azimuth, elevation = np.arctan2(away[1], away[0]) - turn, np.arctan2(away[2], np.hypot(*away[:2]))
            distance = "" if station in silent else f"{np.linalg.norm(away):.7f}"
            rows.append(f"{station},P{i},{np.degrees(azimuth):.10f},{np.degrees(elevation):.10f},{distance}")
    (folder / "readings.csv").write_text("\n".join(rows) + "\n")
    (folder / "stations.csv").write_text("station,instrument\nA,TS\nB,TS\n")
    (folder / "job.yaml").write_text(NET % (", points: points.csv" * listed, kind))
    known = (f"P{i},{x!r},{y!r},{z!r},0\n" for i, (x, y, z) in enumerate(points.tolist()))
    (folder / "points.csv").write_text("point,x_mm,y_mm,z_mm,sigma_mm\n" + "".join(known))


@pytest.mark.parametrize(("silent", "listed"), [("B", False), ("B", True), ("AB", True)])
def test_a_levelled_station_that_reads_angles_only_is_resected(
    tmp_path: Path, metrocli: Metrocli, silent: str, listed: bool
) -> None:
    write_hall(tmp_path, silent, listed)
    ran = metrocli("adjust-network", tmp_path / "job.yaml", "--json")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)["estimates"]
    places = {name: np.array([found[f"{name}.{axis}"]["value"] for axis in "xyz"]) for name in HALL}
    distance = np.linalg.norm(np.subtract(HALL["A"][0], HALL["B"][0]))
    assert np.linalg.norm(places["A"] - places["B"]) == pytest.approx(distance, abs=1e-3)
    if listed:
        np.testing.assert_allclose(list(places.values()), [place for place, _ in HALL.values()], atol=1e-3)


def test_points_that_only_resected_stations_see_are_placed_and_place_the_next_one(
    tmp_path: Path, metrocli: Metrocli
) -> None:
    """Two stations without distances place three points of one corner, which place a third station."""
    write_hall(tmp_path, "AB", True)
    known = (tmp_path / "points.csv").read_text().splitlines()
    (tmp_path / "points.csv").write_text("\n".join(known[:6]) + "\n")
    points = np.array([line.split(",")[1:4] for line in known[6:]], dtype=float)
    place, turn = np.array([7000.0, 12000, 900]), -1.0
    with (tmp_path / "readings.csv").open("a") as file:
        for i, away in enumerate(points - place, 5):
            azimuth, elevation = np.arctan2(away[1], away[0]) - turn, np.arctan2(away[2], np.hypot(*away[:2]))
            file.write(f"C,P{i},{np.degrees(azimuth):.10f},{np.degrees(elevation):.10f},\n")
    with (tmp_path / "stations.csv").open("a") as file:
        file.write("C,TS\n")
    ran = metrocli("adjust-network", tmp_path / "job.yaml", "--json")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)["estimates"]
    np.testing.assert_allclose([found[f"C.{axis}"]["value"] for axis in "xyz"], place, atol=1e-2)


def test_a_tracker_without_distances_is_refused_with_what_is_missing(tmp_path: Path, metrocli: Metrocli) -> None:
    write_hall(tmp_path, "B", kind="tracker")
    ran = metrocli("adjust-network", tmp_path / "job.yaml")
    assert ran.code == 4
    assert (
        "B: it shares no point with the rest" in ran.err
        and "to P0, P1" in ran.err
        and "one of them is missing" in ran.err
    )


def test_a_station_on_one_circle_with_its_points_is_not_resected() -> None:
    around = np.array([0.3, 1.7, 3.0, 4.4])
    points = np.stack([5 * np.cos(around), 5 * np.sin(around), np.zeros(4)], axis=1)
    for place, found in ((np.array([5.0, 0, 1]), False), (np.array([4.0, 0, 1]), True)):
        away = points - place
        azimuth, elevation = np.arctan2(away[:, 1], away[:, 0]) - 0.7, np.arctan2(away[:, 2], np.hypot(*away.T[:2]))
        stand = resected(points, azimuth, elevation)
        assert (stand is not None) == found
        assert stand is None or stand == pytest.approx([*place, 0.7])
