"""Noise of single units, and scatter at all places of a kind, that only stand for a law.

A search weights noisier units and finds scatters before any law is sought. A law in one unit, such as a fast wave, then
passes for its noise. So the search is held again without them, and the law stays if it explains them.

Method: docs/algorithms/laws.md.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.findings import Diagnosis
from metrocli.diagnosis.laws.search import Law
from metrocli.diagnosis.noise import noisier_units
from metrocli.diagnosis.selection.all_of_a_kind import log_level_beside
from metrocli.diagnosis.selection.selection_state import Selection
from metrocli.diagnosis.selection.thresholds import LATER


def without_scatter(job: AdjustedJob, found: Diagnosis) -> AdjustedJob | None:
    """Return the job without the kinds of noise of units, and the scatters, that a diagnosis found beside a law.

    None if it found no law, or neither of them.
    """
    even = frozenset(unit.key for unit in found.noisier_units)
    scattered = {one.found.effect.name for one in found.scatters}
    if found.law is None or found.interrupted or not (even or scattered):
        return None
    effects = tuple(replace(one, of_all="") if one.name in scattered else one for one in job.effects)
    return replace(job, effects=effects, even=even)


def explains_scatter(law: Law, job: AdjustedJob, found: Diagnosis, selection: Selection) -> bool:
    """Return whether no noise of a unit, and none of the scatters of a diagnosis, is needed beside a law.

    `selection` is that of the search without them, in which the law was found.
    """
    beside = selection.fitted(without=selection.unknown).with_columns(law.columns)
    if found.noisier_units and noisier_units(job, selection.test_set.system, beside):
        return False
    levels = [log_level_beside(beside, selection.test_set, one.found.effect.name) for one in found.scatters]
    return all(level > np.log(LATER) for level in levels)
