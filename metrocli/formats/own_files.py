"""Files of one's own, as users keep them, and meshes of triangles."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from metrocli.errors import Fault, InputError
from metrocli.formats.file_bytes import FileBytes, folder_made, read_bytes, refuse_unwritable, write_bytes
from metrocli.geometry.triangles import Triangles

LIST = ".metrocli-files"
"""In each folder: a line `SHA-256  NAME` for each file that metrocli wrote there, as `sha256sum --check` reads it"""


def inside(folder: Path, name: str) -> Path:
    """Return the path of a file in a folder; raise InputError if the name leads out of it."""
    parts = Path(name).parts
    if not parts or Path(name).is_absolute() or ".." in parts or "\0" in name:
        raise InputError([Fault(f"'{name}' is not the name of a file inside {folder}", hint="rename it in the inputs")])
    return folder / name


def refuse_inputs(paths: Iterable[Path], inputs: Iterable[Path]) -> None:
    """Raise InputError for files to be written that are inputs and exist: no option allows to replace these."""
    # realpath: the same file by a link or by `..` is the same input
    read = {os.path.realpath(path) for path in inputs}
    if used := [path for path in paths if path.exists() and os.path.realpath(path) in read]:
        hint = "choose another name or folder: an input is never replaced"
        raise InputError(
            [Fault("would overwrite this file, which the job reads", str(path), hint=hint) for path in used]
        )


def write_all(contents: Mapping[Path, bytes], force: bool = False) -> Iterator[Path]:
    """Write files and yield each path once it is written.

    Raises InputError, before anything is written, if one of them exists that metrocli did not write, or that was
    changed since then, unless forced.
    """
    with _alone_in(path.parent for path in contents):
        yield from _write_all(contents, force)


def _write_all(contents: Mapping[Path, bytes], force: bool) -> Iterator[Path]:
    for path in contents:
        refuse_unwritable(path)
    lists = {path.parent: _listed(path.parent) for path in contents}
    faults = []
    for path, data in contents.items():
        if not force and path.exists() and not _may_replace(path, data, lists[path.parent]):
            hint = "choose another name or folder, or use --force"
            faults.append(Fault("the file exists, and metrocli did not write it so", str(path), hint=hint))
    if faults:
        raise InputError(faults)
    # listed before they are written, beside what is there: after a kill the next call knows them by either digest
    before = {path: lists[path.parent].get(path.name, set()) for path in contents}
    for path, data in contents.items():
        lists[path.parent][path.name] = before[path] | {_digest(data)}
    _write_lists(lists)
    for path, data in contents.items():
        write_bytes(path, data)
        lists[path.parent][path.name] = {_digest(data)}
        yield path
    if any(before.values()):
        _write_lists(lists)


def _write_lists(lists: Mapping[Path, Mapping[str, Collection[str]]]) -> None:
    for folder, names in lists.items():
        lines = (f"{digest}  {name}\n" for name, digests in sorted(names.items()) for digest in sorted(digests))
        write_bytes(folder / LIST, "".join(lines).encode())


@contextmanager
def _alone_in(folders: Iterable[Path]) -> Iterator[None]:
    """Hold folders, which are made if need be: others that write there at the same time wait, so no entry is lost.

    Where the system has no such locks, nothing is held. Raises InputError if a folder cannot be made.
    """
    with ExitStack() as held:
        try:
            import fcntl

            # sorted: two calls that lock the same folders in different order would wait for each other
            for folder in sorted(set(folders)):
                held.enter_context(folder_made(folder))
                handle = os.open(folder, os.O_RDONLY)
                held.callback(os.close, handle)
                fcntl.flock(handle, fcntl.LOCK_EX)
        except ImportError:
            pass
        except OSError as error:
            raise InputError([Fault(f"cannot be written: {error.strerror}", str(error.filename))]) from error
        yield


def _may_replace(path: Path, data: bytes, listed: Mapping[str, Collection[str]]) -> bool:
    if not path.is_file():
        return False
    there = path.read_bytes()
    return there == data or _digest(there) in listed.get(path.name, ())


def _listed(folder: Path) -> dict[str, set[str]]:
    """Return the digests of the files of a folder by their names, several where a call was killed."""
    digests: dict[str, set[str]] = {}
    try:
        lines = (folder / LIST).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return {}
    for digest, _, name in (line.partition("  ") for line in lines):
        digests.setdefault(name, set()).add(digest)
    return digests


def _digest(data: bytes) -> str:
    return sha256(data).hexdigest()


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
        raise InputError([Fault(f"triangle {bad + 1} has a coordinate that is not a number", str(path))])
    return _merged(corners)


_ALIKE = 1e-9
"""Grid on which vertices are one, relative to the largest coordinate: what rounding of a calculation leaves"""
_EXPORT = "copy or export it again"
_HINT = "expected a mesh of triangles in STL, PLY or OBJ"


def _must_be_whole(data: bytes, path: Path) -> None:
    """Raise InputError for a binary STL, 84 bytes and 50 for each triangle, that is cut off."""
    count, length = int.from_bytes(data[80:84], "little"), (len(data) - 84) // 50
    if len(data) > 84 and b"facet" not in data[:1000].lower() and length < count:
        fault = Fault(f"the file is cut off: {length} of its {count} triangles are there", str(path), hint=_EXPORT)
        raise InputError([fault])


def _merged(corners: np.typing.NDArray[np.float64]) -> Triangles:
    points = np.ascontiguousarray(corners.reshape(-1, 3))
    grid = _ALIKE * max(float(np.abs(points).max()), 1e-300)
    # adding 0 turns -0 into 0, whose bits differ
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
