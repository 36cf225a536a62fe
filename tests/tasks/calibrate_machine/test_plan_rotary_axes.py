"""Plans for machines with rotary axes: what they promise comes true, and what few balls leave open is said before."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated import five_axis as sim

from metrocli import nc_program
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
    # the plan is an input of the simulation, which does not replace it
    assert metrocli("simulate", path, "--out", tmp_path / "new").code == 0
    shutil.copy(tmp_path / "new" / "probing.csv", tmp_path)
    file = load(path)
    result = calibrate_machine.run(calibrate_machine.TASK.job(file.settings, **read_inputs(file)))
    found = {one.name: one for one in result.estimates}
    truth = json.loads((tmp_path / "new" / "truth.json").read_text())
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


def visited(text: str) -> list[tuple[dict[str, float], str]]:
    """Return the positions [mm, rad] at which a program reads or waits, with its comment there; Z is up where axes turn."""
    at: dict[str, float] = {}
    found, said = [], ""
    for line in text.splitlines():
        if line.startswith("("):
            said = line[1:-1]
        elif line == "M0" or line.startswith("G4"):
            found.append((dict(at), said))
        elif line.startswith(("G0 ", "G1 ")):
            to = {word[0]: float(word[1:]) for word in line.split()[1:] if word[0] in "XYZABC"}
            turning = {letter: value * sim.DEG for letter, value in to.items() if letter in sim.ROTARY}
            assert not turning or at["Z"] == 0.0
            at |= to | turning
    assert text.splitlines()[-2:] == ["M30", "%"] and at["Z"] == 0.0
    return found


@pytest.mark.alike
@pytest.mark.parametrize("kind", ["table-table", "head-table"])
def test_a_program_stands_off_each_ball_along_the_tool(tmp_path: Path, metrocli: Metrocli, kind: str) -> None:
    """The place of the tip is found by 4 x 4 matrices that share nothing with the program."""
    path = job(tmp_path, "locations", kind=kind)
    assert metrocli("plan", path, "--out", tmp_path, "--force").code == 0
    machine, tools = sim.Machine(sim.KINDS[kind], {}), sim.KINDS[kind].tools
    balls = {
        row.split(",")[0]: np.array(row.split(",")[1:4], float)
        for row in (tmp_path / "balls.csv").read_text().splitlines()[1:]
    }
    stood = visited((tmp_path / "probing.nc").read_text())
    rows = (tmp_path / "probing.csv").read_text().splitlines()
    listed = [dict(zip(rows[0].split(","), row.split(","), strict=True)) for row in rows[1:]]
    assert len([one for one in stood if one[1].startswith("ball")]) == len(listed)
    tool, number = next(iter(tools)), 0
    for pose, said in stood:
        if not said.startswith("ball"):
            tool = said.removeprefix("mount probe ").strip() or tool
            continue
        row, number = listed[number], number + 1
        assert said == f"ball {row['ball']}" and row.get("tool", tool) == tool
        workpiece, spindle = machine.sides(pose)
        vector = np.array(tools[tool])
        tip, ball = (spindle @ np.append(vector, 1))[:3], (workpiece @ np.append(balls[row["ball"]], 1))[:3]
        along = spindle[:3, :3] @ vector / np.linalg.norm(vector)
        assert np.abs(ball - tip - 50 * along).max() < 2e-3


def test_a_tracker_reads_where_the_program_rests(tmp_path: Path, metrocli: Metrocli) -> None:
    rest = "estimate: locations\ninputs: {points: points.csv}\nnoise: {beam: 2 um, lateral: 5 um}\nvolume: {grid: [2, 2, 2, 2, 2]}\n"
    path = sim.job(tmp_path, sim.Machine(sim.KINDS["table-table"], {}), "standstill", rest)
    ran = metrocli("plan", path, "--out", tmp_path, "--force")
    # what is promised depends on where it stands
    assert ran.code == 0 and "mm in the machine, assumed; `plan: {tracker: [..]}`" in ran.out
    given = metrocli("plan", path, "--out", tmp_path / "given", "--set", "plan.tracker=[-1 m, 2 m, 0.3 m]")
    assert "tracker at (-1000, 2000, 300) mm in the machine, as the job has it" in given.out
    rows = [row.split(",") for row in (tmp_path / "points.csv").read_text().splitlines()]
    stood = [one for one in visited((tmp_path / "points.nc").read_text()) if one[1].startswith("point")]
    assert [said for _, said in stood] == [f"point {row[0]}" for row in rows[1:]]
    for (pose, _), row in zip(stood, rows[1:], strict=True):
        cells = dict(zip(rows[0], row, strict=True))
        for letter, value in pose.items():
            unit = ("deg", sim.DEG) if letter in sim.ROTARY else ("mm", 1.0)
            assert abs(value / unit[1] - float(cells[f"{letter.lower()}_{unit[0]}"])) < 1e-4


def test_siemens_turns_any_turn_the_shortest_way() -> None:
    blocks = [nc_program.Rapid({"A": -30.0, "C": 361.0}, "C"), nc_program.Rapid({"C": -1.0}, "C")]
    assert "G0 A-30.0000 C=DC(1.0000)\nG0 C=DC(359.0000)\n" in nc_program.program("", (), blocks, "siemens")
    assert "G0 A-30.0000 C361.0000\nG0 C-1.0000\n" in nc_program.program("", (), blocks)


def test_a_table_alone_is_planned_with_as_many_poses_as_it_needs(tmp_path: Path, metrocli: Metrocli) -> None:
    """Few poses leave knots open that more do not; a spindle that stands on the bed beside the instrument is not read."""
    (tmp_path / "reflectors.csv").write_text(
        "reflector,on,x_mm,y_mm,z_mm,sigma_mm\nR1,workpiece,200,0,50,0.1\nR2,workpiece,-100,170,120,0.1\n"
        "R3,workpiece,-100,-170,20,0.1\n"
    )
    (tmp_path / "job.yaml").write_text(
        "metrocli: 1\njob: calibrate-machine\nmethod: lengths\nmachine:\n  chain: wCbt\n"
        "  axes: {c: {range: [0 deg, 360 deg], knots: 9, at: [0 mm, 0 mm, 0 mm]}}\n"
        "inputs: {lengths: lengths.csv, reflectors: reflectors.csv}\nnoise: {constant: 0.3 um}\n"
        "instrument: {on: bed}\nplan: {uncertainty: 1 um}\noutput: t.h5\n"
    )
    path = tmp_path / "job.yaml"
    path.write_text(path.read_text() + "simulation: {error: 20 um}\n")
    ran = metrocli("plan", path, "--out", tmp_path / "plan", "--json")
    assert ran.code == 0, ran.err
    promised = json.loads(ran.out)["figures"]["ratio"]["value"]
    planned = "inputs.lengths=plan/lengths.csv"
    assert metrocli("simulate", path, "--out", tmp_path / "new", "--set", planned).code == 0
    solved = metrocli("calibrate-machine", path, "--json", "--set", "inputs.lengths=new/lengths.csv")
    assert solved.code == 0, solved.err
    # what the list of reflectors holds moves nothing, and makes no ratio infinite
    assert json.loads(solved.out)["statistics"]["ratio"] == pytest.approx(promised, rel=0.2)
    rows = (tmp_path / "plan/lengths.csv").read_text().splitlines()
    at = rows[0].split(",").index("tool")
    assert {row.split(",")[at] for row in rows[1:]} == {"R1", "R2", "R3"}
    program = (tmp_path / "plan/lengths.nc").read_text()
    assert program.count("M0") == 12 and "Z" not in program.split("G94")[1]
