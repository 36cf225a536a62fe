"""Where several cameras of other programs are to each other: their poses in the frame of the first.

All programs state how points of a frame that the cameras share go to a camera, `X_camera = R X + t`. Kalibr states it
from the camera before (T_cn_cnm1, m), mrcal from its reference (extrinsics: rotation vector and shift, m), OpenCV from
the first camera (R, T), COLMAP from that of the rig (rigs.txt, quaternions w x y z). Lengths of the last two have the
unit of the board or the model.

Sources: Kalibr, YAML formats; mrcal, Camera model representation; OpenCV, stereoCalibrate; COLMAP, Rigs and sensors.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from metrocli import units
from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.geometry.rotations import nearest_rotation, rotation_from_vector
from metrocli.imports.camera_fields import Keys, ReadCamera, listed, text_after
from metrocli.imports.lines import TextLines, is_number, must_be_length
from metrocli.instruments.lenses.forms import LENGTHS

_TURNED = 1e-5
"""How far a matrix may be from a rotation: files with six digits are"""
_METRES = ("kalibr", "mrcal")
_RIG = re.compile(r"^\s*[0-9]+\s+[0-9]+\s+(?:CAMERA|IMU)\s")


@dataclass(frozen=True)
class CameraPart:
    """A camera with the text that states it."""

    lines: TextLines
    program: str
    text: str
    camera: ReadCamera
    paired: int | None = None
    """Its number among several of one text"""


def is_rigs(lines: TextLines) -> bool:
    """Return whether a file is rigs.txt of COLMAP."""
    first = next((line for _, line in lines.without("#")), "")
    return _RIG.match(first) is not None


def poses_of(parts: Mapping[str, CameraPart], rigs: TextLines | None, unit: str) -> dict[str, Array] | None:
    """Return the pose (6,) of each camera in the frame of the first, 0 for itself; None if the files state none.

    `unit` is that of lengths in files that do not state it. Raises InputError for a pose that is missing or no
    rotation, UsageError for a unit that is not known.
    """
    programs = {part.program for part in parts.values()}
    read = _READERS.get(programs.pop()) if len(programs) == 1 else None
    stated_poses = read(parts, rigs) if read is not None and len(parts) > 1 else {}
    if not any(stated_poses.values()):
        return None
    to_camera, before = dict[str, Array](), np.zeros(6)
    for name, part in parts.items():
        stated = stated_poses[name]
        if stated is None and to_camera:
            hint = f"expected where {name} is beside {next(iter(parts))}"
            raise InputError([part.lines.fault(f"the file has no pose of the camera {name}", None, hint)])
        here = np.zeros(6) if stated is None else _pose(part.lines, name, stated)
        in_file = "m" if part.program in _METRES else unit
        size = 1.0 if stated is None else _size_of_unit(part.lines if rigs is None else rigs, in_file)
        # where a guess of mm is wrong, nothing would show it, since lenses fit any scale (docs/decisions/268)
        if size is None:
            return None
        here[:3] *= size
        to_camera[name] = before = poses.compose(here, before) if part.program == "kalibr" else here
    first = next(iter(to_camera.values()))
    return {name: poses.compose(first, poses.inverse(pose)) for name, pose in to_camera.items()}


def _size_of_unit(lines: TextLines, unit: str) -> float | None:
    """Return the length [mm] of the unit of a file; None if neither the file nor the user states it."""
    if not unit:
        return 1.0 if any(LENGTHS in line for line in lines.lines if line.startswith("#")) else None
    must_be_length(unit)
    return units.find_unit(unit, "length").inside(1.0)


def _pose(lines: TextLines, name: str, stated: Sequence[str]) -> Array:
    """Return the pose of nine numbers of a rotation, row by row, and three of a shift."""
    if len(stated) != 12 or not all(map(is_number, stated)):
        message = f"the pose of the camera {name} is {' '.join(stated[:16])}"
        raise InputError([lines.fault(message, None, "expected numbers: a rotation and a shift")])
    values = np.array([float(number) for number in stated])
    turn = values[:9].reshape(3, 3)
    if np.abs(turn.T @ turn - np.eye(3)).max() > _TURNED or np.linalg.det(turn) < 0:
        raise InputError([lines.fault(f"the pose of the camera {name} is not a rotation", None, "expected R' R = 1")])
    return poses.pose(nearest_rotation(turn), values[9:])


Stated = dict[str, "list[str] | None"]
"""Rotation and shift as text, 12 numbers of each camera; None without a pose"""


def _of_kalibr(parts: Mapping[str, CameraPart], rigs: TextLines | None) -> Stated:
    stated_poses: Stated = {}
    for name, part in parts.items():
        rows = re.search(r"^[ \t]*T_cn_cnm1\s*:((?:[^:\n]*(?:\n|$))*)", part.text, re.MULTILINE)
        numbers = (
            re.findall(
                r"[^\s\[\],]+", re.sub(r"#.*|^\s*-(?=\s)|-\s+(?=\[)|(?<=\s)-(?=\s)", " ", rows[1], flags=re.MULTILINE)
            )
            if rows
            else []
        )
        if rows and (len(numbers) != 16 or not _is_last(numbers[12:])):
            message = f"T_cn_cnm1 of {name} has {len(numbers)} numbers"
            raise InputError([part.lines.fault(message, None, "expected 4 rows of 4, the last 0 0 0 1")])
        stated_poses[name] = (
            [*(numbers[4 * row + k] for row in range(3) for k in range(3)), *numbers[3:12:4]] if rows else None
        )
    return stated_poses


def _is_last(row: Sequence[str]) -> bool:
    return all(map(is_number, row)) and [float(number) for number in row] == [0.0, 0.0, 0.0, 1.0]


def _of_mrcal(parts: Mapping[str, CameraPart], rigs: TextLines | None) -> Stated:
    stated_poses: Stated = {}
    for name, part in parts.items():
        text = text_after(part.lines, r"'(?:extrinsics|rt_cam_ref)'\s*:\s*\[([^\]]*)\]", part.text)
        numbers = listed(text or "")
        if len(numbers) != 6 or not all(map(is_number, numbers)):
            hint = "expected 6 numbers: rotation vector and shift"
            raise InputError([part.lines.fault(f"extrinsics is {text}", None, hint)])
        turn = rotation_from_vector(np.array([float(number) for number in numbers[:3]]))
        stated_poses[name] = [*map(repr, turn.ravel().tolist()), *numbers[3:]]
    # cameras that were calibrated alone are all at the reference
    return stated_poses if len({tuple(names or ()) for names in stated_poses.values()}) > 1 else {}


def _of_opencv(parts: Mapping[str, CameraPart], rigs: TextLines | None) -> Stated:
    stated_poses: Stated = {}
    for name, part in parts.items():
        keys = Keys(part.lines, part.text)
        stated = [*keys.entries("R"), *keys.entries("T")] if part.paired in (None, 1) else []
        stated_poses[name] = stated or None
    return stated_poses


def _of_colmap(parts: Mapping[str, CameraPart], rigs: TextLines | None) -> Stated:
    if rigs is None:
        return {}
    stated_poses: Stated = dict.fromkeys(parts)
    for number, line in rigs.without("#"):
        _, _, kind, first, *rest = line.split()
        stated_poses = {f"camera-{first}": None, **stated_poses}
        while rest:
            kind, sensor, posed, *rest = rest if len(rest) > 2 else ["", "", ""]
            quaternion, shift, rest = (rest[:4], rest[4:7], rest[7:]) if posed == "1" else ([], [], rest)
            name = f"camera-{sensor}"
            if kind != "CAMERA" or name not in parts or not all(map(is_number, quaternion)) or len(shift) != 3:
                hint = "expected CAMERA, its number in cameras.txt, 1, QW QX QY QZ TX TY TZ of each but the first"
                raise InputError([rigs.fault(f"a sensor of the rig: {kind} {sensor}", number, hint)])
            w, *vector = np.array([float(each) for each in quaternion]) / np.linalg.norm([float(q) for q in quaternion])
            half = float(np.linalg.norm(vector))
            axis = np.array(vector) * (2 * np.arctan2(half, w) / half if half else 2.0)
            stated_poses[name] = [*map(repr, rotation_from_vector(axis).ravel().tolist()), *shift]
        break
    return {name: stated_poses[name] for name in parts}


_READERS: Mapping[str, Callable[[Mapping[str, CameraPart], TextLines | None], Stated]] = {
    "kalibr": _of_kalibr,
    "mrcal": _of_mrcal,
    "opencv": _of_opencv,
    "colmap": _of_colmap,
}
