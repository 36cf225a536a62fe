"""Stepwise selection of effects, smooth terms and outliers: forward steps to the most significant, then backward steps.

A member stays in the model only while it is significant beside the others.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from metrocli.diagnosis.linear.fitted_columns import FittedColumns, FittedParts, nothing_fitted
from metrocli.diagnosis.linear.score_tests import ScoreTests
from metrocli.diagnosis.selection.all_of_a_kind import all_of_a_kind
from metrocli.diagnosis.selection.backward_steps import backward_steps
from metrocli.diagnosis.selection.forward_steps import forward_steps
from metrocli.diagnosis.selection.selection_state import Chosen, Selection
from metrocli.diagnosis.selection.thresholds import has_dominant_effect

STRUCTURED = 4
"""Number of smooth terms that show structure at all scales: a smooth process explains it rather than further terms"""
_STEPS = 40


def search(test_set: ScoreTests, start: FittedColumns, most_smooth: int = _STEPS) -> Selection:
    """Return the selection found step by step from `start`, until no further candidate is significant.

    It ends before, where it has `most_smooth` smooth terms.
    """
    return continued(Selection(test_set, FittedParts(start)), most_smooth)


def continued(selection: Selection, most_smooth: int = _STEPS) -> Selection:
    """Return a selection after further forward and backward steps, until no candidate is significant beside it.

    A step that leads back to an earlier selection is replaced by the next best step. The search also ends where
    instances of an effect turn out to be one scatter of all of its kind: the job is then adjusted with it. It ends with
    what it has found where its time is spent.
    """
    selection = backward_steps(selection)
    passed = [selection.members]
    for _ in range(_STEPS):
        if selection.test_set.budget.spent() or len(selection.unknown) >= most_smooth:
            break
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
        if all_of_a_kind(selection) is not None:
            return selection
    return backward_steps(selection)


def transferred(selection: Selection, test_set: ScoreTests) -> Selection:
    """Return the selection with the same members in other score tests, at the nearest values of scanned parameters."""
    new = Selection(test_set, FittedParts(nothing_fitted(test_set.system)))
    for one in selection.chosen:
        if one.outlier:
            new = new.with_one(Chosen(-1, one.number, test_set.of_reading(one.number)))
            continue
        place = test_set.place_of(selection.alternative(one), one.columns.shape[1])
        if place is not None:
            new = new.with_one(Chosen(*place, test_set.visible(*place)))
    return new
