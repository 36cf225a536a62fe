"""Refinement of scanned parameters between the best value of a coarse scan and its neighbours.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.linear.candidates import Alternative, Family
from metrocli.diagnosis.linear.column_parts import Own
from metrocli.diagnosis.linear.fitted_columns import FittedColumns
from metrocli.diagnosis.linear.scans import is_filled, thinned
from metrocli.diagnosis.linear.score_tests import Remembered, ScoreTests
from metrocli.diagnosis.linear.signatures import signature
from metrocli.diagnosis.selection.search import STRUCTURED, continued
from metrocli.diagnosis.selection.selection_state import Chosen, Selection
from metrocli.effects.links.own import NoValueAtReadingError

_TRIED = 40
_ROUNDS = 2
_ALIKE, _APART = 1 / 20, 0.02
"""Odds from which another value of a scan explains the readings as well, and how far off it is at least, relatively"""
_NEAR, _STARTS = 0.7, 5
"""Values of a scan that explain at least this share of what its best one does are refined too, at most so many"""


def refined_scans(job: AdjustedJob, selection: Selection) -> Selection:
    """Return the selection with the scanned parameters of its effects at their best values.

    A second value of the same cause at the same place can correct the first one's scan: it is sought again beside the
    first one's best value. The levels stay those of the scan, which are corrected for the number of values tried.
    """
    first = {selection.alternative(one).spot: one for one in reversed(selection.named)}
    again = [one for one in selection.named if first[selection.alternative(one).spot] is not one]
    if any(is_filled(selection.alternative(one).effect) for one in again):
        selection = continued(_refined(job, selection.without(*again)), STRUCTURED)
    return _refined(job, selection)


def _refined(job: AdjustedJob, selection: Selection) -> Selection:
    """Return the selection with each scanned parameter at its best value beside the rest, in some rounds."""
    for _ in range(_ROUNDS):
        for one in selection.named:
            alternative = selection.alternative(one)
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
    """Return the selection with a scanned parameter at its best value between values of the scan.

    The best value need not lie beside the best one of the scan: it lies beside one that is nearly as good.
    """
    test_set = selection.test_set
    family = test_set.families[one.family]
    alternative = family.alternatives[one.number]
    fitted = selection.beside(one)
    best, most = alternative, test_set.score(one.family, fitted, [one.number]).gain[0]
    shown = whole = one.columns
    peaks: list[tuple[float, float]] = []
    for start in _starts(test_set, one, fitted, name):
        peak = dict(start.scanned)[name], 0.0
        for value in _between(job, family, start, name).tolist():
            found = _tried(job, test_set, fitted, _at(start, name, value))
            if found is None:
                continue
            peak = max(peak, (value, found.gain), key=lambda each: each[1])
            if found.gain > most * (1 + 1e-9):
                best, most, shown, whole = _at(start, name, value), found.gain, found.seen, found.full
        peaks.append(peak)
    found_at = dict(best.scanned)[name]
    apart = [
        (value, gain)
        for value, gain in peaks
        if abs(value - found_at) > _APART * abs(found_at)
        # between two values of one broad peak the readings are explained as well
        and (middle := _tried(job, test_set, fitted, _at(best, name, (value + found_at) / 2))) is not None
        and _odds(fitted, middle.gain, most, best) < _ALIKE
    ]
    known = tuple(alias for alias in one.aliases if alias[0] != name)
    found_alike = ((name, value, _odds(fitted, gain, most, best)) for value, gain in apart if is_filled(best.effect))
    aliases = (*known, *(alias for alias in found_alike if alias[2] > _ALIKE))
    if best is alternative:
        return selection.with_one(replace(one, aliases=aliases), instead=one) if aliases != one.aliases else selection
    grown = _with_alternative(test_set, one.family, best, shown, whole)
    new = Chosen(one.family, len(family.alternatives), shown, aliases)
    return replace(selection, test_set=grown).with_one(new, instead=one)


@dataclass(frozen=True)
class _Tried:
    """What an alternative explains beside a fit, with its visible and its whole columns."""

    gain: float
    seen: Array
    full: Array


def _tried(job: AdjustedJob, test_set: ScoreTests, fitted: FittedColumns, tried: Alternative) -> _Tried | None:
    """Return what an alternative explains; None if it has no value at some reading."""
    try:
        full = signature(job.model, test_set.system, tried.effect, tried.instance, dict(tried.scanned))
    except NoValueAtReadingError:
        return None
    seen = test_set.system.seen(full)
    return _Tried(fitted.squares - fitted.with_columns(seen).squares, seen, full)


def _at(start: Alternative, name: str, value: float) -> Alternative:
    return replace(start, scanned=tuple((key, value if key == name else old) for key, old in start.scanned))


def _odds(fitted: FittedColumns, gain: float, most: float, one: Alternative) -> float:
    """Return the odds of a value that explains `gain` against the one that explains most."""
    dof = max(fitted.dof - len(one.parameters), 1.0)
    left = np.log((fitted.squares - gain) / max(fitted.squares - most, 1e-300))
    return float(np.exp(-dof / 2 * max(float(left), 0.0)))


def _starts(test_set: ScoreTests, one: Chosen, fitted: FittedColumns, name: str) -> list[Alternative]:
    """Return the alternatives that differ in a scanned parameter only and are nearly as good, the best first.

    Of neighbours in the scan only the better one is a start.
    """
    family = test_set.families[one.family]
    chosen = family.alternatives[one.number]
    alike = [i for i, other in enumerate(family.alternatives) if _differs_in(chosen, other, name)]
    alike.sort(key=lambda i: dict(family.alternatives[i].scanned)[name])
    gains = test_set.score(one.family, fitted, alike).gain
    higher = np.concatenate([[-np.inf], gains, [-np.inf]])
    peaks = (gains >= higher[:-2]) & (gains >= higher[2:]) & (gains > _NEAR * gains.max(initial=0.0))
    ranked = sorted(np.flatnonzero(peaks).tolist(), key=lambda at: -gains[at])[:_STARTS]
    return [family.alternatives[alike[at]] for at in ranked]


def _differs_in(one: Alternative, other: Alternative, name: str) -> bool:
    """Return whether two alternatives of a cause differ in one scanned parameter at most."""
    others = [{key: value for key, value in each.scanned if key != name} for each in (one, other)]
    return one.like(other) and others[0] == others[1]


def _between(job: AdjustedJob, family: Family, start: Alternative, name: str) -> Array:
    """Return values of a scanned parameter between the tried neighbours of one."""
    parameter = next(p for p in start.effect.scanned if p.name == name)
    if parameter.grid is None:
        return np.zeros(0)
    tried = np.unique([dict(one.scanned)[name] for one in family.alternatives if one.instance == start.instance])
    own = dict(start.scanned)[name]
    low, high = tried[tried < own].max(initial=-np.inf), tried[tried > own].min(initial=np.inf)
    values = np.sort(parameter.grid(job.model.readings[0].observations.conditions))
    inside = np.flatnonzero((values > low) & (values < high))
    if start.effect.is_step or not len(inside):
        return thinned(values[inside][values[inside] != own], _TRIED)
    # a grid can be coarser than the readings tell
    return np.interp(np.linspace(inside[0], inside[-1], _TRIED), np.arange(len(values)), values)


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
