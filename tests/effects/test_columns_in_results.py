"""An effect of a column of the data in align-part, in results, extended jobs and proposals of what to measure next."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from effects.test_further_columns import CASES, made
from tasks.shared.images import small_jobs

from metrocli.diagnosis.next_readings.proposals import proposals
from metrocli.project.diagnosed import adjusted_job_of
from metrocli.project.job import load

Metrocli = Callable[..., Any]
SIZE = 200.0
OWN = (
    "define: [{name: load-error, acts_on: point-in-part, adds: {z: a*load}, "
    "parameters: {a: {unit: um/kN, plausible: 2000 um/kN}}}]\n"
)


def test_the_column_of_a_pose_holds_for_all_readings_of_its_image(tmp_path: Path, metrocli: Metrocli) -> None:
    job = small_jobs.turned(tmp_path)
    (file,) = job.parent.glob("*poses*.csv")
    head, *rows = file.read_text().splitlines()
    loads = np.random.default_rng(6).uniform(0.2, 1.4, len(rows)).round(4).tolist()
    rows = [f"{row},{load}" for row, load in zip(rows, loads, strict=True)]
    file.write_text("\n".join([f"{head},load_kN", *rows]) + "\n")
    job.write_text(job.read_text() + OWN)
    new, planted = tmp_path / "new", f"load-error:a={SIZE}um/kN"
    ran = metrocli("simulate", job, "--out", new, "--effect", planted, "--seed", "5")
    assert ran.code == 0, ran.err
    changed = ["--set", f"inputs.observations={new / 'observations.csv'}"]
    job.write_text(job.read_text() + "effects: [{name: load-error}]\n")
    ran = metrocli("align-part", job, *changed, "--json")
    assert ran.code == 0, ran.err
    one = json.loads(ran.out)["estimates"]["load-error.a"]
    assert abs(one["value"] - SIZE * 1e-9) < 4 * one["std"] < SIZE * 1e-9


@pytest.fixture
def hall(metrocli: Metrocli, tmp_path: Path) -> Path:
    """A job whose lengths were simulated with a cause in their column load_kN, which it defines."""
    return made(CASES["multilaterate"], metrocli, tmp_path)


@pytest.mark.slow
def test_the_extended_job_and_its_result_keep_the_definition(hall: Path, metrocli: Metrocli) -> None:
    extended = Path(json.loads(metrocli("diagnose", hall, "--json").out)["extended_job"])
    ran = metrocli("multilaterate", extended)
    assert ran.code == 0, ran.err
    with h5py.File(hall.parent.parent / "results" / "hall.extended.h5") as file:
        kept = file["effects/load-error/definition"]
        assert "a*load" in str(kept[()] if isinstance(kept, h5py.Dataset) else dict(kept.attrs))


def test_a_proposed_reading_has_the_column_of_the_reading_that_it_repeats(hall: Path) -> None:
    job = adjusted_job_of(load(hall))
    (group,) = job.model.readings
    there, keys = group.observations.conditions["load_kN"], group.observations.keys
    found = proposals(job)
    assert found
    for one in found:
        (added,) = one.added.values()
        same = np.all([np.asarray(keys[key]) == name for key, name in one.where.items()], axis=0)
        assert added.conditions["load_kN"][0] == there[np.flatnonzero(same)[-1]]


def test_a_proposed_reading_is_written_as_a_row(hall: Path, metrocli: Metrocli) -> None:
    """A tracer reads a point once more, later."""
    file = hall.parent.parent / "data" / "made.csv"
    head, first, *rows = file.read_text().splitlines()
    cells = dict(zip(head.split(","), first.split(","), strict=True))
    later = ",".join((cells | {"t_s": "99999.0"}).values())
    file.write_text("\n".join([head, first, *rows, later]) + "\n")
    assert metrocli("check", hall).code == 0
    (group,) = adjusted_job_of(load(hall)).model.readings
    assert group.observations.count == len(rows) + 2
    file.write_text("\n".join([head, first, *rows, first]) + "\n")
    assert "a second row" in metrocli("check", hall).err
