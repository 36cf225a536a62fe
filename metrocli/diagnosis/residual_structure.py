"""Structure in the residuals beyond noise, before anything is named and after.

Method: docs/algorithms/selection-and-levels.md (remaining structure).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.linear.distributions import log_family, log_tail, noncentrality, single_level
from metrocli.diagnosis.linear.fitted_columns import PRIOR, FittedColumns, nothing_fitted
from metrocli.diagnosis.linear.projection import System
from metrocli.diagnosis.linear.score_tests import ScoreTests
from metrocli.diagnosis.selection.confidence_set import NamedEffect
from metrocli.diagnosis.selection.forward_steps import carried_by_few
from metrocli.diagnosis.selection.selection_state import Selection, levels_of
from metrocli.frozen import dataclass

_AFTER, _NOTHING_NAMED = 0.03, 0.005
"""Levels, counted over all smooth functions, of remaining structure: beside named effects, and if nothing is named"""
_CARRIED = 0.2
"""Level that structure must keep beside outliers, counted over all, without the few readings that support it most"""
_NEGLIGIBLE = 0.05
"""Fraction of the largest change below which a reading does not count as changed"""
REPEATS = "what repeated readings have in common"


@dataclass(frozen=True)
class RemainingStructure:
    """Structure that no known effect explains."""

    p_value: float
    depends_on: tuple[str, ...]
    where: tuple[str, ...] = ()
    """The units (tracers, images) whose readings show it; empty if all do"""
    size: float = 0.0
    """Its visible size: root mean square over those readings, in their unit"""


@dataclass(frozen=True)
class PureError:
    """The noise found from readings that were repeated under the same conditions, independent of the model."""

    ratio: float
    """Ratio of their scatter to the declared noise"""
    dof: float
    lack_of_fit: float
    """Significance level of the remaining residuals compared with that scatter"""


def pure_error(job: AdjustedJob, system: System, fitted: FittedColumns) -> PureError | None:
    """Return the scatter of repeated readings and the F test of the rest of the residuals; None without repetitions.

    `F = ((S - S_pe) / (nu - nu_pe)) / (S_pe / nu_pe)`, the lack-of-fit test (Fisher 1922; NIST e-Handbook 4.4.4.6).
    """
    squares, dof = 0.0, 0.0
    for group in job.model.readings:
        label = job.replicates.get(group.name)
        if label is not None:
            d, n = group.observations.readings.shape
            start = system.first[group.name]
            scatter, freedoms = _within(fitted.residual[start : start + n * d].reshape(n, d), label)
            squares, dof = squares + scatter, dof + freedoms
    if dof < 1:
        return None
    whole = float(fitted.residual @ fitted.residual)
    rest = max(fitted.dof - PRIOR - dof, 1.0)
    share = np.array(np.clip(1 - squares / max(whole, 1e-300), 0.0, 1.0))
    return PureError(float(np.sqrt(squares / dof)), dof, float(np.exp(log_tail(share, rest, dof))))


def _within(values: Array, label: Index) -> tuple[float, float]:
    """Return the sum of squares of values (n, d) about the means of equal labels, and its degrees of freedom."""
    _, number = np.unique(label, return_inverse=True)
    counts = np.bincount(number)
    means = np.stack([np.bincount(number, column) / counts for column in values.T], axis=1)
    return float(((values - means[number]) ** 2).sum()), float((len(values) - len(counts)) * values.shape[1])


def log_level_of_strongest(test_set: ScoreTests, fitted: FittedColumns) -> float:
    """Return ln of the level of the strongest candidate beside a model, counted over all."""
    levels = [
        test_set.level(i, score.log_p[score.best]) for i, score in enumerate(test_set.scores(fitted)) if len(score.gain)
    ]
    wrong = test_set.outliers(fitted)
    return test_set.overall(min([*levels, test_set.level(-1, wrong.log_p[wrong.best])]))


def remaining_structure(
    selection: Selection, names: Sequence[NamedEffect], test_set: ScoreTests, fitted: FittedColumns
) -> tuple[RemainingStructure | None, float]:
    """Return the structure that no effect explains, and the level of the strongest smooth function left."""
    unknown = [selection.test_set.families[one.family].unknown for one in selection.unknown]
    units = {place for name in names for place in name.alternative.instance}
    found = []
    for number, family in enumerate(test_set.families):
        if not family.unknown:
            continue
        score = test_set.score(number, fitted)
        found.append((test_set.level(number, score.log_p[score.best]), number, score.best))
        own = [i for i, a in enumerate(family.alternatives) if not a.instance or a.instance[0] in units]
        if units and own:
            best = own[int(np.argmin(score.log_p[own]))]
            found.append((float(np.minimum(score.log_p[best] + np.log(len(own)), 0.0)), number, best))
    log_level, number, best = min(found, default=(0.0, -1, 0))
    level = float(np.exp(log_family(log_level, test_set.unknowns)))
    stays = number >= 0 and level < (_AFTER if names else _NOTHING_NAMED)
    if stays and selection.outliers:
        stays = carried_by_few(test_set, fitted, number, best) < np.log(_CARRIED)
    after = [test_set.families[number].unknown] if stays else []
    if unknown:
        levels = dict(zip(map(id, selection.chosen), levels_of(selection), strict=True))
        p = float(np.exp(min(levels[id(one)] for one in selection.unknown)))
        places = [
            selection.test_set.families[one.family].alternatives[one.number].instance for one in selection.unknown
        ]
        size = _size(selection.test_set, selection.fitted(without=selection.unknown), selection.fitted())
        where = tuple(dict.fromkeys(name for place in places for name in _units(test_set, place)))
        return RemainingStructure(p, tuple(dict.fromkeys([*unknown, *after])), where, size), level
    if not after:
        return None, level
    family = test_set.families[number]
    size = _size(test_set, fitted, fitted.with_columns(test_set.visible(number, best)))
    return RemainingStructure(level, tuple(after), _units(test_set, family.alternatives[best].instance), size), level


def _units(test_set: ScoreTests, instance: Iterable[str]) -> tuple[str, ...]:
    """Return the units (tracers, images) of an alternative's place; waves have a component and a period instead."""
    names = {name for place in test_set.system.model.places.values() for name in place.names}
    return tuple(name for name in instance if name in names)


def other_shape_from(name: NamedEffect, test_set: ScoreTests, noise: float) -> float:
    """Return the smallest relative difference in shape that is detected as structure beside a named effect.

    It is `sqrt(lambda s^2 / |G theta|^2)`, lambda the non-centrality at which a smooth function, of the median number
    of terms of those that are tried, is found with 80 % power. A true cause whose signature has the angle phi to the
    named one differs from it by the fraction sin phi. The noise s is in units of the declared one.
    """
    needed = []
    for number, family in enumerate(test_set.families):
        ranks = test_set.score(number, nothing_fitted(test_set.system)).rank
        if family.unknown and ranks.any():
            level = single_level(single_level(_AFTER, test_set.unknowns), test_set.tests[number])
            terms = int(np.median(ranks[ranks > 0]))
            needed.append(noncentrality(level, terms, max(test_set.system.dof - terms, 1.0)))
    least = float(np.median(needed)) if needed else float("inf")
    return float(np.sqrt(least) * noise / max(name.shows, 1e-300))


def _size(test_set: ScoreTests, without: FittedColumns, beside: FittedColumns) -> float:
    """Return the visible size of terms in the readings of the first unit that they change: root mean square.

    It is 0 where they change readings of another unit above all.
    """
    change = without.residual - beside.residual
    heavy = (np.abs(change) > _NEGLIGIBLE * np.abs(change).max(initial=0.0)) & test_set.system.alike
    return float(np.sqrt(((change * test_set.system.scale)[heavy] ** 2).mean())) if heavy.any() else 0.0
