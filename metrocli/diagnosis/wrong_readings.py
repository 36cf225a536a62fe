"""Wrong readings: each outlier of a selection with what is as likely instead: other readings, and effects at its place.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from metrocli.adjust.robust import as_likely
from metrocli.diagnosis.linear.candidates import Alternative
from metrocli.diagnosis.linear.fitted_columns import FittedColumns
from metrocli.diagnosis.linear.score_tests import ScoreTests
from metrocli.diagnosis.selection.selection_state import Chosen, Selection
from metrocli.frozen import dataclass

Places = Mapping[frozenset[tuple[str, str]], list[tuple[int, int]]]


@dataclass(frozen=True)
class Outlier:
    """A reading that is wrong (gross error)."""

    keys: Mapping[str, str]
    test: float
    """Its error in standard deviations, with all other findings in the model"""
    others: tuple[Mapping[str, str], ...] = ()
    """Readings whose error would explain the misfit about as well, the likeliest first"""
    effects: tuple[Alternative, ...] = ()
    """Effects at the place of the reading, such as a bad pose, that would explain it about as well"""


def wrong_readings(selection: Selection) -> tuple[Outlier, ...]:
    """Return the outliers, the largest first, each with the test of it beside all else in the model."""
    places = _places(selection.test_set) if selection.outliers else {}
    return tuple(sorted((_outlier(selection, one, places) for one in selection.outliers), key=lambda one: -one.test))


def _outlier(selection: Selection, one: Chosen, places: Places) -> Outlier:
    """Return an outlier with what would explain as much, beside all else in the model."""
    test_set, fitted, without = selection.test_set, selection.fitted(), selection.fitted(without=[one])
    variance, keys = fitted.squares / max(fitted.dof, 1), test_set.keys_of(one.number)
    gain, rank = test_set.gains_of_readings(without)
    # an error of several components can always explain more: only readings of its rank compare
    squares = np.where(rank == rank[one.number], gain, 0.0) / variance
    own = max(without.squares - fitted.squares, 0.0) / variance
    taken = [other.number for other in selection.outliers]
    rivals = [at for at in np.flatnonzero(as_likely(np.minimum(squares, own))).tolist() if at not in taken]
    rivals.sort(key=lambda at: -squares[at])
    others = tuple(test_set.keys_of(at) for at in rivals)
    effects = tuple(_at_its_place(test_set, without, places, keys, own, variance))
    return Outlier(keys, float(np.sqrt(own)), others, effects)


def _places(test_set: ScoreTests) -> Places:
    """Return the alternatives of each place: family and number, by the names of what they act on."""
    found: dict[frozenset[tuple[str, str]], list[tuple[int, int]]] = {}
    for family, one in enumerate(test_set.families):
        for number, alternative in enumerate(() if one.unknown else one.alternatives):
            place = zip(alternative.effect.keys, alternative.instance, strict=True)
            found.setdefault(frozenset(place), []).append((family, number))
    return found


def _at_its_place(
    test_set: ScoreTests, without: FittedColumns, places: Places, keys: Mapping[str, str], own: float, variance: float
) -> Iterator[Alternative]:
    """Yield the best form of each effect at the place of a reading that explains as much as the error of the reading.

    Where it also changes other readings, these contradict it unless they are much less certain.
    """
    here = [combination for size in range(1, len(keys) + 1) for combination in combinations(keys.items(), size)]
    families: dict[int, list[int]] = {}
    for place in here:
        for family, number in places.get(frozenset(place), ()):
            families.setdefault(family, []).append(number)
    for family, numbers in families.items():
        score = test_set.score(family, without, numbers)
        if as_likely(np.array([own, score.gain[score.best] / variance]))[1]:
            yield test_set.alternative(family, numbers[score.best])
