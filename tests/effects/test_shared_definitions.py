"""A file of effects for many jobs, of which some have data without the columns that its effects use."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

Metrocli = Callable[..., Any]
LOAD = (
    "- {name: load-error, acts_on: length, adds: a*load, parameters: {a: {unit: um/kN, plausible: 30 um/kN}}}\n"
    "- {name: zero-error, acts_on: length, adds: a, parameters: {a: {unit: um, plausible: 30 um}}, where: [tracer]}\n"
)


@pytest.fixture
def hall(metrocli: Metrocli, tmp_path: Path) -> Path:
    """The job of a laboratory whose file has an effect of the load, which the lengths of this job lack."""
    metrocli("init", tmp_path / "lab", "--sample", "laboratory-effects")
    (tmp_path / "lab" / "lab-effects.yaml").write_text(f"define:\n{LOAD}")
    return tmp_path / "lab" / "jobs" / "hall.yaml"


def not_tested(metrocli: Metrocli, job: Path) -> dict[str, str]:
    ran = metrocli("diagnose", job, "--design", "--json")
    assert ran.code == 0, ran.err
    every = json.loads(ran.out)["candidates"]
    return {one["name"]: one["reason"] for one in every if one["status"] == "not-tested"}


def test_an_effect_of_a_column_that_the_data_lack_is_not_tested(hall: Path, metrocli: Metrocli) -> None:
    assert metrocli("check", hall).code == 0
    assert not_tested(metrocli, hall)["load-error"] == "needs a column load"
    assert metrocli("run", hall.parent.parent).code == 0


def test_the_reason_has_the_nearest_name(hall: Path, metrocli: Metrocli) -> None:
    shared = hall.parent.parent / "lab-effects.yaml"
    shared.write_text(shared.read_text().replace("a*load", "a*lenght*load"))
    told = not_tested(metrocli, hall)["load-error"]
    assert told == "needs a column lenght (did you mean 'length'?) and load"


@pytest.mark.parametrize("how", ["effects", "--effect", "define"])
def test_it_is_a_fault_where_the_job_wants_it(how: str, hall: Path, metrocli: Metrocli) -> None:
    more = {"effects": "effects: [{name: load-error}]\n", "define": f"define:\n{LOAD.replace('-error', '-fault')}"}
    hall.write_text(hall.read_text() + more.get(how, ""))
    given = ["simulate", hall, "--out", hall.parent / "made", "--effect", "load-error:a=1um/kN"]
    ran = metrocli(*(given if how == "--effect" else ["check", hall]))
    file, line = ("hall.yaml", 11) if how == "define" else ("lab-effects.yaml", 2)
    assert ran.code == 3 and f"{file}:{line}:" in ran.err and "unknown variable 'load'" in ran.err


def test_a_job_with_the_column_tests_it(hall: Path, metrocli: Metrocli) -> None:
    lengths = hall.parent.parent / "data" / "lengths.csv"
    head, *rows = [line for line in lengths.read_text().splitlines() if not line.startswith("#")]
    loads = np.random.default_rng(3).uniform(0.2, 1.4, len(rows)).round(3).tolist()
    rows = [f"{row},{load}" for row, load in zip(rows, loads, strict=True)]
    lengths.write_text("\n".join([f"{head},load_kN", *rows]) + "\n")
    assert "load-error" not in not_tested(metrocli, hall)


def test_the_check_of_a_file_names_what_only_data_know(
    hall: Path, metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(hall.parent.parent)
    ran = metrocli("effects", "multilaterate", "--from", "lab-effects.yaml", "--check")
    assert ran.code == 0 and "load-error: needs a column load;" in ran.out
    assert "zero-error" not in ran.out
    own = json.loads(metrocli("effects", "multilaterate", "--json").out)["effects"]
    assert [one["name"] for one in own if one["own"]] == ["load-error", "zero-error"]


def test_a_column_named_as_a_constant_refuses_no_job_that_leaves_the_effect_out(hall: Path, metrocli: Metrocli) -> None:
    folder = hall.parent.parent
    wave = (
        "- {name: belt, acts_on: length, adds: a*cos(2*pi*t/(60*s1)), parameters: {a: {unit: um, plausible: 5 um}}}\n"
    )
    wave = wave.replace("(60*s1)", "p").replace("}}}", "}}, scan: {p: {from: 60 s, to: 600 s, steps: 9}}}")
    (folder / "lab-effects.yaml").write_text(f"define:\n{wave}")
    head, *rows = [one for one in (folder / "data/lengths.csv").read_text().splitlines() if not one.startswith("#")]
    cells = [f"{row},{number % 5}" for number, row in enumerate(rows)]
    (folder / "data/lengths.csv").write_text("\n".join([f"{head},pi", *cells]) + "\n")
    assert metrocli("check", hall).code == 0
    reason = not_tested(metrocli, hall)["belt"]
    assert reason.startswith("'pi' is 3.14159, and a column of the data has this name (row 1 of lengths.csv:"), reason
    hall.write_text(f"{hall.read_text()}effects: [{{name: belt, p: 120 s}}]\n")
    ran = metrocli("check", hall)
    assert ran.code == 3 and "write the heading 'pi' as my_pi" in ran.err


def test_a_definition_for_another_kind_lacks_no_column(hall: Path, metrocli: Metrocli) -> None:
    """Lengths have a side of approach in calibrate-machine, not in multilaterate."""
    shared = hall.parent.parent / "lab-effects.yaml"
    shared.write_text(shared.read_text().replace("a*load", "a*from_x").replace("um/kN", "um"))
    found = json.loads(metrocli("effects", "--from", shared, "--json").out)["kinds"]
    own = {kind: [one["name"] for one in every["effects"] if one["own"]] for kind, every in found.items()}
    assert own["calibrate-machine"] == ["load-error", "zero-error"]
    assert own["multilaterate"] == ["zero-error"]


@pytest.mark.slow
def test_sizes_without_a_dimension_are_told_in_the_unit_of_their_definition(hall: Path, metrocli: Metrocli) -> None:
    lengths = hall.parent.parent / "data" / "lengths.csv"
    head, *rows = [line for line in lengths.read_text().splitlines() if not line.startswith("#")]
    loads = np.random.default_rng(3).uniform(0.2, 1.4, len(rows)).round(4)
    cells = [f"{row},{load}" for row, load in zip(rows, loads.tolist(), strict=True)]
    lengths.write_text("\n".join([f"{head},load_kN", *cells]) + "\n")
    every = json.loads(metrocli("diagnose", hall, "--design", "--json").out)["candidates"]
    (reason,) = [one["reason"] for one in every if one["name"] == "load-error"]
    assert re.fullmatch(r"excluded above \S+ um/kN; larger than 30 um/kN is not plausible", reason), reason
    (line,) = [one for one in metrocli("diagnose", hall, "--design").out.splitlines() if one.startswith("load-error")]
    assert re.search(r"detectable from \S+ um/kN", line), line
    hall.write_text(f"{hall.read_text()}effects: [{{name: load-error}}]\n")
    ran = json.loads(metrocli("multilaterate", hall, "--force", "--json").out)
    page = hall.parent / "page.html"
    assert metrocli("report", ran["result"], "--out", page).code == 0
    size = ran["estimates"]["load-error.a"]["value"]  # in s2 kg-1: 1 um/kN = 1e-9 s2/kg
    (shown, unit) = re.findall(
        r"load-error\.a</td><td[^>]*>([^<]*)</td><td[^>]*>[^<]*</td><td>([^<]*)<", page.read_text()
    )[0]
    assert unit == "µm/kN" and float(shown) == pytest.approx(size / 1e-9, abs=0.06)


def test_a_definition_for_places_that_a_measurement_lacks_is_not_tested(metrocli: Metrocli, tmp_path: Path) -> None:
    """Points of a tracker have no tracers of lengths."""
    metrocli("init", tmp_path / "otf", "--sample", "otf-tracker")
    job = tmp_path / "otf" / "jobs" / "feed-2500.yaml"
    job.write_text(f"{job.read_text()}define:\n{LOAD.replace('a*load', 'a').replace('um/kN', 'um')}")
    reasons = not_tested(metrocli, job)
    assert reasons["zero-error"] == "this measurement has no tracer"
    assert reasons["load-error"] == "has no influence on the readings"
