"""The job adjusted with the effects that a search named, which a diagnosis needs more than once.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from metrocli.adjust.model.observations import Mask
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.extended_fit import extended_fit
from metrocli.diagnosis.selection.confidence_set import NamedEffect
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class FitOfNames:
    """A job, adjusted to some of its readings with named effects in its model."""

    job: AdjustedJob
    names: Sequence[NamedEffect]
    kept: Mapping[str, Mask]
    fit: AdjustedJob | None
    """The adjusted job; None without names, or if the adjustment fails"""

    @classmethod
    def of(cls, job: AdjustedJob, names: Sequence[NamedEffect], kept: Mapping[str, Mask]) -> FitOfNames:
        """Return the job adjusted to the kept readings."""
        return cls(job, names, kept, extended_fit(job, names, kept) if names else None)

    def or_of(self, job: AdjustedJob, names: Sequence[NamedEffect], kept: Mapping[str, Mask]) -> FitOfNames:
        """Return this fit if it is of the same job, effects and readings, otherwise a new one."""
        same = job is self.job and len(names) == len(self.names)
        same = same and all(one.is_at(other) for one, other in zip(names, self.names, strict=True))
        same = same and all(np.array_equal(mask, self.kept[name]) for name, mask in kept.items())
        return self if same else FitOfNames.of(job, names, kept)
