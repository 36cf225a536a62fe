"""What a page of a result holds, beside the result itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any

from metrocli.frozen import dataclass
from metrocli.plots.beside import ALONE, Beside
from metrocli.record import Record
from metrocli.result import Result


@dataclass(frozen=True)
class Diagnosis:
    """What `metrocli diagnose --json` printed for the job of a result."""

    data: Mapping[str, Any]
    path: str
    of_this: bool
    """Whether it is the diagnosis of this job with these inputs"""


@dataclass(frozen=True)
class Content:
    """A result with what its page shows of it."""

    result: Result
    record: Record
    path: str
    tables: Mapping[str, str] = field(default_factory=dict)
    """Shown tables as text"""
    diagnosis: Diagnosis | None = None
    job: str = "JOB.yaml"
    """How commands name the job"""
    beside: Beside = ALONE
    """What figures show beside the result"""
    stated: Result | None = None
    """The result in the units of its estimates on the page; the result itself unless given"""
