"""Levels: when something may go into the model, when it must leave it, and when all else has to wait.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from metrocli.diagnosis.selection.selection_state import Chosen, Selection

FIRST, LATER, UNKNOWN, WRONG_READING = 0.03, 0.01, 0.005, 0.01
"""Counted over all that is tried: of the first name, of further names, of smooth terms and of outliers

Beside outliers the first name has the level of further ones: where readings are wrong, more are than are found.
"""
STANDING_OUT = 0.05
"""Level at which an effect must stand out of smooth terms in which it lies to be named beside them

Counted over the effects that lie in them.
"""
_DOMINANT, _MANY = 4.0, 50
"""By how much effects lower the mean square, and degrees of freedom, for all else to wait until they are adjusted"""


def entry_level(selection: Selection, family: int) -> float:
    """Return the level that a family needs to go into the model."""
    if family < 0:
        return WRONG_READING
    if selection.test_set.families[family].unknown:
        return UNKNOWN
    return LATER if selection.chosen else FIRST


def exit_level(selection: Selection, one: Chosen) -> float:
    """Return the level beyond which what was chosen has to leave."""
    if one.outlier:
        return WRONG_READING
    if selection.around(one):
        return 2 * STANDING_OUT
    return FIRST if len(selection.chosen) == 1 else 2 * LATER


def has_dominant_effect(selection: Selection) -> bool:
    """Whether effects with which the unknowns were not adjusted make up most of what is left without them.

    Signatures are derivatives: what those of a large effect leave beyond first order would look like other effects.
    """
    test_set, fitted = selection.test_set, selection.fitted()
    if selection.unknown or fitted.dof <= _MANY:
        return False
    new = [one for one in selection.named if test_set.alternative(one.family, one.number).spot not in test_set.adjusted]
    without = selection.fitted(without=new)
    return bool(new) and without.squares / without.dof > _DOMINANT * fitted.squares / fitted.dof
