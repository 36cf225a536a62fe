"""The commands on jobs of this kind: simulate, check, run, show, export, and every fault of a job at once."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metrocli.formats import csv, hdf5
from metrocli.tasks.calibrate_machine.files import TRACK
from metrocli.tasks.calibrate_machine.problem import SIDES

Metrocli = Callable[..., Any]
HEAD = """metrocli: 1
job: calibrate-machine
machine:
  chain: wXbYZt
  axes: {x: {range: [0 mm, 600 mm], knots: 5}, y: {range: [-260 mm, 260 mm], knots: 5}, z: {range: [-500 mm, 0 mm], knots: 5}}
  tools: {T1: [0 mm, 0 mm, 120 mm], T2: [110 mm, 20 mm, 150 mm], T3: [-30 mm, 100 mm, 210 mm]}
output: result.h5
"""
STANDSTILL = (
    HEAD
    + """method: standstill
inputs: {points: points.csv}
noise: {beam: 1 um, lateral: {constant: 2 um, proportional: 3 um/m}}
simulation: {error: 80 um, points: 200}
"""
)
FLIGHT = (
    HEAD
    + """method: on-the-fly
inputs: {path: path.csv, track: track.csv}
noise: {beam: 1 um, radial: 5 um}
simulation: {error: 117 um, sampling: 50 ms}
"""
)
LINES = (
    HEAD.replace(
        "tools: {T1: [0 mm, 0 mm, 120 mm], T2: [110 mm, 20 mm, 150 mm], T3: [-30 mm, 100 mm, 210 mm]}",
        "tool: [0 mm, 0 mm, 0 mm]",
    )
    + """method: six-dof
inputs: {lines: lines.csv}
noise: {displacement: 0.5 um, straightness: 1 um, angle: 1 urad}
simulation: {error: 50 um, step: 20 mm}
"""
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def made(folder: Path, text: str, metrocli: Metrocli) -> Path:
    """A job with its simulated measurement."""
    job = folder / "job.yaml"
    job.write_text(text)
    if "path.csv" in text:
        assert metrocli("plan", job, "--out", folder / "plan").code == 0
        (folder / "path.csv").write_text((folder / "plan" / "path.csv").read_text())
    assert metrocli("simulate", job, "--out", folder / "new", "--seed", 3).code == 0
    for path in (folder / "new").glob("*.csv"):
        (folder / path.name).write_text(path.read_text())
    return job


@pytest.mark.slow
@pytest.mark.parametrize("text", [STANDSTILL, FLIGHT, LINES], ids=["standstill", "on-the-fly", "six-dof"])
def test_what_is_simulated_is_found_again(folder: Path, text: str, metrocli: Metrocli) -> None:
    job = made(folder, text, metrocli)
    assert metrocli("check", job).code == 0
    ran = metrocli("calibrate-machine", job, "--json")
    assert ran.code == 0, ran.err
    summary = json.loads(ran.out)
    truth = json.loads((folder / "new" / "truth.json").read_text())
    assert set(summary["estimates"]) == {"A0Z", "B0Z", "C0Y"}
    assert any("repeatability and its errors between knots add to it" in note for note in summary["notes"])
    for name, estimate in summary["estimates"].items():
        assert abs(estimate["value"] - truth[name]) < 4.5 * estimate["std"]
        assert estimate["unit"] == "rad"
    true = csv.read(folder / "new" / "true_errors.csv", columns_of_truth())
    result, _ = hdf5.read(folder / "result.h5")
    for name in set(true.texts("error")):
        rows = np.array(true.texts("error")) == name
        value = np.nan_to_num(true.numbers("value")[rows]) + np.nan_to_num(true.numbers("turn")[rows])
        table = result.tables[f"tables/{name}"]
        std = table.numbers("std")
        assert np.abs((table.numbers("value") - value) / np.maximum(std, 1e-12)).max() < 5, name
    shown = metrocli("show", folder / "result.h5")
    assert "every error is determined" in shown.out and "C0Y" in shown.out
    assert metrocli("export", folder / "result.h5", "--to", "csv", "--out", folder / "out").code == 0


@pytest.mark.parametrize("axes", [("x",), ("x", "z")])
def test_displacement_alone_is_simulated_planned_and_found_again(
    axes: tuple[str, ...], folder: Path, metrocli: Metrocli
) -> None:
    """Five runs to and fro along each axis of the job, with the channel of its displacement (ISO 230-2)."""
    given = ", ".join(f"{axis}: {{range: [0 mm, 600 mm], knots: 5}}" for axis in axes)
    text = LINES[: LINES.index("machine:")] + f"machine: {{axes: {{{given}}}}}\nmethod: six-dof\n"
    text += "inputs: {lines: new/lines.csv}\nnoise: {displacement: 0.5 um}\nsimulation: {error: 20 um, step: 50 mm}\n"
    (folder / "job.yaml").write_text(text + "output: result.h5\n")
    assert metrocli("simulate", "job.yaml", "--seed", 2, "--out", "new").code == 0
    head = (folder / "new" / "lines.csv").read_text().splitlines()[0].split(",")
    assert [name for name in head if name[:2] in ("ex", "ey", "ez", "ea")] == [f"e{axis}_mm" for axis in axes]
    assert metrocli("calibrate-machine", "job.yaml").code == 0
    result, true = hdf5.read(folder / "result.h5")[0], csv.read(folder / "new" / "true_errors.csv", columns_of_truth())
    assert set(result.tables["positioning"].numbers("runs_up")) == {5}
    for name in (f"E{axis}{axis}".upper() for axis in axes):
        table = result.tables[f"tables/{name}"]
        off = table.numbers("value") - true.numbers("value")[np.array(true.texts("error")) == name]
        assert np.abs(off / np.maximum(table.numbers("std"), 1e-6)).max() < 4.5
    assert metrocli("plan", "job.yaml", "--out", "plan").code == 0


def columns_of_truth():  # type: ignore[no-untyped-def]
    from metrocli.table import TEXT, Column, Columns

    return Columns(
        (
            Column("error", TEXT),
            Column("position", "length"),
            Column("value", "length", may_be_empty=True),
            Column("turn", "angle", may_be_empty=True),
        )
    )


PLANTED = {
    "backlash:axis=x,width=9um": ("backlash, axis: x", {"backlash.x.width": 0.009}),
    "straightness-reversal:reversal=xz,width=9um": (
        "straightness-reversal, reversal: xz",
        {"straightness-reversal.xz.width": 0.009},
    ),
    "angular-reversal:axis=y,rx=40urad,ry=-30urad,rz=50urad": (
        "angular-reversal, axis: y",
        {"angular-reversal.y.rx": 4e-5, "angular-reversal.y.ry": -3e-5, "angular-reversal.y.rz": 5e-5},
    ),
    "screw-pitch-error:axis=y,amplitude=5um,phase=2rad,period=27mm": (
        "screw-pitch-error, axis: y, period: 27 mm",
        {"screw-pitch-error.y.amplitude": 0.005, "screw-pitch-error.y.phase": 2.0},
    ),
    "load-sag:pair=yz,c=4e-7 1/mm": ("load-sag, pair: yz", {"load-sag.yz.c": 4e-7}),
    "machine-drift:vx=3um/min,vy=-2um/min,vz=6um/min": (
        "machine-drift",
        {"machine-drift.vx": 5e-5, "machine-drift.vy": -2e-3 / 60, "machine-drift.vz": 1e-4},
    ),
}


IN_MOTION = {"servo-lag:axis=y,tau=1.5ms": ("servo-lag, axis: y", {"servo-lag.y.tau": 1.5e-3})}
SHORT = ("backlash", "machine-drift")
AT_REST = [
    pytest.param(STANDSTILL, key, *found, marks=() if key.startswith(SHORT) else pytest.mark.slow)
    for key, found in PLANTED.items()
]
MOVING = [pytest.param(FLIGHT, key, *found, marks=pytest.mark.slow) for key, found in (PLANTED | IN_MOTION).items()]


@pytest.mark.alike
@pytest.mark.parametrize("text, planted, wanted, truth", AT_REST + MOVING)
def test_an_effect_that_is_planted_is_estimated(
    folder: Path, text: str, planted: str, wanted: str, truth: dict[str, float], metrocli: Metrocli
) -> None:
    job = made(folder, text, metrocli)
    assert metrocli("simulate", job, "--out", folder / "new", "--force", "--effect", planted).code == 0
    for name in ("points.csv", "track.csv"):
        if (folder / "new" / name).exists():
            (folder / name).write_text((folder / "new" / name).read_text())
    plain = json.loads(metrocli("calibrate-machine", job, "--json").out)
    job.write_text(f"{text}effects: [{{name: {wanted}}}]\n")
    found = json.loads(metrocli("calibrate-machine", job, "--json").out)
    assert plain["statistics"]["sigma0"] > 1.05 > found["statistics"]["sigma0"]
    for name, value in truth.items():
        estimate = found["estimates"][name]
        off = estimate["value"] - value
        if name.endswith("phase"):
            off = (off + np.pi) % (2 * np.pi) - np.pi
        assert abs(off) < 4.5 * estimate["std"], name
        assert abs(value) > 4 * estimate["std"], name
    true = json.loads((folder / "new" / "truth.json").read_text())
    assert set(truth) <= set(true)


def test_backlash_is_found_along_lines_that_go_to_and_fro(folder: Path, metrocli: Metrocli) -> None:
    job = made(folder, LINES, metrocli)
    planted = "backlash:axis=y,width=3um"
    assert metrocli("simulate", job, "--out", folder / "new", "--force", "--effect", planted).code == 0
    (folder / "lines.csv").write_text((folder / "new" / "lines.csv").read_text())
    job.write_text(f"{LINES}effects: [{{name: backlash, axis: y}}]\n")
    found = json.loads(metrocli("calibrate-machine", job, "--json").out)
    width = found["estimates"]["backlash.y.width"]
    assert abs(width["value"] - 0.003) < 4 * width["std"] < 0.001
    figures = hdf5.read(folder / "result.h5")[0].tables["positioning"]
    assert figures.numbers("B")[1] == pytest.approx(0.003, abs=0.002)  # noise of two readings, 27 targets
    assert max(figures.numbers("B")[[0, 2]]) < 0.0025


def test_a_tracker_that_was_pushed_is_named(folder: Path, metrocli: Metrocli) -> None:
    """A step of 3 um had passed for a drift, and one of 1 mm for the pitch of a screw, with wrong points."""
    job = made(folder, STANDSTILL, metrocli)
    head, *rows = (folder / "points.csv").read_text().splitlines()
    names, cells = head.split(","), [row.split(",") for row in rows]
    at, half = names.index("mx_mm"), len(rows) // 2
    for row in cells[half:]:
        row[at : at + 3] = [f"{float(cell) + step:.9f}" for cell, step in zip(row[at:], (1.0, -1.0, 0.5), strict=False)]
    (folder / "points.csv").write_text("\n".join([head, *map(",".join, cells)]) + "\n")
    found = json.loads(metrocli("diagnose", job, "--json").out)
    assert [one["name"] for one in found["effects"]] == ["tracker-moved"] and not found["outliers"]
    size = found["effects"][0]["parameters"]
    t = names.index("t_s")
    assert float(cells[half - 1][t]) < size["at"]["value"] < float(cells[half][t])
    moved = [size[f"d{axis}"]["value"] for axis in "xyz"]
    assert abs(np.linalg.norm(moved) - 1.5) < 4 * size["dx"]["std"] < 0.01
    assert metrocli("calibrate-machine", found["extended_job"]).code == 0


@pytest.mark.slow
def test_time_of_a_laser_shows_drift_and_what_it_cannot_see_is_told(folder: Path, metrocli: Metrocli) -> None:
    job = made(folder, LINES, metrocli)
    planted = "machine-drift:vx=3um/min,vy=0um/min,vz=0um/min"
    assert metrocli("simulate", job, "--out", folder / "new", "--force", "--effect", planted).code == 0
    (folder / "lines.csv").write_text((folder / "new" / "lines.csv").read_text())
    found = json.loads(metrocli("diagnose", job, "--json").out)
    assert [one["name"] for one in found["effects"]] == ["machine-drift"]
    drift = found["effects"][0]["parameters"]["vx"]
    assert abs(drift["value"] - 5e-5) < 4 * drift["std"] < 7e-6
    told = {one["name"]: one["reason"] for one in found["candidates"] if one["status"] == "not-tested"}
    assert told["tracker-scale"] == told["tracker-drift"] == "has no influence on the readings"
    job.write_text(f"{LINES}effects: [{{name: tracker-scale}}]\n")
    ran = metrocli("calibrate-machine", job)
    assert ran.code == 3 and "tracker-scale has no influence on the readings" in ran.err


@pytest.mark.slow
def test_backlash_needs_the_side_of_its_own_axis_only(folder: Path, metrocli: Metrocli) -> None:
    """Sides of X alone are enough for X; Y and Z are said to be not tested, each with its column."""
    job = made(folder, STANDSTILL, metrocli)
    text = (folder / "points.csv").read_text().replace("from_y,from_z", "side_y,side_z", 1)
    (folder / "points.csv").write_text(text)
    for axis, code in (("x", 0), ("y", 3)):
        job.write_text(f"{STANDSTILL}effects: [{{name: backlash, axis: {axis}}}]\n")
        ran = metrocli("calibrate-machine", job)
        assert ran.code == code, ran.err
    assert "backlash needs a column from_y" in ran.err and "from_x" not in ran.err
    job.write_text(STANDSTILL)
    listed = json.loads(metrocli("diagnose", job, "--design", "--json").out)["candidates"]
    told = [(one["where"], one["status"], one["reason"]) for one in listed if one["name"] == "backlash"]
    assert ({"axis": "x"}, "excluded") in [one[:2] for one in told]
    assert ({"axis": "y"}, "not-tested", "needs a column from_y") in told
    assert ({"axis": "z"}, "not-tested", "needs a column from_z") in told


@pytest.mark.slow
def test_held_out_points_are_predicted_to_about_their_noise(folder: Path, metrocli: Metrocli) -> None:
    """Their readings have a covariance each; the errors are told in micrometres all the same."""
    job = made(folder, STANDSTILL, metrocli)
    assert (
        metrocli("simulate", job, "--out", folder / "new", "--force", "--effect", "backlash:axis=x,width=20um").code
        == 0
    )
    (folder / "points.csv").write_text((folder / "new" / "points.csv").read_text())
    gain = json.loads(metrocli("diagnose", job, "--json").out)["effects"][0]["gain"]
    assert gain["unit"] == "um" and 1 < gain["holdout_after"] < 8 < gain["holdout_before"] < 50


def test_what_cannot_be_told_apart_is_refused(folder: Path, metrocli: Metrocli) -> None:
    """One tracker sees machine and tracker drift as one."""
    job = made(folder, STANDSTILL, metrocli)
    job.write_text(STANDSTILL + "effects: [{name: machine-drift}, {name: tracker-drift}]\n")
    ran = metrocli("calibrate-machine", job)
    assert ran.code == 4
    assert "machine-drift" in ran.err and "tracker-drift" in ran.err


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("chain: wXbYZt", "chain: wXbYt", "'wXbYt' is not a chain of the axes X, Y and Z"),
        ("range: [0 mm, 600 mm]", "range: [600 mm, 0 mm]", "the range does not ascend"),
        ("knots: 5", "knots: 1", "1 is out of range"),
        ("method: standstill", "method: on-the-fly", "method on-the-fly needs the input 'track'"),
        ("method: standstill", "method: six-dof", "method six-dof needs the noise 'displacement'"),
        ("noise: {beam: 1 um, ", "noise: {", "method standstill needs the noise 'beam'"),
        (
            "lateral: {constant: 2 um, proportional: 3 um/m}",
            "lateral: 2 um, radial: 2 um",
            "lateral and radial are two names of one setting",
        ),
        ("noise: {", "noise: {proportional: 1 um/m, ", "method standstill does not use the noise 'proportional'"),
        ("noise: {", "noise: {repeatability: estimated, ", "method standstill does not use the noise 'repeatability'"),
        ("method: standstill", "method: standstill\nsensor: tool", "does not use this key (of probing)"),
        ("method: standstill", "method: standstill\ncorner: 5 mm", "does not use this key (of on-the-fly)"),
        ("method: standstill", "method: six-dof\ninstrument: {on: bed}", "key (of standstill and lengths)"),
        ("method: standstill", "method: standstill\nplan: {length: 5 m}", "does not use this key (of on-the-fly)"),
        ("method: standstill", "method: standstill\nsimulation: {step: 5 mm}", "does not use this key (of six-dof)"),
        ("method: standstill", "method: standstill\nsimulation: {polar: true}", "without rotary axes points.csv has"),
        (
            "method: standstill",
            "method: lengths\nplan: {tracker: [1 m, 1 m, 1 m]}",
            "key (of standstill and on-the-fly)",
        ),
        (
            "method: standstill",
            "method: standstill\ninstrument: {'on': bed}",
            "readings are in the axes of the workpiece",
        ),
        ("method: standstill", "method: standstill\nvolume: {circle: 5 m}", "no plane has room for this radius"),
        ("method: standstill", "method: standstill\nestimate: [EXX, EXQ]", "unknown word 'EXQ'"),
        ("method: standstill", "method: standstill\nestimate: []", "it names no error of the axes"),
        *(
            (
                "method: standstill",
                f"method: standstill\nestimate: [{name}, {other}]",
                f"'{other}' is in the list twice",
            )
            for name, other in [("C0Y", "EC0Y"), ("C0Y", "COY"), ("C0Y", "E_C0Y"), ("EXX", "E_XX"), ("EX0C", "E_X0C")]
        ),
        ("tools: {T1", "tool: [0 mm, 0 mm, 0 mm]\n  tools: {T1", "both tool and tools are given"),
        ("120 mm]", "120]", "120 has no unit"),
        ("x: {range", "u: {range", "unknown key 'u'"),
    ],
)
def test_faults_of_a_job_are_told(folder: Path, old: str, new: str, message: str, metrocli: Metrocli) -> None:
    (folder / "job.yaml").write_text(STANDSTILL.replace(old, new, 1))
    (folder / "points.csv").write_text("point,x_mm,y_mm,z_mm,mx_mm,my_mm,mz_mm,tool\na,0,0,0,0,0,0,T1\n")
    ran = metrocli("check", "job.yaml")
    assert ran.code == 3
    assert message in ran.err
    assert "job.yaml:" in ran.err


@pytest.mark.parametrize(
    ("change", "code", "message"),
    [
        (lambda lines: [lines[0], lines[1].replace(",T", ",X"), *lines[2:]], 3, "points.csv:2: error: tool 'X"),
        (lambda lines: [lines[0].replace("mx_mm,my_mm,mz_mm", "mx_m,my_m,mz_m"), *lines[1:]], 3, "1000 times as large"),
        (
            lambda lines: [lines[0].replace("mx_mm,my_mm", "my_mm,mx_mm"), *lines[1:]],
            3,
            "two of mx, my, mz are swapped",
        ),
        (
            lambda lines: [lines[0], lines[1].replace(lines[1].split(",")[4], "nan"), *lines[2:]],
            3,
            "'nan' is not a finite number",
        ),
        (
            lambda lines: [
                lines[0],
                *[
                    ",".join([*row.split(",")[:1], *other.split(",")[1:4], *row.split(",")[4:]])
                    for row, other in zip(lines[1:-1], reversed(lines[1:-1]), strict=True)
                ],
                "",
            ],
            3,
            "do not have the shape",
        ),
        (lambda lines: [lines[0].replace(",tool", ",kind"), *lines[1:]], 3, "the file has no column 'tool'"),
        (lambda lines: [*lines[:3], ""], 3, "2 points are too few"),
        (
            lambda lines: [lines[0], re.sub(r"-?1.0,(?=-?1.0,T)", "17.5,", lines[1]), *lines[2:]],
            3,
            "y = 17.5 is not a dir",
        ),
        (lambda lines: [*lines[:20], ""], 4, "combinations of errors that move"),
        (
            lambda lines: [lines[0], "A,700," + lines[1].split(",", 2)[2], *lines[2:]],
            3,
            "points.csv:2: error: x = 700 mm is outside the range of the axis, 0 to 600 mm",
        ),
    ],
)
def test_wrong_points_are_told(folder: Path, change, code: int, message: str, metrocli: Metrocli) -> None:  # type: ignore[no-untyped-def]
    job = made(folder, STANDSTILL, metrocli)
    lines = (folder / "points.csv").read_text().split("\n")
    (folder / "points.csv").write_text("\n".join(change(lines)))
    ran = metrocli("calibrate-machine", job)
    assert (ran.code, message in ran.err) == (code, True), ran.err
    assert not (folder / "result.h5").exists()


def test_numbers_that_are_none_in_the_stream_are_told_with_their_line(folder: Path, metrocli: Metrocli) -> None:
    job = made(folder, FLIGHT, metrocli)
    lines = (folder / "track.csv").read_text().split("\n")
    lines[400] = ",".join(["nan", *lines[400].split(",")[1:]])
    (folder / "track.csv").write_text("\n".join(lines))
    ran = metrocli("calibrate-machine", job)
    assert ran.code == 3
    assert "track.csv:401:1: error: column 'x_mm': 'nan' is not a finite number" in ran.err


@pytest.mark.slow
def test_files_are_whole_though_nobody_reads_the_output(folder: Path, metrocli: Metrocli) -> None:
    """`metrocli plan JOB | head -1` ends the output, not the files."""
    job = made(folder, FLIGHT, metrocli)
    assert metrocli("calibrate-machine", job).code == 0
    for arguments in (
        ("plan", job, "--out", folder / "piped"),
        ("export", folder / "result.h5", "--to", "csv", "--out", folder / "piped", "--force"),
        ("simulate", job, "--out", folder / "piped", "--force"),
    ):
        ran = subprocess.Popen(
            [sys.executable, "-m", "metrocli", *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        assert ran.stdout is not None
        ran.stdout.close()
        ran.wait()
    whole = {"plan.json", "path.nc", "path.csv", "tables-EXX.csv", "errors-squareness.csv", "track.csv", "truth.json"}
    assert whole <= {path.name for path in (folder / "piped").iterdir()}


@pytest.mark.parametrize("text", [STANDSTILL, FLIGHT, LINES], ids=["standstill", "on-the-fly", "six-dof"])
def test_plan_needs_no_measurement_and_says_that_it_has_no_effects(folder: Path, text: str, metrocli: Metrocli) -> None:
    job = folder / "job.yaml"
    job.write_text(f"{text}effects: [{{name: backlash, axis: x}}]\n")
    ran = metrocli("plan", job, "--out", folder / "plan")
    assert ran.code == 0, ran.err
    assert "every error is determined" in ran.out and "the plan leaves out `effects` of the job" in ran.err
    assert any(path.suffix == ".nc" for path in (folder / "plan").iterdir())


def test_simulate_wants_a_truth(folder: Path, metrocli: Metrocli) -> None:
    (folder / "job.yaml").write_text(STANDSTILL.replace("simulation: {error: 80 um, points: 200}\n", ""))
    ran = metrocli("simulate", "job.yaml", "--out", "new")
    assert ran.code == 3 and "simulate needs the truth" in ran.err


def test_the_schema_names_what_a_job_may_say(metrocli: Metrocli) -> None:
    schema = json.loads(metrocli("schema", "calibrate-machine").out)
    assert {"method", "machine", "estimate", "inputs", "noise", "volume", "simulation", "plan"} <= set(
        schema["properties"]
    )
    assert TRACK.columns[0].name == "x"


def test_an_axis_that_stands_still_keeps_the_side_from_which_it_came(folder: Path, metrocli: Metrocli) -> None:
    """Points in rows along x, to and fro: y and z stand still within each."""
    to_and_fro = [*range(0, 601, 150), *range(600, -1, -150)]
    places = [(x, y, z) for z in (0, -250, -500) for y in (0, 260, -260) for x in to_and_fro]
    rows = [f"P{i},{x},{y},{z},{x},{y},{z},T1" for i, (x, y, z) in enumerate(places)]
    (folder / "points.csv").write_text("\n".join(["point,x_mm,y_mm,z_mm,mx_mm,my_mm,mz_mm,tool", *rows]) + "\n")
    job = folder / "job.yaml"
    job.write_text(STANDSTILL)
    assert metrocli("simulate", job, "--out", folder / "new").code == 0
    head, *lines = (folder / "new" / "points.csv").read_text().splitlines()
    sides = {name: [float(line.split(",")[head.split(",").index(name)]) for line in lines] for name in SIDES}
    assert sides["from_x"] == ([1.0] * 6 + [-1.0] * 4 + ([-1.0] + [1.0] * 5 + [-1.0] * 4) * 8)
    assert sides["from_y"] == ([1.0] * 20 + [-1.0] * 10 + [1.0] * 20 + [-1.0] * 10) + ([1.0] * 20 + [-1.0] * 10)
    assert sides["from_z"] == [1.0] * 30 + [-1.0] * 60


def test_lengths_are_made_again_with_the_sides_of_their_file(folder: Path, metrocli: Metrocli) -> None:
    assert metrocli("init", folder / "lab", "--sample", "machine-lengths").code == 0
    data, job = folder / "lab" / "data" / "lengths.csv", folder / "lab" / "jobs" / "lengths.yaml"
    head, *lines = [line for line in data.read_text().splitlines() if not line.startswith("#")]
    x = [float(line.split(",")[head.split(",").index("x_mm")]) for line in lines]
    sides = [1.0]
    for before, place in pairwise(x):
        sides.append(float(np.sign(place - before)) or sides[-1])
    data.write_text("\n".join([f"{head},from_x", *(f"{a},{b:g}" for a, b in zip(lines, sides, strict=True))]) + "\n")
    planted = ["--effect", "hysteresis:axis=x,width=20um,length=60mm"]
    ran = metrocli("simulate", job, "--seed", 5, "--out", folder / "new", *planted)
    assert ran.code == 0, ran.err
    data.write_text((folder / "new" / "lengths.csv").read_text())
    job.write_text(
        job.read_text() + "effects: [{name: hysteresis, axis: x, length: 60 mm}, {name: backlash, axis: x}]\n"
    )
    found = json.loads(metrocli("calibrate-machine", job, "--json").out)["estimates"]
    for name, true in {"hysteresis.x.width": 0.02, "backlash.x.width": 0.0}.items():
        assert abs(found[name]["value"] - true) < 4 * found[name]["std"] < 0.02
