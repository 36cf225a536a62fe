"""Selection: effects, unknown smooth terms and outliers race; what wins goes into the model, and must stay worth it.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from metrocli.diagnosis.linear.fitted_columns import FittedColumns, FittedParts, nothing_fitted
from metrocli.diagnosis.linear.score_tests import ScoreTests
from metrocli.diagnosis.selection.backward_steps import backward_steps
from metrocli.diagnosis.selection.forward_steps import forward_steps
from metrocli.diagnosis.selection.selection_state import Chosen, Selection
from metrocli.diagnosis.selection.thresholds import has_dominant_effect

_STEPS = 40


def search(test_set: ScoreTests, start: FittedColumns) -> Selection:
    """Return what wins the race, step by step, until nothing more is beyond chance."""
    return continued(Selection(test_set, FittedParts(start)))


def continued(selection: Selection) -> Selection:
    """Return a selection with what else wins the race beside it, and without what is not worth it any more.

    A step that leads back to what was there before gives way to the next best.
    """
    selection = backward_steps(selection)
    passed = [selection.members]
    for _ in range(_STEPS):
        for step in forward_steps(selection):
            if has_dominant_effect(step):
                return step
            new = backward_steps(step)
            if new.members not in passed:
                break
        else:
            break
        selection = new
        passed.append(selection.members)
    return backward_steps(selection)


def transferred(selection: Selection, test_set: ScoreTests) -> Selection:
    """Return the selection of the same in another race; of scanned parameters, the values next to those it had."""
    new = Selection(test_set, FittedParts(nothing_fitted(test_set.system)))
    for one in selection.chosen:
        if one.outlier:
            new = new.with_one(Chosen(-1, one.number, test_set.of_reading(one.number)))
            continue
        place = test_set.place_of(selection.test_set.alternative(one.family, one.number), one.columns.shape[1])
        if place is not None:
            new = new.with_one(Chosen(*place, test_set.families[place[0]].columns[:, place[1]]))
    return new
