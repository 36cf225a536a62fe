"""Forward steps: candidates that are significant beside a selection and could enter the model next.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.linear.distributions import log_tail
from metrocli.diagnosis.linear.fitted_columns import FittedColumns
from metrocli.diagnosis.linear.projection import MOST_NUMBERS
from metrocli.diagnosis.linear.score_tests import Score, ScoreTests
from metrocli.diagnosis.selection.selection_state import Chosen, Drop, Selection, levels_of, special
from metrocli.diagnosis.selection.thresholds import (
    LATER,
    STANDING_OUT,
    UNKNOWN,
    WRONG_READING,
    entry_level,
    has_dominant_effect,
)
from metrocli.errors import InputError

_SHARE = 0.1
"""Largest share of the readings that can be named outliers"""
_AS_MUCH = 0.9
"""Effects that explain at least this share of what a smooth term explains are named before it"""
_TOGETHER = 4
"""Largest number of effects that replace one smooth term"""
_ALIKE = 0.3
"""Largest correlation of two outliers that are taken in one step"""
_FEW = 3


def forward_steps(selection: Selection) -> Iterator[Selection]:
    """Yield the selection with each significant candidate, the most significant first."""
    test_set, fitted = selection.test_set, selection.fitted()
    if fitted.dof < 3:
        return
    scores = test_set.scores(fitted)
    found = [(test_set.level(i, score.log_p[score.best]), i) for i, score in enumerate(scores) if len(score.gain)]
    wrong = test_set.outliers(fitted)
    if len(selection.outliers) < _SHARE * len(wrong.gain):
        found.append((test_set.level(-1, wrong.log_p[wrong.best]), -1))
    for level, family in sorted(found):
        if test_set.overall(level) > np.log(entry_level(selection, family)):
            continue
        if family < 0:
            yield _with_outliers(selection, wrong, fitted)
        elif test_set.families[family].unknown:
            yield from _with_smooth(selection, scores, family)
        else:
            yield _with_best(selection, family, scores[family])
    yield from _beside_smooth(selection)


def _with_smooth(selection: Selection, scores: Sequence[Score], family: int) -> Iterator[Selection]:
    """Yield the selection with effects that explain a smooth term, with one that stands out of it, then with itself."""
    test_set, fitted, score = selection.test_set, selection.fitted(), scores[family]
    if carried_by_few(test_set, fitted, family, score.best) > np.log(UNKNOWN):
        return
    known = _with_effects(selection)
    best = test_set.score(family, known.fitted())
    left = test_set.overall(test_set.level(family, best.log_p[best.best]))
    level = test_set.level(family, score.log_p[score.best])
    if (left > np.log(UNKNOWN) and _together(selection, known) <= level) or (
        fitted.squares - known.fitted().squares > _AS_MUCH * score.gain[score.best]
    ):
        yield known
    part = _standing_out(selection, scores)
    if part is not None:
        yield part
    yield _with_best(selection, family, score)


def _with_best(selection: Selection, family: int, score: Score) -> Selection:
    columns = selection.test_set.visible(family, score.best)
    return selection.with_one(Chosen(family, score.best, columns))


def _with_effects(selection: Selection) -> Selection:
    """Return the selection with the best effects if there were no smooth terms: several can make up one such term."""
    test_set = selection.test_set
    for _ in range(_TOGETHER):
        fitted = selection.fitted()
        found = [
            (test_set.level(i, score.log_p[score.best]), i, score)
            for i, score in enumerate(test_set.scores(fitted))
            if len(score.gain) and not test_set.families[i].unknown
        ]
        if not found:
            break
        level, family, score = min(found, key=lambda one: one[0])
        if (
            fitted.dof < 3
            or test_set.overall(level) > np.log(entry_level(selection, family))
            or has_dominant_effect(selection)
        ):
            break
        selection = _with_best(selection, family, score)
    return selection


def _standing_out(selection: Selection, scores: Sequence[Score]) -> Selection | None:
    """Return the selection with the significant effect that stands out of all smooth terms in which it lies.

    Several effects together look like a smooth term with many parameters, which is then more significant than each of
    them. Causes are named before smooth terms.
    """
    test_set = selection.test_set
    effects = [i for i, family in enumerate(test_set.families) if not family.unknown and len(scores[i].gain)]
    levels = {i: test_set.overall(test_set.level(i, scores[i].log_p[scores[i].best])) for i in effects}
    for family in sorted(effects, key=lambda i: levels[i]):
        best = scores[family].best
        if levels[family] < np.log(LATER) and all(
            _stands_out(test_set, scores, (family, best), smooth) for smooth in test_set.around(family, best)
        ):
            return _with_best(selection, family, scores[family])
    return None


def _stands_out(
    test_set: ScoreTests, scores: Sequence[Score], effect: tuple[int, int], smooth: tuple[int, int]
) -> bool:
    own, whole = (Drop(float(scores[i].gain[at]), float(scores[i].rank[at])) for i, at in (effect, smooth))
    rest = Drop(whole.squares - own.squares, whole.dof - own.dof)
    return bool(special(test_set, effect[0], [smooth], own, rest) <= np.log(STANDING_OUT))


def _beside_smooth(selection: Selection) -> Iterator[Selection]:
    """Yield the selection with each effect that stands out of the selected smooth terms in which it lies.

    The smooth terms absorbed such an effect when they were chosen. It shows only with all other effects in the model.
    """
    test_set, unknown = selection.test_set, selection.unknown
    found = []
    for number, family in enumerate(test_set.families):
        if family.unknown or not unknown:
            continue
        lying = np.array([test_set.lying_in(one.family, one.number)[number] for one in unknown])
        for inside in np.unique(lying[:, lying.any(axis=0)], axis=1).T:
            places = np.flatnonzero((lying == inside[:, None]).all(axis=0))
            fitted = selection.fitted(without=[one for one, there in zip(unknown, inside, strict=True) if there])
            score = test_set.score(number, fitted, places.tolist())
            if test_set.overall(test_set.level(number, score.log_p[score.best])) > np.log(LATER):
                continue
            place = int(places[score.best])
            grown = selection.with_one(Chosen(number, place, test_set.visible(number, place)))
            level = levels_of(grown)[-1]
            if level <= np.log(STANDING_OUT):
                found.append((level, grown))
    for _, grown in sorted(found, key=lambda one: one[0]):
        yield grown


def _together(selection: Selection, known: Selection) -> float:
    """Return ln of the joint level of the additional members of a larger selection, corrected for multiple tests."""
    before, after = selection.fitted(), known.fitted()
    gain, q = before.squares - after.squares, int(before.dof - after.dof)
    if q < 1:
        return 0.0
    new = known.chosen[len(selection.chosen) :]
    tries = sum(float(np.log(selection.test_set.tests[one.family])) for one in new)
    return float(log_tail(np.array(gain / max(before.squares, 1e-300)), q, max(after.dof, 1.0))) + tries


def carried_by_few(test_set: ScoreTests, fitted: FittedColumns, family: int, number: int) -> float:
    """Return ln of the level of smooth terms without the few readings that support them most.

    A polynomial of many terms follows two or three wrong readings; true structure stays significant without them.
    """
    columns = test_set.visible(family, number)
    left = fitted.beside(columns)
    size = np.maximum(np.linalg.norm(left, axis=0), 1e-300)
    curve = (left / size) @ np.linalg.lstsq(left / size, fitted.residual, rcond=1e-6)[0]
    speaks = np.where(test_set.places >= 0, (curve * fitted.residual)[test_set.places], 0.0).sum(axis=1)
    few = np.argsort(-speaks)[:_FEW]
    beside = fitted.with_columns(np.concatenate([test_set.of_reading(int(reading)) for reading in few], axis=1))
    score = test_set.score(family, beside, [number])
    return test_set.overall(test_set.level(family, float(score.log_p[0])))


def _with_outliers(selection: Selection, wrong: Score, fitted: FittedColumns) -> Selection:
    """Return the selection with the worst reading, and with others as bad whose tests are not correlated with it."""
    test_set = selection.test_set
    there = {one.number for one in selection.outliers}
    batch: list[int] = []
    for reading in np.argsort(wrong.log_p, kind="stable").tolist():
        level = test_set.overall(test_set.level(-1, wrong.log_p[reading]))
        if level > np.log(WRONG_READING) or wrong.gain[reading] < wrong.gain[wrong.best] / 2:
            break
        if reading not in there and all(_alike(test_set, reading, other) < _ALIKE for other in batch):
            batch.append(reading)
    _must_be_held(test_set, fitted.width + len(batch) * test_set.places.shape[1])
    for reading in batch:
        selection = selection.with_one(Chosen(-1, reading, test_set.of_reading(reading)))
    return selection


def _must_be_held(test_set: ScoreTests, columns: int) -> None:
    """Raise InputError if so many fitted columns need more memory than a diagnosis may take."""
    rows = test_set.system.rows
    if rows * columns > MOST_NUMBERS:
        raise InputError(
            f"diagnose finds more than {MOST_NUMBERS // rows} wrong readings and effects in {rows} readings: "
            "it fits them together, which needs too much memory\n"
            "remove the wrong readings first: write `outliers: remove` in the job"
        )


def _alike(test_set: ScoreTests, reading: int, other: int) -> float:
    """Return the largest correlation of the tests of two readings."""
    rows, others = test_set.places[reading], test_set.places[other]
    product = test_set.system.basis.products(rows[rows >= 0], others[others >= 0])
    sizes = np.sqrt(np.outer(_diagonal(test_set, reading), _diagonal(test_set, other)))
    return float(np.abs(product / np.maximum(sizes, 1e-12)).max())


def _diagonal(test_set: ScoreTests, reading: int) -> Array:
    kept = test_set.places[reading] >= 0
    return np.asarray(np.diag(test_set.blocks[reading])[kept])
