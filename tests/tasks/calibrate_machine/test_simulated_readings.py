"""What a simulation takes over from the file of the job, and the times, temperatures and sides that it sets without one."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

Metrocli = Callable[..., Any]
HEAD = """metrocli: 1
job: calibrate-machine
machine:
  chain: wXbYZt
  axes: {x: {range: [0 mm, 600 mm], knots: 3}, y: {range: [-260 mm, 260 mm], knots: 3}, z: {range: [-500 mm, 0 mm], knots: 3}}
  tool: [0 mm, 0 mm, 0 mm]
output: result.h5
"""
LINES = f"""{HEAD}method: six-dof
inputs: {{lines: lines.csv}}
noise: {{displacement: 0.5 um, straightness: 1 um, angle: 1 urad}}
simulation: {{error: 50 um, step: 60 mm, warming: 3 K}}
"""
LENGTHS = f"""{HEAD}method: lengths
inputs: {{lengths: lengths.csv}}
noise: {{constant: 0.2 um, proportional: 0.2 um/m}}
simulation: {{error: 50 um, points: 30, warming: 2 K}}
"""
POINTS = f"""{HEAD}method: standstill
inputs: {{points: points.csv}}
noise: {{beam: 1 um, lateral: 2 um}}
simulation: {{error: 50 um, points: 30}}
"""
AIR = "laser-refraction-drift:by=T,rate=4e-5 1/K"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def simulated(folder: Path, text: str, metrocli: Metrocli, file: str, *effects: str) -> dict[str, list[str]]:
    """Return the columns of a simulated file, by heading."""
    (folder / "job.yaml").write_text(text)
    wanted = [word for effect in effects for word in ("--effect", effect)]
    ran = metrocli("simulate", folder / "job.yaml", "--out", folder / "new", "--force", *wanted)
    assert ran.code == 0, ran.err
    head, *rows = (line for line in (folder / "new" / file).read_text().splitlines() if not line.startswith("#"))
    return dict(zip(head.split(","), map(list, zip(*(row.split(",") for row in rows), strict=True)), strict=True))


def numbers(columns: dict[str, list[str]], name: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array(columns[name], dtype=float)


def test_air_that_warms_up_is_planted_on_lines_and_found(folder: Path, metrocli: Metrocli) -> None:
    columns = simulated(folder, LINES, metrocli, "lines.csv", AIR)
    assert np.ptp(numbers(columns, "temp_degC")) == pytest.approx(3.0)
    (folder / "lines.csv").write_text((folder / "new" / "lines.csv").read_text())
    job = folder / "job.yaml"
    job.write_text(f"{LINES}effects: [{{name: laser-refraction-drift, by: T}}]\n")
    rate = json.loads(metrocli("calibrate-machine", job, "--json").out)["estimates"]["laser-refraction-drift.rate"]
    assert abs(rate["value"] - 4e-5) < 4 * rate["std"] < 1.2e-5


def test_the_lines_of_a_file_are_made_again(folder: Path, metrocli: Metrocli) -> None:
    """Their order, names, times and temperatures stand, and so does where the other axes are."""
    rows = [
        (f"run{k}", "x", p, 40.0 * i + 600 * k, 20 + np.sin(i)) for k in range(2) for i, p in enumerate([0, 250, 600])
    ]
    text = "line,axis,position_mm,y_mm,z_mm,t_s,temp_degC,ex_um,ey_um,ez_um,ea_urad,eb_urad,ec_urad\n"
    text += "".join(f"{line},{axis},{p},100,-200,{t},{warm:.3f},0,0,0,0,0,0\n" for line, axis, p, t, warm in rows)
    (folder / "lines.csv").write_text(text)
    columns = simulated(folder, LINES.replace(", warming: 3 K", ""), metrocli, "lines.csv", AIR)
    assert columns["line"] == [row[0] for row in rows]
    for name, at in (("position_mm", 2), ("t_s", 3), ("temp_degC", 4)):
        assert numbers(columns, name) == pytest.approx([float(row[at]) for row in rows], abs=1e-3)
    assert set(numbers(columns, "y_mm")) == {100.0} and set(numbers(columns, "z_mm")) == {-200.0}


def test_without_a_file_lengths_have_sides_and_temperatures(folder: Path, metrocli: Metrocli) -> None:
    columns = simulated(folder, LENGTHS, metrocli, "lengths.csv", "backlash:axis=x,width=20um")
    assert np.ptp(numbers(columns, "temp_degC")) == pytest.approx(2.0)
    for axis in "xyz":
        moves, side = np.diff(numbers(columns, f"{axis}_mm")), numbers(columns, f"from_{axis}")
        assert np.array_equal(np.sign(moves[moves != 0]), side[1:][moves != 0])


def test_sides_follow_the_times_of_a_list_not_its_rows(folder: Path, metrocli: Metrocli) -> None:
    at, t = np.random.default_rng(5).uniform([0, -260, -500], [600, 260, 0], (40, 3)), np.arange(40.0)
    order = np.random.default_rng(6).permutation(40)
    rows = "".join(f"P{i},{at[i, 0]},{at[i, 1]},{at[i, 2]},0,0,0,{t[i]}\n" for i in order)
    (folder / "points.csv").write_text(f"point,x_mm,y_mm,z_mm,mx_mm,my_mm,mz_mm,t_s\n{rows}")
    columns = simulated(folder, POINTS, metrocli, "points.csv", "backlash:axis=x,width=20um")
    travel = np.argsort(numbers(columns, "t_s"))
    for axis in "xyz":
        places, side = numbers(columns, f"{axis}_mm")[travel], numbers(columns, f"from_{axis}")[travel]
        assert np.array_equal(np.sign(np.diff(places)), side[1:])


def at_once(folder: Path, metrocli: Metrocli) -> None:
    """The file of the job: four stations that read each of 80 points at once."""
    first = simulated(folder, f"{LENGTHS.replace('points: 30', 'points: 80')}", metrocli, "lengths.csv")
    first["t_s"] = [f"{4 * int(name[1:])}" for name in first["point"]]
    rows = [",".join(row) for row in zip(*first.values(), strict=True)]
    (folder / "lengths.csv").write_text("\n".join([",".join(first), *rows]) + "\n")


def test_lengths_of_one_stop_share_its_deviation(folder: Path, metrocli: Metrocli) -> None:
    """Stops that scatter ten times as much as the lengths leave no more misfit than lengths that do not."""
    at_once(folder, metrocli)
    text = LENGTHS.replace("0.2 um/m}", "0.2 um/m, repeatability: 3 um}")
    simulated(folder, text, metrocli, "lengths.csv")
    (folder / "job.yaml").write_text(text.replace("lengths.csv", "new/lengths.csv"))
    found = json.loads(metrocli("calibrate-machine", folder / "job.yaml", "--force", "--json").out)["statistics"]
    assert 0.8 < found["sigma0"] < 1.2, found["sigma0"]


def test_a_stop_off_its_place_is_planted_and_estimated(folder: Path, metrocli: Metrocli) -> None:
    at_once(folder, metrocli)
    where = "stop=P005 at 20 s"
    simulated(folder, LENGTHS, metrocli, "lengths.csv", f"repeatability:{where},dx=30um,dy=-20um,dz=10um")
    job = LENGTHS.replace("lengths.csv", "new/lengths.csv")
    (folder / "job.yaml").write_text(f"{job}effects: [{{name: repeatability, stop: P005 at 20 s}}]\n")
    found = json.loads(metrocli("calibrate-machine", folder / "job.yaml", "--force", "--json").out)["estimates"]
    for name, planted in (("dx", 0.03), ("dy", -0.02), ("dz", 0.01)):
        size = found[f"repeatability.P005 at 20 s.{name}"]
        assert abs(size["value"] - planted) < 4 * size["std"] < 0.02


def test_a_scatter_that_no_simulation_draws_is_refused_with_what_to_write(folder: Path, metrocli: Metrocli) -> None:
    (folder / "job.yaml").write_text(LENGTHS)
    ran = metrocli("simulate", folder / "job.yaml", "--out", folder / "new", "--effect", "repeatability:std=3um")
    assert ran.code == 3 and "draws no sizes from `std`" in ran.err and "--set noise.repeatability=" in ran.err
