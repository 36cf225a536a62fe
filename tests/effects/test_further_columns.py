"""Further columns of the data as variables of user-defined effects, in each kind of job."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metrocli.expressions.dimensions import compound

Metrocli = Callable[..., Any]


@dataclass(frozen=True)
class Case:
    """A measurement that is simulated with a cause that grows with the column `load_kN` of its readings."""

    kind: str
    sample: str
    job: str
    file: str
    """The file that gets the column"""
    readings: str
    """The file that the simulation writes in its place"""
    acts_on: str
    adds: str
    unit: str
    size: float
    key: str
    """Of the file under `inputs:`"""


CASES = {
    "multilaterate": Case(
        "multilaterate", "laboratory-effects", "hall", "data/lengths.csv", "lengths.csv", "length", "a*load", "um/kN", 3.0, "lengths"
    ),
    "selfcal-grid": Case(
        "selfcal-grid", "ball-cube", "views", "data/views.csv", "views.csv", "coordinates", "{x: a*load}", "um/kN", 6.0, "views"
    ),
    "lengths": Case(
        "calibrate-machine", "machine-lengths", "lengths", "data/lengths.csv", "lengths.csv", "point-in-machine", "{z: a*load}", "um/kN",
        6.0, "lengths",
    ),
    "launch unit": Case(
        "locate-launch-unit", "xm60-launch-unit", "table", "data/table_places.csv", "poses.csv", "launch-angles", "{base: a*load}", "mrad/kN", 0.4, "poses"
    ),
}  # fmt: skip


def with_column(path: Path, seed: int) -> None:
    """Add the column `load_kN` with values drawn at random to a file."""
    head, *rows = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    loads = np.random.default_rng(seed).uniform(0.2, 1.4, len(rows))
    rows = [f"{row},{load:.4f}" for row, load in zip(rows, loads, strict=True)]
    path.write_text("\n".join([f"{head},load_kN", *rows]) + "\n")


def defined(case: Case, adds: str = "") -> str:
    return (
        f"\ndefine:\n- {{name: load-error, acts_on: {case.acts_on}, adds: {adds or case.adds},\n"
        f"   parameters: {{a: {{unit: {case.unit}, plausible: {10 * case.size} {case.unit}}}}}}}\n"
    )


def made(case: Case, metrocli: Metrocli, tmp_path: Path) -> Path:
    """Return a job with readings that were simulated with the cause."""
    metrocli("init", tmp_path / "lab", "--sample", case.sample)
    job = tmp_path / "lab" / "jobs" / f"{case.job}.yaml"
    with_column(tmp_path / "lab" / case.file, 5)
    job.write_text(job.read_text() + defined(case) + SIMULATION.get(case.sample, ""))
    out = tmp_path / "lab" / "made"
    planted = f"load-error:a={case.size}{case.unit}"
    ran = metrocli("simulate", job, "--seed", 4, "--out", out, "--effect", planted)
    assert ran.code == 0, ran.err
    (out / case.readings).replace(tmp_path / "lab" / "data" / "made.csv")
    job.write_text(job.read_text().replace(f"{case.key}: ../{case.file}", f"{case.key}: ../data/made.csv"))
    if case.key == "poses":
        job.write_text(job.read_text().replace("poses: ../data/table.csv", "poses: ../data/made.csv"))
    return job


SIMULATION = {"laboratory-effects": "simulation: {tracer_error: 1 mm}\n"}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_cause_that_grows_with_a_column_is_found_and_estimated(name: str, metrocli: Metrocli, tmp_path: Path) -> None:
    case = CASES[name]
    job = made(case, metrocli, tmp_path)
    found = json.loads(metrocli("diagnose", job, "--json").out)
    assert "load-error" in [one["name"] for one in found["effects"]]
    job.write_text(job.read_text() + "\neffects: [{name: load-error}]\n")
    ran = metrocli(case.kind, job, "--json")
    assert ran.code in (0, 6), ran.err
    one = json.loads(ran.out)["estimates"]["load-error.a"]
    true = case.size * compound(case.unit).factor
    assert abs(one["value"] - true) < 4 * one["std"] < true


MACHINE = """metrocli: 1
job: calibrate-machine
method: {method}
machine:
  chain: wXbYZt
  axes: {{x: {{range: [0 mm, 600 mm], knots: 4}}, y: {{range: [0 mm, 500 mm], knots: 4}},
    z: {{range: [0 mm, 400 mm], knots: 4}}}}
  tool: [0 mm, 0 mm, 120 mm]
inputs: {{INPUTS}}
noise: {noise}
simulation: {simulation}
"""
BEFORE = {
    "standstill": MACHINE.format(
        method="standstill", noise="{beam: 1 um, lateral: 3 um}", simulation="{error: 50 um, points: 250}"
    ),
    "on the fly": MACHINE.format(
        method="on-the-fly", noise="{beam: 1 um, lateral: 5 um}", simulation="{error: 50 um, sampling: 40 ms}"
    ),
    "six-dof": MACHINE.format(
        method="six-dof", noise="{displacement: 0.2 um, straightness: 1 um, angle: 1 urad}",
        simulation="{error: 50 um, step: 50 mm}",
    ),
    "camera": """metrocli: 1
job: calibrate-camera
rig: board
inputs: {INPUTS}
camera: {image_size: [640, 480], pixel_size: 6 um, estimate: [f, cx, cy, k1, k2]}
noise: 0.05 px
simulation: {lens: {f: 690 px, cx: 323 px, cy: 236 px, k1: -0.2, k2: 0.1}, distance: 420 mm, tilt: 35 deg, images: 12}
""",
}  # fmt: skip
VERTICES = np.random.default_rng(2).uniform(0, (600, 500, 400), (60, 3)).round(1).tolist()
PATH = "x_mm,y_mm,z_mm\n" + "".join(f"{x},{y},{z}\n" for x, y, z in [[0, 0, 0], *VERTICES, [600, 500, 400]])
TARGETS = "target,x_mm,y_mm,z_mm\n" + "".join(f"T{i}_{j},{25 * i},{25 * j},0\n" for i in range(9) for j in range(6))
AFTER = {
    "standstill": ("calibrate-machine", "points.csv", "points", "mz_mm", "point-in-tracker", "z", 6.0, "um/kN"),
    "on the fly": ("calibrate-machine", "track.csv", "track", "z_mm", "point-in-tracker", "z", 20.0, "um/kN"),
    "six-dof": ("calibrate-machine", "lines.csv", "lines", "ex_mm", "error-motion", "x", 2.0, "um/kN"),
    "camera": ("calibrate-camera", "observations.csv", "observations", "u_px", "image", "u", 0.2, "px/kN"),
}
"""Kind, file of the readings, its key, the column that the cause changes, where it acts, component, size, unit"""


@pytest.mark.alike
@pytest.mark.parametrize("name", AFTER)
def test_readings_of_every_method_take_the_column(name: str, metrocli: Metrocli, tmp_path: Path) -> None:
    kind, file, key, column, acts_on, component, size, unit = AFTER[name]
    more = {"on the fly": ("path", PATH), "camera": ("targets", TARGETS)}.get(name)
    start = "" if more is None else f"{more[0]}: more.csv, "
    (tmp_path / "more.csv").write_text(more[1] if more else "")
    job, before = tmp_path / "job.yaml", BEFORE[name].replace("INPUTS", f"{start}{key}: {file}")
    job.write_text(before)
    ran = metrocli("simulate", job, "--seed", 3, "--out", tmp_path / "made")
    assert ran.code == 0, ran.err
    head, *rows = (tmp_path / "made" / file).read_text().splitlines()
    at, cells = head.split(",").index(column), [row.split(",") for row in rows]
    true = size * compound(unit).factor
    loads = np.random.default_rng(8).uniform(0.2, 1.4, len(rows)).round(4)
    for row, load in zip(cells, loads.tolist(), strict=True):
        row[at] = repr(float(row[at]) + true * compound("kN").factor * load)
        row.append(repr(load))
    text = "\n".join([f"{head},load_kN", *map(",".join, cells)]) + "\n"
    (tmp_path / file).write_text(text)
    plausible = f"{10 * size} {unit}"
    own = f"define: [{{name: load-error, acts_on: {acts_on}, adds: {{{component}: a*load}}, "
    own += f"parameters: {{a: {{unit: {unit}, plausible: {plausible}}}}}}}]\neffects: [{{name: load-error}}]\n"
    job.write_text(before + own)
    ran = metrocli(kind, job, "--json")
    assert ran.code in (0, 6), ran.err
    one = json.loads(ran.out)["estimates"]["load-error.a"]
    assert abs(one["value"] - true) < 4 * one["std"] < true
    if name not in ("standstill", "six-dof"):
        planted = ["--effect", f"load-error:a={size}{unit}"]
        ran = metrocli("simulate", job, "--out", tmp_path / "again", *planted)
        assert ran.code == 3 and "needs a column load_kN" in ran.err and "chooses its own readings" in ran.err


@pytest.fixture
def hall(metrocli: Metrocli, tmp_path: Path) -> Path:
    """The job of a laboratory with the column `load_kN` in its lengths, and without definitions."""
    metrocli("init", tmp_path / "lab", "--sample", "laboratory-effects")
    with_column(tmp_path / "lab" / "data/lengths.csv", 5)
    return tmp_path / "lab" / "jobs" / "hall.yaml"


FAULTS = {
    "a*load": ("um", "expected mm"),
    "a*lod": ("um/kN", "did you mean 'load'?"),
    "a*load*load_kN": ("um/kN", "unknown variable 'load_kN'"),
}


@pytest.mark.parametrize("adds", FAULTS)
def test_units_and_names_of_columns_are_checked(adds: str, hall: Path, metrocli: Metrocli) -> None:
    unit, told = FAULTS[adds]
    own = f"define: [{{name: load-error, acts_on: length, adds: {adds}, parameters: {{a: {{unit: {unit}, plausible: 1 {unit}}}}}}}]"
    hall.write_text(hall.read_text() + own + "\n")
    ran = metrocli("check", hall)
    assert ran.code == 3 and told in ran.err and "hall.yaml:10:" in ran.err


HEADINGS = {
    "load [kN]": (
        "a*load",
        "unknown variable 'load'",
        "row 1 of lengths.csv: write the heading 'load [kN]' as load_kN",
    ),
    "load (tons)": ("a*load", "unknown variable 'load'", "write the heading 'load (tons)' as load_UNIT"),
    "pi": ("a*cos(2*pi*t/(60*s1))", "'pi' is 3.14159, and a column of the data", "heading 'pi' as my_pi"),
}


@pytest.mark.parametrize("heading", HEADINGS)
def test_a_heading_that_no_expression_can_use_is_named_with_what_to_write(
    heading: str, hall: Path, metrocli: Metrocli
) -> None:
    adds, fault, told = HEADINGS[heading]
    lengths = hall.parent.parent / "data/lengths.csv"
    lengths.write_text(lengths.read_text().replace("load_kN", heading, 1))
    hall.write_text(
        f"{hall.read_text()}define: [{{name: load-error, acts_on: length, adds: {adds.replace('/(60*s1)', '/b')}, "
        "parameters: {a: {unit: um, plausible: 1 um}}, scan: {b: {from: 60 s, to: 600 s, steps: 9}}}]\n"
    )
    ran = metrocli("check", hall)
    assert ran.code == 3 and "hall.yaml:10:" in ran.err
    assert fault in ran.err and told in ran.err


def test_an_empty_cell_of_a_column_that_is_used_has_its_place(hall: Path, metrocli: Metrocli) -> None:
    lengths = hall.parent.parent / "data/lengths.csv"
    head, first, *rows = lengths.read_text().splitlines()
    lengths.write_text("\n".join([head, first.rpartition(",")[0] + ",", *rows]) + "\n")
    assert metrocli("check", hall).code == 0
    hall.write_text(hall.read_text() + defined(CASES["multilaterate"]))
    ran = metrocli("check", hall)
    assert ran.code == 3 and "lengths.csv:2:" in ran.err and "'load_kN': an empty cell" in ran.err


def test_a_cell_that_is_no_number_has_its_place(hall: Path, metrocli: Metrocli) -> None:
    lengths = hall.parent.parent / "data/lengths.csv"
    head, first, *rows = lengths.read_text().splitlines()
    lengths.write_text("\n".join([head, first.rpartition(",")[0] + ",n/a", *rows]) + "\n")
    hall.write_text(hall.read_text() + defined(CASES["multilaterate"]))
    ran = metrocli("check", hall)
    assert ran.code == 3 and "lengths.csv:2:" in ran.err and "'n/a'" in ran.err


def test_only_a_column_that_is_used_counts_as_read(hall: Path, metrocli: Metrocli) -> None:
    assert "the column 'load_kN' is not used" in metrocli("multilaterate", hall).err
    hall.write_text(hall.read_text() + defined(CASES["multilaterate"]))
    assert "load_kN" not in metrocli("multilaterate", hall).err


def test_a_new_column_changes_no_definition(hall: Path, metrocli: Metrocli) -> None:
    own = "define: [{name: load-error, acts_on: length, adds: load*sin(3*azimuth), "
    own += "parameters: {load: {unit: um, plausible: 5 um}}}]"
    hall.write_text(hall.read_text() + own + "\neffects: [{name: load-error}]\n")
    assert metrocli("check", hall).code == 0
    assert "the column 'load_kN' is not used" in metrocli("multilaterate", hall).err


@pytest.mark.parametrize("heading", ["tracer_gain", "temp_spindle", "length_2"])
def test_a_column_whose_name_begins_like_one_of_the_job_is_a_variable(
    heading: str, hall: Path, metrocli: Metrocli
) -> None:
    lengths = hall.parent.parent / "data/lengths.csv"
    lengths.write_text(lengths.read_text().replace("load_kN", heading))
    own = f"define: [{{name: load-error, acts_on: length, adds: a*{heading}, parameters: {{a: {{unit: um, plausible: 5 um}}}}}}]"
    hall.write_text(hall.read_text() + own + "\neffects: [{name: load-error}]\n")
    ran = metrocli("multilaterate", hall, "--json")
    assert ran.code in (0, 6), ran.err
    assert "load-error.a" in json.loads(ran.out)["estimates"]
