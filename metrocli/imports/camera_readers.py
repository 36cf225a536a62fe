"""Readers of cameras: what the files of each program have, as the values of a lens model.

Sources: OpenCV tutorial camera_calibration; ROS REP 104 and sensor_msgs/CameraInfo; COLMAP, Camera Models; Kalibr, YAML
formats; mrcal, Camera model representation; Metashape manual, Camera models; MATLAB, cameraIntrinsics; Bouguet, Camera
Calibration Toolbox for MATLAB.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from metrocli.errors import InputError
from metrocli.imports.camera_fields import (
    LIST,
    ReadCamera,
    by_name,
    camera_of,
    form_of,
    must_have,
    numbers_after,
    parsed_xml,
    text_after,
)
from metrocli.imports.lines import TextLines, is_number
from metrocli.instruments.lenses.forms import PROGRAMS


def _of_opencv(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of OpenCV's FileStorage or of ROS, which share their keys."""
    # a message of ROS (CameraInfo) has the keys height, width, D, K; those of its region are indented
    extent, anywhere = r"(?:image_?{0}|^{0})\s*:\s*([0-9]+)", re.IGNORECASE | re.MULTILINE
    size = [text_after(extent.format(side), text, anywhere) for side in ("width", "height")]
    matrix = numbers_after(rf"(?i:camera_?matrix)\s*:[^\[]{{0,200}}?data\s*:\s*{LIST}|^[Kk]\s*:\s*{LIST}", text)
    shift = numbers_after(
        rf"(?i:dist(?:ortion)?_?(?:coefficients|coeffs?))\s*:(?:[^\[]{{0,200}}?data\s*:)?\s*{LIST}|^[Dd]\s*:\s*{LIST}",
        text,
    )
    fields = {"camera_matrix with 9 numbers": len(matrix) == 9, "distortion_coefficients": shift}
    sizes = {"image_width": size[0], "image_height": size[1]}
    if all(fields.values()) and None in size:
        hint = "add lines `image_width:` and `image_height:` with the size of its images in pixels"
        lacking = ", ".join(name for name, value in sizes.items() if value is None)
        raise InputError([lines.fault(f"the file lacks {lacking}", None, hint)])
    must_have(lines, "OpenCV or ROS", {**sizes, **fields})
    model = text_after(r"distortion_model\s*:\s*['\"]?([a-z_]+)", text)
    fisheye = text_after(r"fisheye_model\s*:\s*([01])", text) == "1"
    if model is None:
        program, form = "opencv", form_of(lines, "opencv", "fisheye" if fisheye else "opencv", len(shift))
    else:
        program = "ros"
        form = form_of(lines, "ros", model)
        if form.name == "plumb_bob" and len(shift) == 4:
            shift.append("0")
        form = form_of(lines, "ros", model, len(shift))
    fx, skew, cx, _, fy, cy = matrix[:6]
    values = dict(zip(("fx", "fy", "cx", "cy"), (fx, fy, cx, cy), strict=True))
    if float(skew) and "skew" not in form.terms:
        raise InputError([lines.fault("the camera matrix has a skew, which OpenCV does not use", None, "set it to 0")])
    if float(skew):
        values["skew"] = repr(float(skew) / float(fx))
    return camera_of(lines, program, form, [str(name) for name in size], {**values, **by_name(form, shift)})


def _of_storage(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of OpenCV's FileStorage as XML, which has the keys of its YAML."""
    root = parsed_xml(lines, text)
    held = ((entry.tag, entry.find("data"), entry.text) for entry in root)
    rows = [
        f"{tag}: {(alone or '').strip()}"
        if data is None
        else f"{tag}:\n  data: [{', '.join((data.text or '').split())}]"
        for tag, data, alone in held
    ]
    return _of_opencv(lines, "\n".join(rows))


def _of_toolbox(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of Calib_Results.m of the Camera Calibration Toolbox, whose first pixel is (0, 0)."""
    lists = {
        name: numbers_after(rf"^\s*{name}\s*=\s*\[([^\]]*)\]", text.replace(";", " ")) for name in ("fc", "cc", "kc")
    }
    size = [text_after(rf"^\s*{name}\s*=\s*([0-9]+)", text, re.MULTILINE) for name in ("nx", "ny")]
    fields = {"fc": len(lists["fc"]) == 2, "cc": len(lists["cc"]) == 2, "kc": lists["kc"], "nx": size[0], "ny": size[1]}
    must_have(lines, "the Camera Calibration Toolbox for MATLAB", fields)
    skew = text_after(r"^\s*alpha_c\s*=\s*([-+0-9.eE]+)", text, re.MULTILINE) or "0"
    form = form_of(lines, "opencv", "opencv", len(lists["kc"]))
    values = dict(zip(("fx", "fy", "cx", "cy"), [*lists["fc"], *lists["cc"]], strict=True))
    if is_number(skew) and float(skew):
        hint = "calibrate without it: est_alpha = 0"
        raise InputError([lines.fault("the camera has a skew (alpha_c), which OpenCV does not use", None, hint)])
    return camera_of(lines, "opencv", form, [str(side) for side in size], {**values, **by_name(form, lists["kc"])})


def _of_ini(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of the text file of ROS's calibrator (oST), whose values stand below their names."""
    held = {name: text_after(rf"^{name}\s*\n((?:\s*[-+.0-9eE]+)+)", text, re.MULTILINE) for name in _OF_INI}
    width, height, matrix, shift = ((held[name] or "").split() for name in _OF_INI)
    fields = {"width": width, "height": height, "camera matrix with 9 numbers": len(matrix) == 9, "distortion": shift}
    must_have(lines, "ROS", fields)
    form = form_of(lines, "ros", "plumb_bob" if len(shift) == 5 else "rational_polynomial", len(shift))
    values = dict(zip(("fx", "cx", "fy", "cy"), (matrix[0], matrix[2], matrix[4], matrix[5]), strict=True))
    return camera_of(lines, "ros", form, [width[0], height[0]], {**values, **by_name(form, shift)})


_OF_INI = ("width", "height", "camera matrix", "distortion")


def _of_slam(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of a file with a value a key: `projection_parameters` of camodocal, Camera.fx of ORB-SLAM."""
    model = text_after(r"^(?:model_type|Camera\.type)\s*:\s*['\"]?(\w+)", text, re.MULTILINE) or "PinHole"
    if model.lower() not in _SLAM:
        hint = "expected a pinhole with k1 k2 p1 p2, or Kannala-Brandt"
        raise InputError([lines.fault(f"the model {model} is not known here", None, hint)])
    fisheye = "kannala" in model.lower()
    value = r"^\s*(?:Camera[0-9]?\.)?{0}\s*:\s*([-+.0-9eE]+)"
    read = {name: text_after(value.format(name), text, re.MULTILINE) for name in (*_SLAM[model.lower()], "k3")}
    size = [text_after(rf"(?:image_|Camera\.){side}\s*:\s*([0-9]+)", text) for side in ("width", "height")]
    needed = {name: read[name] for name in _SLAM[model.lower()]}
    must_have(lines, "camodocal or ORB-SLAM", {**needed, "width": size[0], "height": size[1]})
    form = form_of(lines, "opencv", *(("fisheye",) if fisheye else ("opencv", 4 if read["k3"] is None else 5)))
    names = [name for name in form.terms if name != "skew"] if fisheye else list(read)
    given = [number for number in (needed if fisheye else read).values() if number is not None]
    return camera_of(lines, "opencv", form, [str(side) for side in size], dict(zip(names, given, strict=False)))


_SLAM = {
    "pinhole": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "kannala_brandt": ("mu", "mv", "u0", "v0", "k2", "k3", "k4", "k5"),
    "kannalabrandt8": ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
}
"""Models, each with the names of its parameters; those of Kannala and Brandt are OpenCV's fisheye in its order"""


def _of_colmap(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of a line of cameras.txt."""
    _, model, width, height, *numbers = text.split()
    form = form_of(lines, "colmap", model)
    if len(numbers) != len(form.terms):
        expected = f"expected {len(form.terms)}: {' '.join(form.terms)}"
        raise InputError([lines.fault(f"the model {model} has {len(numbers)} parameters", None, expected)])
    return camera_of(lines, "colmap", form, [width, height], dict(zip(form.terms, numbers, strict=True)))


def _of_kalibr(lines: TextLines, text: str) -> ReadCamera:
    """Return a camera of a camchain, or of a sensor.yaml of EuRoC; raises InputError unless it is a pinhole."""
    numbers = {name: numbers_after(rf"{name}\s*:\s*{LIST}", text) for name in ("intrinsics", "resolution")}
    model = text_after(r"camera_model\s*:\s*['\"]?(\w+)", text)
    shape = text_after(r"distortion_model\s*:\s*['\"]?([\w-]+)", text)
    shape = "radtan" if shape == "radial-tangential" else shape
    fields = {"camera_model": model, "intrinsics": numbers["intrinsics"], "distortion_model": shape}
    must_have(lines, "Kalibr", {**fields, "resolution": len(numbers["resolution"]) == 2})
    if model != "pinhole" or len(numbers["intrinsics"]) != 4:
        hint = "expected pinhole with radtan, equidistant or none"
        raise InputError([lines.fault(f"the model {model} of kalibr is not known here", None, hint)])
    shift = numbers_after(rf"distortion_coeff(?:icient)?s\s*:\s*{LIST}", text)
    form = form_of(lines, "kalibr", str(shape), len(shift))
    intrinsics = dict(zip(("fx", "fy", "cx", "cy"), numbers["intrinsics"], strict=True))
    return camera_of(lines, "kalibr", form, numbers["resolution"], {**intrinsics, **by_name(form, shift)})


def _of_mrcal(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of a .cameramodel; before 2019 its keys were distortion_model and dimensions."""
    model = text_after(r"'(?:lensmodel|distortion_model)'\s*:\s*'([^']*)'", text)
    intrinsics = numbers_after(r"'intrinsics'\s*:\s*\[([^\]]*)\]", text)
    size = numbers_after(r"'(?:imagersize|dimensions)'\s*:\s*\[([^\]]*)\]", text)
    must_have(lines, "mrcal", {"lensmodel": model, "intrinsics": intrinsics, "imagersize": len(size) == 2})
    model = "LENSMODEL_PINHOLE" if model == "DISTORTION_NONE" else str(model).replace("DISTORTION_", "LENSMODEL_")
    form = form_of(lines, "mrcal", model)
    if len(intrinsics) != len(form.terms):
        expected = f"expected {len(form.terms)}: {' '.join(form.terms)}"
        raise InputError([lines.fault(f"the model {model} has {len(intrinsics)} intrinsics", None, expected)])
    return camera_of(lines, "mrcal", form, size, dict(zip(form.terms, intrinsics, strict=True)))


def _of_metashape(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of a calibration XML; parameters that it lacks are 0, as in Metashape."""
    element = parsed_xml(lines, text)
    held = {entry.tag: (entry.text or "").strip() for entry in element}
    # a document of Metashape has the model and the size in attributes
    extent = element.find("resolution")
    held |= {"projection": element.get("type", held.get("projection", "")), **({} if extent is None else extent.attrib)}
    names = ("projection", "width", "height", "f")
    if "fx" in held and "f" not in held:
        hint = "fx, fy are those of PhotoScan before 1.2: import it there or in Metashape, and export it again"
        raise InputError([lines.fault("the file has fx and fy in place of f, b1 and b2", None, hint)])
    must_have(lines, "Metashape", {name: held.get(name) for name in names})
    form = form_of(lines, "metashape", held["projection"])
    read = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")
    wrong = [f"{name} = '{held[name]}'" for name in read if name in held and not is_number(held[name])]
    if wrong:
        raise InputError([lines.fault(f"not a number: {', '.join(wrong)}")])
    value = {name: float(held.get(name, "0")) for name in read}
    beyond = [name for name in ("k4", "p3", "p4") if value[name] and name not in form.terms]
    if beyond:
        text_of = f"the model {form.name} here has no {', '.join(beyond)}"
        raise InputError([lines.fault(text_of, None, "calibrate in Metashape without them")])
    size = (int(held["width"]), int(held["height"]))
    fx = value["f"] + value["b1"]
    values = {"fx": fx, "fy": value["f"], "cx": size[0] / 2 + value["cx"], "cy": size[1] / 2 + value["cy"]}
    values |= {"skew": value["b2"] / fx if fx else 0.0, "p1": value["p2"], "p2": value["p1"]}
    values |= {name: value[name] for name in form.terms if name[0] == "k"}
    return camera_of(
        lines, "metashape", form, [str(entry) for entry in size], {name: repr(entry) for name, entry in values.items()}
    )


def _of_matlab(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of a call of cameraIntrinsics."""
    plain = text.replace("...", " ").replace("\n", " ")
    lists = re.search(r"cameraIntrinsics\(\s*\[([^\]]*)\]\s*,\s*\[([^\]]*)\]\s*,\s*\[([^\]]*)\]", plain)
    read = [re.split(r"[\s,]+", part.strip()) for part in lists.groups()] if lists else []
    must_have(lines, "MATLAB", {"focalLength, principalPoint and imageSize": len(read) == 3 and len(read[2]) == 2})
    form = PROGRAMS["matlab"].forms[0]
    named = {"Radial": ("k1", "k2", "k3"), "Tangential": ("p1", "p2")}
    focal = read[0] if len(read[0]) == 2 else read[0] * 2
    values = dict(zip(("fx", "fy", "cx", "cy"), [*focal, *read[1]], strict=True))
    for key, names in named.items():
        given = numbers_after(rf"['\"]?{key}Distortion['\"]?\s*[,=]\s*\[([^\]]*)\]", plain)
        values |= dict(zip(names, given, strict=False))
    skew = text_after(r"['\"]?Skew['\"]?\s*[,=]\s*([-+0-9.eE]+)", plain)
    if skew is not None and is_number(skew) and is_number(focal[0]):
        values["skew"] = repr(float(skew) / float(focal[0]))
    return camera_of(lines, "matlab", form, [read[2][1], read[2][0]], values)


MATRIX = "(?:M|K|cameraMatrix)"
"""Begins the key of the matrix of one of a pair of cameras, which a number ends"""
READERS: Sequence[tuple[str, str, Callable[[TextLines, str], ReadCamera]]] = (
    ("kalibr", r"^cam[0-9]+\s*:|^\s*distortion_coeffs\s*:|^intrinsics\s*:\s*\[", _of_kalibr),
    ("mrcal", r"'lensmodel'|'imagersize'|'DISTORTION_[A-Z0-9]+'", _of_mrcal),
    ("metashape", r"<calibration\b|<projection>", _of_metashape),
    ("matlab", r"cameraIntrinsics\(", _of_matlab),
    ("matlab", r"^\s*fc\s*=\s*\[", _of_toolbox),
    ("opencv", r"<opencv_storage>", _of_storage),
    ("ros", r"^camera matrix\s*$", _of_ini),
    ("opencv", r"^projection_parameters\s*:|^Camera1?\.fx\s*:", _of_slam),
    ("opencv", r"(?i:camera_?matrix)\s*:|distortion_coefficients\s*:|image_width\s*:|^[Kk]\s*:\s*(?:\[|$)", _of_opencv),
    ("opencv", rf"^{MATRIX}[0-9]\s*:\s*!!opencv-matrix", _of_opencv),
    ("colmap", r"^\s*[0-9]+\s+[A-Z_]*(PINHOLE|RADIAL|OPENCV|FOV|FISHEYE)[A-Z_]*\s+[0-9]+\s+[0-9]+(\s|$)", _of_colmap),
)
"""Programs, what only their files have, and the reader"""
