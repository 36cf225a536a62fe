"""Readers of cameras: what the files of each program have, as the values of a lens model.

Sources: OpenCV tutorial camera_calibration; ROS REP 104 and sensor_msgs/CameraInfo; COLMAP, Camera Models; Kalibr, YAML
formats; mrcal, Camera model representation; Metashape manual, Camera models; MATLAB, cameraIntrinsics; Bouguet, Camera
Calibration Toolbox for MATLAB.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from xml.etree import ElementTree

from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.imports.lines import TextLines, is_number
from metrocli.instruments.lenses.forms import PROGRAMS, LensForm


@dataclass(frozen=True)
class ReadCamera:
    """A camera as its file has it."""

    form: LensForm
    size: tuple[int, int]
    values: Mapping[str, str]
    """As the file has them, but cx and cy from the centre of the first pixel"""


def _form(lines: TextLines, program: str, name: str, count: int | None = None) -> LensForm:
    """Return the model of a program by its name, and where names stand for several, by its number of coefficients."""
    forms = PROGRAMS[program].forms
    named = [form for form in forms if form.name == name]
    if not named:
        known = ", ".join(form.name for form in forms)
        raise InputError([lines.fault(f"the model {name} of {program} is not known here", None, f"expected {known}")])
    if count is None:
        return named[0]
    counts = {len(_coefficients(form)): form for form in named}
    if count not in counts:
        expected = f"expected {' or '.join(map(str, counts))}"
        raise InputError([lines.fault(f"{count} distortion coefficients of the model {name}", None, expected)])
    return counts[count]


def _coefficients(form: LensForm) -> tuple[str, ...]:
    return tuple(name for name in form.terms if name not in ("f", "fx", "fy", "cx", "cy", "skew"))


def _read(lines: TextLines, program: str, form: LensForm, size: Sequence[str], values: Mapping[str, str]) -> ReadCamera:
    """Return what was read; raises InputError for values that are no numbers."""
    wrong = [f"{name} = '{value}'" for name, value in values.items() if not is_number(value)]
    if wrong:
        raise InputError([lines.fault(f"not a number: {', '.join(wrong)}")])
    pixel = PROGRAMS[program].pixel
    centre = {name: repr(float(values[name]) - pixel) for name in ("cx", "cy")} if pixel else {}
    return ReadCamera(form, (int(size[0]), int(size[1])), {**values, **centre})


def _must_have(lines: TextLines, what: str, fields: Mapping[str, object]) -> None:
    lacking = [name for name, value in fields.items() if not value]
    if lacking:
        raise InputError([lines.fault(f"the file lacks {', '.join(lacking)}", None, f"expected a camera of {what}")])


def _of_opencv(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of OpenCV's FileStorage or of ROS, which share their keys."""
    # a message of ROS (CameraInfo) has the keys height, width, D, K; those of its region are indented
    extent, anywhere = r"(?:image_?{0}|^{0})\s*:\s*([0-9]+)", re.IGNORECASE | re.MULTILINE
    size = [_after(extent.format(side), text, anywhere) for side in ("width", "height")]
    matrix = _numbers(rf"(?i:camera_?matrix)\s*:[^\[]{{0,200}}?data\s*:\s*{_LIST}|^[Kk]\s*:\s*{_LIST}", text)
    shift = _numbers(
        rf"(?i:dist(?:ortion)?_?(?:coefficients|coeffs?))\s*:(?:[^\[]{{0,200}}?data\s*:)?\s*{_LIST}|^[Dd]\s*:\s*{_LIST}",
        text,
    )
    fields = {"camera_matrix with 9 numbers": len(matrix) == 9, "distortion_coefficients": shift}
    sizes = {"image_width": size[0], "image_height": size[1]}
    if all(fields.values()) and None in size:
        hint = "add `image_width: 640` and `image_height: 480`, with the size of its images in pixels"
        lacking = ", ".join(name for name, value in sizes.items() if value is None)
        raise InputError([lines.fault(f"the file lacks {lacking}", None, hint)])
    _must_have(lines, "OpenCV or ROS", {**sizes, **fields})
    model = _after(r"distortion_model\s*:\s*['\"]?([a-z_]+)", text)
    fisheye = _after(r"fisheye_model\s*:\s*([01])", text) == "1"
    if model is None:
        program, form = "opencv", _form(lines, "opencv", "fisheye" if fisheye else "opencv", len(shift))
    else:
        program = "ros"
        form = _form(lines, "ros", model)
        if form.name == "plumb_bob" and len(shift) == 4:
            shift.append("0")
        form = _form(lines, "ros", model, len(shift))
    fx, skew, cx, _, fy, cy = matrix[:6]
    values = dict(zip(("fx", "fy", "cx", "cy"), (fx, fy, cx, cy), strict=True))
    if float(skew) and "skew" not in form.terms:
        raise InputError([lines.fault("the camera matrix has a skew, which OpenCV does not use", None, "set it to 0")])
    if float(skew):
        values["skew"] = repr(float(skew) / float(fx))
    return _read(lines, program, form, [str(name) for name in size], {**values, **_named(form, shift)})


def _of_storage(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of OpenCV's FileStorage as XML, which has the keys of its YAML."""
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError([lines.fault(f"this is not XML: {error}", error.position[0])]) from error
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
    lists = {name: _numbers(rf"^\s*{name}\s*=\s*\[([^\]]*)\]", text.replace(";", " ")) for name in ("fc", "cc", "kc")}
    size = [_after(rf"^\s*{name}\s*=\s*([0-9]+)", text, re.MULTILINE) for name in ("nx", "ny")]
    fields = {"fc": len(lists["fc"]) == 2, "cc": len(lists["cc"]) == 2, "kc": lists["kc"], "nx": size[0], "ny": size[1]}
    _must_have(lines, "the Camera Calibration Toolbox for MATLAB", fields)
    skew = _after(r"^\s*alpha_c\s*=\s*([-+0-9.eE]+)", text, re.MULTILINE) or "0"
    form = _form(lines, "opencv", "opencv", len(lists["kc"]))
    values = dict(zip(("fx", "fy", "cx", "cy"), [*lists["fc"], *lists["cc"]], strict=True))
    if is_number(skew) and float(skew):
        hint = "calibrate without it: est_alpha = 0"
        raise InputError([lines.fault("the camera has a skew (alpha_c), which OpenCV does not use", None, hint)])
    return _read(lines, "opencv", form, [str(side) for side in size], {**values, **_named(form, lists["kc"])})


def _of_ini(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of the text file of ROS's calibrator (oST), whose values stand below their names."""
    held = {name: _after(rf"^{name}\s*\n((?:\s*[-+.0-9eE]+)+)", text, re.MULTILINE) for name in _OF_INI}
    width, height, matrix, shift = ((held[name] or "").split() for name in _OF_INI)
    fields = {"width": width, "height": height, "camera matrix with 9 numbers": len(matrix) == 9, "distortion": shift}
    _must_have(lines, "ROS", fields)
    form = _form(lines, "ros", "plumb_bob" if len(shift) == 5 else "rational_polynomial", len(shift))
    values = dict(zip(("fx", "cx", "fy", "cy"), (matrix[0], matrix[2], matrix[4], matrix[5]), strict=True))
    return _read(lines, "ros", form, [width[0], height[0]], {**values, **_named(form, shift)})


_OF_INI = ("width", "height", "camera matrix", "distortion")


def _of_slam(lines: TextLines, text: str) -> ReadCamera:
    """Return the pinhole of a file with a value a key: `projection_parameters` of camodocal, Camera.fx of ORB-SLAM."""
    model = _after(r"^(?:model_type|Camera\.type)\s*:\s*['\"]?(\w+)", text, re.MULTILINE) or "PinHole"
    if model.lower() != "pinhole":
        raise InputError(
            [lines.fault(f"the model {model} is not known here", None, "expected a pinhole with k1 k2 p1 p2")]
        )
    value = r"^\s*(?:Camera1?\.)?{0}\s*:\s*([-+.0-9eE]+)"
    read = {name: _after(value.format(name), text, re.MULTILINE) for name in (*_SLAM, "k3")}
    size = [_after(rf"(?:image_|Camera\.){side}\s*:\s*([0-9]+)", text) for side in ("width", "height")]
    _must_have(
        lines, "camodocal or ORB-SLAM", {**{name: read[name] for name in _SLAM}, "width": size[0], "height": size[1]}
    )
    form = _form(lines, "opencv", "opencv", 4 if read["k3"] is None else 5)
    values = {name: str(number) for name, number in read.items() if number is not None}
    return _read(lines, "opencv", form, [str(side) for side in size], values)


_SLAM = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")


def _of_colmap(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of a line of cameras.txt."""
    _, model, width, height, *numbers = text.split()
    form = _form(lines, "colmap", model)
    if len(numbers) != len(form.terms):
        expected = f"expected {len(form.terms)}: {' '.join(form.terms)}"
        raise InputError([lines.fault(f"the model {model} has {len(numbers)} parameters", None, expected)])
    return _read(lines, "colmap", form, [width, height], dict(zip(form.terms, numbers, strict=True)))


def _of_kalibr(lines: TextLines, text: str) -> ReadCamera:
    """Return a camera of a camchain, or of a sensor.yaml of EuRoC; raises InputError unless it is a pinhole."""
    numbers = {name: _numbers(rf"{name}\s*:\s*{_LIST}", text) for name in ("intrinsics", "resolution")}
    model = _after(r"camera_model\s*:\s*['\"]?(\w+)", text)
    shape = _after(r"distortion_model\s*:\s*['\"]?([\w-]+)", text)
    shape = "radtan" if shape == "radial-tangential" else shape
    fields = {"camera_model": model, "intrinsics": numbers["intrinsics"], "distortion_model": shape}
    _must_have(lines, "Kalibr", {**fields, "resolution": len(numbers["resolution"]) == 2})
    if model != "pinhole" or len(numbers["intrinsics"]) != 4:
        hint = "expected pinhole with radtan, equidistant or none"
        raise InputError([lines.fault(f"the model {model} of kalibr is not known here", None, hint)])
    shift = _numbers(rf"distortion_coeff(?:icient)?s\s*:\s*{_LIST}", text)
    form = _form(lines, "kalibr", str(shape), len(shift))
    intrinsics = dict(zip(("fx", "fy", "cx", "cy"), numbers["intrinsics"], strict=True))
    return _read(lines, "kalibr", form, numbers["resolution"], {**intrinsics, **_named(form, shift)})


def _of_mrcal(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of a .cameramodel."""
    model = _after(r"'lensmodel'\s*:\s*'([^']*)'", text)
    intrinsics = _numbers(r"'intrinsics'\s*:\s*\[([^\]]*)\]", text)
    size = _numbers(r"'imagersize'\s*:\s*\[([^\]]*)\]", text)
    _must_have(lines, "mrcal", {"lensmodel": model, "intrinsics": intrinsics, "imagersize": len(size) == 2})
    form = _form(lines, "mrcal", str(model))
    if len(intrinsics) != len(form.terms):
        expected = f"expected {len(form.terms)}: {' '.join(form.terms)}"
        raise InputError([lines.fault(f"the model {model} has {len(intrinsics)} intrinsics", None, expected)])
    return _read(lines, "mrcal", form, size, dict(zip(form.terms, intrinsics, strict=True)))


def _of_metashape(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of a calibration XML; parameters that it lacks are 0, as in Metashape."""
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError([lines.fault(f"this is not XML: {error}", error.position[0])]) from error
    element = root if root.tag == "calibration" else root.find(".//calibration")
    held = {entry.tag: (entry.text or "").strip() for entry in element} if element is not None else {}
    names = ("projection", "width", "height", "f")
    _must_have(lines, "Metashape", {name: held.get(name) for name in names})
    form = _form(lines, "metashape", held["projection"])
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
    return _read(
        lines, "metashape", form, [str(entry) for entry in size], {name: repr(entry) for name, entry in values.items()}
    )


def _of_matlab(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of a call of cameraIntrinsics."""
    plain = text.replace("...", " ").replace("\n", " ")
    lists = re.search(r"cameraIntrinsics\(\s*\[([^\]]*)\]\s*,\s*\[([^\]]*)\]\s*,\s*\[([^\]]*)\]", plain)
    read = [re.split(r"[\s,]+", part.strip()) for part in lists.groups()] if lists else []
    _must_have(lines, "MATLAB", {"focalLength, principalPoint and imageSize": len(read) == 3 and len(read[2]) == 2})
    form = PROGRAMS["matlab"].forms[0]
    named = {"Radial": ("k1", "k2", "k3"), "Tangential": ("p1", "p2")}
    focal = read[0] if len(read[0]) == 2 else read[0] * 2
    values = dict(zip(("fx", "fy", "cx", "cy"), [*focal, *read[1]], strict=True))
    for key, names in named.items():
        given = _numbers(rf"['\"]?{key}Distortion['\"]?\s*[,=]\s*\[([^\]]*)\]", plain)
        values |= dict(zip(names, given, strict=False))
    skew = _after(r"['\"]?Skew['\"]?\s*[,=]\s*([-+0-9.eE]+)", plain)
    if skew is not None and is_number(skew) and is_number(focal[0]):
        values["skew"] = repr(float(skew) / float(focal[0]))
    return _read(lines, "matlab", form, [read[2][1], read[2][0]], values)


def _named(form: LensForm, numbers: Sequence[str]) -> dict[str, str]:
    return dict(zip(_coefficients(form), numbers, strict=True))


def _after(pattern: str, text: str, flags: int = 0) -> str | None:
    match = re.search(pattern, text, flags)
    return match[1] if match else None


_LIST = r"(?:\[([^\]]*)\]|((?:\s*\n\s*-\s+[-+.0-9eE]+)+))"
"""A list of YAML, in brackets or with an entry a line"""


def _numbers(pattern: str, text: str) -> list[str]:
    """Return the numbers of a list as written; an empty list if one is no number."""
    match = re.search(pattern, text, re.DOTALL | re.MULTILINE)
    held = next((one for one in match.groups() if one), "") if match else ""
    parts = re.split(r"[\s,]+", re.sub(r"^\s*-\s+", "", held, flags=re.MULTILINE).strip().strip(","))
    parts = [part.rstrip(".") for part in parts]
    return parts if all(map(is_number, parts)) else []


READERS: Sequence[tuple[str, str, Callable[[TextLines, str], ReadCamera]]] = (
    ("kalibr", r"^cam[0-9]+\s*:|^\s*distortion_coeffs\s*:|^intrinsics\s*:\s*\[", _of_kalibr),
    ("mrcal", r"'lensmodel'|'imagersize'", _of_mrcal),
    ("metashape", r"<calibration\b|<projection>", _of_metashape),
    ("matlab", r"cameraIntrinsics\(", _of_matlab),
    ("matlab", r"^\s*fc\s*=\s*\[", _of_toolbox),
    ("opencv", r"<opencv_storage>", _of_storage),
    ("ros", r"^camera matrix\s*$", _of_ini),
    ("opencv", r"^projection_parameters\s*:|^Camera1?\.fx\s*:", _of_slam),
    ("opencv", r"(?i:camera_?matrix)\s*:|distortion_coefficients\s*:|image_width\s*:|^[Kk]\s*:\s*(?:\[|$)", _of_opencv),
    ("colmap", r"^\s*[0-9]+\s+[A-Z_]*(PINHOLE|RADIAL|OPENCV|FOV|FISHEYE)[A-Z_]*\s+[0-9]+\s+[0-9]+(\s|$)", _of_colmap),
)
"""Programs, what only their files have, and the reader"""
