"""Networks are the same however they are written, found without a start, and rid of wrong readings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated.network import Array, Network, marks, network, polar

from metrocli.formats import hdf5
from metrocli.result import Result

Metrocli = Callable[..., Any]


def solved(job: Path, metrocli: Metrocli, *more: object) -> Result:
    ran = metrocli("adjust-network", job, *more)
    assert ran.code == 0, ran.err
    return hdf5.read(job.parent / "result.h5")[0]


def places(result: Result, names: list[str]) -> Array:
    table = result.tables["points"]
    rows = [table.texts("point").index(name) for name in names]
    return table.stacked("xyz")[rows]


def as_total_station(net: Network) -> Network:
    """The readings as a total station writes them: gon, clockwise, zenith distances, face 2 raw."""
    gon = 200 / np.pi
    hz, zd = -net.seen[:, 0] * gon, (np.pi / 2 - net.seen[:, 1]) * gon
    raw = net.face == 2
    hz, zd = np.where(raw, hz + 200, hz), np.where(raw, 400 - zd, zd)
    return replace(net, seen=np.stack([hz % 400, zd, net.seen[:, 2]], axis=1))


def test_gon_clockwise_zenith_and_raw_faces_are_the_same_network(tmp_path: Path, metrocli: Metrocli) -> None:
    net = network(np.random.default_rng(31), faces=2, levelled=True)
    plain = solved(net.write(tmp_path), metrocli)
    job = as_total_station(net).write(tmp_path, header="hz_gon,zd_gon,d_mm")
    text = (tmp_path / "readings.csv").read_text().splitlines()
    (tmp_path / "readings.csv").write_text("\n".join(line.replace(",2,", ",,", 1) for line in text))
    other = solved(job, metrocli)
    assert np.abs(places(plain, net.names) - places(other, net.names)).max() < 1e-6
    assert other.statistics["chi2"] == pytest.approx(plain.statistics["chi2"], rel=1e-5)
    assert len(other.tables["two_face"]) == len(plain.tables["two_face"]) == len(net.station) // 2


def test_points_are_written_for_spatial_analyzer(tmp_path: Path, metrocli: Metrocli) -> None:
    net = network(np.random.default_rng(37))
    result = solved(net.write(tmp_path), metrocli)
    assert metrocli("export", tmp_path / "result.h5", "--to", "sa-ascii", "--out", tmp_path).code == 0
    back = tmp_path / "back"
    assert metrocli("import", tmp_path / "points.txt", "--from", "sa-ascii", "--unit", "mm", "--out", back).code == 0
    found = np.loadtxt(back / "points.csv", delimiter=",", skiprows=2, usecols=(1, 2, 3))
    assert np.abs(found - result.tables["points"].stacked("xyz")).max() < 1e-6


def test_a_detectable_error_moves_its_point_as_stated(tmp_path: Path, metrocli: Metrocli) -> None:
    net = network(np.random.default_rng(38))
    before = solved(net.write(tmp_path), metrocli)
    table = before.tables["residuals"]
    row = next(i for i, name in enumerate(table.texts("quantity")) if name == "d" and table.texts("station")[i] == "S2")
    point, error = table.texts("point")[row], table.numbers("detectable")[row]
    seen = net.seen.copy()
    seen[(net.station == 1) & (net.point == net.names.index(point)), 2] += error
    after = solved(replace(net, seen=seen).write(tmp_path), metrocli)
    moved = np.linalg.norm(places(after, [point]) - places(before, [point]))
    assert moved == pytest.approx(table.numbers("moves_point")[row], rel=1e-2)


def test_verticals_lean_and_beams_bend_over_the_earth(tmp_path: Path, metrocli: Metrocli) -> None:
    """A level network far from its origin: the plumb lines lean by 10 mm/6371 m, the beams bend by k d/2R."""
    net = network(np.random.default_rng(39), 3, 12, levelled=True, noise=0.0)
    radius, refraction = 6.371e9, 0.13
    lean = net.places[:, :2] / radius
    local = np.einsum(
        "nab,na->nb", leaning(lean, net.rotations)[net.station], net.points[net.point] - net.places[net.station]
    )
    seen = polar(local)
    seen[:, 1] += refraction * seen[:, 2] * np.cos(seen[:, 1]) / (2 * radius)
    net = replace(net, seen=seen, near=net.points)
    result = solved(net.write(tmp_path, "vertical: {radius: 6371 km, refraction: 0.13}\n"), metrocli)
    assert np.abs(places(result, net.names) - net.points).max() < 1e-6
    flat = solved(net.write(tmp_path), metrocli)
    assert flat.statistics["chi2"] > 1e3 * result.statistics["chi2"]


def leaning(lean: Array, rotations: Array) -> Array:
    """Rotations of levelled stations whose vertical (x, y, 1) leans from z."""
    turned = []
    for (x, y), rotation in zip(lean, rotations, strict=True):
        small = np.eye(3) + np.array([[0, 0, x], [0, 0, y], [-x, -y, 0]])
        turned.append(small @ rotation)
    return np.array(turned)


def test_missing_cells_are_not_readings(tmp_path: Path, metrocli: Metrocli) -> None:
    net = network(np.random.default_rng(32))
    seen = net.seen.copy()
    seen[3, 2] = seen[7, 0] = seen[11, 1] = np.nan
    whole = solved(net.write(tmp_path), metrocli).statistics
    fewer = solved(replace(net, seen=seen).write(tmp_path), metrocli).statistics
    assert fewer["observations"] == int(str(whole["observations"])) - 3


@pytest.mark.alike
@pytest.mark.parametrize("levelled", [False, True])
def test_it_is_found_without_coordinates_beside_gross_errors(
    levelled: bool, tmp_path: Path, metrocli: Metrocli
) -> None:
    net = network(np.random.default_rng(33), 4, 20, levelled=levelled, listed=False)
    seen = net.seen.copy()
    wrong = [(5, 2, 40.0), (30, 0, 0.02), (61, 1, -0.01)]
    for row, quantity, error in wrong:
        seen[row, quantity] += error
    result = solved(replace(net, seen=seen).write(tmp_path, "outliers: remove\n"), metrocli)
    found = result.tables["rejected"]
    rows = {(f"S{net.station[i] + 1}", net.names[net.point[i]], ("az", "el", "d")[q]) for i, q, _ in wrong}
    assert set(zip(found.texts("station"), found.texts("point"), found.texts("quantity"), strict=True)) == rows
    x = places(result, net.names)
    between = [np.linalg.norm(one[:, None] - one, axis=2) for one in (x, net.points)]
    assert np.abs(between[0] - between[1]).max() < 0.1


def test_set_ups_over_marks_find_unknown_heights(tmp_path: Path, metrocli: Metrocli) -> None:
    x, height, target, seen = marks(np.random.default_rng(34))
    names = [f"P{i}" for i in range(len(x))]
    i, k = np.nonzero(np.isfinite(seen[:, :, 0]))
    rows = [f"S{a},{names[b]},T{b},{','.join(f'{v:.14g}' for v in seen[a, b])}" for a, b in zip(i, k, strict=True)]
    (tmp_path / "readings.csv").write_text("\n".join(["station,point,setup,az_rad,el_rad,d_mm", *rows]))
    listed = [f"S{a},A,{names[4 + a]},{height[a] + 3 * (a == 0)},{'' if a == 0 else 0}" for a in range(4)]
    (tmp_path / "stations.csv").write_text("\n".join(["station,instrument,over,height_mm,sigma_height_mm", *listed]))
    setups = [f"T{b},{target[b] + 5 * (b == 9)},{'' if b == 9 else 0}" for b in range(len(x))]
    (tmp_path / "setups.csv").write_text("\n".join(["setup,height_mm,sigma_mm", *setups]))
    near = x + np.random.default_rng(1).normal(0, 3, x.shape)
    points = [
        f"{n},{','.join(map(str, p))},{'' if b < 4 else 1}" for b, (n, p) in enumerate(zip(names, near, strict=True))
    ]
    heights = [f"P{b},P9,{x[9, 2] - x[b, 2]:.9f},0.1" for b in (0, 1)]
    (tmp_path / "heights.csv").write_text("\n".join(["from,to,dh_mm,sigma_mm", *heights]))
    (tmp_path / "points.csv").write_text("\n".join(["point,x_mm,y_mm,z_mm,sigma_mm", *points]))
    (tmp_path / "job.yaml").write_text(
        "metrocli: 1\njob: adjust-network\ninputs: {readings: readings.csv, stations: stations.csv, setups: setups.csv, "
        "points: points.csv, heights: heights.csv}\ninstruments:\n  A: {type: total-station, noise: {azimuth: 2 urad, "
        "elevation: 2 urad, distance: {constant: 0.1 mm}}}\noutput: result.h5\n"
    )
    found = {one.name: one for one in solved(tmp_path / "job.yaml", metrocli).estimates}
    assert found["S0.height"].value == pytest.approx(height[0], abs=0.01)
    assert found["T9.height"].value == pytest.approx(target[9], abs=0.01)


def test_lengths_alone_are_those_of_multilaterate(tmp_path: Path, metrocli: Metrocli) -> None:
    rng = np.random.default_rng(35)
    x, tracers = rng.uniform(0, 1000, (12, 3)), rng.uniform(-500, 1500, (5, 3))
    near = x + rng.normal(0, 0.02, x.shape)
    dead = rng.uniform(200, 500, 5)
    lengths = np.linalg.norm(x[:, None] - tracers, axis=2) - dead + rng.normal(0, 3e-4, (12, 5))
    rows = [f"T{j},P{i},{lengths[i, j]:.12g}" for i in range(12) for j in range(5)]
    (tmp_path / "lengths.csv").write_text("\n".join(["station,point,length_mm", *rows]))
    (tmp_path / "other.csv").write_text("\n".join(["tracer,point,length_mm", *rows]))
    listed = [f"P{i},{','.join(map(repr, row))}" for i, row in enumerate(near.tolist())]
    (tmp_path / "points.csv").write_text("\n".join(["point,x_mm,y_mm,z_mm", *listed]))
    (tmp_path / "stations.csv").write_text("\n".join(["station,instrument", *(f"T{j},I" for j in range(5))]))
    (tmp_path / "job.yaml").write_text(
        "metrocli: 1\njob: adjust-network\ninputs: {lengths: lengths.csv, stations: stations.csv, points: points.csv}\n"
        "instruments: {I: {type: interferometer, noise: {distance: {constant: 0.3 um, proportional: 0.1 um/m}}}}\n"
        "output: result.h5\n"
    )
    (tmp_path / "same.yaml").write_text(
        "metrocli: 1\njob: multilaterate\ninputs: {lengths: other.csv, points: points.csv}\n"
        "noise: {constant: 0.3 um, proportional: 0.1 um/m}\noutput: same.h5\n"
    )
    result = solved(tmp_path / "job.yaml", metrocli)
    assert metrocli("multilaterate", tmp_path / "same.yaml").code == 0
    same = hdf5.read(tmp_path / "same.h5")[0]
    names = [f"P{i}" for i in range(12)]
    assert np.abs(places(result, names) - places(same, names)).max() < 1e-11
    own, other = (one.arrays["points_covariance"] for one in (result, same))
    assert np.abs(own - other).max() < 1e-11 * np.abs(other).max()


def test_simulated_readings_give_their_truth_and_a_plan_its_uncertainty(tmp_path: Path, metrocli: Metrocli) -> None:
    net = network(np.random.default_rng(36), 3, 10)
    job = net.write(tmp_path, "simulation: {faces: 2, interval: 5 s, point_error: 0.2 mm}\n")
    lines = [f"S{i + 1},A,{','.join(map(str, p))}" for i, p in enumerate(net.places.tolist())]
    (tmp_path / "stations.csv").write_text("\n".join(["station,instrument,x_mm,y_mm,z_mm", *lines]))
    (tmp_path / "readings.csv").unlink()
    assert metrocli("simulate", job, "--seed", 5, "--out", tmp_path / "new").code == 0
    for name in ("readings.csv", "points.csv"):
        (tmp_path / "new" / name).replace(tmp_path / name)
    result = solved(job, metrocli)
    x, spread = places(result, net.names), result.tables["points"].stacked(("sx", "sy", "sz"))
    between = [np.linalg.norm(one[:, None] - one, axis=2) for one in (x, net.near)]
    assert np.abs(between[0] - between[1]).max() < 12 * spread.max()
    assert metrocli("plan", job, "--out", tmp_path / "plan").code == 0
    planned = np.loadtxt(tmp_path / "plan" / "points.csv", delimiter=",", skiprows=1, usecols=(4, 5, 6))
    assert np.abs(planned / spread - 1).max() < 0.02


def test_a_known_orientation_turns_the_network(tmp_path: Path, metrocli: Metrocli) -> None:
    net = replace(network(np.random.default_rng(43), faces=2, levelled=True), listed=False)
    job = net.write(tmp_path)
    free = solved(job, metrocli)
    path = tmp_path / "stations.csv"
    head, *rows = path.read_text().splitlines()
    own = net.rotations[2]
    gamma = np.degrees(np.arctan2(own[1, 0], own[0, 0]))
    lines = [f"{row},{gamma if number == 2 else ''}" for number, row in enumerate(rows)]
    path.write_text("\n".join([f"{head},gamma_deg", *lines]) + "\n")
    turned = solved(job, metrocli)
    assert turned.statistics["dof"] == free.statistics["dof"]
    assert turned.statistics["chi2"] == pytest.approx(free.statistics["chi2"], rel=1e-6)
    away = places(turned, net.names) - net.points
    assert np.abs(away - away.mean(axis=0)).max() < 0.2


def test_places_that_are_not_tested_for_one_reason_stand_in_one_line(tmp_path: Path, metrocli: Metrocli) -> None:
    net = network(np.random.default_rng(37), mixed=True)
    told = metrocli("diagnose", net.write(tmp_path), "--design").out.splitlines()
    lines = [line for line in told if line.startswith("given-point") and "not-tested" in line]
    assert len(lines) == len({line.rpartition("  ")[2] for line in lines}) <= 2
    assert any(
        "more" in line and line.endswith("needs a list that gives it with a standard deviation above zero")
        for line in lines
    )
    assert not any("needs a column heights" in line for line in told)


def test_a_cause_that_would_show_only_beyond_its_plausible_size_is_listed_with_this_reason(
    tmp_path: Path, metrocli: Metrocli
) -> None:
    """A bar is wrong by 10 mm at most, and one with a standard deviation of 50 mm shows no such error."""
    job = network(np.random.default_rng(37), mixed=True).write(tmp_path)
    path = tmp_path / "bars.csv"
    head, first, *others = path.read_text().splitlines()
    path.write_text("\n".join([head, f"{first.rpartition(',')[0]},50", *others]) + "\n")
    lines = [line for line in metrocli("diagnose", job, "--design").out.splitlines() if line.startswith("bar-error")]
    (untested,) = (line for line in lines if "not-tested" in line)
    assert "B1" in untested and untested.endswith("the measurement sees only sizes beyond the plausible")
    assert any("B2" in line for line in lines if line != untested)


@pytest.mark.parametrize("component", range(3))
def test_a_sensor_that_sticks_is_named(component: int, tmp_path: Path, metrocli: Metrocli) -> None:
    """The places of the list were blamed, and the diagnosis named effects of the instruments."""
    net = network(np.random.default_rng(38), 3, 15)
    assert "sticks" not in metrocli("adjust-network", net.write(tmp_path)).err
    seen = net.seen.copy()
    stuck = np.flatnonzero(net.station == 1)[4:10]
    seen[stuck, component] = seen[stuck[0], component]
    job = replace(net, seen=seen).write(tmp_path)
    ran = metrocli("adjust-network", job)
    heading = ("az_rad", "el_rad", "d_mm")[component]
    text = f"{heading} of S2 stays the same in 6 rows in a row from line {stuck[0] + 2} on, at different points"
    assert ran.code == 6 and text in ran.err and "as far from those that its files list" not in ran.out, ran.out


@pytest.mark.parametrize("component", range(3))
def test_coarse_readings_that_repeat_do_not_stick(component: int, tmp_path: Path, metrocli: Metrocli) -> None:
    """Points on a circle about a station, or above one another, have readings that the last digit does not tell apart."""
    net = network(np.random.default_rng(38), 3, 15)
    step = (1e-4, 1e-4, 0.1)[component]
    seen = net.seen.copy()
    same = np.flatnonzero(net.station == 1)[4:10]
    seen[same, component] = seen[same[0], component]
    seen[:, component] = np.round(seen[:, component] / step) * step
    ran = metrocli("adjust-network", replace(net, seen=seen).write(tmp_path))
    assert ran.code in (0, 6) and "stays the same" not in ran.err + ran.out


@pytest.mark.parametrize("component", range(2))
def test_a_circle_of_a_total_station_that_sticks_is_named(component: int, tmp_path: Path, metrocli: Metrocli) -> None:
    """Only azimuths and elevations were looked at, and neither circle readings nor zenith distances."""
    net = network(np.random.default_rng(38), 3, 15)
    seen = net.seen * [-1.0, -1.0, 1.0] + [0.0, np.pi / 2, 0.0]
    stuck = np.flatnonzero(net.station == 1)[4:10]
    seen[stuck, component] = seen[stuck[0], component]
    ran = metrocli("adjust-network", replace(net, seen=seen).write(tmp_path, header="hz_rad,zd_rad,d_mm"))
    assert f"{('hz_rad', 'zd_rad')[component]} of S2 stays the same in 6 rows in a row" in ran.err
