"""Cameras of people: corners that a detector calls not found, lenses that the readings do not cover."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Case = Callable[[str], Path]
Metrocli = Callable[..., Any]


def test_corners_that_mrgingham_did_not_find(case: Case, metrocli: Metrocli) -> None:
    """The reader of mrcal skips them; the truth is f = 1761.2 px."""
    case("06-vnl-level-skip")
    ran = metrocli("import", "corners.vnl", "--from", "vnl")
    assert ran.code == 0 and "5 corners that the file calls not found are left out" in ran.err
    assert metrocli("calibrate-camera", "job.yaml").code == 0
    f = json.loads(metrocli("show", "r.h5", "--json").out)["estimates"]["f"]
    assert abs(f["value"] - 1761.2) < 2 * f["std"]


def test_rational_terms_of_boards_in_the_middle(case: Case, metrocli: Metrocli) -> None:
    """Readings cover 6 % of the image; in a corner the lens is off by 130 px."""
    case("10-rational-uncovered")
    ran = metrocli("calibrate-camera", "job.yaml")
    assert ran.code == 6 and "readings span 6 % of the image, up to 23 % of its radius" in ran.out


@pytest.mark.slow
def test_the_older_layout_of_charuco_boards(case: Case, metrocli: Metrocli) -> None:
    """Boards made before OpenCV 4.6 with an even number of rows of squares begin with a marker."""
    case("07-charuco-legacy")
    ran = metrocli("calibrate-camera", "job.yaml")
    assert ran.code == 3 and "with `legacy: true` there are" in ran.err
    ran = metrocli("calibrate-camera", "job.yaml", "--set", "pattern.legacy=true")
    assert ran.code == 0, ran.err
    found = json.loads(metrocli("show", "r.h5", "--json").out)["estimates"]
    for name, value in (("f", 1100.0), ("cx", 634.9), ("cy", 487.0)):
        assert abs(found[name]["value"] - value) < max(4 * found[name]["std"], 0.5)


def test_cameras_of_opencv_and_ros(case: Case, metrocli: Metrocli) -> None:
    """The job reads them, and asks for what they do not state; what an import writes is the camera."""
    folder = case("19-camera-of-others")
    place = "camera.extrinsics={x: 0 mm, y: 0 mm, z: -320 mm, alpha: 0 rad, beta: 0 rad, gamma: 0 rad}"
    for camera in ("ocv.yml", "ros.yaml"):
        job = ("check", "job.yaml", "--set", f"inputs.camera={camera}")
        ran = metrocli(*job)
        assert ran.code == 3 and "camera: {extrinsics: {x: -2.1 mm" in ran.err and ran.err.count("error:") == 1
        assert metrocli(*job, "--set", place).code == 0
    for form, file in (("opencv", "ocv.yml"), ("ros", "ros.yaml")):
        assert metrocli("import", file, "--from", form, "--out", form).code == 0
        text = (folder / form / "camera.yaml").read_text()
        assert "image_size: [2592, 1944]" in text and "cx: 1286.77 px" in text and "k2: -0.1213" in text
    assert metrocli("calibrate-camera", "five-views/job.yaml").code == 0
    assert metrocli("export", "five-views/r.h5", "--to", "opencv", "--out", "out").code == 0
    assert "camera_matrix: !!opencv-matrix" in (folder / "out/opencv.yml").read_text()
    ran = metrocli("export", "five-views/r.h5", "--to", "colmap", "--out", "out")
    assert ran.code == 3 and "the nearest is RADIAL: rms 0.035 px" in ran.err  # it has no skew
    ran = metrocli("export", "five-views/r.h5", "--to", "colmap", "--out", "out", "--within", "0.1 px")
    assert ran.code == 0 and "RADIAL is the nearest model of colmap" in ran.err
