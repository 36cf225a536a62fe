"""A job file as a tree of nodes: texts with their place in the file, before they are read as values."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from metrocli.errors import Fault
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Source:
    """The text a node came from: a file, or an option of the command line."""

    file: str
    lines: tuple[str, ...]
    folder: Path
    """Folder from which relative paths start."""


@dataclass(frozen=True)
class Node:
    """One value of a job file with its place; a scalar is kept as the text in the file."""

    kind: Literal["scalar", "list", "mapping"]
    source: Source
    path: str = ""
    """Keys from the root, such as `camera.estimate`."""
    text: str = ""
    quoted: bool = False
    items: tuple[Node, ...] = ()
    entries: tuple[tuple[Node, Node], ...] = ()
    """Keys and values of a mapping, in the order of the file."""
    line: int | None = None
    column: int | None = None
    part: str = ""
    """The part of a campaign whose values stand in the text, and where they are listed"""

    @property
    def empty(self) -> bool:
        """Whether nothing, or an explicit null, is written after the key."""
        return self.kind == "scalar" and not self.quoted and self.text in ("", "~", "null")

    def fault(self, message: str, hint: str | None = None) -> Fault:
        """Return a fault at the place of this node."""
        lines = self.source.lines
        shown = lines[self.line - 1] if self.line is not None and self.line <= len(lines) else None
        text = f"{message} (for {self.part})" if self.part else message
        return Fault(text, self.source.file, self.line, self.column, shown, hint)

    def get(self, key: str) -> Node | None:
        """Return the value of a key, or None if the key is absent."""
        return next((value for name, value in self.entries if name.text == key), None)

    def at(self, path: str) -> Node:
        """Return the node at a path such as `camera.f`, or the deepest one that exists on the way."""
        node = self
        for key in path.split(".") if path else ():
            below = node.get(key)
            if below is None:
                return node
            node = below
        return node


def values_in(node: Node) -> int:
    """Return how many values a node holds, itself included."""
    return 1 + sum(map(values_in, node.items)) + sum(1 + values_in(value) for _, value in node.entries)


def with_paths(node: Node, path: str = "") -> Node:
    """Return a tree whose nodes hold their paths, such as `camera.estimate[2]`."""
    below = f"{path}." if path else ""
    items = tuple(with_paths(item, f"{path}[{n}]") for n, item in enumerate(node.items, 1))
    entries = tuple((replace(key, path=path), with_paths(value, below + key.text)) for key, value in node.entries)
    return replace(node, path=path, items=items, entries=entries)


def without_lines(node: Node) -> Node:
    """Return a tree without lines and columns, for a value from the command line."""
    items = tuple(without_lines(item) for item in node.items)
    entries = tuple((without_lines(key), without_lines(value)) for key, value in node.entries)
    return replace(node, items=items, entries=entries, line=None, column=None)


def node_of(like: Node, value: Any) -> Node:
    """Return texts, lists and mappings of texts as a node, at the place of another."""
    if isinstance(value, Mapping):
        entries = tuple((node_of(like, key), node_of(like, item)) for key, item in value.items())
        return replace(like, kind="mapping", text="", entries=entries, items=())
    if isinstance(value, list):
        return replace(like, kind="list", text="", entries=(), items=tuple(node_of(like, item) for item in value))
    return replace(like, kind="scalar", text=value, entries=(), items=())


def with_entry(node: Node, path: Sequence[str], value: str | Sequence[str]) -> Node:
    """Return a mapping with a value at a path of keys; an empty value is left out."""
    key, below = path[0], path[1:]
    old = node.get(key) or replace(node, kind="mapping", text="", entries=(), items=())
    new = with_entry(old, below, value) if below else node_of(node, value)
    others = [(name, held) for name, held in node.entries if name.text != key]
    return replace(node, entries=(*others, *([(node_of(node, key), new)] if below or value else [])))


def relocated(node: Node, old: Path, new: Path) -> Node:
    """Return a node with its paths, relative to `old`, rewritten relative to `new`."""
    if os.path.abspath(old) == os.path.abspath(new) or (node.kind == "scalar" and Path(node.text).is_absolute()):
        return node
    if node.kind == "scalar":
        return replace(node, text=Path(os.path.relpath(old / node.text, new)).as_posix())
    items = (relocated(item, old, new) for item in node.items)
    entries = ((key, relocated(value, old, new)) for key, value in node.entries)
    return replace(node, items=tuple(items), entries=tuple(entries))
