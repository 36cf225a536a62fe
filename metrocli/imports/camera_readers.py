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
    Keys,
    ReadCamera,
    by_name,
    camera_of,
    children,
    form_of,
    listed,
    must_be_numbers,
    must_have,
    parsed_xml,
    text_after,
)
from metrocli.imports.lines import TextLines
from metrocli.imports.splined_camera import splined
from metrocli.instruments.lenses.forms import PROGRAMS, LensForm
from metrocli.instruments.lenses.stereographic import StereographicGrid


def _of_opencv(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of OpenCV's FileStorage or of ROS, which share their keys."""
    keys = Keys(lines, text)
    # a message of ROS (CameraInfo) has the keys height, width, D, K; those of its region are indented
    size = [keys.text(f"image_?{side}") or keys.text(side, nested=False) for side in ("width", "height")]
    matrix = keys.entries("camera_?matrix") or keys.entries("K", nested=False)
    shift = keys.entries("dist(ortion)?_?(coefficients|coeffs?)") or keys.entries("D", nested=False)
    fields = {"camera_matrix with 9 numbers": len(matrix) == 9, "distortion_coefficients": shift}
    sizes = {"image_width": size[0], "image_height": size[1]}
    if all(fields.values()) and not all(size):
        hint = "add lines `image_width:` and `image_height:` with the size of its images in pixels"
        lacking = ", ".join(name for name, value in sizes.items() if not value)
        raise InputError([lines.fault(f"the file lacks {lacking}", None, hint)])
    must_have(lines, "OpenCV or ROS", {**sizes, **fields})
    model, fisheye = keys.text("distortion_model"), keys.text("fisheye_model")
    if fisheye not in (None, "0", "1"):
        raise InputError([lines.fault(f"fisheye_model: {fisheye}", None, "expected 0 or 1")])
    if model is None:
        # R and P are those of ROS too, but OpenCV's storage has R beside T, from the first of two cameras
        if keys.has("camera_name|rectification_matrix|projection_matrix") or (
            "opencv" not in text and keys.has("[RP]")
        ):
            must_have(lines, "ROS", {"distortion_model": model})
        program, form = "opencv", form_of(lines, "opencv", "fisheye" if fisheye == "1" else "opencv", len(shift))
    else:
        program = "ros"
        form = form_of(lines, "ros", model)
        if form.name == "plumb_bob" and len(shift) == 4:
            shift.append("0")
        form = form_of(lines, "ros", model, len(shift))
    values = _of_matrix(lines, matrix)
    if "skew" in values and "skew" not in form.terms:
        raise InputError([lines.fault("the camera matrix has a skew, which OpenCV does not use", None, "set it to 0")])
    return camera_of(lines, program, form, [str(side) for side in size], {**values, **by_name(form, shift)})


def _of_matrix(lines: TextLines, matrix: Sequence[str]) -> dict[str, str]:
    """Return what a camera matrix states, row by row; the skew only where it is not 0."""
    names = ("fx", "skew", "cx", "the fourth", "fy", "cy", "the seventh", "the eighth", "the last")
    must_be_numbers(lines, {f"{name} of camera_matrix": number for name, number in zip(names, matrix, strict=True)})
    fx, skew, cx, low, fy, cy, *last = matrix
    if list(map(float, (low, *last))) != [0.0, 0.0, 0.0, 1.0]:
        hint = "expected fx, skew, cx, 0, fy, cy, 0, 0, 1, row by row"
        raise InputError([lines.fault(f"camera_matrix is {', '.join(matrix)}", None, hint)])
    values = {"fx": fx, "fy": fy, "cx": cx, "cy": cy}
    return {**values, "skew": repr(float(skew) / float(fx))} if float(skew) and float(fx) else values


def _of_storage(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of OpenCV's FileStorage as XML, which has the keys of its YAML."""
    rows = list[str]()
    for tag, element in children(lines, parsed_xml(lines, text)).items():
        below = {name: " ".join((each.text or "").split()) for name, each in children(lines, element).items()}
        if "data" in below:
            below["data"] = f"[{below['data']}]"
        rows += [f"{tag}: {(element.text or '').strip()}", *(f"  {name}: {value}" for name, value in below.items())]
    return _of_opencv(lines, "\n".join(rows))


def _of_toolbox(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of Calib_Results.m of the Camera Calibration Toolbox, whose first pixel is (0, 0)."""
    lists = {
        name: listed(text_after(lines, rf"^\s*{name}\s*=\s*\[([^\]]*)\]", text) or "") for name in ("fc", "cc", "kc")
    }
    alone = {name: text_after(lines, rf"^\s*{name}\s*=([^;\n%]*)", text) for name in ("nx", "ny", "alpha_c")}
    lengths = {name: len(lists[name]) == 2 for name in ("fc", "cc")}
    fields = {**lengths, "kc": "".join(lists["kc"]), "nx": alone["nx"], "ny": alone["ny"]}
    must_have(lines, "the Camera Calibration Toolbox for MATLAB", fields)
    form = form_of(lines, "opencv", "opencv", len(lists["kc"]))
    values = dict(zip(("fx", "fy", "cx", "cy"), [*lists["fc"], *lists["cc"]], strict=True))
    skew = "0" if alone["alpha_c"] is None else alone["alpha_c"]
    must_be_numbers(lines, {"alpha_c": skew})
    if float(skew):
        hint = "calibrate without it: est_alpha = 0"
        raise InputError([lines.fault("the camera has a skew (alpha_c), which OpenCV does not use", None, hint)])
    size = [str(alone[name]) for name in ("nx", "ny")]
    return camera_of(lines, "opencv", form, size, {**values, **by_name(form, lists["kc"])})


def _of_ini(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of the text file of ROS's calibrator (oST), whose values stand below their names."""
    held = {
        name: text_after(lines, rf"^{name}[ \t]*\n((?:.*\S.*(?:\n|$)){{1,{count}}})", text)
        for name, count in _OF_INI.items()
    }
    width, height, matrix, shift = ((held[name] or "").split() for name in _OF_INI)
    fields = {"width": len(width) == 1, "height": len(height) == 1}
    must_have(lines, "ROS", {**fields, "camera matrix with 9 numbers": len(matrix) == 9, "distortion": shift})
    form = form_of(lines, "ros", "plumb_bob" if len(shift) == 5 else "rational_polynomial", len(shift))
    return camera_of(lines, "ros", form, [*width, *height], {**_of_matrix(lines, matrix), **by_name(form, shift)})


_OF_INI = {"width": 1, "height": 1, "camera matrix": 3, "distortion": 1}
"""Names, and how many lines stand below each"""


def _of_slam(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of a file with a value a key: `projection_parameters` of camodocal, Camera.fx of ORB-SLAM."""
    keys = Keys(lines, text)
    model = keys.text(r"model_type|Camera\.type") or "PinHole"
    if model.lower() not in _SLAM:
        hint = "expected a pinhole with k1 k2 p1 p2, or Kannala-Brandt"
        raise InputError([lines.fault(f"the model {model} is not known here", None, hint)])
    fisheye = "kannala" in model.lower()
    read = {name: keys.text(rf"(Camera[0-9]?\.)?{name}") for name in (*_SLAM[model.lower()], "k3")}
    size = [keys.text(rf"(image_|Camera\.){side}") for side in ("width", "height")]
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
    row = text.split()
    must_have(lines, "COLMAP", {f"MODEL, WIDTH or HEIGHT of the camera {row[0]}": len(row) > 3})
    _, model, width, height, *numbers = row
    form = form_of(lines, "colmap", model)
    if len(numbers) != len(form.terms):
        expected = f"expected {len(form.terms)}: {' '.join(form.terms)}"
        raise InputError([lines.fault(f"the model {model} has {len(numbers)} parameters", None, expected)])
    return camera_of(lines, "colmap", form, [width, height], dict(zip(form.terms, numbers, strict=True)))


def _of_kalibr(lines: TextLines, text: str) -> ReadCamera:
    """Return a camera of a camchain, or of a sensor.yaml of EuRoC; raises InputError unless it is a pinhole."""
    keys = Keys(lines, text)
    intrinsics, size = keys.entries("intrinsics"), keys.entries("resolution")
    model, shape = keys.text("camera_model"), keys.text("distortion_model")
    shape = "radtan" if shape == "radial-tangential" else shape
    fields = {"camera_model": model, "intrinsics": intrinsics, "distortion_model": shape}
    must_have(lines, "Kalibr", {**fields, "resolution": len(size) == 2})
    if model != "pinhole" or len(intrinsics) != 4:
        hint = "expected pinhole with radtan, equidistant or none, and 4 intrinsics"
        other = f"the model {model} of kalibr is not known here"
        message = other if model != "pinhole" else f"{len(intrinsics)} intrinsics"
        raise InputError([lines.fault(message, None, hint)])
    shift = keys.entries("distortion_coeff(icient)?s")
    form = form_of(lines, "kalibr", str(shape), len(shift))
    values = dict(zip(("fx", "fy", "cx", "cy"), intrinsics, strict=True))
    return camera_of(lines, "kalibr", form, size, {**values, **by_name(form, shift)})


def _of_mrcal(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of a .cameramodel; before 2019 its keys were distortion_model and dimensions."""
    model = text_after(lines, r"'(?:lensmodel|distortion_model)'\s*:\s*'([^']*)'", text)
    intrinsics = listed(text_after(lines, r"'intrinsics'\s*:\s*\[([^\]]*)\]", text) or "")
    size = listed(text_after(lines, r"'(?:imagersize|dimensions)'\s*:\s*\[([^\]]*)\]", text) or "")
    must_have(lines, "mrcal", {"lensmodel": model, "intrinsics": intrinsics, "imagersize": len(size) == 2})
    model = "LENSMODEL_PINHOLE" if model == "DISTORTION_NONE" else str(model).replace("DISTORTION_", "LENSMODEL_")
    grid = StereographicGrid.named(model)
    if grid is not None and len(intrinsics) == 4 + 2 * grid.size:
        return splined(lines, grid, intrinsics, size)
    form = LensForm(model, (*_CORE, *["du"] * 2 * grid.size)) if grid is not None else form_of(lines, "mrcal", model)
    if len(intrinsics) != len(form.terms):
        expected = f"expected {len(form.terms)}" + (f": {' '.join(form.terms)}" if grid is None else "")
        raise InputError([lines.fault(f"the model {model} has {len(intrinsics)} intrinsics", None, expected)])
    return camera_of(lines, "mrcal", form, size, dict(zip(form.terms, intrinsics, strict=True)))


_CORE = ("fx", "fy", "cx", "cy")


def _of_metashape(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of a calibration XML; parameters that it lacks are 0, as in Metashape."""
    element = parsed_xml(lines, text)
    held = {tag: (each.text or "").strip() for tag, each in children(lines, element).items()}
    # a document of Metashape has the model and the size in attributes
    extent = element.find("resolution")
    held |= {"projection": element.get("type", held.get("projection", "")), **({} if extent is None else extent.attrib)}
    names = ("projection", "width", "height", "f")
    if "fx" in held and "f" not in held:
        hint = "fx, fy are those of PhotoScan before 1.2: import it there or in Metashape, and export it again"
        raise InputError([lines.fault("the file has fx and fy in place of f, b1 and b2", None, hint)])
    must_have(lines, "Metashape", {name: held.get(name) for name in names})
    form = form_of(lines, "metashape", held["projection"])
    read = ("width", "height", "f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")
    must_be_numbers(lines, {name: held[name] for name in read if name in held})
    value = {name: float(held.get(name, "0")) for name in read}
    beyond = [name for name in ("k4", "p3", "p4") if value[name] and name not in form.terms]
    if beyond:
        text_of = f"the model {form.name} here has no {', '.join(beyond)}"
        raise InputError([lines.fault(text_of, None, "calibrate in Metashape without them")])
    fx = value["f"] + value["b1"]
    cx, cy = (value[side] / 2 + value[name] for side, name in (("width", "cx"), ("height", "cy")))
    values = {"fx": fx, "fy": value["f"], "cx": cx, "cy": cy}
    values |= {"skew": value["b2"] / fx if fx else 0.0, "p1": value["p2"], "p2": value["p1"]}
    values |= {name: value[name] for name in form.terms if name[0] == "k"}
    size = [held["width"], held["height"]]
    return camera_of(lines, "metashape", form, size, {name: repr(entry) for name, entry in values.items()})


def _of_matlab(lines: TextLines, text: str) -> ReadCamera:
    """Return the camera of a call of cameraIntrinsics."""
    plain = text.replace("...", " ").replace("\n", " ")
    call = text_after(lines, r"cameraIntrinsics\(([^()]*)\)", plain) or ""
    lists = re.match(r"\s*\[([^\]]*)\]\s*,\s*\[([^\]]*)\]\s*,\s*\[([^\]]*)\](.*)", call)
    focal, centre, size = map(listed, lists.groups()[:3]) if lists else ([], [], [])
    alone = len(focal) == 1 and not re.match(r"[^\]]*,", call)
    lengths = {"focalLength": alone or len(focal) == 2, "principalPoint": len(centre) == 2, "imageSize": len(size) == 2}
    must_have(lines, "MATLAB", lengths)
    form, named = PROGRAMS["matlab"].forms[0], lists[4] if lists else ""
    named_values = re.findall(r"['\"]\s*(\w+)\s*['\"]|(\w+)\s*=", named)
    if strange := [name for pair in named_values for name in pair if name and name not in _OF_MATLAB]:
        raise InputError(
            [lines.fault(f"cameraIntrinsics has no {strange[0]}", None, f"expected {', '.join(_OF_MATLAB)}")]
        )
    values = dict(zip(("fx", "fy", "cx", "cy"), [*(focal * 2)[:2], *centre], strict=True))
    for key, names in {"Radial": ("k1", "k2", "k3"), "Tangential": ("p1", "p2")}.items():
        given = text_after(lines, rf"\b{key}Distortion['\"]?\s*[,=]([^\]'\"=]*)", named)
        numbers = None if given is None else re.fullmatch(r"\s*\[(.*)", given)
        if given is not None and (numbers is None or len(listed(numbers[1])) not in (2, len(names))):
            expected = f"expected a list of {' or '.join(dict.fromkeys(['2', str(len(names))]))} numbers"
            raise InputError([lines.fault(f"{key}Distortion is {given}", None, expected)])
        values |= dict(zip(names, listed(numbers[1]) if numbers else (), strict=False))
    skew = text_after(lines, r"\bSkew['\"]?\s*[,=]([^,]*)", named)
    must_be_numbers(lines, {"Skew": skew or "0", "fx": values["fx"]})
    if skew is not None and float(skew) and float(values["fx"]):
        values["skew"] = repr(float(skew) / float(values["fx"]))
    return camera_of(lines, "matlab", form, size[::-1], values)


_OF_MATLAB = ("RadialDistortion", "TangentialDistortion", "Skew")
MATRIX = "(?:M|K|cameraMatrix)"
"""Begins the key of the matrix of one of a pair of cameras, which a number ends"""
READERS: Sequence[tuple[str, str, Callable[[TextLines, str], ReadCamera]]] = (
    ("kalibr", r"^cam[0-9]+\s*:|^\s*(?:distortion_coeffs|camera_model)\s*:|^intrinsics\s*:\s*\[", _of_kalibr),
    ("mrcal", r"'lensmodel'|'imagersize'|'DISTORTION_[A-Z0-9]+'", _of_mrcal),
    ("metashape", r"<calibration\b|<projection>", _of_metashape),
    ("matlab", r"cameraIntrinsics\(", _of_matlab),
    ("matlab", r"^\s*(?:fc|cc|kc)\s*=\s*\[", _of_toolbox),
    ("opencv", r"<opencv_storage>", _of_storage),
    ("ros", r"^camera matrix\s*$|^# oST version", _of_ini),
    ("opencv", r"^projection_parameters\s*:|^Camera[0-9]?\.(?:fx|fy|type)\s*:", _of_slam),
    (
        "opencv",
        r"(?i:camera_?matrix)\s*:|distortion_(?:coefficients|model)\s*:|image_width\s*:|^[Kk]\s*:\s*(?:\[|$)",
        _of_opencv,
    ),
    ("opencv", rf"^{MATRIX}[0-9]\s*:\s*!!opencv-matrix", _of_opencv),
    ("colmap", r"^\s*[0-9]+\s+[A-Z_]*(PINHOLE|RADIAL|OPENCV|FOV|FISHEYE)[A-Z_]*\s+\S+\s+\S+(\s|$)", _of_colmap),
)
"""Programs, what only their files have, and the reader"""
