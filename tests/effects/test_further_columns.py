"""Further columns of the data as variables of effects of one's own, in each kind of job."""

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
