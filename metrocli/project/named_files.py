"""The files that a job names: found by its settings, YAML files read at once, and those that are missing."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from metrocli.errors import Fault, InputError
from metrocli.formats.file_bytes import FileBytes, read_bytes
from metrocli.frozen import dataclass
from metrocli.imports.cameras import as_yaml
from metrocli.imports.lines import TextLines
from metrocli.nodes import Node
from metrocli.project import yaml_text
from metrocli.settings import (
    BAD,
    At,
    Either,
    FileOf,
    ImageFiles,
    ListOf,
    MapOf,
    MeshFile,
    Section,
    TableFile,
    folders_searched,
    has_wildcards,
    settings_of,
)
from metrocli.words import suggestion


@dataclass(frozen=True)
class Input:
    """One key that names files, mostly under `inputs:`; `held` is the content if it is a YAML file."""

    key: str
    spec: Any
    value: Any
    """A path, a tuple of paths, or a dict of paths."""
    node: Node
    held: Any = None
    bytes: FileBytes | None = None
    """The bytes of the YAML file that `held` was read from"""

    @property
    def paths(self) -> tuple[Path, ...]:
        """All files of this input."""
        if isinstance(self.value, Mapping):
            return tuple(self.value.values())
        return self.value if isinstance(self.value, tuple) else (self.value,)

    @property
    def patterns(self) -> tuple[Path, ...]:
        """The patterns of file names from the folder of the job, such as `../img/*.png`."""
        return tuple(Path(os.path.normpath(node.text)) for node in self._named if has_wildcards(node.text))

    @property
    def searched(self) -> tuple[Path, ...]:
        """The folders whose names decide which files match its patterns."""
        return tuple(folder for node in self._named for folder in folders_searched(node))

    @property
    def _named(self) -> tuple[Node, ...]:
        return (self.node.items or (self.node,)) if isinstance(self.value, tuple) else ()


def inputs_of(root: Node, settings: type, faults: list[Fault]) -> tuple[Input, ...]:
    """Return the inputs of a job whose entries have no fault; YAML files are read and checked at once."""
    inputs = []
    for name, (wanted, _) in settings_of(settings).items():
        for item in _files_in(wanted.spec, root.get(wanted.key), within_inputs=name == "inputs"):
            inputs.append(_with_content(item, faults))
    return tuple(inputs)


def _files_in(spec: Any, node: Node | None, within_inputs: bool = False) -> Iterator[Input]:
    """Yield the entries at a node that name files: keys of `inputs:` by name, all others by path."""
    if node is None or not spec.fits(node):
        return
    if _names_files(spec):
        value = spec.read(node, [])
        if value is not BAD:
            yield Input(node.path, spec, value, node)
    elif isinstance(spec, Section):
        for name, (wanted, _) in settings_of(spec.section).items():
            below = _files_in(wanted.spec, node.get(wanted.key))
            yield from (replace(item, key=name) if within_inputs else item for item in below)
    elif isinstance(spec, At):
        yield from _files_in(spec.spec, node)
    elif isinstance(spec, Either):
        for choice in spec.specs:
            yield from _files_in(choice, node)
    elif isinstance(spec, MapOf | ListOf):
        inner = spec.value if isinstance(spec, MapOf) else spec.item
        for part in node.items or [value for _, value in node.entries]:
            yield from _files_in(inner, part)


def _names_files(spec: Any) -> bool:
    of_a_file = isinstance(spec, TableFile | ImageFiles | FileOf | MeshFile)
    return of_a_file or (isinstance(spec, MapOf) and _names_files(spec.value))


def _with_content(item: Input, faults: list[Fault]) -> Input:
    """Read the YAML file of an input, or that of another program, into its dataclass."""
    path, section, others = item.value, getattr(item.spec, "section", None), getattr(item.spec, "others", ())
    if section is None or path.suffix.lower() not in (".yaml", ".yml", *others) or not path.is_file():
        return item
    try:
        bytes_read = read_bytes(path, "a job file", most=yaml_text.MOST_BYTES)
        text = yaml_text.text_of(bytes_read, str(path))
        if others:
            text = as_yaml(TextLines(str(path), text.splitlines())) or text
        root = yaml_text.parse(text, str(path), path.parent)
    except InputError as error:
        faults.extend(error.faults)
        return item
    return replace(item, held=Section(section).read(root, faults), bytes=bytes_read)


def missing(inputs: Iterable[Input], not_needed: Collection[str], made: Collection[Path]) -> list[Fault]:
    """Return a fault for each input file that does not exist and that no job will write."""
    faults = []
    for item in inputs:
        if isinstance(item.spec, ImageFiles) and item.key not in not_needed:
            for pattern in item.spec.unmatched(item.node):
                message = f"{item.node.path}: no file matches '{pattern.text}'"
                faults.append(pattern.fault(message, f"in {pattern.source.folder}"))
        places = item.node.items or [value for _, value in item.node.entries] or [item.node]
        for n, path in enumerate(item.paths):
            if path.is_file() or item.key in not_needed or absolute(path) in made:
                continue
            place = places[n] if len(places) == len(item.paths) else item.node
            faults.append(place.fault(f"{item.node.path}: {_what_stands_at(path)}: {path}", _missing_hint(path)))
    return faults


def _what_stands_at(path: Path) -> str:
    """Return, in words, what stands where a file is expected."""
    if path.is_dir():
        return "a folder, not a file"
    if path.exists():
        return "a pipe or a device, not a file"
    return "a link that leads nowhere" if path.is_symlink() else "no such file"


def _missing_hint(path: Path) -> str | None:
    """Return a hint for a missing file: a file of nearly the same name, a job to run first, or a missing folder."""
    names = [other.name for other in path.parent.iterdir() if other.is_file()] if path.parent.is_dir() else []
    hint = suggestion(path.name, names)
    if hint.startswith("did you mean"):
        return hint
    if path.suffix == ".h5":
        return "first run the job that writes this result"
    return None if path.parent.is_dir() else f"the folder {path.parent} does not exist"


def absolute(path: Path) -> Path:
    """Return the absolute path of a file in its real folder, so that one file has one path, however it is reached."""
    return Path(os.path.realpath(path.parent)) / path.name
