"""Noise of single units, and scatter at all places of a kind, that only stand for a law or an effect.

A search weights noisier units and finds scatters before any law is sought. A law in one unit, such as a fast wave, then
passes for its noise. So the search is held again without them, and the law stays if it explains them. So is it where an
effect is found in a unit that was weighted before.

Method: docs/algorithms/laws.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.laws.search import Law
from metrocli.diagnosis.noise import Unit, noisier_units
from metrocli.diagnosis.selection.all_of_a_kind import log_level_beside
from metrocli.diagnosis.selection.selection_state import Selection
from metrocli.diagnosis.selection.thresholds import LATER


def without_scatter(job: AdjustedJob, units: Sequence[Unit], scattered: Sequence[str]) -> AdjustedJob | None:
    """Return the job without the kinds of noise of some units, and without the scatters of some effects.

    None if there are neither, or if less time is left than the search with them took.
    """
    if not (units or scattered) or job.budget.left() < job.budget.seconds / 2:
        return None
    effects = tuple(replace(one, of_all="") if one.name in scattered else one for one in job.effects)
    return replace(job, effects=effects, even=frozenset(unit.key for unit in units))


def explains_scatter(
    law: Law | None, job: AdjustedJob, selection: Selection, units: Sequence[Unit], scattered: Sequence[str]
) -> bool:
    """Return whether no noise of a unit, where there was some, and no scatter is needed beside a law and named effects.

    `selection` is that of the search without them, in which these were found.
    """
    beside = selection.fitted(without=selection.unknown)
    beside = beside if law is None else beside.with_columns(law.columns)
    if units and noisier_units(job, selection.test_set.system, beside):
        return False
    levels = [log_level_beside(beside, selection.test_set, name) for name in scattered]
    return all(level > np.log(LATER) for level in levels)
