"""Cameras as other programs read them: a function a program, of the nearest lens that its models can express.

Where no model is exactly the lens, the file begins with a note on the difference.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from metrocli.arrays import Array
from metrocli.effects.links.lens_shape import Knots
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.instruments.lenses.conventions import Converted, projection_range
from metrocli.instruments.lenses.forms import PROGRAMS, Form, nearest
from metrocli.result import Result
from metrocli.units.people import two_digits


@dataclass(frozen=True)
class _Camera:
    form: Form
    values: dict[str, float]
    """Of the form's terms, cx and cy counted as the program does"""
    size: tuple[int, int]
    notes: tuple[str, ...] = ()

    @property
    def matrix(self) -> list[float]:
        fx, fy, cx, cy = self.intrinsics
        return [fx, fx * self.values.get("skew", 0.0), cx, 0.0, fy, cy, 0.0, 0.0, 1.0]

    @property
    def intrinsics(self) -> list[float]:
        """Return fx, fy, cx, cy."""
        return [self.values[name] for name in ("fx", "fy", "cx", "cy")]

    @property
    def distortion(self) -> list[float]:
        own = ("f", "fx", "fy", "cx", "cy", "skew")
        return [value for name, value in self.values.items() if name not in own]

    def commented(self, lines: Iterable[str], begin: str = "# ", end: str = "") -> str:
        """Return the text of lines behind the notes."""
        return "\n".join([*(f"{begin}note: {note}{end}" for note in self.notes), *lines, ""])


def _expressed(program: str, result: Result, within: float) -> _Camera:
    """Return the camera of a result in the first model of a program that holds it, else in the nearest.

    Raises InputError for a result that is no camera, and where the nearest differs by more than `within` [px].
    """
    if "camera" not in result.tables or "image_width" not in result.statistics:
        raise InputError(f"a result of {result.kind} is no camera: this format takes results of calibrate-camera")
    table = result.tables["camera"]
    lens = dict(zip(table.texts("parameter"), table.numbers("value").tolist(), strict=True))
    width, height = (int(float(result.statistics[name])) for name in ("image_width", "image_height"))  # type: ignore[arg-type]
    forms, pixel = PROGRAMS[program].forms, PROGRAMS[program].pixel
    convention = str(result.statistics["convention"])
    unshifted = _base_of(result, (width, height))
    exact = next((form for form in forms if unshifted is None and form.holds(lens, convention)), None)
    notes: tuple[str, ...] = ()
    if exact is not None:
        form, values = exact, exact.of(lens)
    else:
        fitted = ((one, nearest(lens, convention, (width, height), one, unshifted or np.asarray)) for one in forms)
        form, fit = _near([(one, fit) for one, fit in fitted if fit is not None], program, within)
        values, notes = dict(fit.values), (f"{form.title} is the nearest model of {program}: {_difference(fit)}",)
    if convention != "backward" and (fold := projection_range(lens, (width, height), convention == "fisheye")):
        notes += (f"beyond {fold:.0f} px from its principal point the lens folds over and has no direction",)
    shifted = {name: value + pixel * (name in ("cx", "cy")) for name, value in values.items()}
    return _Camera(form, shifted, (width, height), notes)


def _base_of(result: Result, image_size: tuple[int, int]) -> Callable[[Array], Array] | None:
    """Return what takes image points to those of the base lens; None for a lens without a shape."""
    if "lens_shape" not in result.tables:
        return None
    table = result.tables["lens_shape"]
    knots = Knots(image_size, (len(np.unique(table.numbers("u"))), len(np.unique(table.numbers("v")))))
    coefficients = np.stack([table.numbers("du"), table.numbers("dv")])
    return lambda uv: knots.unshifted(coefficients, uv)


_AS_NEAR = 1.1
"""Ratio of largest differences up to which the model with fewer parameters is taken"""


def _near(fitted: Sequence[tuple[Form, Converted]], program: str, within: float) -> tuple[Form, Converted]:
    """Return the nearest, with few parameters; raises InputError with its difference if that is above `within` [px]."""
    if not fitted:
        raise InputError(f"no model of {program} sees all that this lens sees")
    least = min(fit.largest for _, fit in fitted)
    form, fit = next(one for one in fitted if one[1].largest <= _AS_NEAR * least)
    if fit.largest <= within:
        return form, fit
    raise InputError(
        f"no model of {program} is within {within:g} px of this lens; the nearest is {form.title}: {_difference(fit)}. "
        f"Allow it by e.g. --within '{two_digits(fit.largest * 1.1)} px', or calibrate with its parameters"
    )


def _difference(fit: Converted) -> str:
    return f"rms {two_digits(fit.rms)} px, largest difference {two_digits(fit.largest)} px over the image"


def _row(values: Sequence[float]) -> str:
    """Return numbers with all their digits; readers of YAML 1.1 take 5e-05 for a text, but 5.0e-05 for a number."""
    return ", ".join(text if "." in text else text.replace("e", ".0e") for text in map(repr, values))


def opencv(result: Result, within: float) -> dict[str, str]:
    """Return the YAML of cv::FileStorage, with the names that OpenCV's samples use."""
    camera = _expressed("opencv", result, within)

    def stored(name: str, rows: int, columns: int, values: Sequence[float]) -> list[str]:
        head = f"{name}: !!opencv-matrix"
        return [head, f"   rows: {rows}", f"   cols: {columns}", "   dt: d", f"   data: [ {_row(values)} ]"]

    lines = [f"image_width: {camera.size[0]}", f"image_height: {camera.size[1]}"]
    lines += [f"fisheye_model: {int(camera.form.fisheye)}", *stored("camera_matrix", 3, 3, camera.matrix)]
    lines += stored("distortion_coefficients", 1, len(camera.distortion), camera.distortion)
    return {"opencv.yml": "%YAML:1.0\n---\n" + camera.commented(lines)}


def ros(result: Result, within: float) -> dict[str, str]:
    """Return the YAML of ROS camera_calibration (sensor_msgs/CameraInfo)."""
    camera = _expressed("ros", result, within)
    fx, fy, cx, cy = camera.intrinsics

    def matrix(name: str, rows: int, columns: int, values: Sequence[float]) -> list[str]:
        return [f"{name}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: [{_row(values)}]"]

    lines = [f"image_width: {camera.size[0]}", f"image_height: {camera.size[1]}", "camera_name: camera"]
    lines += matrix("camera_matrix", 3, 3, camera.matrix) + [f"distortion_model: {camera.form.name}"]
    lines += matrix("distortion_coefficients", 1, len(camera.distortion), camera.distortion)
    lines += matrix("rectification_matrix", 3, 3, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    lines += matrix("projection_matrix", 3, 4, [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0])
    return {"ros.yaml": camera.commented(lines)}


def colmap(result: Result, within: float) -> dict[str, str]:
    """Return cameras.txt of COLMAP."""
    camera = _expressed("colmap", result, within)
    numbers = " ".join(map(repr, camera.values.values()))
    lines = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    lines += [f"1 {camera.form.name} {camera.size[0]} {camera.size[1]} {numbers}"]
    return {"cameras.txt": camera.commented(lines)}


def kalibr(result: Result, within: float) -> dict[str, str]:
    """Return a camchain of Kalibr."""
    camera = _expressed("kalibr", result, within)
    lines = [
        "cam0:",
        "  camera_model: pinhole",
        f"  intrinsics: [{_row(camera.intrinsics)}]",
        f"  distortion_model: {camera.form.name}",
        f"  distortion_coeffs: [{_row(camera.distortion)}]",
        f"  resolution: [{camera.size[0]}, {camera.size[1]}]",
    ]
    return {"camchain.yaml": camera.commented(lines)}


def mrcal(result: Result, within: float) -> dict[str, str]:
    """Return a camera model of mrcal."""
    camera = _expressed("mrcal", result, within)
    lines = [
        "{",
        f"    'lensmodel': '{camera.form.name}',",
        "    'extrinsics': [ 0, 0, 0, 0, 0, 0 ],",
        f"    'intrinsics': [ {_row([*camera.values.values()])} ],",
        f"    'imagersize': [ {camera.size[0]}, {camera.size[1]} ],",
        "}",
    ]
    return {"camera.cameramodel": camera.commented(lines)}


def metashape(result: Result, within: float) -> dict[str, str]:
    """Return the calibration XML of Metashape: cx, cy from the centre of the image, `fx = f + b1`, `fx skew = b2`.

    Its p1, p2 are OpenCV's p2, p1.
    """
    camera = _expressed("metashape", result, within)
    fx, fy, cx, cy = camera.intrinsics
    values = {**camera.values, "f": fy, "b1": fx - fy, "b2": fx * camera.values["skew"]}
    values |= {"cx": cx - camera.size[0] / 2, "cy": cy - camera.size[1] / 2}
    values |= {"p1": camera.values["p2"], "p2": camera.values["p1"]}
    lines = ["<calibration>", f"  <projection>{camera.form.name}</projection>"]
    lines += [f"  <width>{camera.size[0]}</width>", f"  <height>{camera.size[1]}</height>"]
    names = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2")
    lines += [f"  <{name}>{values.get(name, 0.0)!r}</{name}>" for name in names]
    text = camera.commented([*lines, "</calibration>"], "<!-- ", " -->")
    return {"metashape.xml": f'<?xml version="1.0" encoding="UTF-8"?>\n{text}'}


def matlab(result: Result, within: float) -> dict[str, str]:
    """Return a script of MATLAB's Computer Vision Toolbox that makes a cameraIntrinsics."""
    camera = _expressed("matlab", result, within)
    fx, fy, cx, cy = camera.intrinsics
    k1, k2, k3, p1, p2 = camera.distortion
    lines = [
        f"intrinsics = cameraIntrinsics([{_row([fx, fy])}], [{_row([cx, cy])}], ...",
        f"    [{camera.size[1]}, {camera.size[0]}], ...",
        f"    'RadialDistortion', [{_row([k1, k2, k3])}], 'TangentialDistortion', [{_row([p1, p2])}], ...",
        f"    'Skew', {fx * camera.values['skew']!r});",
    ]
    return {"camera.m": camera.commented(lines, "% ")}
