"""Refinement of scanned parameters between the best value of a coarse scan and its neighbours.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.linear.candidates import Alternative, Family
from metrocli.diagnosis.linear.column_parts import Own
from metrocli.diagnosis.linear.columns import Remembered
from metrocli.diagnosis.linear.fitted_columns import FittedColumns
from metrocli.diagnosis.linear.scans import is_filled, thinned
from metrocli.diagnosis.linear.score_tests import ScoreTests
from metrocli.diagnosis.linear.signatures import signature
from metrocli.diagnosis.selection.search import STRUCTURED, continued
from metrocli.diagnosis.selection.selection_state import Chosen, Selection
from metrocli.effects.links.own import NoValueAtReadingError
from metrocli.frozen import dataclass

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


@dataclass(frozen=True)
class _Tried:
    """An alternative with what it explains beside a fit, and its visible and whole columns."""

    alternative: Alternative
    gain: float
    seen: Array
    full: Array


@dataclass(frozen=True)
class _Scan:
    """A scanned parameter of a member of the selection, beside the rest."""

    job: AdjustedJob
    test_set: ScoreTests
    one: Chosen
    fitted: FittedColumns
    name: str

    def tried(self, alternative: Alternative) -> _Tried | None:
        """Return what an alternative explains; None if it has no value at some reading."""
        system = self.test_set.system
        try:
            full = signature(
                self.job.model, system, alternative.effect, alternative.instance, dict(alternative.scanned)
            )
        except NoValueAtReadingError:
            return None
        seen = system.seen(full)
        return _Tried(alternative, self.fitted.squares - self.fitted.with_columns(seen).squares, seen, full)

    def at(self, start: Alternative, value: float) -> _Tried | None:
        """Return what an alternative with another value of the parameter explains."""
        scanned = tuple((key, value if key == self.name else old) for key, old in start.scanned)
        return self.tried(replace(start, scanned=scanned))

    def value(self, tried: _Tried) -> float:
        """Return the value of the parameter."""
        return dict(tried.alternative.scanned)[self.name]

    def peaks(self) -> list[_Tried]:
        """Return the best value about each start, between its neighbours in the scan."""
        family, found = self.test_set.families[self.one.family], list[_Tried]()
        for start in _starts(self.test_set, self.one, self.fitted, self.name):
            values = _between(self.job, family, start, self.name).tolist()
            near = [one for value in values if (one := self.at(start, value)) is not None]
            found += [max(near, key=lambda one: one.gain)] if near else []
        return found

    def aliases(self, peaks: Sequence[_Tried], best: _Tried) -> list[tuple[str, float, float]]:
        """Return the values of other peaks that fit as well, with their odds.

        Between two values of one broad peak the readings are explained as well.
        """
        if not is_filled(best.alternative.effect):
            return []
        found = []
        for one in peaks:
            value, here = self.value(one), self.value(best)
            if abs(value - here) > _APART * abs(here) and self._odds(one, best) > _ALIKE:
                middle = self.at(best.alternative, (value + here) / 2)
                if middle is not None and self._odds(middle, best) < _ALIKE:
                    found.append((self.name, value, self._odds(one, best)))
        return found

    def _odds(self, one: _Tried, best: _Tried) -> float:
        dof = max(self.fitted.dof - len(best.alternative.parameters), 1.0)
        left = (self.fitted.squares - one.gain) / max(self.fitted.squares - best.gain, 1e-300)
        return float(np.exp(-dof / 2 * max(float(np.log(left)), 0.0)))


def _closer(job: AdjustedJob, selection: Selection, one: Chosen, name: str) -> Selection:
    """Return the selection with a scanned parameter at its best value between values of the scan.

    The best value need not lie beside the best one of the scan: it lies beside one that is nearly as good.
    """
    test_set, family = selection.test_set, selection.test_set.families[one.family]
    scan = _Scan(job, test_set, one, selection.beside(one), name)
    known = float(test_set.score(one.family, scan.fitted, [one.number]).gain[0])
    held, peaks = _Tried(family.alternatives[one.number], known, one.columns, one.columns), scan.peaks()
    best = max(peaks, key=lambda each: each.gain, default=held)
    best = best if best.gain > held.gain * (1 + 1e-9) else held
    others = tuple(alias for alias in one.aliases if alias[0] != name)
    aliases = (*others, *scan.aliases(peaks, best))
    if best is held:
        return selection.with_one(replace(one, aliases=aliases), instead=one) if aliases != one.aliases else selection
    grown = _with_alternative(test_set, one.family, best.alternative, best.seen, best.full)
    new = Chosen(one.family, len(family.alternatives), best.seen, aliases)
    return replace(selection, test_set=grown).with_one(new, instead=one)


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
