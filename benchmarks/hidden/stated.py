"""What `diagnose` itself states of the least size that it finds."""

from __future__ import annotations

from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.detectability import needed
from metrocli.diagnosis.evidence.measured_job import measurement_of


def stated(adjusted: AdjustedJob, name: str, parameters: int) -> float:
    """Return the squared norm, in standard deviations, at which an effect is said to be found with 80 % power.

    For an effect that is in no table it is that of a family of as many parameters tried for each tracer.
    """
    field = measurement_of(adjusted)
    known = [i for i, family in enumerate(field.families) if family.name == name]
    number = known[0] if known else next(i for i, f in enumerate(field.families) if f.name == "dead-path-drift")
    return needed(field, number, parameters)
