"""Selection: effects, unknown smooth terms and outliers race; what wins goes into the model, and must stay worth it."""

from __future__ import annotations

from metrocli.diagnosis.given import Fit, Given
from metrocli.diagnosis.levels import dominated
from metrocli.diagnosis.race import Field
from metrocli.diagnosis.selected import Selection
from metrocli.diagnosis.settled import settled
from metrocli.diagnosis.steps import steps

_STEPS = 40


def select(field: Field, start: Given) -> Selection:
    """Return what wins the race, step by step, until nothing more is beyond chance.

    A step that leads back to what was there before gives way to the next best.
    """
    selection = Selection(field, Fit(start))
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
