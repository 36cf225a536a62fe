"""The image points of a simulated board are inputs of a job without further work."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
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


BOARD = """metrocli: 1
job: calibrate-camera
rig: board
inputs: {observations: new/observations.csv}
pattern: {type: %s, columns: 9, rows: 6, pitch: 25 mm%s}
noise: 0.1 px
camera: {image_size: [400, 300], estimate: [f, cx, cy, k1]}
simulation: {lens: {f: 375 px, k1: -0.2}, images: 4, distance: 500 mm}
output: camera.h5
"""


@pytest.mark.alike
@pytest.mark.parametrize(
    ("board", "more"), [("chessboard", ""), ("circles", ", diameter: 10 mm"), ("charuco", ", marker_size: 18.75 mm")]
)
def test_a_board_needs_no_list_of_its_targets(board: str, more: str, metrocli: Metrocli, tmp_path: Path) -> None:
    """The image points and the pictures of a simulation, each without a file of targets."""
    (tmp_path / "job.yaml").write_text(BOARD % (board, more))
    ran = metrocli("simulate", tmp_path / "job.yaml", "--out", tmp_path / "new", "--images")
    assert ran.code == 0, ran.err
    assert len(list((tmp_path / "new" / "images").glob("*.png"))) == 4
    for inputs in ("observations: new/observations.csv", "images: new/images/*.png"):
        ran = metrocli("calibrate-camera", tmp_path / "job.yaml", "--set", f"inputs={{{inputs}}}", "--json", "--force")
        assert ran.code == 0, ran.err
        found = json.loads(ran.out)["estimates"]
        for name, value in (("f", 375.0), ("k1", -0.2), ("cx", 199.5)):
            assert abs(found[name]["value"] - value) < 4 * found[name]["std"]


def test_a_board_that_cannot_be_drawn_is_refused(metrocli: Metrocli, tmp_path: Path) -> None:
    (tmp_path / "job.yaml").write_text(BOARD % ("charuco", ", marker_size: 18 mm"))
    ran = metrocli("simulate", tmp_path / "job.yaml", "--out", tmp_path / "new", "--images")
    assert ran.code == 3 and "the marker's cells do not fill a square evenly" in ran.err
    assert "marker_size: 18.75 mm" in ran.err and not (tmp_path / "new").exists()
