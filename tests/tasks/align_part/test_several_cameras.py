"""A part seen by several cameras that are fixed to each other, and by one whose lens has a shape."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from benchmarks.apart import rig

Metrocli = Callable[..., Any]


_MADE: dict[tuple[int | None, str], dict[str, bytes]] = {}


def made(folder: Path, metrocli: Metrocli, noise: int | None, fisheye: str = "") -> Path:
    """The job of an alignment whose cameras are calibrated, once; `noise` is a seed, None: without noise."""
    if (noise, fisheye) not in _MADE:
        rig.write_jobs(folder, None if noise is None else np.random.default_rng(noise), fisheye=fisheye)
        assert metrocli("calibrate-camera", folder / "cam.yaml").code == 0
        _MADE[noise, fisheye] = {path.name: path.read_bytes() for path in folder.iterdir()}
    for name, content in _MADE[noise, fisheye].items():
        (folder / name).write_bytes(content)
    return folder / "job.yaml"


@pytest.fixture
def noisy(tmp_path: Path, metrocli: Metrocli) -> Path:
    return made(tmp_path, metrocli, 5)


def estimates(ran: Any) -> dict[str, dict[str, float]]:
    assert ran.code == 0, ran.err
    found: dict[str, dict[str, float]] = json.loads(ran.out)["estimates"]
    return found


@pytest.mark.alike
@pytest.mark.parametrize("fisheye", ["", "left", "right"])
def test_the_part_is_found_exactly_without_noise(fisheye: str, tmp_path: Path, metrocli: Metrocli) -> None:
    found = estimates(metrocli("align-part", made(tmp_path, metrocli, None, fisheye), "--json"))
    assert {name: one["value"] for name, one in found.items()} == pytest.approx(rig.TRUTH, abs=1e-6)


@pytest.mark.alike
@pytest.mark.parametrize("fisheye", ["", "right"])
def test_the_part_is_found_within_its_uncertainty(fisheye: str, tmp_path: Path, metrocli: Metrocli) -> None:
    found = estimates(metrocli("align-part", made(tmp_path, metrocli, 5, fisheye), "--json"))
    z = [(found[name]["value"] - value) / found[name]["std"] for name, value in rig.TRUTH.items()]
    assert np.abs(z).max() < 3.5


def test_one_camera_of_several_is_as_good_as_that_camera_alone(noisy: Path, metrocli: Metrocli) -> None:
    """Targets placed by a CMM calibrate each camera for itself, so both calibrations know the same of the right one."""
    folder = noisy.parent
    for file in ("cal", "obs"):
        rig.write(folder / f"{file}-right.csv", "seen", rows_of(folder / f"{file}.csv", "right"))
    names = [row.replace(",", ".png,", 1) for row in rows_of(folder / "poses.csv", "")]
    rig.write(folder / "poses-right.csv", "poses", [f"right{row}" for row in names])
    camera = "camera: {image_size: [1600, 1200], estimate: [f, cx, cy, k1]}"
    (folder / "alone.yaml").write_text(
        (rig.CALIBRATION % camera).replace("cam.h5", "alone.h5").replace("cal.", "cal-right.")
    )
    assert metrocli("calibrate-camera", folder / "alone.yaml").code == 0
    right = given({"inputs.observations": "obs-right.csv", "inputs.poses": "poses-right.csv"})
    ran = metrocli("align-part", noisy, "--json", *right)
    assert "no image is that of left" in ran.err
    of_several = estimates(ran)
    single = estimates(metrocli("align-part", noisy, "--json", *right, *given({"inputs.camera": "alone.h5"})))
    for name, one in single.items():
        assert of_several[name]["value"] == pytest.approx(one["value"], abs=1e-3 * one["std"])
        assert of_several[name]["std"] == pytest.approx(one["std"], rel=1e-3)


def test_images_have_the_names_that_the_job_states(noisy: Path, metrocli: Metrocli) -> None:
    rows = [row.replace("left", "L_").replace("right", "R_") for row in rows_of(noisy.parent / "obs.csv", "")]
    rig.write(noisy.parent / "named.csv", "seen", rows)
    named = given({"inputs.observations": "named.csv"})
    assert "images of no camera, or of two: L_0.png" in metrocli("align-part", noisy, *named).err
    both = given({"cameras": '{left: "L_*.png", right: "R_*.png"}'})
    ran = metrocli("align-part", noisy, "--json", *named, *both)
    assert estimates(ran) == estimates(metrocli("align-part", noisy, "--json"))


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"cameras": '{left: "left*.png", top: "top*.png"}'}, "the calibration has no top"),
        ({"cameras": "{left: left.png}"}, "'left.png' has not one *"),
        (
            {"inputs.poses": "twice.csv"},
            "images 'left2.png' and 'right2.png' are taken at once, and their poses differ",
        ),
        ({"inputs.observations": "wide.csv"}, "outside an image of 1280 x 960 px"),
    ],
)
def test_what_does_not_fit_the_cameras_is_refused(
    keys: dict[str, str], words: str, noisy: Path, metrocli: Metrocli
) -> None:
    poses = rows_of(noisy.parent / "poses.csv", "")
    twice = [*poses[:2], *poses[3:], "left2.png,0,0,0,0,0,0", "right2.png,0,0,1,0,0,0"]
    rig.write(noisy.parent / "twice.csv", "poses", twice)
    wide = [f"left{i}.png,T{j},{1300 + 30 * i},{100 * j}" for i in range(5) for j in range(9)]
    rig.write(noisy.parent / "wide.csv", "seen", wide)
    ran = metrocli("check", noisy, *given(keys))
    assert ran.code == 3 and words in ran.err, ran.err


def test_images_of_another_size_are_refused(noisy: Path, metrocli: Metrocli) -> None:
    for grey, name in enumerate(("left0.png", "right0.png")):
        cv2.imwrite(str(noisy.parent / name), np.full((960, 1280), grey, np.uint8))
    text = noisy.read_text().replace("observations: obs.csv", 'images: "*.png"')
    noisy.write_text(text + "pattern: {type: coded-rings, diameter: 5 mm}\n")
    ran = metrocli("check", noisy)
    assert ran.code == 3 and "the camera right was calibrated with 1600 x 1200 px" in ran.err


SIMULATION = "{part: {x: 40 mm, y: -30 mm, z: 250 mm, alpha: 0.02 rad, beta: -0.03 rad, gamma: 0.4 rad}}"


def test_a_wrong_pose_of_the_spindle_is_that_of_all_cameras(noisy: Path, metrocli: Metrocli) -> None:
    job = [noisy, *given({"simulation": SIMULATION, "inputs.observations": "new/observations.csv"})]
    effect = "bad-pose:image=2,dx=0.3mm,dy=0mm,dz=0mm"
    assert metrocli("simulate", *job, "--seed", 3, "--out", noisy.parent / "new", "--effect", effect).code == 0
    seen_in = {row.split(",")[0] for row in rows_of(noisy.parent / "new/observations.csv", "")}
    assert seen_in == {f"{name}{exposure}.png" for name in ("left", "right") for exposure in rig.SPINDLE}
    found = json.loads(metrocli("diagnose", *job, "--quick", "--json").out)["effects"]
    assert [(one["name"], one["where"]) for one in found] == [("bad-pose", {"image": "2"})]


def test_a_lens_with_a_shape_locates_the_part_and_finds_what_it_simulates(tmp_path: Path, metrocli: Metrocli) -> None:
    rig.write_jobs(tmp_path, np.random.default_rng(6), ("wide",))
    assert metrocli("calibrate-camera", tmp_path / "cam.yaml").code == 0
    ran = metrocli("align-part", tmp_path / "job.yaml", "--json")
    # by the base lens alone it is 1.7
    assert json.loads(ran.out)["statistics"]["sigma0"] == pytest.approx(1.0, abs=0.15)
    found = estimates(ran)
    z = [(found[name]["value"] - value) / found[name]["std"] for name, value in rig.TRUTH.items()]
    assert np.abs(z).max() < 3.5
    job = [tmp_path / "job.yaml", *given({"simulation": SIMULATION, "inputs.observations": "new/observations.csv"})]
    assert metrocli("simulate", *job, "--set", "noise=1e-6 px", "--out", tmp_path / "new").code == 0
    found = estimates(metrocli("align-part", *job, "--json"))
    assert {name: one["value"] for name, one in found.items()} == pytest.approx({**rig.TRUTH, "gamma_s": 0.0}, abs=1e-5)


def rows_of(file: Path, begin: str) -> list[str]:
    return [row for row in file.read_text().splitlines()[1:] if row.startswith(begin)]


def given(keys: Mapping[str, str]) -> list[str]:
    return [part for key, value in keys.items() for part in ("--set", f"{key}={value}")]


def test_a_noisier_camera_is_named(noisy: Path, metrocli: Metrocli) -> None:
    rng, rows = np.random.default_rng(6), []
    for image, target, u, v in (row.split(",") for row in rows_of(noisy.parent / "obs.csv", "")):
        spread = rig.NOISE * np.sqrt(15.0) if image.startswith("right") else 0.0
        rows.append(f"{image},{target},{float(u) + spread * rng.normal()},{float(v) + spread * rng.normal()}")
    rig.write(noisy.parent / "obs.csv", "seen", rows)
    found = json.loads(metrocli("diagnose", noisy, "--json").out)
    assert not found["effects"]
    (apart,) = found["noise"]["apart"]
    assert apart["camera"] == "right" and apart["ratio"] == pytest.approx(4.0, rel=0.25)
