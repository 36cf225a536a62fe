"""Further columns of the data as variables of laws: a cause in them is found, what has nothing to do with it is not."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metrocli.diagnosis.laws.terms import kept

Metrocli = Callable[..., Any]
MACHINE = """metrocli: 1
job: calibrate-machine
method: standstill
machine:
  chain: wXbYZt
  axes: {x: {range: [0 mm, 600 mm], knots: 4}, y: {range: [0 mm, 500 mm], knots: 4},
    z: {range: [0 mm, 400 mm], knots: 4}}
  tool: [0 mm, 0 mm, 120 mm]
inputs: {points: made.csv}
noise: {beam: 1 um, lateral: 3 um}
simulation: {error: 50 um, points: 150}
"""


def lengths(metrocli: Metrocli, folder: Path) -> tuple[Path, Path, str]:
    """Return a job of multilaterate, the file of its readings and the column with the readings, without any cause."""
    metrocli("init", folder / "lab", "--sample", "laboratory-effects")
    (folder / "lab" / "metrocli.yaml").unlink()
    job = folder / "lab" / "jobs" / "hall.yaml"
    for name in ("points", "lengths"):  # of half of its places
        rows = (file := folder / "lab" / "data" / f"{name}.csv").read_text().splitlines(keepends=True)
        file.write_text("".join(row for row in rows if not re.match(r"P(2[1-9]|3|40)", row)))
    job.write_text(job.read_text() + "simulation: {tracer_error: 1 mm}\n")
    assert metrocli("simulate", job, "--seed", 4, "--out", folder / "made").code == 0
    job.write_text(job.read_text().replace("lengths: ../data/lengths.csv", "lengths: made.csv"))
    (folder / "made" / "lengths.csv").replace(job.parent / "made.csv")
    return job, job.parent / "made.csv", "length_mm"


def machine(metrocli: Metrocli, folder: Path) -> tuple[Path, Path, str]:
    """Return the same for a machine whose points a tracker measures."""
    job = folder / "machine.yaml"
    job.write_text(MACHINE)
    ran = metrocli("simulate", job, "--seed", 3, "--out", folder / "made")
    assert ran.code == 0, ran.err
    (folder / "made" / "points.csv").replace(folder / "made.csv")
    return job, folder / "made.csv", "mz_mm"


KINDS = {"multilaterate": (lengths, 0.004), "calibrate-machine": (machine, 0.025)}
"""Readings, and the size of the cause in mm"""


def with_cause(file: Path, column: str, size: float, form: str, seed: int) -> None:
    """Add the columns load_kN, spindle_krpm and pressure_bar, drawn at random, and a cause in the first of them."""
    head, *rows = file.read_text().splitlines()
    at, cells = head.split(",").index(column), [row.split(",") for row in rows]
    rng = np.random.default_rng(seed)
    load, spindle, pressure = rng.uniform(0.2, 1.4, (3, len(rows))).round(4)
    for row, a, b, c in zip(cells, load.tolist(), spindle.tolist(), pressure.tolist(), strict=True):
        row[at] = repr(float(row[at]) + size * a * (b if form == "product" else 1.0))
        row += [str(a), str(b), str(c)]
    file.write_text("\n".join([f"{head},load_kN,spindle_krpm,pressure_bar", *map(",".join, cells)]) + "\n")


@pytest.mark.parametrize(("kind", "form"), [("multilaterate", "linear"), pytest.param("multilaterate", "product", marks=pytest.mark.slow), pytest.param("calibrate-machine", "linear", marks=pytest.mark.slow)])  # fmt: skip
def test_a_cause_in_a_column_is_found_as_a_law(kind: str, form: str, metrocli: Metrocli, tmp_path: Path) -> None:
    made, size = KINDS[kind]
    job, file, column = made(metrocli, tmp_path)
    with_cause(file, column, size, form, 11)
    ran = metrocli("diagnose", job, "--json")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)
    (law,) = [one for one in found["laws"] if one["chosen"]]
    text = str(law["adds"])
    assert ("load*spindle_krpm" if form == "product" else "load") in text and "pressure" not in text
    (parameter,) = law["parameters"].values()
    assert parameter["unit"] == "mm/kN"
    assert abs(parameter["value"] - size) < 4 * parameter["std"] < size
    assert found["verdict"] == "unexplained"
    extended = Path(found["extended_job"])
    assert "load" in extended.read_text()
    assert metrocli(kind, extended).code in (0, 6)
    assert "load" not in str([one["adds"] for one in json.loads(metrocli("diagnose", extended, "--json").out)["laws"]])


@pytest.mark.slow
def test_columns_without_a_cause_give_no_law(metrocli: Metrocli, tmp_path: Path) -> None:
    job, file, column = lengths(metrocli, tmp_path)
    with_cause(file, column, 0.0, "linear", 12)
    assert json.loads(metrocli("diagnose", job, "--json").out)["laws"] == []


def test_a_column_with_an_empty_cell_is_left_out(metrocli: Metrocli, tmp_path: Path) -> None:
    job, file, column = lengths(metrocli, tmp_path)
    with_cause(file, column, 0.004, "linear", 11)
    head, first, *rows = file.read_text().splitlines()
    *before, _, spindle, pressure = first.split(",")
    file.write_text("\n".join([head, ",".join([*before, "", spindle, pressure]), *rows]) + "\n")
    ran = metrocli("diagnose", job, "--json")
    assert ran.code == 0, ran.err
    assert "load" not in str(json.loads(ran.out)["laws"])


def test_columns_that_tell_nothing_new_are_left_out() -> None:
    rng = np.random.default_rng(4)
    t = np.repeat(np.sort(rng.uniform(0, 900, 40)), 4)
    values = {
        "t": t,
        "load": rng.uniform(0.2, 1.4, 160),
        "row": np.arange(160.0),
        "minutes": t / 60 + 3,
        "shift": rng.choice([1.0, 2.0, 3.0], 160),
        "same": np.ones(160),
        "from_wall": rng.uniform(0, 9, 160),
    }
    values["weight"] = 102 * values["load"] + 0.01 * rng.normal(size=160)
    assert list(kept(values, set(values) - {"t"})) == ["t", "load"]
    assert list(kept(values, ())) == list(values)
