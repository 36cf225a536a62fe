"""Kinematic tests: the range of the tip's error along listed paths, against matrices that share no code."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from simulated import five_axis as sim

from metrocli.errors import InputError
from metrocli.project.inputs import read_inputs
from metrocli.project.job import load
from metrocli.result import Result
from metrocli.tasks.calibrate_machine import task as calibrate_machine


def result(job: Path) -> Result:
    file = load(job)
    return calibrate_machine.run(calibrate_machine.TASK.job(file.settings, effects=file.effects, **read_inputs(file)))


def test_the_range_along_a_path_is_predicted_and_measured_where_an_r_test_followed_it(tmp_path: Path) -> None:
    rng = np.random.default_rng(51)
    machine = sim.drawn(sim.KINDS["table-table"], rng, linear=False)
    job = sim.probed(tmp_path, machine, rng, 160, 3e-4, rtest=True)
    tool, ball = np.array(machine.kind.tools["T1"]), np.array(machine.kind.balls[0])
    turns = [{**dict.fromkeys(machine.knots, 0.0), "C": c * sim.DEG} for c in range(0, 361, 15)]
    poses = [sim._meeting(machine.perfect(), pose, ball, tool) for pose in turns]
    read = [row.split(",") for row in (tmp_path / "probing.csv").read_text().splitlines()]
    followed = [row[1:6] for row in read[1:] if row[0] == "K2"][:12]
    rows = [f"turn,{sim.cells(pose)}" for pose in poses] + [f"read,{','.join(row)}" for row in followed]
    (tmp_path / "paths.csv").write_text("\n".join([f"path,{sim.header(machine)}", *rows]) + "\n")
    job.write_text(job.read_text().replace("balls: balls.csv", "balls: balls.csv, paths: paths.csv"))
    table = result(job).tables["paths"]
    also = [dict(zip(machine.knots, map(float, row), strict=True)) for row in followed]
    also = [{k: v * sim.DEG if k in sim.ROTARY else v for k, v in pose.items()} for pose in also]
    ranges = [np.ptp(sim.errors_at(machine, own, tool)[1], axis=0) for own in (poses, also)]
    true, size, u = np.concatenate(ranges), table.numbers("range"), table.numbers("U_range")
    assert table.texts("path") == ["turn"] * 3 + ["read"] * 3
    assert (np.abs(size - true) < 1.5 * u).all()
    assert (u < 0.2 * true).all()
    measured, spread = table.numbers("measured"), table.numbers("U_measured")
    assert np.isnan(measured[:3]).all()
    assert (np.abs(measured - true)[3:] < 2 * spread[3:]).all()


def test_a_path_of_one_position_is_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(52)
    machine = sim.drawn(sim.KINDS["table-table"], rng, linear=False)
    job = sim.probed(tmp_path, machine, rng, 60, 5e-4, estimate="locations")
    (tmp_path / "paths.csv").write_text(f"path,{sim.header(machine)}\nBK1,0,0,-300,0,0\n")
    job.write_text(job.read_text().replace("balls: balls.csv", "balls: balls.csv, paths: paths.csv"))
    with pytest.raises(InputError, match="path BK1 has one position"):
        result(job)
