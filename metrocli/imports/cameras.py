"""Cameras of other programs as the YAML file that jobs read, recognised by what is in the file.

Sources: OpenCV tutorial camera_calibration; ROS REP 104 and sensor_msgs/CameraInfo; COLMAP, Camera Models; Kalibr, YAML
formats; mrcal, Camera model representation; Metashape manual, Camera models; MATLAB, cameraIntrinsics.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from xml.etree import ElementTree

from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.imports import Imported, ImportOptions
from metrocli.imports.lines import TextLines, is_number
from metrocli.instruments.lenses.forms import PROGRAMS, LensForm
from metrocli.instruments.lenses.lens import UNITS

_FIELD_OF_VIEW = 0.05
"""Focal lengths below this share of the longer side of the image are in mm, or in units of the image"""
_CENTRE = (0.02, 0.98)
"""Principal points beyond these shares of the image are not plausible, or in other units"""


def files(lines: TextLines, wishes: ImportOptions) -> Imported:
    """Return camera.yaml; raises InputError for what the file lacks, and for models that are not known here."""
    text = as_yaml(lines)
    if text is None:
        expected = f"expected a camera of {', '.join(PROGRAMS)}"
        raise InputError([lines.fault("this is no camera of another program", None, expected)])
    return {"camera.yaml": text}


def as_yaml(lines: TextLines) -> str | None:
    """Return the text of camera.yaml; None for a file that is no camera of another program. Raises as `files`."""
    text = "\n".join(lines.lines)
    for program, (sign, reader) in _READERS.items():
        if re.search(sign, text, re.MULTILINE):
            camera = reader(lines, text)
            _must_be_pixels(lines, camera)
            return _written(lines, program, camera)
    return None


@dataclass(frozen=True)
class _ReadCamera:
    form: LensForm
    size: tuple[int, int]
    values: Mapping[str, str]
    """As the file has them, but cx and cy from the centre of the first pixel"""


def _written(lines: TextLines, program: str, camera: _ReadCamera) -> str:
    model = "fisheye" if camera.form.fisheye else "opencv"
    head = [f"# from {lines.file} (camera)", f"program: {program}", f"image_size: [{camera.size[0]}, {camera.size[1]}]"]
    values = [
        f"{name}: {value}{f' {UNITS[name]}' if name in UNITS else ''}"
        for name, value in camera.values.items()
        if name in ("f", "fx", "fy", "cx", "cy") or float(value)
    ]
    return "\n".join([*head, f"model: {model}", *values, ""])


def _must_be_pixels(lines: TextLines, camera: _ReadCamera) -> None:
    """Raise InputError if focal lengths or principal point cannot be pixels of an image of this size."""
    faults = []
    for name, value in camera.values.items():
        extent = camera.size[0] if name == "cx" else camera.size[1]
        number = float(value)
        if name in ("f", "fx", "fy") and not _FIELD_OF_VIEW * max(camera.size) < number:
            faults.append(lines.fault(f"{name} = {value} is no focal length in pixels of this image"))
        if name in ("cx", "cy") and not _CENTRE[0] * extent < number < _CENTRE[1] * extent:
            faults.append(lines.fault(f"{name} = {value} is no principal point in pixels of this image"))
    if faults:
        width, height = camera.size
        hint = f"expected pixels: the file states an image of {width} x {height} px"
        raise InputError([Fault(fault.message, fault.file, hint=hint) for fault in faults])


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


def _read(
    lines: TextLines, program: str, form: LensForm, size: Sequence[str], values: Mapping[str, str]
) -> _ReadCamera:
    """Return what was read; raises InputError for values that are no numbers."""
    wrong = [f"{name} = '{value}'" for name, value in values.items() if not is_number(value)]
    if wrong:
        raise InputError([lines.fault(f"not a number: {', '.join(wrong)}")])
    pixel = PROGRAMS[program].pixel
    centre = {name: repr(float(values[name]) - pixel) for name in ("cx", "cy")} if pixel else {}
    return _ReadCamera(form, (int(size[0]), int(size[1])), {**values, **centre})


def _must_have(lines: TextLines, what: str, fields: Mapping[str, object]) -> None:
    lacking = [name for name, value in fields.items() if not value]
    if lacking:
        raise InputError([lines.fault(f"the file lacks {', '.join(lacking)}", None, f"expected a camera of {what}")])


def _of_opencv(lines: TextLines, text: str) -> _ReadCamera:
    """Return the camera of OpenCV's FileStorage or of ROS, which share their keys."""
    size = [_after(rf"image_?{side}\s*:\s*([0-9]+)", text, re.IGNORECASE) for side in ("width", "height")]
    matrix = _numbers(rf"(?:camera_matrix|cameraMatrix|Camera_Matrix)\s*:[^\[]*?{_DATA}", text)
    shift = _numbers(rf"dist(?:ortion_coefficients|Coeffs|_coeffs|ortion_Coefficients)\s*:[^\[]*?{_DATA}", text)
    fields = {"image_width": size[0], "image_height": size[1], "camera_matrix with 9 numbers": len(matrix) == 9}
    _must_have(lines, "OpenCV or ROS", {**fields, "distortion_coefficients": shift})
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


def _of_colmap(lines: TextLines, text: str) -> _ReadCamera:
    """Return the camera of cameras.txt; raises InputError unless it is one."""
    rows = [(number, line.split()) for number, line in lines.without("#")]
    if len(rows) != 1:
        hint = "keep the line of the camera that the job uses"
        raise InputError([lines.fault(f"the file has {len(rows)} cameras", None, hint)])
    number, (_, model, width, height, *numbers) = rows[0]
    form = _form(lines, "colmap", model)
    if len(numbers) != len(form.terms):
        expected = f"expected {len(form.terms)}: {' '.join(form.terms)}"
        raise InputError([lines.fault(f"the model {model} has {len(numbers)} parameters", number, expected)])
    return _read(lines, "colmap", form, [width, height], dict(zip(form.terms, numbers, strict=True)))


def _of_kalibr(lines: TextLines, text: str) -> _ReadCamera:
    """Return the camera of a camchain; raises InputError unless it is one, of the model pinhole."""
    names = re.findall(r"^(cam[0-9]+)\s*:", text, re.MULTILINE)
    if len(names) > 1:
        hint = "keep the one that the job uses"
        raise InputError([lines.fault(f"the file has the cameras {', '.join(names)}", None, hint)])
    numbers = {name: _numbers(rf"{name}\s*:\s*\[([^\]]*)\]", text) for name in ("intrinsics", "resolution")}
    model = _after(r"camera_model\s*:\s*['\"]?(\w+)", text)
    shape = _after(r"distortion_model\s*:\s*['\"]?(\w+)", text)
    fields = {"camera_model": model, "intrinsics": numbers["intrinsics"], "distortion_model": shape}
    _must_have(lines, "Kalibr", {**fields, "resolution": len(numbers["resolution"]) == 2})
    if model != "pinhole" or len(numbers["intrinsics"]) != 4:
        hint = "expected pinhole with radtan, equidistant or none"
        raise InputError([lines.fault(f"the model {model} of kalibr is not known here", None, hint)])
    shift = _numbers(r"distortion_coeffs\s*:\s*\[([^\]]*)\]", text)
    form = _form(lines, "kalibr", str(shape), len(shift))
    intrinsics = dict(zip(("fx", "fy", "cx", "cy"), numbers["intrinsics"], strict=True))
    return _read(lines, "kalibr", form, numbers["resolution"], {**intrinsics, **_named(form, shift)})


def _of_mrcal(lines: TextLines, text: str) -> _ReadCamera:
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


def _of_metashape(lines: TextLines, text: str) -> _ReadCamera:
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


def _of_matlab(lines: TextLines, text: str) -> _ReadCamera:
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


_DATA = r"data\s*:\s*\[([^\]]*)\]"


def _numbers(pattern: str, text: str) -> list[str]:
    """Return the numbers of a list as written; an empty list if one is no number."""
    match = re.search(pattern, text, re.DOTALL)
    parts = re.split(r"[\s,]+", match[1].strip().strip(",")) if match and match[1].strip() else []
    parts = [part.rstrip(".") for part in parts]
    return parts if all(map(is_number, parts)) else []


_READERS: Mapping[str, tuple[str, Callable[[TextLines, str], _ReadCamera]]] = {
    "kalibr": (r"^cam[0-9]+\s*:|^\s*distortion_coeffs\s*:\s*\[", _of_kalibr),
    "mrcal": (r"'lensmodel'|'imagersize'", _of_mrcal),
    "metashape": (r"<calibration\b|<projection>", _of_metashape),
    "matlab": (r"cameraIntrinsics\(", _of_matlab),
    "opencv": (r"(?i:camera_?matrix)\s*:|distortion_coefficients\s*:|image_width\s*:", _of_opencv),
    "colmap": (r"^\s*[0-9]+\s+[A-Z_]+\s+[0-9]+\s+[0-9]+(\s|$)", _of_colmap),
}
"""What only files of a program have, and their reader"""
