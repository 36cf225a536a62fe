"""Meshes of triangles from STL, PLY and OBJ files."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from metrocli.errors import Fault, InputError
from metrocli.formats.file_bytes import FileBytes, read_bytes
from metrocli.geometry.triangles import Triangles


def read(path: Path, held: FileBytes | None = None) -> Triangles:
    """Return the mesh of a file; vertices equal but for rounding are merged, triangles without area are left out.

    `held` are the bytes of the file where they were read before. Raises InputError if the file cannot be read or has no
    triangles. Coordinates are as in the file.
    """
    import trimesh

    data, kind = (held or read_bytes(path, "a mesh")).data, path.suffix.lower().removeprefix(".")
    if kind == "stl":
        _must_be_whole(data, path)
    try:
        scene: Any = trimesh.load_scene(BytesIO(data), file_type=kind, process=False, skip_materials=True)
        bodies = [body for body in scene.geometry.values() if isinstance(body, trimesh.Trimesh)]
        # joining the bodies of a file copies them, which takes as long as all else of a large mesh
        mesh = bodies[0] if len(bodies) == 1 else scene.to_mesh()
        corners = np.asarray(mesh.vertices, dtype=np.float64)[np.asarray(mesh.faces, dtype=np.intp)]
    except Exception as error:  # trimesh raises any kind of error for a damaged file
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError([Fault(f"cannot be read as a mesh: {reason}", str(path), hint=_HINT)]) from error
    if not len(corners):
        raise InputError([Fault("there are no triangles in this file", str(path), hint=_HINT)])
    if not np.isfinite(corners).all():
        bad = int(np.flatnonzero(~np.isfinite(corners).all(axis=(1, 2)))[0])
        raise InputError([Fault(f"triangle {bad + 1} has a coordinate that is no number", str(path))])
    return _merged(corners)


_ALIKE = 1e-9
"""Grid on which vertices are one, relative to the largest coordinate: what rounding of a calculation leaves"""
_EXPORT = "copy or export it again"
_HINT = "expected a mesh of triangles in STL, PLY or OBJ"


def _must_be_whole(data: bytes, path: Path) -> None:
    """Raise InputError for a binary STL, 84 bytes and 50 for each triangle, that is cut off."""
    count, found = int.from_bytes(data[80:84], "little"), (len(data) - 84) // 50
    if len(data) > 84 and b"facet" not in data[:1000].lower() and found < count:
        fault = Fault(f"the file is cut off: {found} of its {count} triangles are there", str(path), hint=_EXPORT)
        raise InputError([fault])


def _merged(corners: np.typing.NDArray[np.float64]) -> Triangles:
    points = np.ascontiguousarray(corners.reshape(-1, 3))
    grid = _ALIKE * max(float(np.abs(points).max()), 1e-300)
    cells = np.rint(points / grid) + 0.0
    order = np.argsort(_mixed(cells), kind="stable")
    cells = cells[order]
    new = np.concatenate([[True], (cells[1:] != cells[:-1]).any(axis=1)])
    index = np.empty(len(points), dtype=np.intp)
    index[order] = np.cumsum(new) - 1
    faces = index.reshape(-1, 3)
    distinct = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return Triangles(points[order[new]], faces[distinct])


def _mixed(points: np.typing.NDArray[np.float64]) -> np.typing.NDArray[np.uint64]:
    """Return one number for each point (n, 3), equal for equal points: sorting one column is faster than three."""
    bits = points.view(np.uint64)
    mixed = np.zeros(len(points), dtype=np.uint64)
    for column, factor in enumerate((0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9)):
        mixed = (mixed ^ bits[:, column]) * np.uint64(factor)
        mixed ^= mixed >> np.uint64(29)
    return mixed
