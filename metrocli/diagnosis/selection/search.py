"""Selection: effects, unknown smooth terms and outliers race; what wins goes into the model, and must stay worth it."""

from __future__ import annotations

from metrocli.diagnosis.linear.fitted_columns import Fit, Given, nothing
from metrocli.diagnosis.linear.score_tests import Field
from metrocli.diagnosis.selection.backward_steps import settled
from metrocli.diagnosis.selection.forward_steps import steps
from metrocli.diagnosis.selection.selection_state import Chosen, Selection
from metrocli.diagnosis.selection.thresholds import dominated

_STEPS = 40


def select(field: Field, start: Given) -> Selection:
    """Return what wins the race, step by step, until nothing more is beyond chance."""
    return carried_on(Selection(field, Fit(start)))


def carried_on(selection: Selection) -> Selection:
    """Return a selection with what else wins the race beside it, and without what is not worth it any more.

    A step that leads back to what was there before gives way to the next best.
    """
    selection = settled(selection)
    passed = [selection.members]
    for _ in range(_STEPS):
        for step in steps(selection):
            if dominated(step):
                return step
            new = settled(step)
            if new.members not in passed:
                break
        else:
            break
        selection = new
        passed.append(selection.members)
    return settled(selection)


def carried_over(selection: Selection, field: Field) -> Selection:
    """Return the selection of the same in another race; of scanned parameters, the values next to those it had."""
    new = Selection(field, Fit(nothing(field.system)))
    for one in selection.chosen:
        if one.outlier:
            new = new.with_one(Chosen(-1, one.number, field.of_reading(one.number)))
            continue
        place = field.place_of(selection.field.alternative(one.family, one.number), one.columns.shape[1])
        if place is not None:
            new = new.with_one(Chosen(*place, field.families[place[0]].columns[:, place[1]]))
    return new
