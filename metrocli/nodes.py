"""A job file as a plain tree: text with its place, not yet numbers, words or paths."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from metrocli.errors import Fault


@dataclass(frozen=True)
class Source:
    """The text a node came from: a file, or an option of the command line."""

    file: str
    lines: tuple[str, ...]
    folder: Path
    """Where relative paths start."""


@dataclass(frozen=True)
class Node:
    """One value of a job file with its place; its text is not yet a number, a word or a path."""

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

    @property
    def empty(self) -> bool:
        """Nothing is written after the key."""
        return self.kind == "scalar" and not self.quoted and self.text in ("", "~", "null")

    def fault(self, message: str, hint: str | None = None) -> Fault:
        """Return a fault at this place."""
        lines = self.source.lines
        shown = lines[self.line - 1] if self.line is not None and self.line <= len(lines) else None
        return Fault(message, self.source.file, self.line, self.column, shown, hint)

    def get(self, key: str) -> Node | None:
        """Return the value of a key, None where it is absent."""
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
