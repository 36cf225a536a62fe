"""Backward steps: names are replaced by better ones or by wrong readings, and what is not significant is removed.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Mask
from metrocli.adjust.robust import SAME
from metrocli.diagnosis.linear.fitted_columns import FittedColumns
from metrocli.diagnosis.linear.score_tests import Score, ScoreTests
from metrocli.diagnosis.selection.selection_state import Chosen, Selection, levels_of
from metrocli.diagnosis.selection.thresholds import WRONG_READING, exit_level

_CLEARLY = 1.0
"""Smallest difference of the evidence (ln) by which a name counts as better than another, or than wrong readings"""
_FEW = 3
"""Largest number of wrong readings that replace a name"""


def backward_steps(selection: Selection) -> Selection:
    """Return the selection after swaps, without members that are not significant beside the others."""
    if len(selection.chosen) > 1:
        selection = _with_swaps(selection)
    return _without_idle(_with_wrong_readings(selection))


def _without_idle(selection: Selection) -> Selection:
    """Return the selection without members that are not significant beside the others, the weakest removed first."""
    while selection.chosen:
        levels = levels_of(selection)
        over = [level - np.log(exit_level(selection, one)) for level, one in zip(levels, selection.chosen, strict=True)]
        worst = int(np.argmax(over))
        if over[worst] <= 0:
            break
        selection = selection.without(selection.chosen[worst])
    return selection


def evidence(test_set: ScoreTests, fitted: FittedColumns, family: int, score: Score) -> Array:
    """Return ln of the evidence for each alternative, `-(nu ln RSS + q ln nu)/2 - ln m` (Schwarz 1978).

    nu are the degrees of freedom, RSS is the residual sum of squares with the alternative, q its rank, and m the
    effective number of tests of its family.
    """
    left = np.maximum(fitted.squares - score.gain, 1e-300)
    terms = fitted.dof * np.log(left) + score.rank * np.log(max(fitted.dof, 2.0))
    value = -terms / 2 - np.log(test_set.tests[family])
    return np.asarray(np.where(score.rank > 0, value, -np.inf))


def evidence_of(selection: Selection, names: Sequence[Chosen], bare: FittedColumns, fitted: FittedColumns) -> float:
    """Return ln of the evidence of named effects in a fit, against the fit without them."""
    count = float(np.log(bare.squares / fitted.squares)) * bare.dof - (bare.dof - fitted.dof) * float(np.log(bare.dof))
    return count / 2 - float(sum(np.log(selection.test_set.tests[one.family]) for one in names))


def _with_swaps(selection: Selection) -> Selection:
    """Return the selection with names replaced by others that have more evidence beside the rest of the selection.

    A name replaces another only if the other is then no longer needed. A name that explains something else is left to
    the forward steps.
    """
    # swaps could go round in a circle, so their rounds are limited
    for _ in range(5):
        for one in (*selection.named, *selection.unknown):
            new = _better(selection, one)
            if new is not None:
                selection = selection.with_one(new, instead=one)
                break
        else:
            break
    return selection


def _with_wrong_readings(selection: Selection) -> Selection:
    """Return the selection with wrong readings instead of each name that they explain as well.

    Two wrong readings of one image together look like a bad pose, and the pose then shows before each of them.
    """
    for one in selection.named:
        if not selection.around(one):
            selection = _as_one_wrong_reading(selection, one) or _as_wrong_readings(selection, one) or selection
    return selection


def _as_one_wrong_reading(selection: Selection, one: Chosen) -> Selection | None:
    """Return the selection with a wrong reading instead of a name that is the same to all other readings, else None.

    Beside its dead path, a jump after the first reading of a tracer is an error of that reading. How many readings
    there are is no evidence for the jump.
    """
    bare = selection.without(one)
    new = _with_wrong_reading(bare, True)
    if new is None or new.fitted().dof < selection.fitted().dof or _is_needed(selection, one, new):
        return None
    explained = bare.fitted().squares - np.array([selection.fitted().squares, new.fitted().squares])
    return new if explained[1] > SAME**2 * explained[0] else None


def _as_wrong_readings(selection: Selection, one: Chosen) -> Selection | None:
    """Return the selection with wrong readings instead of a name; None if the name has clearly more evidence.

    Selected wrong readings at its place are part of its explanation: beside the true ones they may not be needed.
    """
    test_set, own = selection.test_set, (one, *selection.wrong_at(one))
    bare = new = selection.without(*own)
    changed = test_set.changed_by(one.family, one.number)
    for _ in range(_FEW + len(own) - 1):
        more = _with_wrong_reading(new, changed)
        if more is None:
            return None
        new = more
        if not _is_needed(selection, one, new):
            added = new.chosen[len(bare.chosen) :]
            better = evidence_of(selection, own, bare.fitted(), selection.fitted())
            return new if evidence_of(new, added, bare.fitted(), new.fitted()) > better - _CLEARLY else None
    return None


def _with_wrong_reading(selection: Selection, among: Mask | bool) -> Selection | None:
    """Return the selection with the most significant wrong reading among some; None if it is not significant."""
    test_set = selection.test_set
    wrong = test_set.outliers(selection.fitted(), among)
    if test_set.overall(test_set.level(-1, wrong.log_p[wrong.best])) > np.log(WRONG_READING):
        return None
    return selection.with_one(Chosen(-1, wrong.best, test_set.of_reading(wrong.best)))


def _is_needed(selection: Selection, one: Chosen, beside: Selection) -> bool:
    """Return whether a member of a selection would be significant beside another selection."""
    test_set = selection.test_set
    left = test_set.score(one.family, beside.fitted(), [one.number]).log_p[0]
    level = test_set.overall(test_set.level(one.family, float(left)))
    return level < float(np.log(exit_level(selection, one)))


def _better(selection: Selection, one: Chosen) -> Chosen | None:
    """Return the replacement of a chosen member, or None if it stays."""
    test_set, fitted = selection.test_set, selection.beside(one)
    scores = test_set.scores(fitted)
    best = [evidence(test_set, fitted, i, score) for i, score in enumerate(scores)]
    for family, number in test_set.around(one.family, one.number) if one in selection.named else ():
        # smooth terms that contain the effect are no replacement: the forward steps compare them with it
        best[family][number] = -np.inf
    family = _preferred(test_set, best, one)
    number = int(np.argmax(best[family]))
    differs = family != one.family
    if not differs and best[family][number] <= best[family][one.number] + 1e-6:
        return None
    old, its = scores[one.family].log_p[one.number], scores[family].log_p[number]
    if family > one.family and test_set.level(family, its) > test_set.level(one.family, old):
        return None
    new = Chosen(family, number, test_set.visible(family, number))
    left = test_set.score(one.family, fitted.with_columns(new.columns), [one.number]).log_p[0]
    needed = test_set.overall(test_set.level(one.family, float(left))) < np.log(exit_level(selection, one))
    return None if differs and needed else new


def _preferred(test_set: ScoreTests, best: Sequence[Array], one: Chosen) -> int:
    """Return the family with clearly the most evidence, otherwise the first of the equally good ones.

    The tables of effects list the usual causes first.
    """
    most = np.array([values.max(initial=-np.inf) for values in best])
    own = best[one.family][one.number]
    if most.max() > own + _CLEARLY and int(most.argmax()) != one.family:
        return int(most.argmax())
    if test_set.families[one.family].unknown:
        return one.family
    return int(np.flatnonzero(most[: one.family + 1] >= own - _CLEARLY)[0])
