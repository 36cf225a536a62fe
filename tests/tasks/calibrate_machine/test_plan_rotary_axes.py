"""Plans for machines with rotary axes: what they promise comes true, and what few balls leave open is said before."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from simulated import five_axis as sim

from metrocli.project.inputs import read_inputs
from metrocli.project.job import load
from metrocli.tasks.calibrate_machine import task as calibrate_machine

Metrocli = Callable[..., Any]


def job(folder: Path, estimate: str, more: str = "", kind: str = "table-table") -> Path:
    rest = f"estimate: {estimate}\ninputs: {{probing: probing.csv, balls: balls.csv}}\nnoise: {{probing: 1 um}}\nvolume: {{grid: [3, 3, 3, 3, 3]}}\n{more}"
    return sim.job(folder, sim.Machine(sim.KINDS[kind], {}), "probing", rest)


def test_planned_poses_and_balls_give_what_is_promised(tmp_path: Path, metrocli: Metrocli) -> None:
    path = job(tmp_path, "locations", "plan: {uncertainty: 1 um}\nsimulation: {error: 20 um}")
    ran = metrocli("plan", path, "--json", "--out", tmp_path, "--force")
    assert ran.code == 0, ran.err
    assert 0.8e-3 < json.loads(ran.out)["figures"]["uncertainty"]["value"] < 1e-3
    assert len((tmp_path / "balls.csv").read_text().splitlines()) == 4
    promised = (tmp_path / "errors.csv").read_text().splitlines()[1:]
    std = {row.split(",")[0]: float(row.split(",")[3]) for row in promised}
    assert metrocli("simulate", path, "--out", tmp_path, "--force").code == 0
    file = load(path)
    result = calibrate_machine.run(calibrate_machine.TASK.job(file.settings, **read_inputs(file)))
    found = {one.name: one for one in result.estimates}
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert set(std) == set(truth) == set(found)
    assert max(abs(found[name].std / std[name] - 1) for name in std) < 0.02
    z = np.array([(found[name].value - truth[name]) / found[name].std for name in std])
    assert np.sqrt((z**2).mean()) < 2.0


def test_what_one_ball_leaves_open_is_said_before_measuring(tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "balls.csv").write_text("ball,x_mm,y_mm,z_mm\nK1,148,36,-507\n")
    ran = metrocli("plan", job(tmp_path, "rotary"))
    assert ran.code == 4
    assert "three balls that are not on one line, or `estimate: locations`" in ran.err


def test_one_tool_of_a_head_is_a_plan_that_names_what_stays_open(tmp_path: Path, metrocli: Metrocli) -> None:
    path = job(tmp_path, "locations", kind="head-table")
    path.write_text(
        path.read_text().replace(", T2: [0.0 mm, 0.0 mm, -260.0 mm], T3: [90.0 mm, 40.0 mm, -180.0 mm]", "")
    )
    ran = metrocli("plan", path, "--set", "plan.uncertainty=3 um")
    assert ran.code == 0, ran.err
    assert "undetermined" in ran.out and "EC0S" in ran.out
