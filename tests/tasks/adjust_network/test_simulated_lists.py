"""A simulated list of points has what the job knows of them: exact coordinates, coordinates with sigma, rough places."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from simulated.network import SIZE

from metrocli.formats import hdf5
from metrocli.uncertainty.predicted import COMMON, CORE

Metrocli = Callable[..., Any]
ROUGH = 0.5
"""Standard deviation of the places without a sigma [mm]"""
JOB = f"""\
metrocli: 1
job: adjust-network
inputs: {{points: points.csv, stations: stations.csv}}
instruments: {{A: {{type: tracker, noise: {{azimuth: 2 urad, elevation: 2 urad, distance: {{constant: 5 um}}}}}}}}
datum: given
simulation: {{point_error: {ROUGH} mm}}
output: result.h5
"""
TOTAL = "total-station"
EFFECTS = ("given-point:point=P01,dx=0.3mm,dy=0mm,dz=-0.2mm", "given-point:point=P07,dx=0mm,dy=0.4mm,dz=0mm")


def simulated(folder: Path, metrocli: Metrocli) -> Path:
    """Write a network of which six points are exact and six known to 0.01 mm, and simulate it; return its new job."""
    places = np.random.default_rng(31).uniform(0, 1, (16, 3)) * SIZE
    sigmas = [*["0"] * 6, *["0.01"] * 6, *[""] * 4]
    rows = [
        f"P{i:02d},{x:.6f},{y:.6f},{z:.6f},{s}" for i, ((x, y, z), s) in enumerate(zip(places, sigmas, strict=True))
    ]
    (folder / "points.csv").write_text("\n".join(["point,x_mm,y_mm,z_mm,sigma_mm", *rows]) + "\n")
    stations = [f"S{i},A,{x},{y},1200" for i, (x, y) in enumerate([(800, 700), (7000, 900), (4000, 4300)])]
    (folder / "stations.csv").write_text("\n".join(["station,instrument,x_mm,y_mm,z_mm", *stations]) + "\n")
    (folder / "job.yaml").write_text(JOB)
    added = [word for effect in EFFECTS for word in ("--effect", effect)]
    ran = metrocli("simulate", folder / "job.yaml", "--out", folder / "new", "--seed", "3", *added)
    assert ran.code == 0, ran.err
    names = {"points: points": "points: new/points", "stations:": "readings: new/readings.csv, stations:"}
    text = JOB
    for old, new in names.items():
        text = text.replace(old, new)
    (folder / "new.yaml").write_text(text)
    return folder / "new.yaml"


def test_known_coordinates_stay_known_in_a_simulated_list(tmp_path: Path, metrocli: Metrocli) -> None:
    job = simulated(tmp_path, metrocli)

    def listed(name: str) -> list[list[str]]:
        return [line.split(",") for line in (tmp_path / name).read_text().splitlines()[1:]]

    true, new = listed("points.csv"), listed("new/points.csv")
    off = np.array([[float(x) for x in row[1:4]] for row in new]) - [[float(x) for x in row[1:4]] for row in true]
    assert np.abs(off[:6]).max() < 1e-6
    known = np.delete(off[6:12], 1, axis=0)
    assert 0.004 < np.sqrt((known**2).mean()) < 0.016
    # the list of P07 is off by the effect, and by its sigma
    assert np.abs(off[7] - [0, 0.4, 0]).max() < 0.05
    assert 0.2 < np.sqrt((off[12:] ** 2).mean()) < 0.9
    assert [float(row[4] or "nan") for row in new[:12]] == [0.0] * 6 + [0.01] * 6 and not any(r[4] for r in new[12:])
    ran = metrocli("diagnose", job, "--json")
    assert ran.code == 0, ran.err
    found = {one["where"]["point"]: one["parameters"] for one in json.loads(ran.out)["effects"]}
    assert set(found) == {"P01", "P07"}
    assert abs(found["P01"]["dx"]["value"] - 0.3) < 0.03 and abs(found["P07"]["dy"]["value"] - 0.4) < 0.06


def test_a_wrong_exact_point_is_wrong_for_all_that_reads_it(tmp_path: Path, metrocli: Metrocli) -> None:
    """Of more exact points than are tested, the levelled ones are last: none acts on the heights alone."""
    places = np.random.default_rng(32).uniform(0, 1, (104, 3)) * SIZE
    rows = [f"P{i:03d},{x:.6f},{y:.6f},{z:.6f},0" for i, (x, y, z) in enumerate(places)]
    (tmp_path / "points.csv").write_text("\n".join(["point,x_mm,y_mm,z_mm,sigma_mm", *rows]) + "\n")
    (tmp_path / "stations.csv").write_text("station,instrument,x_mm,y_mm,z_mm\nS0,A,800,700,1200\n")
    (tmp_path / "heights.csv").write_text("from,to,dh_mm,sigma_mm\nP099,P103,0,0.02\nP098,P099,0,0.02\n")
    (tmp_path / "job.yaml").write_text(JOB.replace("inputs: {", "inputs: {heights: heights.csv, "))

    def simulated_with(point: str, name: str) -> Any:
        effect = f"given-point:point={point},dx=0mm,dy=0mm,dz=9mm"
        command = ("simulate", tmp_path / "job.yaml", "--out", tmp_path / name, "--seed", "3")
        return metrocli(*command, *(("--effect", effect) if point else ()))

    assert simulated_with("", "true").code == 0
    for point, acts in (("P099", True), ("P103", False)):
        ran = simulated_with(point, point)
        assert (ran.code == 0) == acts, ran.err
        for file in ("readings.csv", "heights.csv") if acts else ():
            assert (tmp_path / point / file).read_text() != (tmp_path / "true" / file).read_text()


def test_a_wrong_exact_point_is_delivered_as_one_that_is_not_listed(tmp_path: Path, metrocli: Metrocli) -> None:
    """What takes its list for wrong frees its place: points and stations, and what they share, are the same.

    One station stands over it, another reads it, and three coordinates of a second point are unknown.
    """
    rng = np.random.default_rng(33)
    places = rng.uniform(0, 1, (9, 3)) * SIZE
    stands = np.array([[800, 700, 1200], [7000, 900, 1300], places[4] + [0, 0, 1500]])
    rows = []
    for name, stand in zip(("S0", "S1", "S2"), stands, strict=True):
        for number, (x, y, z) in enumerate(places - stand):
            if not (name == "S2" and number == 4):
                angles = np.array([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))]) + rng.normal(0, 2e-6, 2)
                distance = np.sqrt(x * x + y * y + z * z) + rng.normal(0, 0.005)
                rows.append(f"{name},P{number},{angles[0]:.9f},{angles[1]:.9f},{distance:.6f}")
    (tmp_path / "readings.csv").write_text("\n".join(["station,point,az_rad,el_rad,d_mm", *rows]) + "\n")
    listing = ["station,instrument,over,height_mm,x_mm,y_mm,z_mm", "S0,A,,,800,700,1200", "S1,A,,,7000,900,1300"]
    (tmp_path / "stations.csv").write_text("\n".join([*listing, "S2,A,P4,1500,,,"]) + "\n")
    found = []
    for name, sigma, effects in (("free", "", ""), ("wrong", "0", "effects: [{name: given-point, point: P4}]\n")):
        listed = places + np.where(np.arange(9)[:, None] == 4, [0.3, 0.0, -0.2], 0.0)
        sigmas = {4: sigma, 7: ""}
        points = [f"P{i},{x:.6f},{y:.6f},{z:.6f},{sigmas.get(i, '0')}" for i, (x, y, z) in enumerate(listed)]
        (tmp_path / f"{name}.csv").write_text("\n".join(["point,x_mm,y_mm,z_mm,sigma_mm", *points]) + "\n")
        text = JOB.replace("{points: points", f"{{readings: readings.csv, points: {name}").replace("tracker", TOTAL)
        (tmp_path / f"{name}.yaml").write_text(text.replace("result", name).replace("datum", effects + "datum"))
        ran = metrocli("adjust-network", tmp_path / f"{name}.yaml")
        assert ran.code == 0, ran.err
        found.append(hdf5.read(tmp_path / f"{name}.h5")[0])
    free, wrong = found
    assert np.abs(wrong.tables["points"].stacked("xyz")[4] - places[4]).max() < 0.03
    assert np.abs(wrong.tables["points"].stacked("xyz") - free.tables["points"].stacked("xyz")).max() < 1e-6
    joint = free.arrays["points_joint_covariance"]
    assert np.abs(wrong.arrays["points_joint_covariance"] - joint).max() < 1e-5 * joint.max()
    for one, other in zip(wrong.arrays["points_covariance"], free.arrays["points_covariance"], strict=True):
        assert np.abs(one - other).max() < 1e-5 * joint.max()
    common, core = (wrong.arrays[name] for name in (COMMON, CORE))
    assert np.abs(common[4] @ core @ common[7].T - joint[12:15, 21:24]).max() < 1e-5 * joint.max()
    names = {one.name: one for one in free.estimates}
    for one in wrong.estimates:
        if one.name in names:
            assert abs(one.value - names[one.name].value) < 1e-6
            assert abs(one.std / names[one.name].std - 1) < 1e-4
    assert sum(one.name.startswith("S2.") for one in wrong.estimates) >= 3


def test_the_true_places_of_wrong_exact_points_are_not_those_of_the_list(tmp_path: Path, metrocli: Metrocli) -> None:
    simulated(tmp_path, metrocli)
    rows = {name: (tmp_path / name).read_text().splitlines() for name in ("points.csv", "new/true_points.csv")}
    listed, true = (np.array([[float(x) for x in row.split(",")[1:4]] for row in each[1:]]) for each in rows.values())
    off = listed - true
    assert np.abs(off[1] - [0.3, 0, -0.2]).max() < 1e-6 and np.abs(np.delete(off, 1, axis=0)).max() < 1e-6


def test_points_without_a_place_are_not_simulated_at_the_origin(tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "points.csv").write_text("point,x_mm,y_mm,z_mm\nP1,0,0,0\nP2,4000,0,0\nP3,0,3000,900\n")
    (tmp_path / "stations.csv").write_text("station,instrument,x_mm,y_mm,z_mm\nS0,A,800,700,1200\n")
    (tmp_path / "readings.csv").write_text("station,point,az_rad,el_rad,d_mm\nS0,P1,0,0,1\nS0,P9,0,0,1\n")
    (tmp_path / "job.yaml").write_text(JOB.replace("inputs: {", "inputs: {readings: readings.csv, "))
    ran = metrocli("simulate", tmp_path / "job.yaml", "--out", tmp_path / "new")
    assert ran.code == 3 and "need x, y, z of each point; these have none: P9" in ran.err
