"""A plan states what the measurement then states, also of a station that stands on its side."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated.network import SIZE, Array, polar, turned

from metrocli.formats import csv, hdf5
from metrocli.table import Columns, columns
from metrocli.units import two_digits

Metrocli = Callable[..., Any]
AZIMUTH, ELEVATION, DISTANCE = 2e-6, 3e-5, 0.1
"""Noise of a tracker whose vertical circle is worn: rad, rad, mm"""
NOISE = "{azimuth: 2 urad, elevation: 30 urad, distance: {constant: 0.1 mm}}"
PLACE = np.array([1000.0, 600.0, 1200.0])
UPRIGHT = turned(0.01, -0.02, 0.3)
ON_ITS_SIDE = {"x": turned(np.pi / 2, 0.0, np.pi / 2), "y": turned(np.pi / 2, 0.0, 0.0)}
"""Rotations of instruments whose standing axis lies along x or y"""
REGION = "region: {from: [0 mm, 0 mm, 0 mm], to: [8 m, 5 m, 2.6 m]}"
DRAWS = 20
CANDIDATES = Columns(columns("station axis? [text]", "x y z [length]", "worth"), (), "places that a plan tried")
CORNERS = np.array([[0.0, 0, 0], [8e3, 5e3, 0], [8e3, 0, 2600], [0, 5e3, 2600], [4e3, 2500, -1000]])


def points_of_hall() -> Array:
    return np.random.default_rng(21).uniform(0, 1, (14, 3)) * SIZE


def job(
    folder: Path, *, plan: str = "", readings: str = "", places: Array = PLACE[None], kind: str = "tracker"
) -> Path:
    """Write a job of one instrument at some stations, with the true places of its points as their list."""
    rows = [f"P{i:02d},{x:.13g},{y:.13g},{z:.13g}" for i, (x, y, z) in enumerate(points_of_hall())]
    (folder / "points.csv").write_text("\n".join(["point,x_mm,y_mm,z_mm", *rows]) + "\n")
    rows = [f"S{i + 1},A,{x:.13g},{y:.13g},{z:.13g}" for i, (x, y, z) in enumerate(places)]
    (folder / "stations.csv").write_text("\n".join(["station,instrument,x_mm,y_mm,z_mm", *rows]) + "\n")
    path = folder / "job.yaml"
    path.write_text(
        f"metrocli: 1\njob: adjust-network\ninputs: {{points: points.csv, stations: stations.csv{readings}}}\n"
        f"instruments:\n  A: {{type: {kind}, noise: {NOISE}}}\n{plan}output: result.h5\n"
    )
    return path


def candidates(folder: Path, metrocli: Metrocli, plan: str) -> Any:
    ran = metrocli("plan", job(folder, plan=f"plan: {{{plan}}}\n"), "--out", folder / "plan", "--force")
    assert ran.code == 0, ran.err
    return ran.out, csv.read(folder / "plan" / "candidates.csv", CANDIDATES)


def measured(folder: Path, metrocli: Metrocli, place: Array, rotation: Array, seed: int) -> tuple[Array, Array]:
    """Return errors and stated standard uncertainties of points that a further station there measures as well."""
    rng, points, places = np.random.default_rng(seed), points_of_hall(), np.array([PLACE, place])
    lines = ["station,point,az_rad,el_rad,d_mm"]
    for name, at, turn in (("S1", PLACE, UPRIGHT), ("S2", place, rotation)):
        seen = polar((points - at) @ turn)
        seen = seen + rng.normal(size=seen.shape) * [AZIMUTH, ELEVATION, DISTANCE]
        lines += [f"{name},P{i:02d},{a:.15g},{e:.15g},{d:.15g}" for i, (a, e, d) in enumerate(seen)]
    (folder / "readings.csv").write_text("\n".join(lines) + "\n")
    ran = metrocli("adjust-network", job(folder, readings=", readings: readings.csv", places=places), "--force")
    assert ran.code == 0, ran.err
    found = hdf5.read(folder / "result.h5")[0].tables["points"]
    return found.stacked("xyz") - points, found.stacked(["sx", "sy", "sz"])


def test_a_station_on_its_side_is_planned_where_it_makes_points_better(tmp_path: Path, metrocli: Metrocli) -> None:
    said, table = candidates(tmp_path, metrocli, f"{REGION}, rolled: true")
    axes, worth = np.array(table.texts("axis")), table.numbers("worth")
    assert set(axes) == {"up", "x", "y"}
    assert axes[worth.argmin()] != "up"
    spread = {}
    for axis in ("up", str(axes[worth.argmin()])):
        row = np.flatnonzero(axes == axis)[worth[axes == axis].argmin()]
        place = table.stacked("xyz")[row]
        rotation = UPRIGHT if axis == "up" else ON_ITS_SIDE[axis]
        draws = [measured(tmp_path, metrocli, place, rotation, seed) for seed in range(DRAWS)]
        stated = np.sqrt(np.mean(draws[0][1] ** 2))
        spread[axis] = np.sqrt(np.mean([errors**2 for errors, _ in draws]))
        # the plan draws other small tilts
        assert stated == pytest.approx(worth[row], rel=0.03)
        assert spread[axis] == pytest.approx(worth[row], rel=0.12)
    assert min(spread, key=lambda axis: spread[axis]) != "up"
    assert f"on its side with its standing axis along {axes[worth.argmin()]}: points" in said


def test_the_upright_stations_are_those_of_a_plan_without_any_on_its_side(tmp_path: Path, metrocli: Metrocli) -> None:
    _, rolled = candidates(tmp_path, metrocli, f"{REGION}, rolled: true")
    said, upright = candidates(tmp_path, metrocli, f"{REGION}, rolled: false")
    assert "axis" not in upright and "side" not in said
    assert np.array_equal(rolled.numbers("worth")[np.array(rolled.texts("axis")) == "up"], upright.numbers("worth"))


@pytest.mark.parametrize(
    ("kind", "plan", "says"),
    [
        ("total-station", f"{REGION}, rolled: true", "A, which is levelled and cannot stand on its side"),
        ("tracker", "rolled: true", "say where it may stand"),
        ("tracker", "stations: 2", "say where it may stand"),
        ("interferometer", REGION, "needs a tracker or a total station"),
    ],
)
def test_further_stations_that_cannot_be_are_refused(
    kind: str, plan: str, says: str, tmp_path: Path, metrocli: Metrocli
) -> None:
    path = job(tmp_path, plan=f"plan: {{{plan}}}\n", places=CORNERS, kind=kind)
    ran = metrocli("plan", path, "--out", tmp_path / "plan")
    assert ran.code == 3 and says in ran.err


def test_errors_of_the_instrument_are_stated_in_their_usual_sizes(tmp_path: Path, metrocli: Metrocli) -> None:
    said, table = candidates(tmp_path, metrocli, f"{REGION}, aim: instrument")
    least = 100 * table.numbers("worth").min()
    (line,) = (text for text in said.splitlines() if text.startswith("a further station"))
    assert line.endswith(f"mm: instrument {two_digits(least)} % of the largest usual errors")


def test_errors_and_their_usual_sizes_have_one_unit(tmp_path: Path, metrocli: Metrocli) -> None:
    """The errors stood in urad beside usual sizes in arcsec."""
    candidates(tmp_path, metrocli, f"{REGION}, aim: instrument")
    rows = [line.split(",") for line in (tmp_path / "plan" / "effects.csv").read_text().splitlines()[1:]]
    sized = {row[0]: (float(row[2]), row[3]) for row in rows if row[4].endswith(f" {row[3]}")}
    assert {row[0] for row in rows} == set(sized)
    std, unit = sized["tracker-vertical-index.angle"]
    assert unit == "arcsec" and std > 0.1


def test_a_listed_point_that_is_not_read_does_not_make_the_plan_better(tmp_path: Path, metrocli: Metrocli) -> None:
    path = job(tmp_path, readings=", readings: readings.csv")
    rows = [f"S1,P{i:02d},0.1,0.1,5000" for i in range(len(points_of_hall()))]
    (tmp_path / "readings.csv").write_text("\n".join(["station,point,az_rad,el_rad,d_mm", *rows]) + "\n")
    out, listed = [], tmp_path / "points.csv"
    for more in ("", "X,1000,2000,500\n"):
        listed.write_text(listed.read_text() + more)
        ran = metrocli("plan", path, "--out", tmp_path / "plan", "--force")
        assert ran.code == 0, ran.err
        out.append(next(line for line in ran.out.splitlines() if line.startswith("points: ")))
        assert "X," not in (tmp_path / "plan" / "points.csv").read_text()
    assert out[0] == out[1]
