"""Job files: YAML text to a frozen JobFile; all faults are reported at once."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from metrocli import tasks
from metrocli.effects import wanted as effects
from metrocli.effects.wanted import Wanted
from metrocli.errors import Fault, InputError, UsageError
from metrocli.formats.file_bytes import FileBytes, read_bytes
from metrocli.nodes import Node
from metrocli.project import yaml_text
from metrocli.project.campaign import KEY as CAMPAIGN
from metrocli.project.campaign import Part, bound, parts_of
from metrocli.project.heading import Heading
from metrocli.project.overrides import effect_node, overridden
from metrocli.project.own_effects import Own, own_effects
from metrocli.project.ranges import ranges_of, within
from metrocli.settings import (
    BAD,
    At,
    Either,
    FileOf,
    ImageFiles,
    ListOf,
    MapOf,
    MeshFile,
    Schema,
    Section,
    TableFile,
    read_sections,
    sections_schema,
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


@dataclass(frozen=True)
class JobFile:
    """A job file that has no faults."""

    file: Path
    """As the user named it."""
    heading: Heading
    settings: Any
    inputs: tuple[Input, ...]
    output: Path
    text: str
    """The text of the job as used, after --set."""
    root: Node
    effects: tuple[Wanted, ...] = ()
    wishes: Wishes = field(default_factory=lambda: Wishes())
    """What the command line asked for when it was loaded"""

    own: Own = field(default_factory=Own)
    """Effects of one's own, which extend the table of the kind"""

    @property
    def files(self) -> tuple[Path, ...]:
        """All files that it reads beside its own text: inputs, and effects of one's own."""
        return (*(path for item in self.inputs for path in item.paths), *self.own.files)

    @property
    def accept_doubtful(self) -> bool:
        """Whether results that are doubtful, or do not meet their requirements, are accepted as inputs."""
        return self.wishes.accept_doubtful

    @property
    def kind(self) -> str:
        """The kind of the job."""
        return self.heading.job

    @property
    def folder(self) -> Path:
        """The folder to which paths in the job are relative."""
        return self.file.parent


@dataclass(frozen=True)
class Wishes:
    """What the command line asks for beyond the job file."""

    overrides: tuple[str, ...] = ()
    """The values of --set, each `key.path=value`"""
    output: Path | None = None
    kind: str | None = None
    """The kind of the command, None for any"""
    made: Collection[Path] = ()
    """Absolute paths of results that other jobs will write"""
    not_needed: Collection[str] = ()
    """Keys of inputs whose files may be missing"""
    effects: tuple[str, ...] = ()
    """The values of --effect, each `NAME:key=value,...`"""
    accept_doubtful: bool = False
    text: str | None = None
    """The text of the job, where it is not that of its file"""
    part: Part | None = None
    """The part that a job is loaded for, if its file is for many"""


def load(path: Path, wishes: Wishes | None = None) -> JobFile:
    """Return a job.

    Raises InputError with all faults of the file and its YAML inputs, UsageError if the job is of another kind.
    """
    wishes = wishes or Wishes()
    faults: list[Fault] = []
    root, text = _root(path, wishes.overrides, faults, wishes.text)
    if wishes.part is not None:
        root = bound(root, wishes.part)
        text = f"# {path.name}, for {wishes.part.name}\n{yaml_text.emit(root)}"
    elif root.get(CAMPAIGN) is not None:
        hint = "name it in a project (metrocli.yaml) and use: metrocli run PROJECT --only JOB[PART]"
        raise InputError([root.at(CAMPAIGN).fault("this file is a job for each of many parts", hint)])
    more = tuple(effect_node(effect, path.parent) for effect in wishes.effects)
    kind = _kind(root, path, wishes.kind)
    if kind is None:
        read_sections(_only(root, settings_of(Heading)), (Heading,), faults)
        raise InputError(_in_order(faults))
    section = tasks.KINDS[kind].settings()
    heading, settings = read_sections(root, (Heading, section), faults)
    named = (*(heading.effects if heading is not BAD else ()), *more)
    own = Own() if heading is BAD else own_effects(kind, heading.define, heading.effects_from, path, faults)
    wanted = effects.read((*tasks.KINDS[kind].task().effects, *own.effects), named, faults) if named else ()
    inputs = _inputs(root, section, faults)
    if heading is not BAD and heading.ranges:
        ranges = ranges_of(heading.ranges, [item.spec for item in inputs], faults)
        inputs = tuple(replace(item, spec=within(item.spec, ranges)) for item in inputs)
    faults.extend(_missing(inputs, wishes))
    if faults:
        raise InputError(_in_order(faults))
    output = wishes.output or heading.output or path.parent / "results" / f"{path.stem}.h5"
    if os.path.realpath(output) in {os.path.realpath(file) for item in inputs for file in item.paths}:
        raise InputError([root.at("output").fault(f"the output {output} is one of the inputs", "name another output")])
    return JobFile(path, heading, settings, inputs, output, text, root, wanted, wishes, own)


def load_parts(path: Path, wishes: Wishes) -> list[JobFile]:
    """Return the job of a file, or one for each part if it is for many; raises as `load`."""
    parts = parts_of(_root(path, wishes.overrides, [])[0])
    return [load(path, replace(wishes, part=part)) for part in parts] or [load(path, wishes)]


def absolute(path: Path) -> Path:
    """Return the absolute path of a file in its real folder, so that one file has one path, however it is reached."""
    return Path(os.path.realpath(path.parent)) / path.name


def kind_of_job(path: Path) -> str | None:
    """Return the kind of a job file, or None if it names no known kind."""
    return _kind(_root(path, (), [])[0], path, None)


def _root(path: Path, overrides: Sequence[str], faults: list[Fault], text: str | None = None) -> tuple[Node, str]:
    """Return the tree of a job file with the overrides applied, and the equivalent YAML text.

    A fault for each repeated key is added to `faults`.
    """
    text = yaml_text.read_text(path, str(path)) if text is None else text
    root = yaml_text.parse(text, str(path), path.parent, faults)
    if root.kind != "mapping":
        raise InputError([root.fault("a job file must be a mapping of keys", "write 'metrocli: 1', 'job: KIND', ...")])
    for override in overrides:
        root = overridden(root, override, path.parent)
    if overrides:
        text = f"# as used, with {', '.join(f'--set {override}' for override in overrides)}\n{yaml_text.emit(root)}"
    return root, text


def _kind(root: Node, path: Path, wanted: str | None) -> str | None:
    """Return the kind of a job, or None if it is unknown; raise UsageError if it is not the `wanted` one."""
    node = root.get("job")
    kind = node.text if node is not None and node.kind == "scalar" and node.text in tasks.KINDS else None
    if kind is not None and wanted not in (None, kind):
        raise UsageError(f"{path} is a job of the kind {kind}; use: metrocli {kind} {path}")
    return kind


def _only(root: Node, keys: Iterable[str]) -> Node:
    return replace(root, entries=tuple(entry for entry in root.entries if entry[0].text in keys))


def _in_order(faults: Iterable[Fault]) -> list[Fault]:
    return sorted(faults, key=lambda fault: (fault.file, fault.line or 0, fault.column or 0))


def _inputs(root: Node, settings: type, faults: list[Fault]) -> tuple[Input, ...]:
    """Return the inputs of a job whose entries have no fault; YAML files are read and checked at once."""
    found = []
    for name, (wanted, _) in settings_of(settings).items():
        for item in _files_in(wanted.spec, root.get(wanted.key), within_inputs=name == "inputs"):
            found.append(_with_content(item, faults))
    return tuple(found)


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
        for one in spec.specs:
            yield from _files_in(one, node)
    elif isinstance(spec, MapOf | ListOf):
        inner = spec.value if isinstance(spec, MapOf) else spec.item
        for part in node.items or [value for _, value in node.entries]:
            yield from _files_in(inner, part)


def _names_files(spec: Any) -> bool:
    of_a_file = isinstance(spec, TableFile | ImageFiles | FileOf | MeshFile)
    return of_a_file or (isinstance(spec, MapOf) and _names_files(spec.value))


def _with_content(item: Input, faults: list[Fault]) -> Input:
    """Read the YAML file of an input into its dataclass."""
    path, section = item.value, getattr(item.spec, "section", None)
    if section is None or path.suffix not in (".yaml", ".yml") or not path.is_file():
        return item
    try:
        bytes_read = read_bytes(path, "a job file", most=yaml_text.MOST_BYTES)
        root = yaml_text.parse(yaml_text.text_of(bytes_read, str(path)), str(path), path.parent)
    except InputError as error:
        faults.extend(error.faults)
        return item
    return replace(item, held=Section(section).read(root, faults), bytes=bytes_read)


def _missing(inputs: Iterable[Input], wishes: Wishes) -> list[Fault]:
    """Return a fault for each input file that does not exist and that no job will write."""
    faults = []
    for item in inputs:
        if isinstance(item.spec, ImageFiles) and item.key not in wishes.not_needed:
            for pattern in item.spec.unmatched(item.node):
                message = f"{item.node.path}: no file matches '{pattern.text}'"
                faults.append(pattern.fault(message, f"in {pattern.source.folder}"))
        places = item.node.items or [value for _, value in item.node.entries] or [item.node]
        for n, path in enumerate(item.paths):
            if path.is_file() or item.key in wishes.not_needed or absolute(path) in wishes.made:
                continue
            found = "a folder, not a file" if path.is_dir() else "no such file"
            place = places[n] if len(places) == len(item.paths) else item.node
            faults.append(place.fault(f"{item.node.path}: {found}: {path}", _missing_hint(path)))
    return faults


def _missing_hint(path: Path) -> str | None:
    """Return a hint for a missing file: a file of nearly the same name, a job to run first, or a missing folder."""
    names = [other.name for other in path.parent.iterdir() if other.is_file()] if path.parent.is_dir() else []
    hint = suggestion(path.name, names)
    if hint.startswith("did you mean"):
        return hint
    if path.suffix == ".h5":
        return "first run the job that writes this result"
    return None if path.parent.is_dir() else f"the folder {path.parent} does not exist"


def schema(kind: str) -> Schema:
    """Return the JSON schema (2020-12) of a kind of job, for editors."""
    own = sections_schema((Heading, tasks.KINDS[kind].settings()))
    own["properties"]["effects"] |= effects.schema(tasks.KINDS[kind].task().effects)
    own["properties"]["job"] = {"const": kind, "description": "kind of job"}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"metrocli {kind}", **own}
