"""Cameras as other programs read them: OpenCV, ROS, COLMAP, Kalibr, mrcal. All have OpenCV's model, forward.

Pixel (0, 0) is the centre of the first pixel, as in OpenCV, ROS, Kalibr and mrcal. COLMAP has (0.5, 0.5) there.
"""

from __future__ import annotations

from collections.abc import Sequence

from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.instruments.lens import focal
from metrocli.result import Result

_ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
"""OpenCV's order of distortion coefficients"""
_LENGTHS = (4, 5, 8, 12)
"""Numbers of coefficients that OpenCV reads"""
_SKEW = 1e-9
_HALF_PIXEL = 0.5


@dataclass(frozen=True)
class _Camera:
    lens: dict[str, float]
    width: int
    height: int

    @property
    def intrinsics(self) -> tuple[float, float, float, float]:
        """Return fx, fy, cx, cy."""
        return (*focal(self.lens), self.lens["cx"], self.lens["cy"])

    def distortion(self, lengths: Sequence[int] = _LENGTHS) -> list[float]:
        """Return the shortest list of coefficients that has all that are not zero; raises InputError if none has."""
        values = [self.lens.get(name, 0.0) for name in _ORDER]
        needed = max((i + 1 for i, value in enumerate(values) if value), default=0)
        length = next((one for one in lengths if one >= needed), None)
        if length is None:
            raise InputError(f"this format has no place for {' '.join(_ORDER[lengths[-1] : needed])}: use --to opencv")
        return values[:length]


def _camera(result: Result, skewed: bool = False) -> _Camera:
    """Return the camera of a result; raises InputError for another kind, convention or a skew without a place."""
    if "camera" not in result.tables or "image_width" not in result.statistics:
        raise InputError(f"a result of {result.kind} is no camera: this format takes results of calibrate-camera")
    if result.statistics.get("convention") != "forward":
        raise InputError("other programs have OpenCV's forward model: calibrate with `camera: {convention: forward}`")
    table = result.tables["camera"]
    lens = dict(zip(table.texts("parameter"), table.numbers("value").tolist(), strict=True))
    if abs(lens.get("skew", 0.0)) > _SKEW and not skewed:
        raise InputError("this format has no skew: leave it out of `camera: estimate`")
    width, height = (int(float(result.statistics[name])) for name in ("image_width", "image_height"))  # type: ignore[arg-type]
    return _Camera(lens, width, height)


def _row(values: Sequence[float]) -> str:
    return ", ".join(map(repr, values))


def _matrix(camera: _Camera) -> list[float]:
    fx, fy, cx, cy = camera.intrinsics
    return [fx, fx * camera.lens.get("skew", 0.0), cx, 0.0, fy, cy, 0.0, 0.0, 1.0]


def opencv(result: Result) -> dict[str, str]:
    """Return the YAML of cv::FileStorage, with the names that OpenCV's samples use."""
    camera = _camera(result, skewed=True)
    shift = camera.distortion()

    def stored(name: str, rows: int, columns: int, values: Sequence[float]) -> list[str]:
        head = f"{name}: !!opencv-matrix"
        return [head, f"   rows: {rows}", f"   cols: {columns}", "   dt: d", f"   data: [ {_row(values)} ]"]

    lines = ["%YAML:1.0", "---", f"image_width: {camera.width}", f"image_height: {camera.height}"]
    lines += stored("camera_matrix", 3, 3, _matrix(camera))
    lines += stored("distortion_coefficients", 1, len(shift), shift)
    return {"opencv.yml": "\n".join([*lines, ""])}


def ros(result: Result) -> dict[str, str]:
    """Return the YAML of ROS camera_calibration (sensor_msgs/CameraInfo)."""
    camera = _camera(result)
    shift = camera.distortion((5, 8))
    fx, fy, cx, cy = camera.intrinsics

    def matrix(name: str, rows: int, columns: int, values: Sequence[float]) -> list[str]:
        return [f"{name}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: [{_row(values)}]"]

    model = "plumb_bob" if len(shift) == 5 else "rational_polynomial"
    lines = [f"image_width: {camera.width}", f"image_height: {camera.height}", "camera_name: camera"]
    lines += matrix("camera_matrix", 3, 3, _matrix(camera)) + [f"distortion_model: {model}"]
    lines += matrix("distortion_coefficients", 1, len(shift), shift)
    lines += matrix("rectification_matrix", 3, 3, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    lines += matrix("projection_matrix", 3, 4, [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0])
    return {"ros.yaml": "\n".join([*lines, ""])}


def colmap(result: Result) -> dict[str, str]:
    """Return cameras.txt of COLMAP, whose pixel centres are half a pixel farther."""
    camera = _camera(result)
    fx, fy, cx, cy = camera.intrinsics
    shift = camera.distortion((4, 8))
    model = "OPENCV" if len(shift) == 4 else "FULL_OPENCV"
    numbers = " ".join(map(repr, (fx, fy, cx + _HALF_PIXEL, cy + _HALF_PIXEL, *shift)))
    head = "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"
    return {"cameras.txt": f"{head}\n1 {model} {camera.width} {camera.height} {numbers}\n"}


def kalibr(result: Result) -> dict[str, str]:
    """Return a camchain of Kalibr, model pinhole-radtan."""
    camera = _camera(result)
    lines = [
        "cam0:",
        "  camera_model: pinhole",
        f"  intrinsics: [{_row(camera.intrinsics)}]",
        "  distortion_model: radtan",
        f"  distortion_coeffs: [{_row(camera.distortion((4,)))}]",
        f"  resolution: [{camera.width}, {camera.height}]",
        "",
    ]
    return {"camchain.yaml": "\n".join(lines)}


def mrcal(result: Result) -> dict[str, str]:
    """Return a camera model of mrcal, LENSMODEL_OPENCV4, 5, 8 or 12."""
    camera = _camera(result)
    shift = camera.distortion()
    numbers = _row([*camera.intrinsics, *shift])
    lines = [
        "{",
        f"    'lensmodel': 'LENSMODEL_OPENCV{len(shift)}',",
        "    'extrinsics': [ 0, 0, 0, 0, 0, 0 ],",
        f"    'intrinsics': [ {numbers} ],",
        f"    'imagersize': [ {camera.width}, {camera.height} ],",
        "}",
        "",
    ]
    return {"camera.cameramodel": "\n".join(lines)}
