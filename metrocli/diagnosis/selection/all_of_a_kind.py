"""All of a kind: many instances of one effect are one cause, such as a list of targets that is uncertain throughout.

Method: docs/algorithms/selection-and-levels.md (all of a kind).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from math import lgamma

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.linear.restricted_likelihood import RestrictedLikelihood
from metrocli.diagnosis.linear.score_tests import ScoreTests
from metrocli.diagnosis.selection.selection_state import Chosen, Selection
from metrocli.effects.effect import Effect
from metrocli.effects.extension import can_act_everywhere

_FEWEST = 3
"""Fewest named instances of an effect beside which all of its kind are considered"""


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


def all_of_a_kind(selection: Selection) -> AllOfAKind | None:
    """Return the effect whose scatter over all places has more evidence than the instances that were named.

    Z are the columns of all places, d the eigenvalues of Z'MZ, y the coordinates of the residual along them. The
    restricted likelihood of a variance ratio g is `-(nu ln(S/nu) + sum ln(1 + g d)) / 2` (Patterson and Thompson 1971),
    with `S = sum y^2 / (1 + g d) + the rest`. Evidence counts each named instance with its parameters and its choice
    among all places, and the scatter as one parameter (Schwarz 1978).
    """
    test_set = selection.test_set
    names = Counter(test_set.families[one.family].name for one in selection.named)
    for name, count in names.most_common():
        own = [one for one in selection.named if test_set.families[one.family].name == name]
        effect = test_set.alternative(own[0].family, own[0].number).effect
        if count >= _FEWEST and can_act_everywhere(test_set.system.model, effect):
            found = _compared(selection, own, effect)
            if found is not None:
                return found
    return None


def _compared(selection: Selection, own: list[Chosen], effect: Effect) -> AllOfAKind | None:
    test_set, base, full = selection.test_set, selection.fitted(without=own), selection.fitted()
    columns, places = _columns(test_set, effect)
    left = base.beside(columns)
    scatter = RestrictedLikelihood.of(base, left.T @ left, left.T @ base.residual)
    best = scatter.best()
    singly = -(base.dof * np.log(full.squares) + (base.dof - full.dof) * np.log(base.dof)) / 2
    singly -= lgamma(places + 1) - lgamma(len(own) + 1) - lgamma(places - len(own) + 1)
    if scatter.likelihood(best) - np.log(base.dof) / 2 < singly:
        return None
    variance = scatter.squares(best) / base.dof
    std = float(np.sqrt(np.exp(best) * variance))
    names = ["/".join(test_set.alternative(one.family, one.number).instance) for one in own]
    return AllOfAKind(effect, std, std * scatter.relative_spread(best), scatter.log_level(best), tuple(names), places)


def _columns(test_set: ScoreTests, effect: Effect) -> tuple[Array, int]:
    """Return the visible columns of an effect at all places, (rows, columns), and the number of places."""
    own = [i for i, family in enumerate(test_set.families) if family.name == effect.name and not family.unknown]
    counts = [len(test_set.families[i].alternatives) for i in own]
    columns = [test_set.all_visible(i, range(count)) for i, count in zip(own, counts, strict=True)]
    return np.concatenate([one.reshape(len(one), -1) for one in columns], axis=1), sum(counts)
