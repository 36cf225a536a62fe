"""Every format of cameras with faults anywhere in its text: refused with file and field, and never another camera."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from imports import camera_texts as texts

from metrocli.errors import InputError
from metrocli.imports import ImportOptions
from metrocli.imports.cameras import files
from metrocli.imports.lines import TextLines

Metrocli = Callable[..., Any]
_SIZE = "image_width: 640\nimage_height: 480\n"
_ONE = texts.FILESTORAGE.replace("%YAML:1.0\n", "").replace("camera_matrix", "M{0}").replace("dist_coeff", "D{0}")
FORMATS = {
    "OpenCV": texts.FILESTORAGE + _SIZE,
    "OpenCV, fisheye": f"{texts.FILESTORAGE}fisheye_model: 1\n{_SIZE}",
    "OpenCV, XML": texts.STORAGE,
    "OpenCV, pair": f"%YAML:1.0\n{_ONE.format(1)}{_ONE.replace('500.', '600.').format(2)}{_SIZE}",
    "ROS, message": texts.MESSAGE,
    "ROS, camera_info": texts.ONE_A_LINE,
    "ROS, in braces": texts.IN_BRACES,
    "ROS, oST": texts.OST,
    "camodocal": texts.CAMODOCAL,
    "camodocal, Kannala-Brandt": texts.KANNALA,
    "ORB-SLAM": texts.ORB,
    "ORB-SLAM, pair": texts.TWO_EYES,
    "Kalibr": texts.CHAIN,
    "EuRoC": texts.SENSOR,
    "COLMAP": texts.COLMAP,
    "mrcal": texts.MRCAL,
    "Metashape": texts.CALIBRATION,
    "Metashape, document": texts.DOCUMENT,
    "MATLAB": texts.MATLAB,
    "Toolbox": texts.TOOLBOX,
}
NO_NUMBERS = ("abc", "nan", "inf", ".nan", ".inf", "1e999", "", "12abc", "1.2.3", "0x10", "--1", "-", "'")
"""In place of a number"""
ABSENT = {
    "OpenCV, fisheye": r"fisheye_model",  # OpenCV writes it for fisheyes only
    "Metashape": r"<(cx|cy|k1|k2|p1|p2)>",  # Metashape writes only what is not 0
    "MATLAB": r"RadialDistortion",  # arguments by name are 0 where they are not given
}
"""Lines whose absence is not a fault"""
OPEN = {"camodocal", "camodocal, Kannala-Brandt", "COLMAP"}
"""Formats that nothing closes: a cut within the digits of the last number is not seen"""

Cameras = list[str] | str


def read(text: str) -> Cameras:
    """Return each camera without its name and origin, or how the file is refused."""
    try:
        found = files(TextLines("their.txt", text.splitlines()), ImportOptions())
    except InputError as refused:
        assert refused.faults and all(fault.file == "their.txt" for fault in refused.faults)
        return "\n".join(map(str, refused.faults))
    return [re.sub(r"^(?:#|program:).*\n", "", held, flags=re.MULTILINE) for held in found.values()]


def numbers(text: str) -> Iterator[re.Match[str]]:
    """Yield the numbers of a text on which the cameras depend."""
    whole = read(text)
    for match in re.finditer(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.])", text):
        other = str(float(match[0]) + 0.001) if not match[0].isdecimal() else str(int(match[0]) + 1)
        found = read(put(text, match, other))
        if found != whole and not isinstance(found, str):
            yield match


def put(text: str, match: re.Match[str], other: str) -> str:
    return text[: match.start()] + other + text[match.end() :]


@pytest.mark.parametrize("text", FORMATS.values(), ids=FORMATS)
@pytest.mark.parametrize(
    "other", [pytest.param(one, marks=() if one == "nan" else pytest.mark.slow) for one in NO_NUMBERS]
)
def test_what_is_no_number_is_never_a_camera(text: str, other: str) -> None:
    whole, wrong = read(text), list(numbers(text))
    assert isinstance(whole, list) and len(wrong) >= 3
    for match in wrong:
        found = read(put(text, match, other))
        # a list that ends with a comma, and rows and cols, say nothing else than what stands before
        assert isinstance(found, str) or found == whole, f"{match[0]} as {other!r}: {found}"


@pytest.mark.parametrize("name", FORMATS)
def test_a_line_that_is_missing_or_twice_is_never_another_camera(name: str) -> None:
    whole, rows = read(FORMATS[name]), FORMATS[name].splitlines(keepends=True)
    for at, row in enumerate(rows):
        for some in (rows[:at] + rows[at + 1 :], rows[: at + 1] + rows[at:]):
            found = read("".join(some))
            if name in ABSENT and re.search(ABSENT[name], row):
                continue
            fewer = name == "COLMAP" and len(found) == 1
            assert isinstance(found, str) or found == whole or fewer, row


@pytest.mark.parametrize("name", FORMATS)
def test_a_file_that_ends_too_early_is_never_another_camera(name: str) -> None:
    text = FORMATS[name]
    whole, digits = read(text), list(numbers(text))
    assert isinstance(whole, list)
    for end in range(len(text)):
        found = read(text[:end])
        if name in OPEN and any(match.start() < end < match.end() for match in digits):
            continue
        # a list of cameras may have fewer
        assert isinstance(found, str) or found == whole or (found == whole[:1] and len(whole) > 1), text[:end]


_FOCAL = ("0", "-500", "3.5")
FIELDS = {
    "OpenCV": {"fx": "500.", "fy": "501.", "cx": "321.", "cy": "242.", "image width": "640", "image height": "480"},
    "OpenCV, XML": {"fx": "500.", "fy": "501.", "image width": "640", "image height": "480"},
    "ROS, message": {"fx": "500.0", "fy": "501.0", "image width": "640", "image height": "480"},
    "ROS, camera_info": {"fx": "500.0", "fy": "501.0", "image width": "640", "image height": "480"},
    "ROS, oST": {"fx": "500.0", "fy": "501.0", "image width": "640", "image height": "480"},
    "camodocal": {"fx": "500.0", "fy": "501.0", "image width": "640", "image height": "480"},
    "camodocal, Kannala-Brandt": {"fx": "280.0", "fy": "281.0", "image width": "640", "image height": "480"},
    "ORB-SLAM": {"fx": "500.0", "fy": "501.0", "image width": "640", "image height": "480"},
    "Kalibr": {"fx": "500.0", "fy": "501.0", "image width": "640", "image height": "480"},
    "EuRoC": {"fx": "500.0", "fy": "501.0", "image width": "640", "image height": "480"},
    "COLMAP": {"fx": "500", "fy": "501", "image width": "640", "image height": "480"},
    "mrcal": {"fx": "500", "fy": "501", "image width": "640", "image height": "480"},
    "Metashape": {"fx": "501", "image width": "640", "image height": "480"},
    "MATLAB": {"fx": "500.0", "fy": "501.0", "image width": "640", "image height": "480"},
    "Toolbox": {"fx": "500.0", "fy": "501.0", "image width": "640", "image height": "480"},
}
"""The text of fields by their names here"""


@pytest.mark.parametrize("name", FIELDS)
def test_values_that_no_camera_has_are_refused_by_their_field(name: str) -> None:
    for field, held in FIELDS[name].items():
        wrong = ("0", "-640", "640.5") if "image" in field else ("nonsense", *_FOCAL)
        for other in wrong:
            text = re.sub(rf"(?<![\w.]){re.escape(held)}(?![\w])", other, FORMATS[name], count=1)
            refused = read(text)
            assert isinstance(refused, str) and (field in refused or f"'{other}'" in refused), (
                f"{other} as {field}: {refused}"
            )


LACKING = {
    "OpenCV": ("camera_matrix", "dist_coeff", "image_width", "image_height"),
    "OpenCV, XML": ("Camera_Matrix", "Distortion_Coefficients", "image_Width", "image_Height"),
    "ROS, message": ("K", "D", "width", "height"),
    "ROS, camera_info": ("camera_matrix", "distortion_coefficients", "image_width", "image_height"),
    "ROS, oST": ("camera matrix", "distortion", "width", "height"),
    "camodocal": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "image_width", "image_height"),
    "camodocal, Kannala-Brandt": ("mu", "mv", "u0", "v0", "k2", "k3", "k4", "k5", "image_width", "image_height"),
    "ORB-SLAM": tuple(f"Camera.{name}" for name in ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "width", "height")),
    "Kalibr": ("camera_model", "distortion_coeffs", "distortion_model", "intrinsics", "resolution"),
    "EuRoC": ("camera_model", "distortion_coefficients", "distortion_model", "intrinsics", "resolution"),
    "mrcal": ("lensmodel", "intrinsics", "imagersize"),
    "Metashape": ("projection", "width", "height", "f"),
    "Toolbox": ("fc", "cc", "kc", "nx", "ny"),
}
SAID = {"dist_coeff": "distortion_coefficients", "K": "camera_matrix", "D": "distortion_coefficients"}
"""How a field is called, where its key has several spellings"""


@pytest.mark.parametrize(("name", "field"), [(name, field) for name, fields in LACKING.items() for field in fields])
def test_a_field_that_is_missing_is_named(name: str, field: str) -> None:
    refused = read(re.sub(rf"(?<![\w.]){re.escape(field)}(?![\w.])", "other", FORMATS[name]))
    said = SAID.get(field, field.lower().removeprefix("camera.")).replace("distortion_coeffs", "distortion coeff")
    assert isinstance(refused, str) and re.search(said.removeprefix("image_").replace("_", "[_ ]"), refused.lower()), (
        refused
    )


@pytest.mark.parametrize("name", ["OpenCV", "ROS, message", "Kalibr", "mrcal", "Metashape", "COLMAP", "MATLAB"])
def test_coefficients_of_another_number_are_refused(name: str) -> None:
    more = {
        "OpenCV": ("-2.0e-03 ]", "-2.0e-03, 0., 0. ]"), "ROS, message": ("0.0]\nK", "0.0, 0.0]\nK"), "MATLAB": (", 0.02]", "]"),
        "Kalibr": ("-0.002]", "-0.002, 0.0]"), "mrcal": (", 321", ""), "COLMAP": (" -0.002", ""), "Metashape": ("frame", "spherical"),
    }[name]  # fmt: skip
    refused = read(FORMATS[name].replace(*more))
    assert isinstance(refused, str) and re.search("has [0-9]|numbers|coefficients|model", refused), refused


def test_a_matrix_by_columns_is_refused() -> None:
    matrix = "500., 0., 321., 0., 501., 242., 0., 0., 1."
    refused = read(FORMATS["OpenCV"].replace(matrix, "500., 0., 0., 0., 501., 0., 321., 242., 1."))
    assert isinstance(refused, str) and "camera_matrix is 500, 0, 0" in refused and "row by row" in refused


def test_a_model_that_a_file_of_ros_lacks_is_not_guessed() -> None:
    other = texts.ONE_A_LINE.replace("distortion_model: plumb_bob\n", "camera_name: left\n")
    assert "the file lacks distortion_model" in read(other)


@pytest.mark.parametrize("name", FORMATS)
def test_the_command_line_refuses_with_the_line(name: str, tmp_path: Path, metrocli: Metrocli) -> None:
    match = list(numbers(FORMATS[name]))[-1]
    (tmp_path / "their.yaml").write_text(put(FORMATS[name], match, "nonsense"))
    ran = metrocli("import", tmp_path / "their.yaml", "--from", "ros", "--out", tmp_path / "out")
    assert ran.code == 3 and not (tmp_path / "out").exists()
    assert "nonsense" in ran.err or "lacks" in ran.err or "rows" in ran.err, ran.err


def test_an_argument_of_matlab_that_is_not_known_is_refused() -> None:
    assert "cameraIntrinsics has no Skw" in read(texts.MATLAB.replace("'Tangential", "'Skw', 0.5, 'Tangential"))


def test_the_turn_of_one_of_two_cameras_of_opencv_is_none_of_ros() -> None:
    turn = "R: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]\n"
    assert read(FORMATS["OpenCV"] + turn) == read(FORMATS["OpenCV"])
