"""All of a kind: many instances of one effect are one cause, such as a list of targets that is uncertain throughout.

Method: docs/algorithms/selection-and-levels.md (all of a kind).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import lgamma

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.linear.candidates import Family
from metrocli.diagnosis.linear.fitted_columns import FittedColumns
from metrocli.diagnosis.linear.projection import READING, System
from metrocli.diagnosis.linear.restricted_likelihood import RestrictedLikelihood, gain_of_larger_noise, log_level_of
from metrocli.diagnosis.linear.score_tests import ScoreTests
from metrocli.diagnosis.selection.selection_state import Chosen, Selection
from metrocli.diagnosis.selection.thresholds import LATER
from metrocli.effects.effect import Effect
from metrocli.effects.extension import can_act_everywhere
from metrocli.frozen import dataclass

_FEWEST = 3
"""Fewest named instances of an effect beside which all of its kind are considered, whatever its cause"""
_PLACES = 6
"""Fewest places whose scatter is looked for though fewer instances are named"""
_MOST = 2e10
"""Largest product of rows and squared columns for that, a few seconds of CPU time"""
AS_MUCH = float(np.log(20.0))
"""Difference of log-likelihoods up to which two scatters explain the readings alike"""


@dataclass(frozen=True)
class Instead:
    """Another scatter, or a larger noise of some readings, that explains the readings as well."""

    name: str
    """Of an effect at all its places, or `noise`"""
    where: Mapping[str, str]
    """The group of readings, or the place, that has a noise of its own; empty for an effect"""
    odds: float
    """Ratio of its likelihood to that of what was found"""

    def __str__(self) -> str:
        place = " ".join(name if key == READING else f"{key} {name}" for key, name in self.where.items())
        return f"{self.name} of {place}" if self.where else f"{self.name} everywhere"


@dataclass(frozen=True)
class AllOfAKind:
    """An effect at all its places, with sizes that scatter about 0."""

    effect: Effect
    std: float
    """Standard deviation of its parameters, in their internal unit"""
    spread: float
    """Standard uncertainty of `std`"""
    log_level: float
    """ln of the significance level against no such scatter"""
    instead_of: tuple[str, ...]
    """Places that were named one by one before"""
    places: int
    """Number of all its places"""
    rivals: tuple[Instead, ...] = ()


def all_of_a_kind(selection: Selection) -> AllOfAKind | None:
    """Return the effect whose scatter over all places has more evidence than the instances that were named.

    Z are the columns of all places, d the eigenvalues of Z'MZ, y the coordinates of the residual along them. The
    restricted likelihood of a variance ratio g is `-(nu ln(S/nu) + sum ln(1 + g d)) / 2` (Patterson and Thompson 1971),
    with `S = sum y^2 / (1 + g d) + the rest`. Evidence counts each named instance with its parameters and its choice
    among all places, and the scatter as one parameter (Schwarz 1978).
    """
    names = Counter(selection.test_set.families[one.family].name for one in selection.named)
    for name, count in names.most_common():
        effect = _effect(selection.test_set, name)
        if count >= _FEWEST and can_act_everywhere(selection.test_set.system.model, effect):
            found = _compared(selection, effect, _instances(selection, effect))
            if found is not None:
                return found
    return None


def scattered_throughout(selection: Selection) -> AllOfAKind | None:
    """Return the effect whose scatter over all places is significant, though fewer than three instances are named.

    Where all places are off, none stands out of what then passes for noise, and wrong readings, other effects or smooth
    functions may be named for them: the scatter is held against all that was selected, else against the instances. Of
    effects for which such a scatter is usual the likeliest is returned, with those as likely, if no noise of a group of
    readings is likelier.
    """
    test_set = selection.test_set
    names = dict.fromkeys(family.name for family in (*test_set.families, *test_set.throughout))
    usual = [_effect(test_set, name) for name in names if may_scatter(test_set, name)]
    of_all = _likeliest(selection, [(effect, selection.chosen) for effect in usual])
    return of_all or _likeliest(selection, [(effect, _instances(selection, effect)) for effect in usual])


def _likeliest(selection: Selection, wanted: Sequence[tuple[Effect, Sequence[Chosen]]]) -> AllOfAKind | None:
    """Return the likeliest scatter instead of members of the selection, with what else is as likely instead of them."""
    compared = [(_compared(selection, effect, own), own) for effect, own in wanted]
    found = sorted(((one, own) for one, own in compared if one is not None), key=lambda pair: pair[0].log_level)
    if not found or found[0][0].log_level + np.log(len(wanted)) > np.log(LATER):
        return None
    best, own = found[0]
    others: list[tuple[str, dict[str, str], float]] = [(one.effect.name, {}, one.log_level) for one, _ in found[1:]]
    base = selection.fitted(without=own)
    if best.log_level > log_level_of(gain_of_larger_noise(base)) - AS_MUCH:
        return None  # of few readings each shows a place of its own: that is noise
    others += [("noise", {READING: name}, level) for name, level in _noise_of_groups(selection.test_set.system, base)]
    ahead = [best.log_level - level for _, _, level in others]
    if max(ahead, default=0.0) > AS_MUCH:
        return None
    alike = zip(others, ahead, strict=True)
    return replace(best, rivals=tuple(Instead(*one[:2], float(np.exp(by))) for one, by in alike if by > -AS_MUCH))


def estimated_again(found: AllOfAKind, selection: Selection) -> AllOfAKind:
    """Return the scatter as it is beside another selection, such as the one that was found with it in the model.

    What the first selection took for wrong readings or single instances may be part of the scatter.
    """
    base = selection.fitted()
    scatter = RestrictedLikelihood.beside(base, columns_of(selection.test_set, found.effect)[0])
    return _with_size(found, scatter, base.dof)


def log_level_beside(fitted: FittedColumns, test_set: ScoreTests, name: str) -> float:
    """Return ln of the level at which an effect scatters over all its places beside a fit."""
    scatter = RestrictedLikelihood.beside(fitted, columns_of(test_set, _effect(test_set, name))[0])
    return scatter.log_level(scatter.best())


def _with_size(found: AllOfAKind, scatter: RestrictedLikelihood, dof: float) -> AllOfAKind:
    best = scatter.best()
    std = float(np.sqrt(np.exp(best) * scatter.squares(best) / dof))
    return replace(found, std=std, spread=std * scatter.relative_spread(best), log_level=scatter.log_level(best))


def may_scatter(test_set: ScoreTests, name: str) -> bool:
    """Whether a scatter of an effect at all its places is looked for though fewer than three of them are named."""
    own = _families(test_set, name)
    if not own or not own[0].alternatives[0].effect.of_all:
        return False
    places = sum(len(family.alternatives) for family in own)
    columns = places * len(own[0].alternatives[0].effect.parameters)
    return (
        places >= _PLACES
        and test_set.system.rows * columns**2 <= _MOST
        and can_act_everywhere(test_set.system.model, own[0].alternatives[0].effect)
    )


def _noise_of_groups(system: System, base: FittedColumns) -> Iterator[tuple[str, float]]:
    """Yield each of several groups of readings with ln of the level of a noise of its own."""
    for name, rows in system.of_several_groups():
        unit = np.zeros((system.rows, int(rows.sum())))
        unit[rows, np.arange(unit.shape[1])] = 1.0
        scatter = RestrictedLikelihood.beside(base, system.seen(unit))
        yield name, scatter.log_level(scatter.best())


def _effect(test_set: ScoreTests, name: str) -> Effect:
    return _families(test_set, name)[0].alternatives[0].effect


def _families(test_set: ScoreTests, name: str) -> list[Family]:
    every = (*test_set.families, *test_set.throughout)
    return [family for family in every if family.name == name and not family.unknown]


def _instances(selection: Selection, effect: Effect) -> list[Chosen]:
    """Return the selected instances of an effect."""
    return [one for one in selection.named if selection.test_set.families[one.family].name == effect.name]


def _compared(selection: Selection, effect: Effect, own: Sequence[Chosen]) -> AllOfAKind | None:
    """Return the scatter of an effect if it has more evidence than some members of the selection."""
    test_set, base, full = selection.test_set, selection.fitted(without=own), selection.fitted()
    columns, places = columns_of(test_set, effect)
    scatter = RestrictedLikelihood.beside(base, columns)
    best = scatter.best()
    singly = -(base.dof * np.log(full.squares) + (base.dof - full.dof) * np.log(base.dof)) / 2
    singly -= _log_choices(selection, effect, own, places)
    if scatter.likelihood(best) - np.log(base.dof) / 2 < singly:
        return None
    named = _instances(selection, effect)
    names = tuple("/".join(test_set.alternative(one.family, one.number).instance) for one in named)
    return _with_size(AllOfAKind(effect, 0.0, 0.0, 0.0, names, places), scatter, base.dof)


def _log_choices(selection: Selection, effect: Effect, own: Sequence[Chosen], places: int) -> float:
    """Return ln of the number of ways to choose members: instances among places, others among all that is tried."""
    test_set, named = selection.test_set, len(_instances(selection, effect))
    others = [one for one in own if one.outlier or test_set.families[one.family].name != effect.name]
    tries = sum(float(np.log(test_set.tests[one.family] * test_set.causes)) for one in others)
    alike = sum(one.outlier for one in others)
    return lgamma(places + 1) - lgamma(named + 1) - lgamma(places - named + 1) + tries - lgamma(alike + 1)


def columns_of(test_set: ScoreTests, effect: Effect) -> tuple[Array, int]:
    """Return the visible columns of an effect at all places, (rows, columns), and the number of places."""
    system, own = test_set.system, _families(test_set, effect.name)
    counts = [len(family.alternatives) for family in own]
    columns = [f.columns.whole(range(count), system.rows) for f, count in zip(own, counts, strict=True)]
    return np.concatenate([system.seen(one.reshape(len(one), -1)) for one in columns], axis=1), sum(counts)
