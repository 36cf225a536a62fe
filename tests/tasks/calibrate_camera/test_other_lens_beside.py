"""Several cameras whose lenses have different models: a pinhole beside a fisheye."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from benchmarks.rigs import z_of_rig
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import LinkContext
from metrocli.adjust.model.observations import Observations
from metrocli.instruments import camera
from metrocli.instruments.camera import LENS, MOUNT

Metrocli = Callable[..., Any]
CONVENTIONS = ("forward", "fisheye", "forward", "backward")


def test_each_reading_has_the_lens_of_its_camera_and_its_derivatives() -> None:
    rng = np.random.default_rng(2)
    columns = ("f", "cx", "cy", "k1", "k2", "k3", "k4", "p1")
    values = np.array([900.0, 640.0, 480.0, -0.1, 0.02, 0.0, 0.01, 1e-3]) * rng.uniform(0.9, 1.1, (4, 8))
    lens, of = Block(LENS, values, columns, tuple("abcd")), rng.integers(0, 4, 30)
    points = np.stack([*rng.uniform(-100, 100, (2, 30)), rng.uniform(300, 400, 30)])
    readings = 600 + rng.normal(0, 200, (2, 30))
    seen = Observations(readings, np.ones(1), {LENS: of, MOUNT: of})
    link, wanted = camera.lens_link(*CONVENTIONS), frozenset({LENS})
    step = link.step(points, LinkContext({LENS: lens}, seen, wanted))
    for number, convention in enumerate(CONVENTIONS):
        mine, alone = of == number, Block(LENS, values[number : number + 1], columns)
        local = LinkContext({LENS: alone}, Observations(readings[:, mine], np.ones(1)), wanted)
        own = camera.lens_link(convention).step(points[:, mine], local)
        assert np.array_equal(step.value[:, mine], own.value)
        assert step.by_input is not None and np.array_equal(step.by_input[:, :, mine], own.by_input)
        assert np.array_equal(step.by_block[LENS][:, :, mine], own.by_block[LENS])


def test_the_uncertainties_of_a_pinhole_and_a_fisheye_are_honest() -> None:
    each = np.concatenate([z_of_rig(number) for number in (2, 8)])
    assert 0.8 < np.sqrt(np.mean(each**2)) < 1.2


JOB = """metrocli: 1
job: calibrate-camera
rig: board
inputs: {observations: new/observations.csv}
pattern: {type: chessboard, columns: 9, rows: 6, pitch: 25 mm}
noise: 0.1 px
cameras:
  left: {images: "left*.png", image_size: [1280, 960]}
  wide: {images: "wide*.png", image_size: [1280, 960], model: fisheye}
simulation:
  cameras:
    left: {lens: {f: 1100 px, k1: -0.2}}
    wide: {lens: {f: 500 px, k1: 0.02}, extrinsics: {x: 60 mm, y: 0 mm, z: 0 mm, alpha: 0 deg, beta: -7 deg, gamma: 0 deg}}
  images: 12
  distance: 400 mm
require: {corner_std: "< 5000"}
output: rig.h5
"""


@pytest.fixture
def rig(tmp_path: Path, metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The result of a pinhole and a fisheye; its folder is the working folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.yaml").write_text(JOB)
    assert metrocli("simulate", "rig.yaml", "--out", "new", "--seed", 6).code == 0
    ran = metrocli("calibrate-camera", "rig.yaml")
    assert ran.code == 0, ran.err
    return tmp_path / "rig.h5"


def test_they_are_exported_and_compared_each_by_its_model(rig: Path, metrocli: Metrocli) -> None:
    assert metrocli("export", rig, "--to", "kalibr", "--out", "out").code == 0
    held = yaml.safe_load((rig.parent / "out" / "camchain.yaml").read_text())
    assert [held[name]["distortion_model"] for name in ("cam0", "cam1")] == ["radtan", "equidistant"]
    assert metrocli("simulate", "rig.yaml", "--out", "new", "--seed", 5, "--force").code == 0
    assert metrocli("calibrate-camera", "rig.yaml", "--set", "output=again.h5").code == 0
    told = metrocli("compare", "rig.h5", "again.h5").out
    assert "left, over the image after the best rotation" in told and "wide, over the image" in told


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is_hidden(rig: Path, metrocli: Metrocli) -> None:
    found = json.loads(metrocli("diagnose", "rig.yaml", "--json").out)
    assert found["verdict"] == "clean" and not found["effects"]


@pytest.mark.slow
def test_a_fisheye_that_a_pinhole_nearly_fits_is_named_beside_an_estimated_noise(
    tmp_path: Path, metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pinhole with all its distortion leaves 0.18 px, a fisheye the 0.14 px by which neighbouring points scatter."""
    monkeypatch.chdir(tmp_path)
    Path("rig.yaml").write_text(JOB.replace("f: 500", "f: 400").replace("400 mm", "130 mm").replace("1100", "700"))
    assert metrocli("simulate", "rig.yaml", "--out", "new", "--seed", 3).code == 0
    pinholes = Path("rig.yaml").read_text().replace(", model: fisheye", "").replace("noise: 0.1 px", "noise: estimated")
    Path("rig.yaml").write_text(pinholes)
    found = json.loads(metrocli("diagnose", "rig.yaml", "--quick", "--json").out)
    assert found["verdict"] == "mistaken" and found["mistake"]["what"] == "the lens of wide is a fisheye"
