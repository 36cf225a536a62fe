"""Cameras of other programs as the YAML file that jobs read, recognised by what is in the file."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

from metrocli.arrays import Array
from metrocli.errors import Fault, InputError
from metrocli.geometry import poses
from metrocli.imports import Imported, ImportOptions
from metrocli.imports.camera_fields import ReadCamera, parsed_xml
from metrocli.imports.camera_readers import MATRIX, READERS
from metrocli.imports.camera_rigs import CameraPart, is_rigs, poses_of
from metrocli.imports.lines import NOTE, TextLines
from metrocli.instruments.lenses.forms import PROGRAMS
from metrocli.instruments.lenses.lens import UNITS

_FIELD_OF_VIEW = 0.05
"""Focal lengths below this share of the longer side of the image are in mm, or in units of the image"""
_DECENTRED = 0.2
"""Beyond this p1 and p2 shift a point at 0.2 focal lengths from the centre by more than a tenth of that distance"""
_ALONE = "# the lens of one of several cameras{}\n"
_SHIFT = "(?:D|distCoeffs)"
"""Begins the key of the coefficients of one of a pair of cameras, which a number ends"""
_CENTRE = (0.02, 0.98)
"""Principal points beyond these shares of the image are not plausible, or in other units"""


def files(lines: TextLines, options: ImportOptions) -> Imported:
    """Return camera.yaml, or a file for each of several cameras, and rig.yaml if their poses are stated.

    Raises InputError for what a file lacks, and for models that are not known here.
    """
    parts, rigs = dict[str, CameraPart](), None
    for text in (lines, *options.others):
        if is_rigs(text):
            rigs = text
            continue
        read = _cameras(text)
        if not read:
            expected = f"expected a camera of {', '.join(PROGRAMS)}"
            raise InputError([text.fault("this is not a camera of another program", None, expected)])
        if options.others and len(read) == 1:
            read = {Path(text.file).stem: next(iter(read.values()))}
        if twice := [name for name in read if name in parts]:
            raise InputError([text.fault(f"another file has the camera {twice[0]} too", None, "name files distinctly")])
        parts |= read
    if not parts:
        raise InputError([lines.fault("this is where cameras are, but none of them", None, "give cameras.txt too")])
    if len(parts) == 1:
        return {"camera.yaml": _written(next(iter(parts.values())))}
    placed = poses_of(parts, rigs, options.unit)
    without = "; their poses to each other, if the files have them, are not taken over: give the unit by --unit"
    note = _ALONE.format("; rig.yaml has them with their poses" if placed else without)
    rig = {"rig.yaml": _rig(parts, placed)} if placed else {}
    return {**{f"{name}.yaml": note + _written(part) for name, part in parts.items()}, **rig}


def as_yaml(lines: TextLines) -> str | None:
    """Return the text of camera.yaml or rig.yaml; None for a file that is not a camera of another program.

    Raises InputError as `files` does, and for several cameras whose poses it does not state.
    """
    parts = _cameras(lines)
    if len(parts) < 2:
        return next(map(_written, parts.values()), None)
    if placed := poses_of(parts, None, ""):
        return _rig(parts, placed)
    program = program_of("\n".join(lines.lines))
    hint = f"`metrocli import {lines.file} --from {program}` writes a file for each: name one of these in the job"
    raise InputError([lines.fault(f"the file has the cameras {', '.join(parts)}", None, hint)])


def _cameras(lines: TextLines) -> dict[str, CameraPart]:
    """Return the cameras of a file by their names; none if it is not a camera of another program."""
    # searching a list would take minutes where thousands of empty lines follow each other
    text = re.sub(r"\n(?:[ \t]*\n){3,}", "\n\n", "\n".join(line.rstrip() for line in lines.lines))
    for program, sign, reader in READERS:
        if re.search(sign, text, re.MULTILINE):
            parts = _parts(lines, program, text)
            read = {name: reader(lines, part) for name, part in parts.items()}
            for camera in read.values():
                _must_be_plausible(lines, camera)
            paired = range(len(parts)) if len(parts) > 1 else [None]
            return {
                name: CameraPart(lines, program, parts[name], read[name], number)
                for name, number in zip(parts, paired, strict=True)
            }
    return {}


def program_of(text: str) -> str | None:
    """Return the program whose camera a text is, by what only its files have; None if it is not a camera."""
    return next((program for program, sign, _ in READERS if re.search(sign, text, re.MULTILINE)), None)


def _parts(lines: TextLines, program: str, text: str) -> dict[str, str]:
    """Return the text of each camera by its name; programs with one camera in a file have one part.

    Raises InputError if a camera stands twice, and for text that is not the XML of its program.
    """
    if program == "kalibr":
        before, *named_parts = re.split(r"^(cam[0-9]+)\s*:", text, flags=re.MULTILINE)
        names = named_parts[::2]
        if names and ("intrinsics" in before or len(set(names)) < len(names)):
            message = "a camera without its name, or with that of another"
            raise InputError([lines.fault(message, None, "expected cam0, cam1, ...")])
        return dict(zip(names, named_parts[1::2], strict=True)) or {"": text}
    if program == "colmap":
        return _rows(lines)
    if program == "metashape":
        return _sensors(lines, text)
    if re.search(rf"^{MATRIX}[0-9]\s*:", text, re.MULTILINE):
        stereo = dict.fromkeys(re.findall(rf"^(?:{MATRIX}|{_SHIFT})([0-9])\s*:", text, re.MULTILINE))
        return {f"camera-{number}": _of_pair(number, text) for number in stereo}
    several = sorted(set(re.findall(r"^(Camera[0-9])\.\w+\s*:", text, re.MULTILINE)))
    return {
        name: re.sub(rf"^(?!{name}\.)Camera[0-9]\..*", "", text, flags=re.MULTILINE).replace(f"{name}.", "Camera1.")
        for name in several
    } or {"": text}


def _of_pair(number: str, text: str) -> str:
    """Return the text of a pair of cameras (OpenCV's stereo_calib: M1, D1, M2, D2) with the keys of one camera."""
    matrix = re.sub(rf"^{MATRIX}{number}\s*:", "camera_matrix:", text, flags=re.MULTILINE)
    return re.sub(rf"^{_SHIFT}{number}\s*:", "distortion_coefficients:", matrix, flags=re.MULTILINE)


def _rows(lines: TextLines) -> dict[str, str]:
    """Return the line of each camera of COLMAP; raises InputError if a camera stands twice."""
    rows = [(number, line, line.split()[0]) for number, line in lines.without("#")]
    again = [
        lines.fault(f"camera {key} stands twice", n)
        for i, (n, _, key) in enumerate(rows)
        if key in [r[2] for r in rows[:i]]
    ]
    if again:
        raise InputError(again)
    return {f"camera-{key}": line for _, line, key in rows}


def _sensors(lines: TextLines, text: str) -> dict[str, str]:
    """Return the calibration of each sensor of a document of Metashape: the adjusted one, else the initial one."""
    root = parsed_xml(lines, text)
    if root.tag == "calibration":
        return {"": text}
    calibrations = dict[str, ElementTree.Element]()
    for sensor in root.iter("sensor"):
        name = f"{re.sub(r'[^0-9A-Za-z.-]+', '-', sensor.get('label') or 'sensor')}-{sensor.get('id')}"
        for each in sorted(sensor.iter("calibration"), key=lambda each: each.get("class") != "initial"):
            calibrations[name] = each
    alone = root.find(".//calibration")
    calibrations = calibrations or ({"": alone} if alone is not None else {})
    return {name: ElementTree.tostring(each, encoding="unicode") for name, each in calibrations.items()} or {"": text}


def _written(part: CameraPart) -> str:
    return "\n".join([f"# from {part.lines.file} (camera)", f"program: {part.program}", *_lens(part.camera), ""])


def _lens(camera: ReadCamera) -> list[str]:
    model = "fisheye" if camera.form.fisheye else "opencv"
    values = [
        f"{name}: {value}{f' {UNITS[name]}' if name in UNITS else ''}"
        for name, value in camera.values.items()
        if name in ("f", "fx", "fy", "cx", "cy") or float(value)
    ]
    lines = [*(f"{NOTE}{note}" for note in camera.notes), f"image_size: [{camera.size[0]}, {camera.size[1]}]"]
    lines += [f"model: {model}", *values]
    if camera.shape is not None:
        columns, rows = camera.shape.knots.counts
        shifts = (
            f"  {name}: {shift}" for name, shift in zip(("du", "dv"), camera.shape.coefficients.tolist(), strict=True)
        )
        lines += ["shape:", f"  knots: [{columns}, {rows}]", *shifts]
    return lines


def _rig(parts: Mapping[str, CameraPart], placed: Mapping[str, Array]) -> str:
    """Return the text of rig.yaml: each lens, and its pose in the frame of the first."""
    origin = " and ".join(dict.fromkeys(part.lines.file for part in parts.values()))
    lines = [f"# from {origin} (cameras)", f"program: {next(iter(parts.values())).program}", "cameras:"]
    for number, (name, part) in enumerate(parts.items()):
        lines += [f"  {json.dumps(name)}:", *(f"    {line}" for line in _lens(part.camera))]
        if number:
            numbers = zip(poses.EULER, poses.euler_form(placed[name]).tolist(), strict=True)
            pose = ", ".join(f"{key}: {value!r} {'mm' if key in 'xyz' else 'rad'}" for key, value in numbers)
            lines.append(f"    pose: {{{pose}}}")
    return "\n".join([*lines, ""])


def _must_be_plausible(lines: TextLines, camera: ReadCamera) -> None:
    """Raise InputError if focal lengths or principal point cannot be pixels, or decentring is beyond any lens."""
    beyond = [name for name in ("p1", "p2") if abs(float(camera.values.get(name, 0.0))) > _DECENTRED]
    if beyond:
        values = ", ".join(f"{name} = {camera.values[name]}" for name in beyond)
        four = camera.form.name == "plumb_bob" and camera.values.get("k3") == "0"
        hint = "four coefficients of a fisheye are k1 to k4: for such a lens write `distortion_model: equidistant`"
        raise InputError([lines.fault(f"{values}: no lens is decentred so much", None, hint if four else None)])
    faults = []
    for name, value in camera.values.items():
        extent = camera.size[0] if name == "cx" else camera.size[1]
        number = float(value)
        if name in ("f", "fx", "fy") and not _FIELD_OF_VIEW * max(camera.size) < number:
            faults.append(lines.fault(f"{name} = {value} is not a focal length in pixels of this image"))
        if name in ("cx", "cy") and not _CENTRE[0] * extent < number < _CENTRE[1] * extent:
            faults.append(lines.fault(f"{name} = {value} is not a principal point in pixels of this image"))
    if faults:
        width, height = camera.size
        hint = f"expected pixels: the file states an image of {width} x {height} px"
        raise InputError([Fault(fault.message, fault.file, hint=hint) for fault in faults])
