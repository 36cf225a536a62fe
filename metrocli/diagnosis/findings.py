"""What a diagnosis finds: effects with their sizes and gains, outliers, remaining structure, and the verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.cross_validation import Gain
from metrocli.diagnosis.detectability import Design
from metrocli.diagnosis.extended_fit import (
    Size,
)
from metrocli.diagnosis.mistakes import Mistaken
from metrocli.diagnosis.noise import Noise, Unit
from metrocli.diagnosis.residual_structure import (
    PureError,
    RemainingStructure,
)
from metrocli.diagnosis.selection.confidence_set import NamedEffect


class Verdict(StrEnum):
    """What a diagnosis comes to."""

    CLEAN = "clean"
    """The residuals are what the noise predicts."""
    EXPLAINED = "explained"
    """The named effects leave nothing structured."""
    INDISTINCT = "indistinct"
    """An effect is there, and others explain the readings as well."""
    UNEXPLAINED = "unexplained"
    """Structure remains that no known effect explains."""


@dataclass(frozen=True)
class Outlier:
    """A reading that is wrong."""

    keys: Mapping[str, str]
    test: float
    """By how many standard deviations it is off, given all else that was found"""


@dataclass(frozen=True)
class Finding:
    """One effect that was named."""

    effect: NamedEffect
    sizes: tuple[Size, ...]
    gain: Gain
    shift: float
    """By how much what is delivered changes with it, at most"""
    other_shape_from: float
    """Share of its size from which on a cause of another shape would have shown beside it (80 % power)"""


@dataclass(frozen=True)
class Diagnosis:
    """What the model of a job gets wrong."""

    job: AdjustedJob
    noise: Noise
    noisier_units: tuple[Unit, ...]
    outliers: tuple[Outlier, ...]
    findings: tuple[Finding, ...]
    left: RemainingStructure | None
    before: float
    """Level of the strongest structure before anything was named, counted over all that was tried"""
    after: float
    """Level of the strongest smooth structure left"""
    design: Design
    separate_by: tuple[str, ...]
    adjusts: bool = True
    """Whether the job can be adjusted with what was named"""
    together: Gain | None = None
    """What all that was named gains, where it is more than one"""
    repeats: PureError | None = None
    """What repeated readings say of the noise, where there are any"""
    mistaken: Mistaken | None = None
    """A mistake in the files, without which all else was found"""

    @property
    def verdict(self) -> Verdict:
        """What the report says first."""
        if self.left is not None:
            return Verdict.UNEXPLAINED
        sets: list[tuple[object, ...]] = [finding.effect.rivals for finding in self.findings]
        if self.mistaken is not None:
            sets.append(self.mistaken.mistakes[1:])
        if not sets:
            return Verdict.CLEAN
        return Verdict.INDISTINCT if any(sets) else Verdict.EXPLAINED
