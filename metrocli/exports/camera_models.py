"""Cameras as other programs read them: a function a program, of the nearest lens that its models can express.

Where no model is exactly the lens, the file begins with a note on the difference.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from metrocli.arrays import Array
from metrocli.exports.expressed_cameras import ExpressedCamera, expressed
from metrocli.geometry.rotations import vector_from_rotation
from metrocli.instruments.lenses.forms import LENGTHS
from metrocli.result import Result
from metrocli.units import find_unit


def _row(values: Sequence[float]) -> str:
    """Return numbers with all their digits; readers of YAML 1.1 take 5e-05 for a text, but 5.0e-05 for a number."""
    return ", ".join(text if "." in text else text.replace("e", ".0e") for text in map(repr, values))


def opencv(result: Result, within: float) -> dict[str, str]:
    """Return the YAML of cv::FileStorage, with the names that OpenCV's samples use.

    Of several cameras each has R and T [mm] of cv::stereoCalibrate, from the frame of the first.
    """
    return {camera.file("opencv.yml"): _of_opencv(camera) for camera in expressed("opencv", result, within, posed=True)}


def _of_opencv(camera: ExpressedCamera) -> str:
    def stored(name: str, rows: int, columns: int, values: Sequence[float]) -> list[str]:
        head = f"{name}: !!opencv-matrix"
        return [head, f"   rows: {rows}", f"   cols: {columns}", "   dt: d", f"   data: [ {_row(values)} ]"]

    lines = [f"image_width: {camera.size[0]}", f"image_height: {camera.size[1]}"]
    lines += [f"fisheye_model: {int(camera.form.fisheye)}", *stored("camera_matrix", 3, 3, camera.matrix)]
    lines += stored("distortion_coefficients", 1, len(camera.distortion), camera.distortion)
    if camera.pose is not None:
        turn, shift = camera.from_first
        lines += [f"# {LENGTHS}", *stored("R", 3, 3, turn.ravel().tolist()), *stored("T", 3, 1, shift.tolist())]
    return "%YAML:1.0\n---\n" + camera.commented(lines)


def ros(result: Result, within: float) -> dict[str, str]:
    """Return the YAML of ROS camera_calibration (sensor_msgs/CameraInfo)."""
    return {camera.file("ros.yaml"): _of_ros(camera) for camera in expressed("ros", result, within)}


def _of_ros(camera: ExpressedCamera) -> str:
    fx, fy, cx, cy = camera.intrinsics

    def matrix(name: str, rows: int, columns: int, values: Sequence[float]) -> list[str]:
        return [f"{name}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: [{_row(values)}]"]

    lines = [f"image_width: {camera.size[0]}", f"image_height: {camera.size[1]}"]
    lines += [f"camera_name: {camera.name or 'camera'}"]
    lines += matrix("camera_matrix", 3, 3, camera.matrix) + [f"distortion_model: {camera.form.name}"]
    lines += matrix("distortion_coefficients", 1, len(camera.distortion), camera.distortion)
    lines += matrix("rectification_matrix", 3, 3, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    lines += matrix("projection_matrix", 3, 4, [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0])
    return camera.commented(lines)


def _all_noted(cameras: Sequence[ExpressedCamera], lines: Iterable[str]) -> str:
    """Return the text of lines behind the notes of all cameras."""
    notes = [f"{camera.name}: {note}" if camera.name else note for camera in cameras for note in camera.notes]
    return replace(cameras[0], notes=tuple(notes)).commented(lines)


def colmap(result: Result, within: float) -> dict[str, str]:
    """Return cameras.txt of COLMAP; of several cameras also rigs.txt, with the first as reference, in mm."""
    cameras = expressed("colmap", result, within, posed=True)
    lines, sensors = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"], list[str]()
    for number, camera in enumerate(cameras, 1):
        numbers = " ".join(map(repr, camera.values.values()))
        lines += [f"# {camera.name}"] if camera.name else []
        lines += [f"{number} {camera.form.name} {camera.size[0]} {camera.size[1]} {numbers}"]
        if camera.pose is not None:
            turn, shift = camera.from_first
            sensors.append(f"CAMERA {number} 1 {' '.join(map(repr, [*_quaternion(turn), *shift.tolist()]))}")
    files = {"cameras.txt": _all_noted(cameras, lines)}
    if sensors:
        head = "# RIG_ID, NUM_SENSORS, REF_SENSOR_TYPE, REF_SENSOR_ID, SENSORS[] as (SENSOR_TYPE, SENSOR_ID, HAS_POSE, "
        rig = f"1 {len(cameras)} CAMERA 1 {' '.join(sensors)}"
        files["rigs.txt"] = f"# {LENGTHS}\n{head}[QW, QX, QY, QZ, TX, TY, TZ])\n{rig}\n"
    return files


def _quaternion(turn: Array) -> list[float]:
    """Return the unit quaternion w, x, y, z of a rotation (3, 3)."""
    vector = vector_from_rotation(turn)
    half = float(np.linalg.norm(vector)) / 2
    return [float(np.cos(half)), *(np.sinc(half / np.pi) / 2 * vector).tolist()]


def kalibr(result: Result, within: float) -> dict[str, str]:
    """Return a camchain of Kalibr; T_cn_cnm1 [m] takes points from the camera before to a camera."""
    cameras = expressed("kalibr", result, within, posed=True)
    lines, metre = list[str](), find_unit("m", "length")
    before = np.eye(4)
    for number, camera in enumerate(cameras):
        lines += [
            f"cam{number}:" + (f"  # {camera.name}" if camera.name else ""),
            "  camera_model: pinhole",
            f"  intrinsics: [{_row(camera.intrinsics)}]",
            f"  distortion_model: {camera.form.name}",
            f"  distortion_coeffs: [{_row(camera.distortion)}]",
            f"  resolution: [{camera.size[0]}, {camera.size[1]}]",
        ]
        here = np.eye(4)
        here[:3, :3], shift = camera.from_first
        here[:3, 3] = [metre.outside(coordinate) for coordinate in shift.tolist()]
        if number:
            step = here @ np.linalg.inv(before)
            lines += ["  T_cn_cnm1:", *(f"  - [{_row(row)}]" for row in step.tolist())]
        before = here
    return {"camchain.yaml": _all_noted(cameras, lines)}


def mrcal(result: Result, within: float) -> dict[str, str]:
    """Return a camera model of mrcal, each of several with its extrinsics [m] from the frame of the first."""
    return {
        camera.file("camera.cameramodel"): _of_mrcal(camera)
        for camera in expressed("mrcal", result, within, posed=True)
    }


def _of_mrcal(camera: ExpressedCamera) -> str:
    turn, shift = camera.from_first
    metre = find_unit("m", "length")
    place = [*vector_from_rotation(turn).tolist(), *(metre.outside(coordinate) for coordinate in shift.tolist())]
    lines = [
        "{",
        f"    'lensmodel': '{camera.form.name}',",
        f"    'extrinsics': [ {_row(place) if camera.pose is not None else '0, 0, 0, 0, 0, 0'} ],",
        f"    'intrinsics': [ {_row([*camera.values.values()])} ],",
        f"    'imagersize': [ {camera.size[0]}, {camera.size[1]} ],",
        "}",
    ]
    return camera.commented(lines)


def metashape(result: Result, within: float) -> dict[str, str]:
    """Return the calibration XML of Metashape: cx, cy from the centre of the image, `fx = f + b1`, `fx skew = b2`.

    Its p1, p2 are OpenCV's p2, p1.
    """
    return {camera.file("metashape.xml"): _of_metashape(camera) for camera in expressed("metashape", result, within)}


def _of_metashape(camera: ExpressedCamera) -> str:
    fx, fy, cx, cy = camera.intrinsics
    values = {**camera.values, "f": fy, "b1": fx - fy, "b2": fx * camera.values["skew"]}
    values |= {"cx": cx - camera.size[0] / 2, "cy": cy - camera.size[1] / 2}
    values |= {"p1": camera.values["p2"], "p2": camera.values["p1"]}
    lines = ["<calibration>", f"  <projection>{camera.form.name}</projection>"]
    lines += [f"  <width>{camera.size[0]}</width>", f"  <height>{camera.size[1]}</height>"]
    names = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2")
    lines += [f"  <{name}>{values.get(name, 0.0)!r}</{name}>" for name in names]
    text = camera.commented([*lines, "</calibration>"], "<!-- ", " -->")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}'


def matlab(result: Result, within: float) -> dict[str, str]:
    """Return a script of MATLAB's Computer Vision Toolbox that makes a cameraIntrinsics."""
    return {camera.file("camera.m"): _of_matlab(camera) for camera in expressed("matlab", result, within)}


def _of_matlab(camera: ExpressedCamera) -> str:
    fx, fy, cx, cy = camera.intrinsics
    k1, k2, k3, p1, p2 = camera.distortion
    lines = [
        f"intrinsics = cameraIntrinsics([{_row([fx, fy])}], [{_row([cx, cy])}], ...",
        f"    [{camera.size[1]}, {camera.size[0]}], ...",
        f"    'RadialDistortion', [{_row([k1, k2, k3])}], 'TangentialDistortion', [{_row([p1, p2])}], ...",
        f"    'Skew', {fx * camera.values['skew']!r});",
    ]
    return camera.commented(lines, "% ")
