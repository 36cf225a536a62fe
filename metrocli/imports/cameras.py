"""Cameras of other programs as the YAML file that jobs read: OpenCV's FileStorage, ROS camera_info, COLMAP cameras.txt.

Sources: OpenCV tutorial camera_calibration; ROS REP 104 and sensor_msgs/CameraInfo; COLMAP, Camera Models. All three
have OpenCV's model. COLMAP has the centre of the first pixel at (0.5, 0.5).
"""

from __future__ import annotations

import re

from metrocli.errors import InputError
from metrocli.imports import Imported, Wishes
from metrocli.imports.lines import Lines, is_number

_ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
_NUMBERS = r"data\s*:\s*\[([^\]]*)\]"
_HALF_PIXEL = 0.5
_COLMAP = {"OPENCV": 4, "FULL_OPENCV": 8}
"""Distortion coefficients of COLMAP's models with fx fy cx cy"""
_MODELS = ("plumb_bob", "rational_polynomial", "radtan", "")


def files(lines: Lines, wishes: Wishes) -> Imported:
    """Return camera.yaml; raises InputError for what the file lacks, and for models that are not OpenCV's."""
    text = "\n".join(lines.lines)
    rows = [line.split() for _, line in lines.without("#")]
    row = next((row for row in rows if len(row) > 4 and row[0].isdigit() and row[1].isupper()), None)
    size, intrinsics, shift = _of_colmap(lines, row) if row is not None else _of_yaml(lines, text)
    names = (*("fx", "fy", "cx", "cy"), *_ORDER)
    values = [
        f"{name}: {value}{' px' if i < 4 else ''}"
        for i, (name, value) in enumerate(zip(names, [*intrinsics, *shift], strict=False))
    ]
    head = f"# from {lines.file} (camera)\nimage_size: [{size[0]}, {size[1]}]\n"
    return {"camera.yaml": head + "\n".join([*values, ""])}


def _of_yaml(lines: Lines, text: str) -> tuple[list[str], list[str], list[str]]:
    """Return size, intrinsics and distortion of OpenCV's and ROS' files, with the digits of the file."""
    size = [_after(rf"image_?{side}\s*:\s*([0-9]+)", text, re.IGNORECASE) for side in ("width", "height")]
    matrix = _numbers(rf"(?:camera_matrix|cameraMatrix|Camera_Matrix)\s*:[^\[]*?{_NUMBERS}", text)
    shift = _numbers(rf"dist(?:ortion_coefficients|Coeffs|_coeffs|ortion_Coefficients)\s*:[^\[]*?{_NUMBERS}", text)
    model = _after(r"distortion_model\s*:\s*['\"]?([a-z_]+)", text) or ""
    lacking = [
        what
        for what, there in (
            ("image_width and image_height", all(size)),
            ("camera_matrix with 9 numbers", len(matrix) == 9),
            ("distortion_coefficients", bool(shift)),
        )
        if not there
    ]
    if lacking:
        raise InputError(
            [lines.fault(f"the file lacks {', '.join(lacking)}", None, "expected a camera of OpenCV or ROS")]
        )
    if model not in _MODELS:
        raise InputError([lines.fault(f"the distortion model '{model}' is not OpenCV's", None, "calibrate it here")])
    if len(shift) not in (4, 5, 8, 12):
        raise InputError([lines.fault(f"{len(shift)} distortion coefficients", None, "expected 4, 5, 8 or 12")])
    fx, skew, cx, _, fy, cy = matrix[:6]
    if float(skew):
        raise InputError([lines.fault("the camera matrix has a skew, which OpenCV does not use", None, "set it to 0")])
    return [str(one) for one in size], [fx, fy, cx, cy], shift


def _of_colmap(lines: Lines, row: list[str]) -> tuple[list[str], list[str], list[str]]:
    """Return size, intrinsics and distortion of the first camera of cameras.txt."""
    _, model, width, height, *numbers = row
    if model not in _COLMAP or len(numbers) != 4 + _COLMAP.get(model, 0) or not all(map(is_number, numbers)):
        hint = "expected OPENCV or FULL_OPENCV with all parameters"
        raise InputError([lines.fault(f"the camera has the model {model}", None, hint)])
    fx, fy, cx, cy, *shift = numbers
    return [width, height], [fx, fy, repr(float(cx) - _HALF_PIXEL), repr(float(cy) - _HALF_PIXEL)], shift


def _after(pattern: str, text: str, flags: int = 0) -> str | None:
    found = re.search(pattern, text, flags)
    return found[1] if found else None


def _numbers(pattern: str, text: str) -> list[str]:
    found = re.search(pattern, text, re.DOTALL)
    parts = [part.strip().rstrip(".") for part in found[1].split(",")] if found else []
    return parts if all(map(is_number, parts)) else []
