"""The record of a result: the job as used, its inputs with checksums, and the verdicts on acceptance criteria."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class InputFile:
    """One file that a job read."""

    path: str
    """Relative to the folder of the job file, with forward slashes."""
    sha256: str
    bytes: int


@dataclass(frozen=True)
class Verdict:
    """One acceptance criterion of a job (`require:`), the value it was applied to, and whether it is met."""

    name: str
    condition: str
    """The condition as written in the job, such as "< 0.01 mm"."""
    value: float
    unit: str
    met: bool


@dataclass(frozen=True)
class Record:
    """What a result file records besides the result, so that it can be traced and repeated."""

    job_text: str
    """Text of the job file as used, after the changes by --set."""
    inputs: tuple[InputFile, ...]
    metrocli_version: str
    created: str
    """Date and time in UTC, ISO 8601."""
    verdicts: tuple[Verdict, ...] = ()
