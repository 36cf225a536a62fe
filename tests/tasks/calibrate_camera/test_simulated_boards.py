"""The image points of a simulated board are inputs of a job without further work."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

Metrocli = Callable[..., Any]


def test_an_effect_in_a_simulated_board_is_estimated(metrocli: Metrocli, tmp_path: Path) -> None:
    metrocli("init", tmp_path / "camera", "--sample", "board-camera")
    job = tmp_path / "camera" / "jobs" / "calibrate.yaml"
    bend = "target-plane-bend:bxx=4e-5 1/mm,bxy=0 1/mm,byy=2e-5 1/mm"
    ran = metrocli("simulate", job, "--seed", "5", "--out", job.parent.parent / "new", "--effect", bend)
    assert ran.code == 0, ran.err
    again = yaml.safe_load(job.read_text())
    del again["pattern"], again["require"]
    again |= {
        "inputs": {"observations": "../new/observations.csv", "targets": "../new/targets.csv"},
        "effects": [{"name": "target-plane-bend"}],
    }
    job.write_text(yaml.safe_dump(again))
    ran = metrocli("calibrate-camera", job, "--json")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)["estimates"]
    for name, planted in (("bxx", 4e-5), ("bxy", 0.0), ("byy", 2e-5)):
        size = found[f"target-plane-bend.{name}"]
        assert abs(size["value"] - planted) < 4 * size["std"] < 4e-5
