"""Decisions on the tolerances of a job: a result of their own, beside the acceptance criteria of `require:`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from metrocli.record import FAIL, GUARD_BAND, PASS, CriterionVerdict
from metrocli.result import Result

_DECISIONS = {"conforming": PASS, "non-conforming": FAIL}
"""By the zone of ISO 14253-1; in any other zone nothing is shown"""
OVER_LIMIT = "length_error_over_limit"
"""Statistic: the largest error of a calibrated length over its limit (VDI/VDE 2634, acceptance)"""


def decisions(result: Result, reported: bool) -> Iterator[CriterionVerdict]:
    """Yield the decision on each tolerance of a result; where it is only `reported`, each counts as met."""
    for estimate in result.estimates:
        tolerance: Mapping[str, Any] = result.details.get(estimate.name, {}).get("tolerance", {})
        if "zone" in tolerance:
            decided = _DECISIONS.get(tolerance["zone"], GUARD_BAND)
            low, high = tolerance["limits"]
            ends = [f"{end:.10g}" if math.isfinite(end) else "no limit" for end in (low, high)]
            within = f"{' to '.join(ends)} {estimate.unit}".strip()
            yield CriterionVerdict(
                estimate.name, within, estimate.value, estimate.unit, reported or decided != FAIL, decided
            )
    over = result.statistics.get(OVER_LIMIT)
    if isinstance(over, float):
        met, what = over <= 1, "largest over its limit, <= 1"
        yield CriterionVerdict("length measuring errors", what, over, "1", reported or met, PASS if met else FAIL)
