"""What stands beside a result: its diagnosis, the result before an extension, and the files it was made from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from metrocli.result import Result


@dataclass(frozen=True)
class Node:
    """A file in a lineage."""

    name: str
    kind: str
    """Kind of the job that made it; empty for a file that no job made"""
    sound: bool
    """Whether it is as it was read, and fit for use"""
    needs: tuple[str, ...]
    """Names of the files that it was made from"""


@dataclass(frozen=True)
class Beside:
    """What figures take beside the result; by default nothing."""

    diagnosis: Mapping[str, Any] | None = None
    """Output of `metrocli diagnose --json` for the job of the result"""
    before: Result | None = None
    """Result of the job without its extension"""
    lineage: tuple[Node, ...] = ()
    """The result itself first"""


ALONE = Beside()
