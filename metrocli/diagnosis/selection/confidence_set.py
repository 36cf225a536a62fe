"""Confidence sets: for each effect that was found, the others that would explain the readings as well.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Mask
from metrocli.diagnosis.linear.candidates import Alternative
from metrocli.diagnosis.linear.fitted_columns import FittedColumns
from metrocli.diagnosis.linear.projection import FLAT, VISIBLE
from metrocli.diagnosis.selection.backward_steps import evidence
from metrocli.diagnosis.selection.rival_tests import Named, against
from metrocli.diagnosis.selection.selection_state import Chosen, Selection, levels_of
from metrocli.frozen import dataclass

_ODDS = 1 / 20
_NEEDED = 0.01
"""An effect is still needed beside another if its p-value is below this level; then the other does not explain it"""
_DISTINGUISHED = 6.6
"""Two effects are distinguished if the part that only the named effect explains has this non-centrality"""
_NEAR = 0.9
"""Smallest cosine at which a form with more parameters counts as another explanation"""
_SIGNIFICANT = 0.05
_DISTANT = 0.3
_BLIND = 1e-2
"""Smallest part of a parameter in an unseen direction that leaves the parameter undetermined"""


@dataclass(frozen=True)
class Rival:
    """Another effect that would explain the readings as well."""

    alternative: Alternative
    correlation: float
    """Cosine between the fitted signature of the named effect and the span of the rival's columns"""
    odds: float
    """Ratio of its evidence to that of the named effect"""


@dataclass(frozen=True)
class NamedEffect:
    """An effect that the readings require, with its confidence set: the rivals that explain them as well."""

    chosen: Chosen
    alternative: Alternative
    log_level: float
    values: Array
    """Estimated parameters (one-step, linear)"""
    covariance: Array
    """Covariance of the parameters with the estimated noise"""
    seen: Mask
    """Which parameters the readings determine together; the others are taken as 0"""
    apart: Mask
    """Which parameters have no part in an unseen direction; the others are not determined individually"""
    rivals: tuple[Rival, ...]
    forms: tuple[Rival, ...]
    """Other forms of the same cause that explain the readings as well: by temperature for by time"""
    shows: float
    """Norm of its visible part in the readings, in standard deviations of the declared noise"""

    def is_at(self, other: NamedEffect) -> bool:
        """Return whether another is the same effect with the same parameters."""
        return self.alternative == other.alternative and np.array_equal(self.values, other.values)

    @property
    def held(self) -> tuple[str, ...]:
        """The parameters taken as 0, because the readings do not determine them beside the others."""
        return tuple(name for name, free in zip(self.alternative.parameters, self.seen, strict=True) if not free)

    @property
    def known(self) -> dict[str, float]:
        """The parameters that are not estimated: the scanned ones, and those taken as 0."""
        return {**dict(self.alternative.scanned), **dict.fromkeys(self.held, 0.0)}


@dataclass(frozen=True)
class Compared:
    """Rivals compared with a named effect, (k,) each."""

    cosines: Array
    """Cosine between the fitted signature of the named effect and the span of the rival's columns"""
    still_needed: Array
    """ln of the p-value of the named effect beside the rival"""
    ranks: Array
    """Number of visible parameters"""


def explains_as_well(rivals: Compared, shown: Array | float, rank: int, log_odds: Array) -> Mask:
    """Return which rivals explain the readings as well as a named effect of so many visible parameters, (k,).

    `shown` is what the named effect takes off the sum of squares, over the variance; `log_odds` is ln of the ratio of
    the evidence of each rival to its own.
    """
    # the rival makes the named effect unnecessary, or cannot be distinguished from it
    alike = (1 - rivals.cosines**2) * shown < _DISTINGUISHED
    instead = (rivals.still_needed > np.log(_NEEDED)) & ((rivals.ranks <= rank) | (rivals.cosines > _NEAR))
    return np.asarray((log_odds > np.log(_ODDS)) | ((rivals.cosines > _DISTANT) & (alike | instead)))


def confidence_sets(selection: Selection) -> tuple[NamedEffect, ...]:
    """Return the effects of a selection, each with its confidence set."""
    levels = dict(zip(map(id, selection.chosen), levels_of(selection), strict=True))
    return tuple(_named(selection, one, levels[id(one)]) for one in selection.named)


def _named(selection: Selection, one: Chosen, level: float) -> NamedEffect:
    fitted, full = selection.beside(one), selection.fitted(without=selection.around(one))
    alternative = selection.test_set.families[one.family].alternatives[one.number]
    left = fitted.beside(one.columns)
    whole = selection.test_set.families[one.family].raw[one.number]
    seen, apart = determined(left, whole), _apart(left, whole)
    left = np.where(seen, left, 0.0)
    # unit columns before the inverse: parameters may differ in units by many powers of ten
    norm = np.linalg.norm(left, axis=0)
    size = np.where(norm > 0, norm, 1.0)
    inverse = np.linalg.pinv((left / size).T @ (left / size), rcond=1e-11, hermitian=True) / size / size[:, None]
    values = inverse @ (left.T @ fitted.residual)
    covariance = inverse * full.squares / max(full.dof, 1)
    others = _as_likely(selection, one, fitted, left @ values)
    rivals = tuple(other for other in others if other.alternative.spot != alternative.spot)
    forms = tuple(other for other in others if other.alternative.spot == alternative.spot)
    shows = float(np.linalg.norm(left @ values))
    return NamedEffect(one, alternative, level, values, covariance, seen, apart, rivals, forms, shows)


def determined(left: Array, whole: Array) -> Mask:
    """Return which parameters (q,) can be estimated together.

    While a direction of the parameters is unseen, the parameter with the largest part in it is removed.
    """
    seen = np.ones(left.shape[1], dtype=bool)
    scaled = left / np.where(whole > 0, whole, 1.0)
    while seen.sum() > 1:
        columns = scaled[:, seen]
        values, vectors = np.linalg.eigh(columns.T @ columns)
        if values[0] > max(VISIBLE**2, FLAT * values[-1]):
            break
        seen[np.flatnonzero(seen)[int(np.argmax(np.abs(vectors[:, 0])))]] = False
    return seen


def _apart(left: Array, whole: Array) -> Mask:
    """Return which parameters (q,) have no part in an unseen direction."""
    columns = left / np.where(whole > 0, whole, 1.0)
    values, vectors = np.linalg.eigh(columns.T @ columns)
    open_ones = values <= max(VISIBLE**2, FLAT * values[-1])
    return np.asarray(np.linalg.norm(vectors[:, open_ones], axis=1) < _BLIND)


def _as_likely(selection: Selection, one: Chosen, fitted: FittedColumns, explained: Array) -> tuple[Rival, ...]:
    """Return the best form of each other cause and place in the confidence set, and the other forms of its own."""
    test_set = selection.test_set
    own = test_set.families[one.family].alternatives[one.number]
    score = test_set.score(one.family, fitted, [one.number])
    mine = float(evidence(test_set, fitted, one.family, score)[0])
    full = selection.fitted(without=selection.around(one))
    named = Named(fitted.beside(one.columns), test_set.families[one.family].raw[one.number], explained)
    best: dict[tuple[str, tuple[str, ...]], Rival] = {}
    there = [other for other in selection.named if other is not one]
    others = {test_set.families[other.family].alternatives[other.number].spot for other in there}
    for number, family in enumerate(test_set.families):
        if family.unknown:
            continue
        scores = test_set.score(number, fitted)
        odds = np.exp(np.clip(evidence(test_set, fitted, number, scores) - mine, -700, 700))
        cosines, still_needed = against(test_set, number, fitted, named)
        shown = score.gain[0] / (full.squares / max(full.dof, 1))
        compared = Compared(cosines, still_needed, scores.rank)
        explains = explains_as_well(compared, shown, int(score.rank[0]), np.log(odds))
        for at in np.flatnonzero((scores.rank > 0) & explains):
            rival = family.alternatives[at]
            key = rival.spot if rival.spot != own.spot else (rival.effect.by, ())
            known = best.get(key)
            same = rival.spot == own.spot and rival.effect.by == own.effect.by
            if same or rival.spot in others or (known is not None and known.odds >= odds[at]):
                continue
            if test_set.overall(test_set.level(number, scores.log_p[at])) <= np.log(_SIGNIFICANT):
                best[key] = Rival(rival, float(cosines[at]), float(odds[at]))
    return tuple(sorted(best.values(), key=lambda rival: -rival.odds))
