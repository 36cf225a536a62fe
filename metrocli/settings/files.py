"""Specifications of files that a job names: tables, images, and results of other jobs; their content is read later."""

from __future__ import annotations

import contextlib
import fnmatch
import itertools
import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.settings.values import BAD, OfText, Schema, Spec, refuse


@dataclass(frozen=True)
class TableFile(OfText):
    """A CSV file with a path relative to the job file; `columns` (`table.Columns`) describes what is read from it."""

    columns: Any
    expects = "the path of a CSV file"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        path = _path(self, node, faults)
        if path is not BAD and path.suffix.lower() in (".h5", ".hdf5", ".yaml", ".yml"):
            return refuse(self, node, faults, f"'{node.text}' is not a CSV file")
        return path

    def schema(self) -> Schema:
        return {"type": "string", "minLength": 1}


MOST_FILES = 100_000
"""Most files that a pattern looks through"""


@dataclass(frozen=True)
class ImageFiles:
    """Images beside the job file: a path, a pattern such as img/*.jpg, or a list of these; read as sorted paths."""

    expects = "the path of an image, or a pattern such as img/*.jpg"

    def fits(self, node: Node) -> bool:
        return node.kind == "list" or (node.kind == "scalar" and not node.empty)

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if not self.fits(node) or (node.kind == "list" and not node.items):
            return refuse(self, node, faults)
        each = [_path(self, part, faults) for part in (node.items or (node,))]
        if BAD in each:
            return BAD
        try:
            return tuple(sorted({path for part in (node.items or (node,)) for path in _matches(part)}))
        except TooManyFilesError as error:
            return refuse(self, node, faults, str(error))

    def unmatched(self, node: Node) -> list[Node]:
        """Return the nodes of patterns that match no file."""
        return [part for part in (node.items or (node,)) if not _matches(part)]

    def schema(self) -> Schema:
        text = {"type": "string", "minLength": 1}
        return {"anyOf": [text, {"type": "array", "items": text, "minItems": 1}]}


def has_wildcards(path: Path | str) -> bool:
    """Return whether a path is a pattern."""
    return bool(set(str(path)) & set("*?["))


def _matches(node: Node) -> list[Path]:
    """Return the files that match a pattern; a path without wildcards is returned even if it does not exist."""
    if not has_wildcards(node.text):
        return [path_beside(node)]
    return [_plain(path, node) for path in _glob(node) if path.is_file()]


class TooManyFilesError(ValueError):
    """A pattern looks through more files than a measurement has."""


def folders_searched(node: Node) -> list[Path]:
    """Return the folders whose names decide which files match a pattern, none of a path without wildcards."""
    searched: list[Path] = []
    for _ in _glob(node, searched) if has_wildcards(node.text) else ():
        pass
    return [path for path in dict.fromkeys(searched) if path.is_dir()]


def _glob(node: Node, searched: list[Path] | None = None) -> Iterable[Path]:
    """Yield the paths that match a pattern, existing or not; folders that decide which are added to `searched`."""
    pattern, seen = Path(node.text), itertools.count(1)
    searched = [] if searched is None else searched

    def looked_at(name: str) -> str:
        if next(seen) > MOST_FILES:
            raise TooManyFilesError(f"the pattern '{node.text}' looks through more than {MOST_FILES} files")
        return name

    if pattern.is_absolute():
        return _matching(Path(pattern.anchor), pattern.parts[1:], looked_at, searched)
    return _matching(node.source.folder, pattern.parts, looked_at, searched)


def _matching(
    folder: Path, parts: tuple[str, ...], looked_at: Callable[[str], str], searched: list[Path]
) -> Iterator[Path]:
    """Yield the paths below a folder that match the parts of a pattern; `**` stands for any number of folders."""
    if not parts:
        yield folder
        return
    first, rest = parts[0], parts[1:]
    if searched or has_wildcards(first):
        searched.append(folder)
    if not has_wildcards(first):
        yield from _matching(folder / first, rest, looked_at, searched)
        return
    if first == "**":
        yield from _matching(folder, rest, looked_at, searched)
    with contextlib.suppress(OSError):
        for name in sorted(map(looked_at, os.listdir(folder))):
            below = folder / name
            if first == "**":
                if below.is_dir() and not below.is_symlink():
                    yield from _matching(below, parts, looked_at, searched)
            elif name.startswith(".") and not first.startswith("."):
                continue  # hidden, as a shell has it: `*` is not for .gitkeep, nor for ._view01.jpg
            elif fnmatch.fnmatchcase(name, first) and (not rest or below.is_dir()):
                yield from _matching(below, rest, looked_at, searched)


ANY_KIND = ("any kind of job",)
"""For `FileOf`: results of all kinds of job are accepted"""


@dataclass(frozen=True)
class FileOf(OfText):
    """The result of another job (.h5), or a YAML file with the same data written by hand."""

    results: tuple[str, ...] = ()
    """Kinds of job whose results are accepted."""
    section: type | None = None
    """The dataclass that a YAML file is read into."""
    others: tuple[str, ...] = ()
    """Endings of files of other programs that are read into it, too."""

    @property
    def expects(self) -> str:
        kinds = [f"the .h5 result of {' or '.join(self.results)}"] if self.results else []
        return ", or ".join(kinds + (["a .yaml file"] if self.section else []))

    def read(self, node: Node, faults: list[Fault]) -> Any:
        path = _path(self, node, faults)
        endings = ((".h5", ".hdf5") if self.results else ()) + ((".yaml", ".yml") if self.section else ())
        endings += self.others
        if path is not BAD and path.suffix.lower() not in endings:
            return refuse(self, node, faults, f"'{node.text}' does not end in {' or '.join(endings)}")
        return path

    def schema(self) -> Schema:
        return {"type": "string", "minLength": 1}


@dataclass(frozen=True)
class MeshFile(OfText):
    """A mesh of triangles, with a path relative to the job file."""

    expects = "the path of a mesh (.stl, .ply, .obj)"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        path = _path(self, node, faults)
        if path is not BAD and path.suffix.lower() not in (".stl", ".ply", ".obj"):
            return refuse(self, node, faults, f"'{node.text}' does not end in .stl, .ply or .obj")
        return path

    def schema(self) -> Schema:
        return {"type": "string", "minLength": 1}


def _path(spec: Spec, node: Node, faults: list[Fault]) -> Any:
    if node.kind != "scalar" or node.empty or not node.text.strip() or "\0" in node.text:
        return refuse(spec, node, faults)
    try:
        return path_beside(node)
    except InputError as error:
        faults.extend(error.faults)
        return BAD


def path_beside(node: Node) -> Path:
    """Return the path that a node names, relative to the folder of the job file.

    The path is normalised (no `..` in the middle), so that two jobs record the same file under the same path. Raises
    InputError where a link before `..` makes that another file.
    """
    return _plain(node.source.folder / node.text, node)


def _plain(path: Path, node: Node) -> Path:
    plain = Path(os.path.normpath(path))
    with contextlib.suppress(OSError):
        if ".." in path.parts and not os.path.samefile(path, plain):
            there = os.path.realpath(path)
            message = f"{node.path}: '{node.text}' leads through a link to {there}, without it to {plain}"
            raise InputError([node.fault(message, "name the file that is meant by a path without '..'")])
    return plain
