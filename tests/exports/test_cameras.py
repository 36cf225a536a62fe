"""Cameras of other programs: what each reads projects as the result does, and what cannot is refused or stated."""

from __future__ import annotations

import ast
import json
import re
import subprocess
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from benchmarks.beside.environments import python_with
from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.exports import export
from metrocli.imports import ImportOptions, imported
from metrocli.imports.cameras import as_yaml
from metrocli.imports.lines import TextLines
from metrocli.instruments.lenses.distortion import PRISM, RATIONAL, TANGENTIAL
from metrocli.instruments.lenses.lens import Lens, equidistant, image_point
from metrocli.result import Result
from metrocli.table import Table

Metrocli = Callable[..., Any]
SIZE = (1280, 960)
PLAIN = {"f": 1100.0, "cx": 650.25, "cy": 470.5}
USUAL = {"fx": 1100.0, "fy": 1102.0, "cx": 650.25, "cy": 470.5, "k1": -0.21, "k2": 0.09, "p1": 4e-4, "p2": -3e-4}
RICH = {**USUAL, "k3": 0.01, "k4": 0.02, "k5": -0.01, "k6": 0.005}
FISHEYE = {"f": 390.0, "cx": 641.0, "cy": 482.0, "k1": -0.03, "k2": 4e-3, "k3": -8e-4, "k4": 5e-5}
LENSES = {
    "plain": PLAIN,
    "one radial": {**PLAIN, "k1": -0.2},
    "two radial": {**PLAIN, "k1": -0.2, "k2": 0.05},
    "usual": USUAL,
    "k3": {**USUAL, "k3": -0.04},
    "rational": RICH,
    "prism": {**RICH, "s1": 1e-3, "s2": -2e-4, "s3": 5e-4, "s4": 1e-4},
    "tilted": {**USUAL, "s1": 1e-3, "tau_x": 0.01, "tau_y": -0.02},
    "skewed": {**USUAL, "skew": 2e-3},
    "fisheye": FISHEYE,
    "fisheye, one radial": {"f": 390.0, "cx": 641.0, "cy": 482.0, "k1": -0.03},
    "fisheye, decentred": {**FISHEYE, "p1": 2e-4, "p2": -1e-4, "s1": 3e-4, "s3": 1e-4},
    "fisheye, skewed": {**FISHEYE, "skew": 1e-3},
}
HELD = {
    "opencv": {"plain", "one radial", "two radial", "usual", "k3", "rational", "prism", "tilted", "fisheye", "fisheye, one radial", "fisheye, skewed"},
    "ros": {"plain", "one radial", "two radial", "usual", "k3", "rational", "fisheye", "fisheye, one radial"},
    "colmap": {"plain", "one radial", "two radial", "usual", "k3", "rational", "fisheye", "fisheye, one radial", "fisheye, decentred"},
    "kalibr": {"plain", "one radial", "two radial", "usual", "fisheye", "fisheye, one radial"},
    "mrcal": {"plain", "one radial", "two radial", "usual", "k3", "rational", "prism"},
    "metashape": {"plain", "one radial", "two radial", "usual", "k3", "skewed", "fisheye", "fisheye, one radial", "fisheye, skewed"},
    "matlab": {"plain", "one radial", "two radial", "usual", "k3", "skewed"},
}  # fmt: skip
"""The lenses that a program has exactly"""
CASES = [(program, lens) for program, lenses in HELD.items() for lens in sorted(lenses)]


def result(lens: Mapping[str, float], convention: str) -> Result:
    table = Table.of({"parameter": list(lens), "value": list(lens.values())})
    statistics = {"image_width": float(SIZE[0]), "image_height": float(SIZE[1]), "convention": convention}
    return Result("calibrate-camera", "", (), np.zeros((0, 0)), statistics, {"camera": table})


def convention_of(name: str) -> str:
    return "fisheye" if "fisheye" in name else "forward"


def written(program: str, name: str, within: float = 0.05) -> str:
    (text,) = export(program, result(LENSES[name], convention_of(name)), within=within).values()
    return str(text)


def points(name: str, count: int = 1000) -> Array:
    """Points that are seen all over the image, (count, 3); of a fisheye up to 75 degrees off its axis."""
    rng = np.random.default_rng(len(name))
    across = rng.uniform(-1, 1, (count, 2)) * (3.0 if "fisheye" in name else [0.55, 0.42])
    return np.column_stack([across, np.ones(count)]) * rng.uniform(0.5, 3.0, (count, 1))


def ours(name: str, seen: Array) -> Array:
    x, y = (seen / seen[:, 2:])[:, :2].T
    if "fisheye" in name:
        flat = equidistant(seen.T)
        x, y = flat.x, flat.y
    return np.stack(image_point(LENSES[name], x, y, "fisheye" in name), axis=1)


def of_opencv(matrix: Array, shift: Array, seen: Array, fisheye: bool) -> Array:
    still = np.zeros(3)
    if not fisheye:
        return cv2.projectPoints(seen, still, still, matrix, shift)[0][:, 0]
    skew = matrix[0, 1] / matrix[0, 0]
    return cv2.fisheye.projectPoints(seen[:, None], still, still, matrix, shift, alpha=skew)[0][:, 0]


def square(fx: float, fy: float, cx: float, cy: float) -> Array:
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def read_opencv(text: str, seen: Array) -> Array:
    stored = cv2.FileStorage(text, cv2.FILE_STORAGE_READ + cv2.FILE_STORAGE_MEMORY)
    matrix, shift = stored.getNode("camera_matrix").mat(), stored.getNode("distortion_coefficients").mat()
    return of_opencv(matrix, shift, seen, stored.getNode("fisheye_model").real() == 1)


def read_ros(text: str, seen: Array) -> Array:
    held = yaml.safe_load(text)
    shift = np.array(held["distortion_coefficients"]["data"])
    return of_opencv(
        np.reshape(held["camera_matrix"]["data"], (3, 3)), shift, seen, held["distortion_model"] == "equidistant"
    )


def read_kalibr(text: str, seen: Array) -> Array:
    held = yaml.safe_load(text)["cam0"]
    shift = np.array(held["distortion_coeffs"] or [0.0] * 4)
    return of_opencv(square(*held["intrinsics"]), shift, seen, held["distortion_model"] == "equidistant")


def read_mrcal(text: str, seen: Array) -> Array:
    held = ast.literal_eval("\n".join(line for line in text.splitlines() if line[0] != "#"))
    count = int(re.sub(r"[^0-9]", "", held["lensmodel"]) or 0)
    assert len(held["intrinsics"]) == 4 + count
    return of_opencv(square(*held["intrinsics"][:4]), np.array(held["intrinsics"][4:] or [0.0] * 4), seen, False)


def read_colmap(text: str, seen: Array) -> Array:
    """The formulas of COLMAP's page Camera Models; pixel centres are at 0.5."""
    (row,) = (line.split() for line in text.splitlines() if line[0] != "#")
    name, values = row[1], list(map(float, row[4:]))
    u, v = (seen / seen[:, 2:])[:, :2].T
    if "FISHEYE" in name:
        r = np.hypot(u, v)
        u, v = u * np.arctan(r) / r, v * np.arctan(r) / r
    single = name.startswith("SIMPLE") or name.startswith("RADIAL")
    fx, fy, cx, cy, *k = values[:1] * 2 + values[1:] if single else values
    r2 = u * u + v * v
    p1 = p2 = sx = sy = 0.0
    if name in ("SIMPLE_RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL", "RADIAL_FISHEYE", "OPENCV_FISHEYE"):
        radial = 1 + sum(one * r2 ** (i + 1) for i, one in enumerate(k))
    elif name in ("OPENCV", "FULL_OPENCV"):
        k1, k2, p1, p2, k3, k4, k5, k6 = [*k, 0.0, 0.0, 0.0, 0.0][:8]
        radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    elif name == "THIN_PRISM_FISHEYE":
        k1, k2, p1, p2, k3, k4, sx, sy = k
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3 + k4 * r2**4
    else:
        assert name in ("PINHOLE", "SIMPLE_PINHOLE")
        radial = np.ones_like(r2)
    x = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u) + sx * r2
    y = v * radial + 2 * p2 * u * v + p1 * (r2 + 2 * v * v) + sy * r2
    return np.stack([fx * x + cx - 0.5, fy * y + cy - 0.5], axis=1)


def read_metashape(text: str, seen: Array) -> Array:
    """The formulas of the manual, appendix Camera models; (0, 0) is the corner of the first pixel."""
    held = {one.tag: one.text or "" for one in ElementTree.fromstring(text)}
    number = {name: float(value) for name, value in held.items() if name != "projection"}
    x, y = (seen / seen[:, 2:])[:, :2].T
    if held["projection"] == "fisheye":
        r = np.hypot(x, y)
        x, y = x * np.arctan(r) / r, y * np.arctan(r) / r
    r2 = x * x + y * y
    radial = 1 + number["k1"] * r2 + number["k2"] * r2**2 + number["k3"] * r2**3 + number["k4"] * r2**4
    xd = x * radial + number["p1"] * (r2 + 2 * x * x) + 2 * number["p2"] * x * y
    yd = y * radial + number["p2"] * (r2 + 2 * y * y) + 2 * number["p1"] * x * y
    u = number["width"] / 2 + number["cx"] + xd * number["f"] + xd * number["b1"] + yd * number["b2"]
    v = number["height"] / 2 + number["cy"] + yd * number["f"]
    return np.stack([u, v], axis=1) - 0.5


def read_matlab(text: str, seen: Array) -> Array:
    """Positional and named arguments of cameraIntrinsics; the first pixel is (1, 1)."""
    (fx, fy), (cx, cy), size, radial, (p1, p2) = (
        [float(one) for one in part.split(",")] for part in re.findall(r"\[([^\]]*)\]", text)
    )
    skew = float(re.findall(r"'Skew', ([^)]*)\)", text)[0])
    assert size == [SIZE[1], SIZE[0]]
    shift = np.array([*radial[:2], p1, p2, radial[2]])
    flat = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), np.eye(3), shift)[0][:, 0]
    return np.stack([fx * flat[:, 0] + skew * flat[:, 1] + cx, fy * flat[:, 1] + cy], axis=1) - 1


READERS = {name.removeprefix("read_"): one for name, one in list(globals().items()) if name.startswith("read_")}


@pytest.mark.parametrize(("program", "name"), CASES)
def test_what_is_written_projects_as_the_result_does(program: str, name: str) -> None:
    seen = points(name)
    assert np.abs(READERS[program](written(program, name), seen) - ours(name, seen)).max() < 1e-9


def values_of(text: str) -> dict[str, float]:
    return {
        key: float(value.split()[0])
        for key, _, value in (line.partition(": ") for line in text.splitlines())
        if key in (*PLAIN, "fx", "fy", "skew", "k1", "k2", "k3", "tau_x", "tau_y", *RATIONAL, *TANGENTIAL, *PRISM)
    }


@pytest.mark.parametrize(("program", "name"), CASES)
def test_what_is_written_is_read_back(program: str, name: str) -> None:
    text = as_yaml(TextLines("camera", written(program, name).splitlines()))
    assert text is not None and f"image_size: [{SIZE[0]}, {SIZE[1]}]" in text
    assert f"model: {'fisheye' if 'fisheye' in name else 'opencv'}" in text
    seen = points(name, 50)
    flat = equidistant(seen.T) if "fisheye" in name else None
    x, y = (flat.x, flat.y) if flat is not None else (seen / seen[:, 2:])[:, :2].T
    found = np.stack(image_point(values_of(text), x, y, flat is not None), axis=1)
    assert np.abs(found - ours(name, seen)).max() < 1e-9


def test_pycolmap_projects_as_the_result_does() -> None:
    pycolmap = pytest.importorskip("pycolmap")
    for name in sorted(HELD["colmap"]):
        (row,) = (line.split() for line in written("colmap", name).splitlines() if line[0] != "#")
        camera = pycolmap.Camera(model=row[1], width=SIZE[0], height=SIZE[1], params=list(map(float, row[4:])))
        seen = points(name)
        assert np.abs(camera.img_from_cam(seen) - 0.5 - ours(name, seen)).max() < 1e-9


MRCAL_PROJECTS = """
import json, sys, mrcal, numpy
models = [(mrcal.cameramodel(file), numpy.array(points)) for file, points in json.load(sys.stdin)]
print(json.dumps([mrcal.project(points, *model.intrinsics()).tolist() for model, points in models]))
"""


def mrcal_projects(folder: Path, names: Iterable[str]) -> dict[str, tuple[Path, Array]]:
    """The files of some lenses, and the image points that mrcal gives with them; one process for all, for its imports."""
    python = python_with("mrcal")
    if python is None:
        pytest.skip("no Python of this machine has mrcal (Debian: python3-mrcal)")
    files = {name: folder / f"{name.replace(' ', '-')}.cameramodel" for name in names}
    for name, file in files.items():
        file.write_text(written("mrcal", name))
    work = json.dumps([(str(file), points(name).tolist()) for name, file in files.items()])
    done = subprocess.run([python, "-c", MRCAL_PROJECTS], input=work, capture_output=True, text=True, check=True)
    return dict(zip(files, zip(files.values(), map(np.array, json.loads(done.stdout)), strict=True), strict=True))


def test_mrcal_projects_as_the_result_does(tmp_path: Path) -> None:
    for name, (_, found) in mrcal_projects(tmp_path, sorted(HELD["mrcal"])).items():
        assert np.abs(found - ours(name, points(name))).max() < 1e-9


@pytest.mark.parametrize(
    ("program", "name", "model"),
    [
        ("colmap", "plain", "SIMPLE_PINHOLE"),
        ("colmap", "one radial", "SIMPLE_RADIAL"),
        ("colmap", "usual", "OPENCV"),
        ("colmap", "fisheye", "OPENCV_FISHEYE"),
        ("ros", "rational", "rational_polynomial"),
        ("ros", "fisheye", "equidistant"),
        ("mrcal", "k3", "LENSMODEL_OPENCV5"),
    ],
)
def test_the_model_with_the_fewest_parameters_is_taken(program: str, name: str, model: str) -> None:
    assert re.search(rf"\b{model}\b", written(program, name))


def stated(text: str) -> tuple[float, float]:
    rms, largest = re.findall(r"note: .*rms ([0-9.e-]+) px, largest difference ([0-9.e-]+) px", text)[0]
    return float(rms), float(largest)


@pytest.mark.parametrize(("program", "name", "within"), [("kalibr", "k3", 2.0), ("ros", "tilted", 20.0)])
def test_the_nearest_model_differs_as_stated(program: str, name: str, within: float) -> None:
    text = written(program, name, within)
    u, v = np.meshgrid(np.linspace(0, SIZE[0] - 1, 60), np.linspace(0, SIZE[1] - 1, 60))
    lens, (fx, cx, cy) = LENSES[name], (1100.0, 650.25, 470.5)
    x, y = (u.ravel() - cx) / fx, (v.ravel() - cy) / fx
    for _ in range(60):  # the direction of each pixel, by plain iteration
        a, b = image_point(lens, x, y)
        x, y = x + (u.ravel() - a) / fx, y + (v.ravel() - b) / fx
    distance = np.hypot(
        *(READERS[program](text, np.stack([x, y, np.ones_like(x)], axis=1)) - np.stack([u.ravel(), v.ravel()], 1)).T
    )
    rms, largest = stated(text)
    assert distance.max() == pytest.approx(largest, rel=0.1) and largest > 0.05
    assert np.sqrt((distance**2).mean()) == pytest.approx(rms, rel=0.1)


def test_what_no_model_holds_is_refused_with_its_difference() -> None:
    with pytest.raises(InputError, match=r"no model of kalibr is within 0.05 px of this lens; the nearest is \w+: rms"):
        written("kalibr", "rational")
    with pytest.raises(InputError, match="not a camera"):
        export("ros", Result("multilaterate", "", (), np.zeros((0, 0)), {}))


def test_a_lens_that_folds_over_is_exported_with_its_radius() -> None:
    (text,) = export("opencv", result({**PLAIN, "k1": -0.6}, "forward")).values()
    assert "note: beyond 547 px from its principal point the lens folds over" in str(text)
    assert "note" not in written("opencv", "usual")


def test_a_backward_lens_is_approached() -> None:
    lens = {**PLAIN, "k1": 0.03, "p1": 1e-4}
    (text,) = export("opencv", result(lens, "backward"), within=0.05).values()
    assert stated(str(text))[1] <= 0.05


GOOD_COLMAP = "1 OPENCV 640 480 500 500 320 240 0.1 0 0 0\n"
KALIBR = "cam0:\n  camera_model: {}\n  intrinsics: [500, 500, 320, 240]\n  distortion_model: radtan\n"
MRCAL = "{{ 'lensmodel': '{}', 'intrinsics': [ {} ], 'imagersize': [ 640, 480 ] }}\n"
METASHAPE = "<calibration><projection>{}</projection><width>640</width><height>480</height>{}</calibration>\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1 FOV 640 480 500 320 240 0.1\n", "the model FOV of colmap is not known here"),
        ("1 OPENCV 640 480 500 320 240 0.1\n", "4 parameters"),
        (GOOD_COLMAP * 2, "camera 1 stands twice"),
        (GOOD_COLMAP.replace("500 500", "6.1 6.1"), "fx = 6.1 is not a focal length in pixels"),
        (GOOD_COLMAP.replace("320", "0.5"), "is not a principal point in pixels"),
        (GOOD_COLMAP.replace("0.1", "nan"), "not a number: k1 = 'nan'"),
        ("image_width: 640\nimage_height: 480\n", "the file lacks camera_matrix with 9 numbers, distortion_coeff"),
        ("image_width: 640\ncamera_matrix:\n  data: [1]\n", "the file lacks image_height, camera_matrix"),
        (KALIBR.format("pinhole"), "the file lacks resolution"),
        (KALIBR.format("omni") + "  resolution: [640, 480]\n", "the model omni of kalibr is not known here"),
        (KALIBR.format("pinhole") + "  resolution: [640, 480]\n", "0 distortion coefficients of the model radtan"),
        (MRCAL.format("LENSMODEL_CAHVOR", "500, 500, 320, 240"), "LENSMODEL_CAHVOR of mrcal is not known"),
        (MRCAL.format("LENSMODEL_OPENCV4", "500, 500, 320, 240"), "has 4 intrinsics"),
        (METASHAPE.format("frame", ""), "the file lacks f"),
        (METASHAPE.format("frame", "<f>500</f><k4>0.1</k4>"), "the model frame here has no k4"),
        (METASHAPE.format("spherical", "<f>500</f>"), "the model spherical of metashape is not known"),
        ("<calibration><f>500</calibration>\n", "this is not XML"),
        ("x = cameraIntrinsics(f, c, s)\n", "the file lacks focalLength"),
        ("nothing of a camera\n", "this is not a camera of another program"),
    ],
)
def test_what_is_missing_or_in_other_units_is_refused(text: str, words: str) -> None:
    with pytest.raises(InputError, match=re.escape(words)) as refused:
        imported("colmap", TextLines("camera.txt", text.splitlines()), ImportOptions())
    assert all(fault.file == "camera.txt" for fault in refused.value.faults)


def test_a_lens_sees_beyond_ninety_degrees() -> None:
    """COLMAP's OPENCV_FISHEYE by atan2, at 110 degrees off axis."""
    angle = np.radians(110)
    seen = np.array([[np.sin(angle)], [0.0], [np.cos(angle)]])
    radius = angle * (1 + sum(FISHEYE[f"k{i}"] * angle ** (2 * i) for i in (1, 2, 3, 4)))
    flat = equidistant(seen)
    u, v = image_point(FISHEYE, flat.x, flat.y, fisheye=True)
    assert Lens(fisheye=True).fisheye and (u[0], v[0]) == pytest.approx((641.0 + 390.0 * radius, 482.0))


NAMES, TURN, SHIFT = ("left", "right"), Rotation.from_euler("xyz", [0.02, -0.1, 0.3]), np.array([95.0, -4.0, 12.0])
"""Pose of the right camera in the frame of the left one: `X_left = R X_right + d`, mm"""


def several(lens: Mapping[str, float] = USUAL) -> Result:
    rows = [(name, key, value) for name in NAMES for key, value in lens.items()]
    camera, parameter, value = zip(*rows, strict=True)
    place = np.stack([np.zeros(6), [*SHIFT, *TURN.as_euler("xyz")]])
    sizes = {"image_width": [float(SIZE[0])] * 2, "image_height": [float(SIZE[1])] * 2}
    cameras = Table.of({"camera": NAMES, **sizes, "x y z [mm]": place[:, :3], "alpha beta gamma [rad]": place[:, 3:]})
    tables = {"camera": Table.of({"camera": camera, "parameter": parameter, "value": value}), "cameras": cameras}
    return Result("calibrate-camera", "", (), np.zeros((0, 0)), {"convention": "forward"}, tables)


def posed(program: str) -> tuple[Array, Array]:
    """Rotation and shift [mm] from the left to the right camera, as the program reads its file."""
    files = {name: str(text) for name, text in export(program, several()).items()}
    if program == "opencv":
        stored = cv2.FileStorage(files["right.yml"], cv2.FILE_STORAGE_READ + cv2.FILE_STORAGE_MEMORY)
        return stored.getNode("R").mat(), stored.getNode("T").mat()[:, 0]
    if program == "kalibr":
        step = np.array(yaml.safe_load(files["camchain.yaml"])["cam1"]["T_cn_cnm1"])
        return step[:3, :3], 1000 * step[:3, 3]
    if program == "mrcal":
        text = "\n".join(line for line in files["right.cameramodel"].splitlines() if line[0] != "#")
        place = np.array(ast.literal_eval(text)["extrinsics"])
        return Rotation.from_rotvec(place[:3]).as_matrix(), 1000 * place[3:]
    row = files["rigs.txt"].splitlines()[-1].split()
    assert row[:8] == ["1", "2", "CAMERA", "1", "CAMERA", "2", "1"] + row[7:8]
    w, *numbers = map(float, row[7:])
    return Rotation.from_quat([*numbers[:3], w]).as_matrix(), np.array(numbers[3:])


@pytest.mark.parametrize("program", ["opencv", "kalibr", "mrcal", "colmap"])
def test_where_several_cameras_are_stands_in_their_files(program: str) -> None:
    turn, shift = posed(program)
    assert turn == pytest.approx(TURN.inv().as_matrix(), abs=1e-12)
    assert shift == pytest.approx(-TURN.inv().apply(SHIFT), abs=1e-9)


def test_a_camera_of_several_is_refused_by_its_name() -> None:
    with pytest.raises(InputError) as refused:
        export("kalibr", several(lens=LENSES["rational"]))
    assert str(refused.value).startswith("error: camera left: no model of kalibr")
    assert str(refused.value).count("error:") == 1


@pytest.mark.parametrize("program", ["ros", "metashape", "matlab"])
def test_a_format_without_poses_says_so(program: str) -> None:
    left, right = map(str, export(program, several()).values())
    assert "the pose of right beside left is not in this format" in right and "pose" not in left
