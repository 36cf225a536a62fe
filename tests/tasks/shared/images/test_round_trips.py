"""What simulate writes, calibration and alignment find again, for each rig and both conventions."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tasks.shared.images import small_jobs

from metrocli.targets.coded_rings import codes

Metrocli = Callable[..., Any]
BOUND = 3.5
"""Standard uncertainties that an estimate may be off"""
LENS = "f: 2813.2 px, cx: 1286.8 px, cy: 999 px, k1: 0.08, k2: -0.03, p1: -1.7e-4, p2: 4e-4"
TRUTH = {
    "board": f"{{lens: {{{LENS}}}, images: 8, distance: 330 mm, tilt: 35 deg}}",
    "network": f"{{lens: {{{LENS}}}, images: 10, distance: 450 mm, tilt: 45 deg}}",
    "cmm": f"{{lens: {{{LENS}}}, extrinsics: {{x: -2 mm, y: 1 mm, z: -320 mm, alpha: 0.02 rad, beta: -0.01 rad, gamma: 0.03 rad}}}}",
}


def simulated(folder: Path, job: Path, metrocli: Metrocli, *more: str) -> dict[str, float]:
    """Simulate a job, make it use what was written, and return the truth."""
    ran = metrocli("simulate", job, "--out", folder / "new", "--seed", "7", *more)
    assert ran.code == 0, ran.err
    truth: dict[str, float] = json.loads((folder / "new" / "truth.json").read_text())
    return truth.get("estimates", truth)  # type: ignore[return-value]


def assert_true(found: dict[str, Any], truth: dict[str, Any]) -> None:
    assert found["estimates"]
    for name, estimate in found["estimates"].items():
        assert abs(estimate["value"] - truth[name]) < BOUND * estimate["std"], name


@pytest.mark.alike
@pytest.mark.parametrize("convention", ["forward", "backward"])
@pytest.mark.parametrize("rig", TRUTH)
def test_a_calibration_finds_the_simulated_lens(rig: str, convention: str, tmp_path: Path, metrocli: Metrocli) -> None:
    job = small_jobs.JOBS[rig](tmp_path)
    told = job.read_text().replace("estimate:", f"convention: {convention}, estimate:")
    job.write_text(told + f"simulation: {TRUTH[rig]}\n")
    truth = simulated(tmp_path, job, metrocli)
    ran = metrocli("calibrate-camera", job, "--json", "--set", "inputs.observations=new/observations.csv")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)
    assert_true(found, truth)
    assert found["statistics"]["convention"] == convention
    assert 0.001 < found["statistics"]["p_value"] < 0.999


@pytest.mark.parametrize("rig", ["board", "cmm"])
def test_the_wrong_convention_does_not_fit(rig: str, tmp_path: Path, metrocli: Metrocli) -> None:
    """The conventions differ by more than the noise, so that the test above tells them apart."""
    job = small_jobs.JOBS[rig](tmp_path)
    told = job.read_text().replace("estimate:", "convention: backward, estimate:").replace("0.05 px", "0.005 px")
    job.write_text(told + f"simulation: {TRUTH[rig]}\n")
    truth = simulated(tmp_path, job, metrocli)
    arguments = ("--json", "--set", "inputs.observations=new/observations.csv", "--set", "camera.convention=forward")
    found = json.loads(metrocli("calibrate-camera", job, *arguments).out)
    errors = {name: abs(e["value"] - truth[name]) / e["std"] for name, e in found["estimates"].items()}
    assert errors["k1"] > 10


def test_an_alignment_finds_the_simulated_part(tmp_path: Path, metrocli: Metrocli) -> None:
    job = small_jobs.align(tmp_path)
    part = "{x: 1 m, y: -300 mm, z: 20 mm, alpha: 2 deg, beta: -1 deg, gamma: 3 mrad}"
    moved = (tmp_path / "poses.csv").read_text().splitlines()
    header, *poses = moved
    rows = [row.split(",") for row in poses]
    (tmp_path / "poses.csv").write_text(
        "\n".join([header, *(f"{n},{float(x) + 880},{float(y) - 380},{float(z) - 20}" for n, x, y, z in rows)]) + "\n"
    )
    job.write_text(job.read_text() + f"simulation: {{part: {part}, clamping_angle: 2.6 mrad}}\n")
    truth = simulated(tmp_path, job, metrocli)
    ran = metrocli("align-part", job, "--json", "--set", "inputs.observations=new/observations.csv")
    assert ran.code == 0, ran.err
    assert_true(json.loads(ran.out), truth)


def _rings(folder: Path) -> Path:
    """Write a calibration with one coded ring in each image, on planes that the camera sees at 45 degrees."""
    camera_x, tilt = np.array([1.0, 0.0, 0.0]), np.radians(45.0)
    down = np.array([0.0, np.cos(tilt), -np.sin(tilt)])
    ahead = np.array([0.0, np.sin(tilt), np.cos(tilt)])
    rows = [
        distance * (ahead + u * camera_x + v * down)
        for distance in (260.0, 330.0, 400.0)
        for u in (-0.3, 0.0, 0.3)
        for v in (-0.22, 0.0, 0.22)
    ]
    lines = [f"{code},{x:.4f},{y:.4f},{z:.4f},0" for code, (x, y, z) in zip(codes(), rows, strict=False)]
    (folder / "targets.csv").write_text("\n".join(["target,x_mm,y_mm,z_mm,sigma_mm", *lines]) + "\n")
    job = folder / "job.yaml"
    job.write_text(
        "metrocli: 1\njob: calibrate-camera\nrig: cmm\ninputs: {images: new/images/*.png, targets: targets.csv}\n"
        "pattern: {type: coded-rings, diameter: 12 mm, polarity: bright}\n"
        "camera: {image_size: [1000, 800], estimate: [f, cx, cy, k1]}\nnoise: estimated\noutput: camera.h5\n"
        "simulation:\n  lens: {f: 1300 px, cx: 503 px, cy: 396 px, k1: -0.1}\n"
        "  extrinsics: {x: 0 mm, y: 0 mm, z: 0 mm, alpha: -45 deg, beta: 0 deg, gamma: 0 deg}\n"
    )
    return job


@pytest.mark.slow
def test_tilted_rings_are_freed_of_eccentricity(tmp_path: Path, metrocli: Metrocli) -> None:
    """Rendered rings seen at 45 degrees: the camera is found where it is; without the correction it is not."""
    job = _rings(tmp_path)
    truth = simulated(tmp_path, job, metrocli, "--images")
    ran = metrocli("calibrate-camera", job, "--json")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)
    assert_true(found, truth)
    away = {name: abs(found["estimates"][name]["value"] - truth[name]) for name in "xyz"}
    ignored = json.loads(metrocli("calibrate-camera", job, "--json", "--force", "--set", "eccentricity=ignore").out)[
        "estimates"
    ]
    assert max(away.values()) < 0.01
    assert abs(ignored["z"]["value"] - truth["z"]) > 0.01


@pytest.mark.alike
@pytest.mark.parametrize("clamping", ["0.1 deg", "35 deg", "172 deg", "-170 deg"])
def test_a_camera_that_looks_down_finds_the_part_at_any_clamping_angle(
    clamping: str, tmp_path: Path, metrocli: Metrocli
) -> None:
    """The camera looks along -z of the taper, the spindle is turned for some images, and no start is given."""
    job = small_jobs.align(tmp_path)
    camera = (tmp_path / "camera.yaml").read_text()
    (tmp_path / "camera.yaml").write_text(
        camera[: camera.index("extrinsics")]
        + "extrinsics: {x: 1 mm, y: 40 mm, z: -120 mm, alpha: 179 deg, beta: 1 deg, gamma: 20 deg}\n"
    )
    turn = float(clamping.split()[0])
    rows = ["image,x_mm,y_mm,z_mm,c_deg"]
    for i, (x, y) in enumerate([(500, 400), (2000, 400), (2000, 1400), (500, 1400)]):
        for j, c in enumerate((turn, turn + 90.0)):  # turned back by what the clamping turns, so that targets are seen
            lever = np.radians(c - turn)
            down = np.array([x - 1 + 40 * np.sin(lever), y - 40 * np.cos(lever)]) + 25 * j
            rows.append(f"image{2 * i + j + 1},{down[0]:.3f},{down[1]:.3f},470,{c}")
    (tmp_path / "poses.csv").write_text("\n".join(rows) + "\n")
    part = "{x: 500 mm, y: 400 mm, z: 50 mm, alpha: 0.3 deg, beta: -0.2 deg, gamma: 0.1 deg}"
    job.write_text(job.read_text() + f"simulation: {{part: {part}, clamping_angle: {clamping}}}\n")
    truth = simulated(tmp_path, job, metrocli)
    ran = metrocli("align-part", job, "--json", "--set", "inputs.observations=new/observations.csv")
    assert ran.code == 0, ran.err
    assert_true(json.loads(ran.out), truth)
