"""Wrong readings: each outlier of a selection with the other readings that are as likely to be the wrong one.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from metrocli.adjust.robust import as_likely
from metrocli.diagnosis.linear.score_tests import ScoreTests
from metrocli.diagnosis.selection.selection_state import Chosen, Selection


@dataclass(frozen=True)
class Outlier:
    """A reading that is wrong (gross error)."""

    keys: Mapping[str, str]
    test: float
    """Its error in standard deviations, with all other findings in the model"""
    others: tuple[Mapping[str, str], ...] = ()
    """Readings whose error would explain the misfit about as well, the likeliest first"""


def wrong_readings(selection: Selection) -> tuple[Outlier, ...]:
    """Return the outliers, the largest first, each with the test of it beside all else in the model."""
    return tuple(sorted((_outlier(selection, one) for one in selection.outliers), key=lambda one: -one.test))


def _outlier(selection: Selection, one: Chosen) -> Outlier:
    """Return an outlier with the readings whose error would explain as much, beside all else in the model."""
    test_set, fitted, without = selection.test_set, selection.fitted(), selection.fitted(without=[one])
    variance = fitted.squares / max(fitted.dof, 1)
    gain, rank = test_set.gains_of_readings(without)
    # an error of several components can always explain more: only readings of its rank compare
    squares = np.where(rank == rank[one.number], gain, 0.0) / variance
    own = max(without.squares - fitted.squares, 0.0) / variance
    taken = [other.number for other in selection.outliers]
    rivals = [at for at in np.flatnonzero(as_likely(np.minimum(squares, own))).tolist() if at not in taken]
    rivals.sort(key=lambda at: -squares[at])
    return Outlier(_keys(test_set, one.number), float(np.sqrt(own)), tuple(_keys(test_set, at) for at in rivals))


def _keys(test_set: ScoreTests, number: int) -> dict[str, str]:
    """Return the keys that identify a reading, with its component if the components are tested one by one."""
    row = int(test_set.places[number][0])
    groups = test_set.system.model.readings
    group = next(g for g in groups if 0 <= row - test_set.system.first[g.name] < g.observations.readings.size)
    observations = group.observations
    reading, component = divmod(row - test_set.system.first[group.name], len(observations.readings))
    keys = {key: values[reading] for key, values in observations.keys.items()}
    single = len(observations.readings) > 1 and test_set.places.shape[1] == 1
    return keys | ({"component": observations.components[component]} if single else {})
