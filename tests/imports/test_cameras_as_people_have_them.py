"""Files of cameras in the other forms that their programs write: messages, lists with an entry a line, several cameras."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from imports.camera_texts import (
    CAMODOCAL,
    CHAIN,
    COLMAP,
    DOCUMENT,
    FILESTORAGE,
    KANNALA,
    MESSAGE,
    ONE_A_LINE,
    ORB,
    OST,
    SENSOR,
    STORAGE,
    TOOLBOX,
    TWO_EYES,
)

Metrocli = Callable[..., Any]
LENS = {"fx": 500.0, "fy": 501.0, "cx": 321.0, "cy": 242.0, "k1": -0.1, "k2": 0.02, "p1": 0.001, "p2": -0.002}


def lens(path: Path) -> dict[str, float]:
    held = yaml.safe_load(path.read_text())
    return {name: float(str(held[name]).split()[0]) for name in LENS if name in held}


def imported(folder: Path, text: str, program: str, metrocli: Metrocli) -> Any:
    (folder / "their.yaml").write_text(text)
    return metrocli("import", folder / "their.yaml", "--from", program, "--out", folder / "out")


FORMS = {"message": MESSAGE, "an entry a line": ONE_A_LINE, "oST": OST, "camodocal": CAMODOCAL, "ORB-SLAM": ORB}


@pytest.mark.parametrize("text", FORMS.values(), ids=FORMS)
def test_other_forms_are_read(text: str, tmp_path: Path, metrocli: Metrocli) -> None:
    assert imported(tmp_path, text, "ros", metrocli).code == 0
    assert lens(tmp_path / "out" / "camera.yaml") == LENS


@pytest.mark.parametrize(
    ("text", "program"), [(SENSOR, "kalibr"), (STORAGE, "opencv"), (TOOLBOX, "matlab")], ids=lambda part: part[:6]
)
def test_forms_of_other_programs_are_read_and_named(
    text: str, program: str, tmp_path: Path, metrocli: Metrocli
) -> None:
    assert imported(tmp_path, text, program, metrocli).code == 0
    assert lens(tmp_path / "out" / "camera.yaml") == LENS
    (tmp_path / "other.txt").write_text(text)
    assert f"--from {program}" in metrocli("import", tmp_path / "other.txt").err


def test_a_skew_of_the_toolbox_is_refused(tmp_path: Path, metrocli: Metrocli) -> None:
    ran = imported(tmp_path, TOOLBOX.replace("alpha_c = 0.0", "alpha_c = 0.1"), "matlab", metrocli)
    assert ran.code == 3 and "a skew (alpha_c)" in ran.err


@pytest.mark.parametrize(
    ("text", "program", "names"), [(CHAIN, "kalibr", ("cam0", "cam1")), (COLMAP, "colmap", ("camera-1", "camera-2"))]
)
def test_several_cameras_have_a_file_each(
    text: str, program: str, names: tuple[str, str], tmp_path: Path, metrocli: Metrocli
) -> None:
    assert imported(tmp_path, text, program, metrocli).code == 0
    assert lens(tmp_path / "out" / f"{names[0]}.yaml") == LENS
    assert lens(tmp_path / "out" / f"{names[1]}.yaml")["fx"] == 280.0


def test_a_file_without_the_size_of_the_images_is_complete_with_it(tmp_path: Path, metrocli: Metrocli) -> None:
    ran = imported(tmp_path, FILESTORAGE, "opencv", metrocli)
    assert ran.code == 3 and "add lines `image_width:` and `image_height:`" in ran.err
    assert imported(tmp_path, f"{FILESTORAGE}image_width: 640\nimage_height: 480\n", "opencv", metrocli).code == 0
    assert lens(tmp_path / "out" / "camera.yaml") == LENS


def test_coefficients_of_a_fisheye_under_another_name_are_refused(tmp_path: Path, metrocli: Metrocli) -> None:
    wrong = MESSAGE.replace("1.0e-3, -2.0e-3, 0.0", "2.4, 3.3")
    ran = imported(tmp_path, wrong, "ros", metrocli)
    assert ran.code == 3 and "p1 = 2.4, p2 = 3.3: no lens is decentred so much" in ran.err
    right = imported(tmp_path, wrong.replace("plumb_bob", "equidistant"), "ros", metrocli)
    assert right.code == 0 and "model: fisheye" in (tmp_path / "out" / "camera.yaml").read_text()


def test_another_model_with_the_same_keys_is_refused(tmp_path: Path, metrocli: Metrocli) -> None:
    ran = imported(tmp_path, CAMODOCAL.replace("PINHOLE", "MEI"), "opencv", metrocli)
    assert ran.code == 3 and "the model MEI is not known here" in ran.err


ANGULAR = [
    "fx: 280.0 px",
    "fy: 281.0 px",
    "cx: 321.0 px",
    "cy: 242.0 px",
    "k1: -0.01",
    "k2: 0.02",
    "k3: -0.03",
    "k4: 0.004",
]


def test_kannala_brandt_is_the_fisheye(tmp_path: Path, metrocli: Metrocli) -> None:
    assert imported(tmp_path, KANNALA, "opencv", metrocli).code == 0
    assert (tmp_path / "out" / "camera.yaml").read_text().splitlines()[3:] == ["model: fisheye", *ANGULAR]


def test_each_camera_of_orb_slam_has_a_file(tmp_path: Path, metrocli: Metrocli) -> None:
    assert imported(tmp_path, TWO_EYES, "opencv", metrocli).code == 0
    written = {path.name: path.read_text() for path in (tmp_path / "out").glob("*.yaml")}
    assert sorted(written) == ["Camera1.yaml", "Camera2.yaml"]
    first, *rest = written["Camera1.yaml"].splitlines()
    assert "their poses to each other" in first and rest[3:] == ["model: fisheye", *ANGULAR]
    assert "fx: 290.0 px\nfy: 291.0 px\ncx: 322.0 px\ncy: 243.0 px\nk1: 0.01\n" in written["Camera2.yaml"]


def test_a_camera_of_mrcal_with_its_older_keys(tmp_path: Path, metrocli: Metrocli) -> None:
    text = "{{\n 'distortion_model': 'DISTORTION_{}',\n 'intrinsics': [500, 501, 321, 242{}],\n 'dimensions': [640, 480],\n}}\n"
    for model, terms, last in (("OPENCV4", ", -0.1, 0.02, 0.001, -0.002", "p2: -0.002"), ("NONE", "", "cy: 242 px")):
        assert imported(tmp_path, text.format(model, terms), "mrcal", metrocli).code == 0
        assert (tmp_path / "out" / "camera.yaml").read_text().splitlines()[-1] == last


def test_each_sensor_of_a_document_of_metashape_has_a_file(tmp_path: Path, metrocli: Metrocli) -> None:
    assert imported(tmp_path, DOCUMENT, "metashape", metrocli).code == 0
    written = {path.name: path.read_text() for path in (tmp_path / "out").glob("*.yaml")}
    assert sorted(written) == ["left-8-mm-0.yaml", "right-1.yaml"]
    assert "fx: 501.0 px\nfy: 501.0 px\ncx: 321.0 px\ncy: 242.0 px\n" in written["left-8-mm-0.yaml"]
    assert "fx: 502.0 px" in written["right-1.yaml"]


def test_a_pair_of_cameras_has_two_files_once_the_size_is_added(tmp_path: Path, metrocli: Metrocli) -> None:
    one = FILESTORAGE.replace("%YAML:1.0\n", "").replace("camera_matrix", "M{0}").replace("dist_coeff", "D{0}")
    pair = "%YAML:1.0\n" + one.format(1) + one.replace("500.", "600.").format(2)
    ran = imported(tmp_path, pair, "opencv", metrocli)
    assert ran.code == 3 and "add lines `image_width:`" in ran.err
    assert imported(tmp_path, f"{pair}image_width: 640\nimage_height: 480\n", "opencv", metrocli).code == 0
    written = {path.name: lens(path) for path in (tmp_path / "out").glob("*.yaml")}
    assert written == {"camera-1.yaml": LENS, "camera-2.yaml": LENS | {"fx": 600.0}}


def test_photoscan_before_f_is_refused_with_what_to_do(tmp_path: Path, metrocli: Metrocli) -> None:
    text = "<calibration><projection>frame</projection><width>640</width><height>480</height><fx>500</fx><fy>501</fy></calibration>"
    ran = imported(tmp_path, text, "metashape", metrocli)
    assert ran.code == 3 and "fx and fy in place of f" in ran.err and "export it again" in ran.err


def test_a_list_of_coefficients_on_its_line(tmp_path: Path, metrocli: Callable[..., Any]) -> None:
    (tmp_path / "cam.yaml").write_text(
        "image_width: 640\nimage_height: 480\ndistortion_model: plumb_bob\n"
        "distortion_coefficients: [-0.1, 0.02, 0.001, -0.002, 0.0]\n"
        "camera_matrix:\n  rows: 3\n  cols: 3\n  data: [500.0, 0.0, 321.0,\n    0.0, 501.0, 242.0, 0.0, 0.0, 1.0]\n"
    )
    assert metrocli("import", tmp_path / "cam.yaml", "--from", "ros").code == 0
    assert "k1: -0.1" in (tmp_path / "camera.yaml").read_text()


@pytest.mark.parametrize(
    ("text", "known"),
    [
        (CHAIN, "kalibr"),
        (ONE_A_LINE, "opencv"),
        ("# CAMERA_ID, MODEL\n1 SIMPLE_RADIAL 3072 2304 2559.69 1536 1152 -0.02\n", "colmap"),
        ("<?xml version='1.0'?>\n<gama-local>\n<network/>\n</gama-local>\n", "gama-xml"),
        ("# filename x y level\nb.jpg 12 13 0\n", "vnl"),
        ("point;x;y;z\n1 PT 100 200;3;4;5\n", ""),
    ],
)
def test_a_file_of_a_known_program_needs_no_mapping(
    text: str, known: str, tmp_path: Path, metrocli: Callable[..., Any]
) -> None:
    (tmp_path / "file").write_text(text)
    ran = metrocli("import", tmp_path / "file")
    assert ran.code == (2 if known else 0)
    assert f"--from {known}" in ran.err if known else "decimal:" in ran.out
