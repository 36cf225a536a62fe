"""Levels of significance to enter the model and to stay in it, and the rule for dominant effects.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from metrocli.diagnosis.selection.selection_state import Chosen, Selection

FIRST, LATER, UNKNOWN, WRONG_READING = 0.03, 0.01, 0.005, 0.01
"""Levels, corrected for all tests, of the first effect, of further effects, of smooth terms and of outliers

Beside outliers the first effect has the level of further ones, because more readings are wrong than are found.
"""
STANDING_OUT = 0.05
"""Level at which an effect stands out of the smooth terms in which it lies, so that it is named beside them

It is corrected for the number of effects that lie in the terms.
"""
_DOMINANT, _MANY = 4.0, 50
"""Effects are dominant if they lower the mean square by this factor, with at least so many degrees of freedom"""


def entry_level(selection: Selection, family: int) -> float:
    """Return the level below which a family enters the model."""
    if family < 0:
        return WRONG_READING
    if selection.test_set.families[family].unknown:
        return UNKNOWN
    return LATER if selection.chosen else FIRST


def exit_level(selection: Selection, one: Chosen) -> float:
    """Return the level above which a member leaves the model."""
    if one.outlier:
        return WRONG_READING
    if selection.around(one):
        return 2 * STANDING_OUT
    return FIRST if len(selection.chosen) == 1 else 2 * LATER


def has_dominant_effect(selection: Selection) -> bool:
    """Return whether most of the misfit comes from effects with which the unknowns are not adjusted yet.

    Signatures are derivatives. The higher-order terms of a large effect would look like other effects, so the search
    stops until the unknowns are adjusted with it.
    """
    test_set, fitted = selection.test_set, selection.fitted()
    if selection.unknown or fitted.dof <= _MANY:
        return False
    new = [one for one in selection.named if selection.alternative(one).spot not in test_set.adjusted]
    without = selection.fitted(without=new)
    return bool(new) and without.squares / without.dof > _DOMINANT * fitted.squares / fitted.dof
