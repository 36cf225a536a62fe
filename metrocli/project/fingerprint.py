"""Digests of what jobs and files mean: equal for equal values, whatever the comments, order of keys and notation.

docs/decisions/080-up-to-date-by-fingerprint.md has what counts as a change.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Mapping, Set
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from numbers import Number
from pathlib import Path
from typing import Any

from metrocli import __version__
from metrocli.nodes import Node
from metrocli.project.job import JobFile
from metrocli.project.requirements import Requirement
from metrocli.record import CriterionVerdict, InputFile, Record
from metrocli.result import Result
from metrocli.table import Table, ascii_letters

_FOR_MESSAGES = ("node", "source", "file")
"""Fields of settings that hold places for messages"""


def of_job(job: JobFile) -> str:
    """Return the digest of a job as meant: its settings in internal units, effects, criteria and output.

    Packages whose effects it uses count as they are installed. The content of the inputs is not part of it, but their
    names are: of images the pattern.
    """
    apart = ("effects", "effects_from", "output", "parts")
    heading = {name: value for name, value in _named(job.heading) if name not in apart and value is not None}
    heading |= {"require": _by_name(job.heading.require)}
    effects = [
        (effect.name, [form.by for form in effect.forms], effect.where, effect.values, effect.std)
        for effect in job.effects
    ]
    output = os.path.relpath(job.output, job.folder)
    images = [item.node for item in job.inputs if isinstance(item.value, tuple)]
    packages = [package.state for package in job.packages]
    return digest([heading, job.settings, images, effects, output, *packages], job.folder)


def of_diagnosed(job_text: str, inputs: Iterable[InputFile]) -> dict[str, str]:
    """Return the digest of a job as used, and that of its inputs, by which a diagnosis and a result are matched."""
    files = "\n".join(sorted(f"{item.sha256} {item.path}" for item in inputs))
    return {"job_sha256": _sha256(job_text), "inputs_sha256": _sha256(files)}


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def of_table(table: Table) -> str:
    """Return the digest of the cells of a table, in internal units, and of the names of unused columns.

    Lines, comments and the order of columns do not count. An unused column gives the result a warning.
    """
    unused = [line.removeprefix(table.file) for line in table.warnings]
    return digest([table.columns, table.units, *unused])


def of_result(result: Result, record: Record) -> str:
    """Return the digest of a result: its values, whether it is fit for use, and what its inputs hold.

    When and by which version it was made does not count, nor the text of its job.
    """
    skipped = ("list_offset", "made_from", "tables")
    values = {name: value for name, value in _named(result) if name not in skipped}
    tables = {name: (table.columns, table.units) for name, table in result.tables.items()}
    verdicts = _by_name(record.verdicts)
    return digest([values, tables, verdicts, record.doubts, sorted(file.content for file in record.inputs)])


def same_version(made_by: str) -> bool:
    """Return whether another version of metrocli gives the same results: releases differ in the last number only."""
    return made_by.split(".")[:2] == __version__.split(".")[:2]


def changed_inputs(before: Iterable[InputFile], now: Iterable[InputFile], content: Callable[[str], str]) -> list[str]:
    """Return a phrase for each input that is not what it was.

    `content` returns the digest of the content of a path as read now; it is called only where the bytes differ.
    """
    known, present = ({file.path: file for file in files} for files in (before, now))
    changed = [
        f"input {path} changed ({_short(known[path])} -> {_short(file)})"
        for path, file in present.items()
        if path in known and file.sha256 != known[path].sha256 and content(path) != known[path].content
    ]
    changed += [f"input {path} is new" for path in present if path not in known]
    return changed + [f"input {path} is gone" for path in known if path not in present]


def _short(file: InputFile) -> str:
    return f"{file.bytes} bytes, sha256 {file.sha256[:8]}"


def changed_settings(before: Node, now: Node) -> list[str]:
    """Return a phrase for each value that two texts of a job state differently, such as `noise: 1 um -> 2 um`."""
    old, new = dict(_leaves(before)), dict(_leaves(now))
    changed = [f"{path}: {old[path]} -> {text}" for path, text in new.items() if old.get(path, text) != text]
    changed += [f"{path}: {text} is new" for path, text in new.items() if path not in old]
    return changed + [f"{path}: {text} is gone" for path, text in old.items() if path not in new]


def _leaves(node: Node) -> Iterable[tuple[str, str]]:
    for below in (*node.items, *(value for _, value in node.entries)):
        yield from _leaves(below)
    if node.kind == "scalar":
        yield node.path, node.text


def _by_name(criteria: Iterable[Requirement | CriterionVerdict]) -> list[Requirement | CriterionVerdict]:
    """Return criteria so that the order of the names in `require:` does not count; those of one name stay in order."""
    return sorted(criteria, key=lambda file: file.name)


def _named(value: Any) -> Iterable[tuple[str, Any]]:
    return ((field.name, getattr(value, field.name)) for field in fields(value))


def digest(value: Any, folder: Path = Path()) -> str:
    """Return the SHA-256 of a value made of dataclasses, mappings, sequences, arrays, texts and numbers.

    The order of keys does not count; paths count relative to `folder`. Raises TypeError for anything else.
    """
    sha = hashlib.sha256()
    _add(value, sha.update, folder)
    return sha.hexdigest()


_FORMS: dict[str, Callable[[type], bool]] = {
    "scalar": lambda kind: kind in (str, type(None)) or issubclass(kind, (Enum, Number, bytes)),
    "list": lambda kind: issubclass(kind, (list, tuple)),
    "path": lambda kind: issubclass(kind, Path),
    "node": lambda kind: issubclass(kind, Node),
    "fields": is_dataclass,
    "mapping": lambda kind: issubclass(kind, Mapping),
    "set": lambda kind: issubclass(kind, Set),
    "array": lambda kind: hasattr(kind, "tobytes"),
}
"""What a digest has of values of a type; the first form that fits counts"""


@cache
def _form(kind: type) -> str:
    return next((name for name, fits in _FORMS.items() if fits(kind)), "")


def _add(value: Any, add: Callable[[bytes], object], folder: Path) -> None:
    """Feed a value to a digest, each part with its type and length, so that no two values give the same bytes."""
    kind: type = type(value)
    form = _form(kind)
    if form == "scalar":
        text = value if isinstance(value, bytes) else repr(value).encode()
        add(f"{kind.__name__}{len(text)}:".encode() + text)
    elif form == "list":
        if value and all(isinstance(item, Path) for item in value):
            value = ()  # the images that a pattern matches, which are inputs with a digest of their own
        add(f"list{len(value)}:".encode())
        for item in value:
            _add(item, add, folder)
    elif form == "path":
        _add(Path(os.path.relpath(value, folder)).as_posix(), add, folder)
    elif form == "node":
        _add([value.kind, value.text, value.items, {key.text: below for key, below in value.entries}], add, folder)
    elif form == "fields":
        kept = {name: getattr(value, name) for name in _meant(kind)}
        _add([kind.__qualname__, kept], add, folder)
    elif form == "mapping":
        add(f"list{len(value)}:".encode())
        for key in sorted(value, key=str):
            name = repr(str(key)).encode()
            add(b"list2:str%d:%b" % (len(name), name))  # as of a list of pairs, without making one
            _add(value[key], add, folder)
    elif form == "set":
        _add(sorted(value, key=str), add, folder)
    elif form == "array":
        words = value.dtype.kind == "U"  # whose bytes depend on the longest of them
        data = _joined(value) if words else value.tobytes()
        add(f"array{'text' if words else value.dtype.str}{value.shape}{len(data)}:".encode() + data)
    elif callable(value):
        _add(f"{value.__module__}.{value.__qualname__}", add, folder)
    else:
        raise TypeError(f"a {kind.__name__} has no digest")


def _joined(texts: Any) -> bytes:
    """Return texts joined by zeros."""
    letters = ascii_letters(texts)
    if letters is None:
        return "\0".join(texts.tolist()).encode()
    import numpy as np

    kept = np.pad(letters, ((0, 0), (0, 1)), constant_values=0)
    used = kept != 0
    used[:-1, -1] = True
    return bytes(kept[used])


@cache
def _meant(kind: type) -> tuple[str, ...]:
    """Return the fields of a dataclass that count."""
    return tuple(field.name for field in fields(kind) if field.name not in _FOR_MESSAGES and field.name[0] != "_")
