"""Where a result comes from: the job as used, its inputs by content, and how its acceptance criteria came out."""

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
    """One acceptance criterion of a job (`require:`) and how it came out."""

    name: str
    condition: str
    """As written, such as "< 0.01 mm"."""
    value: float
    unit: str
    met: bool


@dataclass(frozen=True)
class Record:
    """What a result file holds besides the result."""

    job_text: str
    """The job file as used, after --set."""
    inputs: tuple[InputFile, ...]
    metrocli_version: str
    created: str
    """UTC, ISO 8601."""
    verdicts: tuple[Verdict, ...] = ()
