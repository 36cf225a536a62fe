"""Errors of the machine that carries the camera: what a diagnosis names, and what it states that it cannot see."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tasks.shared.images import small_jobs

Metrocli = Callable[..., Any]
GROWTH = "spindle-growth:by=t,rate=-20 um/min"


def diagnosed(job: Path, metrocli: Metrocli, planted: str) -> dict[str, Any]:
    """The diagnosis of readings with noise, in which an effect is planted."""
    new = job.parent / "new"
    assert metrocli("simulate", job, "--out", new, "--effect", planted, "--seed", "5").code == 0
    ran = metrocli("diagnose", job, "--json", "--set", f"inputs.observations={new / 'observations.csv'}")
    assert ran.code == 0, ran.err
    found: dict[str, Any] = json.loads(ran.out)
    return found


@pytest.mark.slow
def test_an_axis_that_rolls_pitches_and_yaws_is_named_with_its_rates(tmp_path: Path, metrocli: Metrocli) -> None:
    truth = {"rx": 1e-6, "ry": -8e-7, "rz": 3e-6}
    planted = ",".join(f"{name}={rate} 1/mm" for name, rate in truth.items())
    found = diagnosed(small_jobs.turned(tmp_path), metrocli, f"machine-angular:axis=x,{planted}")
    assert found["verdict"] == "explained"
    (effect,) = found["effects"]
    assert (effect["name"], effect["where"]) == ("machine-angular", {"axis": "x"})
    for name, rate in truth.items():
        sized = effect["parameters"][name]
        assert abs(sized["value"] - rate) < 3 * sized["std"]


@pytest.mark.slow
def test_a_spindle_that_is_never_tilted_grows_as_the_part_drifts(tmp_path: Path, metrocli: Metrocli) -> None:
    found = diagnosed(small_jobs.turned(tmp_path), metrocli, GROWTH)
    assert found["verdict"] == "indistinct"
    (effect,) = found["effects"]
    assert effect["name"] == "spindle-growth"
    assert [(one["name"], round(one["correlation"], 6)) for one in effect["alternatives"]] == [("part-drift", 1.0)]
    rate = effect["parameters"]["rate"]
    assert abs(rate["value"] + 0.02 / 60) < 3 * rate["std"]


@pytest.mark.slow
def test_growth_that_an_estimated_drift_absorbs_is_not_testable(tmp_path: Path, metrocli: Metrocli) -> None:
    job = small_jobs.turned(tmp_path)
    job.write_text(f"{job.read_text()}effects: [{{name: part-drift}}]\n")
    found = diagnosed(job, metrocli, GROWTH)
    assert found["verdict"] == "clean"
    growth = next(one for one in found["candidates"] if one["name"] == "spindle-growth" and one["by"] == "t")
    assert growth["status"] == "not-testable"
    assert "vz of part-drift" in growth["reason"]
