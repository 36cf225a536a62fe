"""One job text for many parts: `for: {part: parts.csv}`, and `{part}` in its paths, titles and values."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from metrocli.errors import Fault, InputError
from metrocli.formats.csv_text import read_text, taken_apart
from metrocli.formats.file_bytes import FileBytes, read_bytes
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.settings import BAD, Schema, path_beside
from metrocli.table import MOST_FAULTS
from metrocli.words import suggestion

KEY = "for"
_ONE = re.compile(r"(.+\.ya?ml)\[(.+)\]")
_NAME = re.compile(r"\{([^{}\s]+)\}")


@dataclass(frozen=True)
class CampaignPart:
    """What stands for the names in braces in the job of one part."""

    name: str
    """The value that stands for the part itself, such as its serial number"""
    values: Mapping[str, str]
    """By name: the part, and all columns of its list"""
    list: FileBytes | None = None
    """The CSV file with the list as it was read, if there is one"""
    place: str = ""
    """The line of that file, as messages name it"""

    @property
    def shown(self) -> str:
        """The part as messages name it."""
        return f"{self.name}, {self.place}" if self.place else self.name


class ForEach:
    """The value of `for:`, one name with the path of a CSV file that has a column of that name, or with a list."""

    expects = "one name with a CSV file or a list, such as {part: parts.csv} or {part: [A1, A2]}"

    def fits(self, node: Node) -> bool:
        return node.kind == "mapping" and len(node.entries) == 1

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if self.fits(node):
            return node
        faults.append(node.fault(f"{node.path}: this is not a list of parts", f"expected {self.expects}"))
        return BAD

    def schema(self) -> Schema:
        shape: Schema = {"anyOf": [{"type": "string"}, {"type": "array", "minItems": 1}]}
        return {"type": "object", "additionalProperties": shape, "minProperties": 1, "maxProperties": 1}


def parts_of(root: Node) -> tuple[CampaignPart, ...]:
    """Return the parts of a job file, none if it is for one only; raise InputError with the faults of the list."""
    node = root.get(KEY)
    if node is None:
        return ()
    faults: list[Fault] = []
    if ForEach().read(node, faults) is BAD:
        raise InputError(faults)
    (name, value), *_ = node.entries
    parts: dict[str, CampaignPart] = {}
    for part, fault_at in _listed(name.text, value) if value.kind == "list" else _in_file(name.text, value):
        if part.name in parts:
            faults.append(fault_at(f"the {name.text} '{part.name}' is there twice"))
        elif part.name in ("", ".", "..") or set(part.name) & set("/\\") or not part.name.isprintable():
            faults.append(fault_at(f"the {name.text} '{part.name}' cannot be part of a file name"))
        parts[part.name] = part
    if faults:
        raise InputError(faults[:MOST_FAULTS])
    return tuple(parts.values())


def named_part(path: Path, root_of: Callable[[Path], Node]) -> tuple[Path, CampaignPart | None]:
    """Return the file and the part that a path `JOB.yaml[PART]` names, else the path and None.

    Raises InputError if the job has no such part.
    """
    named = None if path.exists() else _ONE.fullmatch(str(path))
    if named is None:
        return path, None
    file, name = Path(named[1]), named[2]
    parts = {part.name: part for part in parts_of(root_of(file))}
    if name not in parts:
        hint = suggestion(name, parts) if parts else f"it is for one part only: it has no '{KEY}:'"
        raise InputError([Fault(f"the job has no part '{name}'", str(file), hint=hint)])
    return file, parts[name]


def stem_of(path: Path, part: CampaignPart | None) -> str:
    """Return the name of a job in those of files made from it: of a job for many parts with the part, `gear.A1`."""
    return f"{path.stem}.{part.name}" if part else path.stem


_Placed = tuple[CampaignPart, Callable[[str], Fault]]
"""A part, and what makes a fault at its place of a message"""


def _listed(name: str, value: Node) -> Iterator[_Placed]:
    if not value.items or any(item.kind != "scalar" for item in value.items):
        raise InputError([value.fault(f"{value.path}: this is not a list of names", f"expected {ForEach.expects}")])
    return ((CampaignPart(item.text, {name: item.text}), item.fault) for item in value.items)


def _in_file(name: str, value: Node) -> Iterator[_Placed]:
    if value.kind != "scalar" or value.empty:
        raise InputError([value.fault(f"{value.path}: there is no list", f"expected {ForEach.expects}")])
    path = path_beside(value)
    held = read_bytes(path, "a CSV file")
    raw = taken_apart(read_text(path, str(path), held), str(path))
    if name not in raw.header:
        raise InputError([raw.fault(f"the column '{name}' is missing", raw.header_line, None, f"{KEY}: names it")])
    twice = [column for column, count in Counter(raw.header).items() if count > 1]
    if twice:
        raise InputError([raw.fault(f"the column '{column}' is there twice", raw.header_line) for column in twice])
    at = raw.header.index(name)
    for line, *cells in zip(raw.numbers, *raw.cells, strict=True):
        row = {column: cell.strip() for column, cell in zip(raw.header, cells, strict=True)}
        yield CampaignPart(row[name], row, held, f"{path}:{line}"), partial(raw.fault, line=line, cell=at)


def bound(root: Node, part: CampaignPart) -> Node:
    """Return the job of one part: without `for:`, and with the values of the part for the names in braces.

    Raises InputError with each name that the list of parts does not have.
    """
    faults: list[Fault] = []
    entries = tuple((key, _bound(value, part, faults)) for key, value in root.entries if key.text != KEY)
    if faults:
        raise InputError(faults)
    return replace(root, entries=entries)


def _bound(node: Node, part: CampaignPart, faults: list[Fault]) -> Node:
    if node.kind == "scalar":
        names = _NAME.findall(node.text)
        faults += [
            node.fault(f"{node.path}: no part has '{{{name}}}'", suggestion(name, part.values))
            for name in names if name not in part.values
        ]  # fmt: skip
        text = _NAME.sub(lambda match: part.values.get(match[1], ""), node.text)
        return replace(node, text=text, part=part.shown) if names else node
    items = tuple(_bound(item, part, faults) for item in node.items)
    return replace(node, items=items, entries=tuple((k, _bound(v, part, faults)) for k, v in node.entries))
