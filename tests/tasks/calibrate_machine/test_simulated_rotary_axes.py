"""Simulated readings of machines with rotary axes: 4 x 4 matrices that share nothing with the program show the same."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated import five_axis as sim

Metrocli = Callable[..., Any]
NOISE = {
    "probing": "{probing: 0.001 um}",
    "standstill": "{beam: 0.001 um, lateral: 0.001 um}",
    "lengths": "{constant: 0.001 um}",
}
READS = {"probing": "probing: probing.csv, balls: balls.csv", "standstill": "points: points.csv", "lengths": "lengths: lengths.csv"}  # fmt: skip
POINTS = 40


def simulated(folder: Path, kind: str, method: str, metrocli: Metrocli, more: str = "", options: str = "") -> tuple[sim.Machine, dict[str, Any]]:  # fmt: skip
    """Return the true machine by the files of a simulation, and the columns of its readings."""
    machine = sim.Machine(sim.KINDS[kind], {})
    balls = "\n".join(f"K{i},{x},{y},{z}," for i, (x, y, z) in enumerate(machine.kind.balls, 1))
    (folder / "balls.csv").write_text(f"ball,x_mm,y_mm,z_mm,sigma_mm\n{balls}\n")
    rest = f"estimate: rotary\ninputs: {{{READS[method]}}}\nnoise: {NOISE[method]}\n{more}"
    job = sim.job(folder, machine, method, f"{rest}simulation: {{error: 50 um, points: {POINTS}{options}}}")
    ran = metrocli("simulate", job, "--out", folder / "new")
    assert ran.code == 0, ran.err
    for name, row in rows_by(folder / "new" / "true_errors.csv", "error").items():
        angle, place = (np.array(row[key]) for key in ("angle_rad", "position_mm"))
        machine.knots[name[-1]] = np.where(place == "", angle, place).astype(float)
        length, turn = (np.array(row[key]) for key in ("value_mm", "turn_rad"))
        machine.tables[name] = np.where(length == "", turn, length).astype(float)
    machine.places = json.loads((folder / "new" / "truth.json").read_text())
    file = next(file for file in ("probing.csv", "points.csv", "lengths.csv") if (folder / "new" / file).exists())
    return machine, columns(folder / "new" / file)


def columns(file: Path) -> dict[str, Any]:
    head, *rows = file.read_text().splitlines()
    return dict(zip(head.split(","), map(list, zip(*(row.split(",") for row in rows), strict=True)), strict=True))


def rows_by(file: Path, key: str) -> dict[str, dict[str, list[str]]]:
    whole = columns(file)
    at = {name: [i for i, one in enumerate(whole[key]) if one == name] for name in dict.fromkeys(whole[key])}
    return {name: {head: [cells[i] for i in rows] for head, cells in whole.items()} for name, rows in at.items()}


def tips(machine: sim.Machine, read: dict[str, Any], seen_from: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Where the tools are by 4 x 4 matrices, (n, 3)."""
    found = []
    for i, tool in enumerate(read["tool"]):
        workpiece, spindle = machine.sides(pose(machine, read, i))
        tip = spindle @ np.append(np.array(machine.kind.tools[tool]), 1.0)
        found.append((tip if seen_from == "bed" else np.linalg.inv(workpiece) @ tip)[:3])
    return np.array(found)


def pose(machine: sim.Machine, read: dict[str, Any], row: int) -> dict[str, float]:
    unit = {letter: sim.DEG if letter in sim.ROTARY else 1.0 for letter in machine.knots}
    return {
        letter: float(read[f"{letter.lower()}_{'deg' if letter in sim.ROTARY else 'mm'}"][row]) * unit[letter]
        for letter in machine.knots
    }


@pytest.mark.alike
@pytest.mark.parametrize(("kind", "sensor"), [("table-table", "bed"), ("head-head", "bed"), ("head-table", "tool")])
def test_a_probe_finds_each_ball_at_one_place_of_the_workpiece(
    kind: str, sensor: str, tmp_path: Path, metrocli: Metrocli
) -> None:
    more = "" if sensor == "bed" else f"sensor: {sensor}\n"
    machine, read = simulated(tmp_path, kind, "probing", metrocli, more)
    places = tips(machine, read, "workpiece")
    if sensor == "tool":
        for i in range(len(places)):
            body, spindle = machine.sides(pose(machine, read, i))
            perfect = machine.perfect().sides(pose(machine, read, i))[1]
            moved = perfect[:3, :3] @ [float(read[f"d{axis}_mm"][i]) for axis in "xyz"]
            tip = spindle @ np.append(np.array(machine.kind.tools[read["tool"][i]]), 1.0)
            places[i] = (np.linalg.inv(body) @ (tip + np.append(moved, 0.0)))[:3]
    for number, ball in enumerate(machine.kind.balls, 1):
        own = places[np.array(read["ball"]) == f"K{number}"]
        assert len(own) > 5
        assert np.ptp(own, axis=0).max() < 2e-5
        assert np.abs(own.mean(axis=0) - ball).max() < 3.0
    assert max(np.abs(values).max() for values in machine.tables.values()) > 1e-3


@pytest.mark.parametrize(("kind", "on"), [("head-table", "workpiece"), ("head-head", "bed")])
def test_a_tracker_sees_all_points_as_from_one_place(kind: str, on: str, tmp_path: Path, metrocli: Metrocli) -> None:
    machine, read = simulated(tmp_path, kind, "standstill", metrocli, f"instrument: {{'on': {on}}}\n", ", polar: true")
    distance, azimuth, elevation = (
        np.array(read[name], dtype=float) for name in ("distance_mm", "azimuth_deg", "elevation_deg")
    )
    azimuth, elevation = np.radians(azimuth), np.radians(elevation)
    level = np.cos(elevation)
    seen = distance[:, None] * np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=1)
    true = tips(machine, read, on)
    far, between = (np.linalg.norm(one[:, None] - one, axis=2) for one in (seen, true))
    assert np.abs(far - between).max() < 2e-5
    assert np.ptp(distance) > 100


def test_stations_read_lengths_from_places_of_their_own(tmp_path: Path, metrocli: Metrocli) -> None:
    machine, read = simulated(tmp_path, "head-table", "lengths", metrocli)
    true, station = tips(machine, read, "workpiece"), np.array(read["station"])
    length = np.array(read["length_mm"], dtype=float)
    for name in dict.fromkeys(read["station"]):
        own, path = true[station == name], length[station == name]
        # |p - x|^2 = (l + l0)^2, less the same at the first point, is linear in x, l0 (l = 0 at the first point)
        moved = own - own[0]
        sides = np.column_stack([-2 * moved, -2 * path])
        found, *_ = np.linalg.lstsq(sides, path**2 - (moved**2).sum(axis=1), rcond=None)
        reached = np.linalg.norm(moved - found[:3], axis=1) - np.linalg.norm(found[:3])
        assert np.abs(reached - path).max() < 2e-5


def test_balls_that_no_tool_reaches_are_named(tmp_path: Path, metrocli: Metrocli) -> None:
    machine = sim.Machine(sim.KINDS["table-table"], {})
    (tmp_path / "balls.csv").write_text("ball,x_mm,y_mm,z_mm,sigma_mm\nK1,9000,0,0,\n")
    rest = f"inputs: {{{READS['probing']}}}\nnoise: {NOISE['probing']}\nsimulation: {{}}"
    ran = metrocli("simulate", sim.job(tmp_path, machine, "probing", rest), "--out", tmp_path / "new")
    assert ran.code == 3
    assert "does a tool reach a listed ball" in ran.err
