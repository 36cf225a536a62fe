"""The record of a result: the job as used, its inputs with checksums, and whether the result may be used."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from pathlib import Path
from typing import Any

from metrocli.frozen import dataclass

DONE, FAIL, DOUBTFUL, UNMET = "done", "fail", "doubtful", "requirements not met"
"""The status of a result; `fail` is a sound result of something that is out of tolerance"""
USABLE = (DONE, FAIL)
"""Results that other jobs and exports use"""
PASS, GUARD_BAND = "pass", "in the guard band"
"""With FAIL, the decisions on a tolerance (ISO 14253-1)"""
NOT_MET = 6
"""Exit code of a job that is done but is doubtful or does not meet an acceptance criterion"""


@dataclass(frozen=True)
class InputFile:
    """One file that a job read."""

    path: str
    """Relative to the folder of the job file, with forward slashes."""
    sha256: str
    bytes: int
    content: str = ""
    """Digest of its content as values are read from it: the cells of a table, the numbers of a result."""


@dataclass(frozen=True)
class CriterionVerdict:
    """One acceptance criterion of a job (`require:`), the value it was applied to, and whether it is met."""

    name: str
    condition: str
    """The condition as written in the job, such as "< 0.01 mm"."""
    value: float
    unit: str
    met: bool
    decision: str = ""
    """Of a tolerance: pass, fail, or in the guard band; empty for a criterion of `require:`"""

    def __str__(self) -> str:
        from metrocli.units import as_stated, format_quantity

        outcome = "met" if self.met else "NOT met"
        text = format_quantity(*as_stated(self.value, self.unit, self.condition))
        if self.decision:
            text = f"{self.value:.10g} {'' if self.unit == '1' else self.unit}".strip()
            return f"conformity of {self.name}, {self.condition}: {self.decision} ({text})"
        return f"required {self.name} {self.condition}: {outcome} ({text})"


@dataclass(frozen=True)
class Record:
    """What a result file records besides the result, so that it can be traced and repeated."""

    job_text: str
    """Text of the job file as used, after the changes by --set."""
    inputs: tuple[InputFile, ...]
    metrocli_version: str
    created: str
    """Date and time in UTC, ISO 8601."""
    verdicts: tuple[CriterionVerdict, ...] = ()
    doubts: tuple[str, ...] = ()
    """Why the result must not be used; empty if nothing speaks against it."""
    meaning: str = ""
    """Digest of the job as meant; comments and notation do not change it."""
    content: str = ""
    """Digest of the result, equal for results that come out the same."""
    job_file: str = ""
    """The job file relative to the folder of the result, with forward slashes."""
    certificate: Mapping[str, Any] = field(default_factory=dict)
    """What the job states for a certificate (`certificate:`): texts, and mappings of texts, by key."""
    below: tuple[tuple[str, str], ...] = ()
    """Standards of the results that this one was made from, with certificate numbers; their files have them"""

    def files(self, result: Path) -> tuple[Path, ...]:
        """Return the job file and the inputs, where they were from its result on."""
        job = result.parent / self.job_file
        return (job, *(job.parent / file.path for file in self.inputs)) if self.job_file else ()

    def references(self) -> list[tuple[str, str]]:
        """Return what the result rests on, with certificate numbers.

        Its inputs come first, then standards that are not files, then those of the results among its inputs.
        """
        stated: Mapping[str, str] = self.certificate.get("references", {})
        paths = [file.path for file in self.inputs]
        return [(name, stated.get(name, "")) for name in (*paths, *(name for name in stated if name not in paths))] + [
            *self.below
        ]

    @property
    def status(self) -> str:
        """`doubtful` if anything speaks against the result, else whether criteria and then tolerances are met."""
        if self.doubts:
            return DOUBTFUL
        unmet = [verdict for verdict in self.verdicts if not verdict.met]
        if any(not verdict.decision for verdict in unmet):
            return UNMET
        return FAIL if unmet else DONE

    @property
    def conformity(self) -> str:
        """The worst decision on the tolerances of the job; empty without tolerances."""
        decisions = {verdict.decision for verdict in self.verdicts}
        return next((decision for decision in (FAIL, GUARD_BAND, PASS) if decision in decisions), "")

    @property
    def exit_code(self) -> int:
        """The exit code of the job."""
        return 0 if self.status == DONE else NOT_MET

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the result is not fit for use: its doubts, and the acceptance criteria that are not met."""
        return (*self.doubts, *(str(verdict) for verdict in self.verdicts if not verdict.met and not verdict.decision))
