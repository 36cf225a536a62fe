"""Refinement of scanned parameters between the best value of a coarse scan and its neighbours.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.linear.candidates import Alternative, Family, thinned
from metrocli.diagnosis.linear.column_parts import Own
from metrocli.diagnosis.linear.score_tests import Remembered, ScoreTests
from metrocli.diagnosis.linear.signatures import signature
from metrocli.diagnosis.selection.selection_state import Chosen, Selection
from metrocli.effects.links.own import NoValueAtReadingError

_TRIED = 40
_ROUNDS = 2


def refined_scans(job: AdjustedJob, selection: Selection) -> Selection:
    """Return the selection with the scanned parameters of its effects at their best values.

    The levels stay those of the coarse scan, which are corrected for the number of values tried.
    """
    for _ in range(_ROUNDS):
        for one in selection.named:
            alternative = selection.test_set.families[one.family].alternatives[one.number]
            for parameter in alternative.effect.scanned:
                if parameter.grid is not None:
                    selection = _closer(job, selection, _same(selection, one), parameter.name)
    return selection


def _same(selection: Selection, one: Chosen) -> Chosen:
    """Return the present member of the selection for a cause that was in it before."""
    if any(other is one for other in selection.named):
        return one
    spot = selection.test_set.families[one.family].alternatives[one.number].spot
    return next(
        other
        for other in selection.named
        if other.family == one.family
        and selection.test_set.families[other.family].alternatives[other.number].spot == spot
    )


def _closer(job: AdjustedJob, selection: Selection, one: Chosen, name: str) -> Selection:
    test_set = selection.test_set
    family = test_set.families[one.family]
    alternative = family.alternatives[one.number]
    values = _between(job, family, alternative, name)
    if not len(values):
        return selection
    fitted = selection.beside(one)
    best, most = alternative, test_set.score(one.family, fitted, [one.number]).gain[0]
    shown = whole = one.columns
    for value in values.tolist():
        scanned = tuple((key, value if key == name else old) for key, old in alternative.scanned)
        tried = replace(alternative, scanned=scanned)
        try:
            full = signature(job.model, test_set.system, tried.effect, tried.instance, dict(scanned))
        except NoValueAtReadingError:
            continue
        seen = test_set.system.seen(full)
        gain = fitted.squares - fitted.with_columns(seen).squares
        if gain > most * (1 + 1e-9):
            best, most, shown, whole = tried, gain, seen, full
    if best is alternative:
        return selection
    grown = _with_alternative(test_set, one.family, best, shown, whole)
    new = Chosen(one.family, len(family.alternatives), shown)
    return replace(selection, test_set=grown).with_one(new, instead=one)


def _between(job: AdjustedJob, family: Family, alternative: Alternative, name: str) -> Array:
    """Return values of a scanned parameter between the tried neighbours of the best value."""
    parameter = next(p for p in alternative.effect.scanned if p.name == name)
    if parameter.grid is None:
        return np.zeros(0)
    tried = np.unique([dict(one.scanned)[name] for one in family.alternatives if one.instance == alternative.instance])
    own = dict(alternative.scanned)[name]
    low, high = tried[tried < own].max(initial=-np.inf), tried[tried > own].min(initial=np.inf)
    values = parameter.grid(job.model.readings[0].observations.conditions)
    return thinned(values[(values > low) & (values < high) & (values != own)], _TRIED)


def _with_alternative(
    test_set: ScoreTests, number: int, alternative: Alternative, columns: Array, whole: Array
) -> ScoreTests:
    """Return the score tests with one more alternative of a family, of visible and whole columns."""
    family = test_set.families[number]
    grown = replace(
        family,
        alternatives=(*family.alternatives, alternative),
        columns=family.columns.followed_by(columns),
        raw=np.concatenate([family.raw, np.linalg.norm(columns, axis=0)[None]]),
        gram=np.concatenate([family.gram, (columns.T @ columns)[None]]),
        whole={**family.whole, family.columns.count: Own(np.arange(len(whole)), whole)},
    )
    families = (*test_set.families[:number], grown, *test_set.families[number + 1 :])
    return replace(test_set, families=families, remembered=Remembered())
