"""Levels: when something may go into the model, when it must leave it, and when all else has to wait."""

from __future__ import annotations

from metrocli.diagnosis.selected import Chosen, Selection

FIRST, LATER, UNKNOWN, WRONG_READING = 0.03, 0.01, 0.005, 0.01
"""Counted over all that is tried: of the first name, of further names, of smooth terms and of outliers

Beside outliers the first name has the level of further ones: where readings are wrong, more are than are found.
"""
STANDING_OUT = 0.05
"""Level at which an effect must stand out of smooth terms in which it lies to be named beside them

Counted over the effects that lie in them.
"""
_DOMINANT, _MANY = 4.0, 50
"""By how much effects lower the mean square, and degrees of freedom left, for all else to wait for their adjustment"""


def allowed(selection: Selection, family: int) -> float:
    """Return the level that a family needs to go into the model."""
    if family < 0:
        return WRONG_READING
    if selection.field.families[family].unknown:
        return UNKNOWN
    return LATER if selection.chosen or selection.field.beside_others else FIRST


def bound(selection: Selection, one: Chosen) -> float:
    """Return the level beyond which what was chosen has to leave."""
    if one.outlier:
        return WRONG_READING
    if selection.around(one):
        return 2 * STANDING_OUT
    return FIRST if len(selection.chosen) == 1 and not selection.field.beside_others else 2 * LATER


def dominated(selection: Selection) -> bool:
    """Whether effects make up nearly all of the residuals: what else there is shows when they have been adjusted.

    Their signatures are linear about a model without them; what that leaves of a large effect is structure of its own.
    """
    given = selection.given()
    large = selection.fit.start.squares / selection.fit.start.dof > _DOMINANT * given.squares / max(given.dof, 1.0)
    return bool(selection.named) and not selection.unknown and large and given.dof > _MANY
