"""Steps: what is beyond chance beside a selection, and would go into the model next."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.linear.distributions import log_tail
from metrocli.diagnosis.linear.fitted_columns import Given
from metrocli.diagnosis.linear.score_tests import Field, Score
from metrocli.diagnosis.selection.selection_state import Chosen, Drop, Selection, levels_of, special
from metrocli.diagnosis.selection.thresholds import LATER, STANDING_OUT, UNKNOWN, WRONG_READING, allowed, dominated

_SHARE = 0.1
"""Readings that may be called outliers at most"""
_AS_MUCH = 0.9
"""Share of what a smooth function explains from which effects that explain it are named first"""
_TOGETHER = 4
"""Effects at most that may stand for one smooth term"""
_ALIKE = 0.3
"""Correlation of two outliers above which they are not taken in one step"""
_FEW = 3


def steps(selection: Selection) -> Iterator[Selection]:
    """Yield the selection with each that is beyond chance, the winner of the race first."""
    field, given = selection.field, selection.given()
    if given.dof < 3:
        return
    scores = field.scores(given)
    found = [(field.level(i, score.log_p[score.best]), i) for i, score in enumerate(scores) if len(score.gain)]
    wrong = field.outliers(given)
    if len(selection.outliers) < _SHARE * len(wrong.gain):
        found.append((field.level(-1, wrong.log_p[wrong.best]), -1))
    for level, family in sorted(found):
        if field.overall(level) > np.log(allowed(selection, family)):
            continue
        if family < 0:
            yield _with_outliers(selection, wrong, given)
        elif field.families[family].unknown:
            yield from _with_smooth(selection, scores, family)
        else:
            yield _with_best(selection, family, scores[family])
    yield from _beside_smooth(selection)


def _with_smooth(selection: Selection, scores: Sequence[Score], family: int) -> Iterator[Selection]:
    """Yield the selection with the effects that make up a smooth term or stand out of it, if any; then with itself."""
    field, given, score = selection.field, selection.given(), scores[family]
    if carried_by_few(field, given, family, score.best) > np.log(UNKNOWN):
        return
    known = _with_effects(selection)
    best = field.score(family, known.given())
    left = field.overall(field.level(family, best.log_p[best.best]))
    level = field.level(family, score.log_p[score.best])
    if (left > np.log(UNKNOWN) and _together(selection, known) <= level) or (
        given.squares - known.given().squares > _AS_MUCH * score.gain[score.best]
    ):
        yield known
    part = _standing_out(selection, scores)
    if part is not None:
        yield part
    yield _with_best(selection, family, score)


def _with_best(selection: Selection, family: int, score: Score) -> Selection:
    columns = selection.field.families[family].columns[:, score.best]
    return selection.with_one(Chosen(family, score.best, columns))


def _with_effects(selection: Selection) -> Selection:
    """Return the selection with the effects that win a race without smooth terms: several may make up one of them."""
    field = selection.field
    for _ in range(_TOGETHER):
        given = selection.given()
        found = [
            (field.level(i, score.log_p[score.best]), i, score)
            for i, score in enumerate(field.scores(given))
            if len(score.gain) and not field.families[i].unknown
        ]
        if not found:
            break
        level, family, score = min(found, key=lambda one: one[0])
        if given.dof < 3 or field.overall(level) > np.log(allowed(selection, family)) or dominated(selection):
            break
        selection = _with_best(selection, family, score)
    return selection


def _standing_out(selection: Selection, scores: Sequence[Score]) -> Selection | None:
    """Return the selection with the effect beyond chance that stands out of all smooth terms in which it lies.

    Smooth terms that are many win against one effect among several that they contain; named are causes first.
    """
    field = selection.field
    effects = [i for i, family in enumerate(field.families) if not family.unknown and len(scores[i].gain)]
    levels = {i: field.overall(field.level(i, scores[i].log_p[scores[i].best])) for i in effects}
    for family in sorted(effects, key=lambda i: levels[i]):
        best = scores[family].best
        if levels[family] < np.log(LATER) and all(
            _stands_out(field, scores, (family, best), smooth) for smooth in field.around(family, best)
        ):
            return _with_best(selection, family, scores[family])
    return None


def _stands_out(field: Field, scores: Sequence[Score], effect: tuple[int, int], smooth: tuple[int, int]) -> bool:
    own, whole = (Drop(float(scores[i].gain[at]), float(scores[i].rank[at])) for i, at in (effect, smooth))
    rest = Drop(whole.squares - own.squares, whole.dof - own.dof)
    return bool(special(field, effect[0], [smooth], own, rest) <= np.log(STANDING_OUT))


def _beside_smooth(selection: Selection) -> Iterator[Selection]:
    """Yield the selection with each effect that stands out of those smooth terms in it in which it lies.

    What they took with them when they were chosen is seen only when all else is in the model.
    """
    field, unknown = selection.field, selection.unknown
    found = []
    for number, family in enumerate(field.families):
        if family.unknown or not unknown:
            continue
        lying = np.array([field.lying_in(one.family, one.number)[number] for one in unknown])
        for inside in np.unique(lying[:, lying.any(axis=0)], axis=1).T:
            places = np.flatnonzero((lying == inside[:, None]).all(axis=0))
            given = selection.given(without=[one for one, there in zip(unknown, inside, strict=True) if there])
            score = field.score(number, given, places.tolist())
            if field.overall(field.level(number, score.log_p[score.best])) > np.log(LATER):
                continue
            place = int(places[score.best])
            grown = selection.with_one(Chosen(number, place, family.columns[:, place]))
            level = levels_of(grown)[-1]
            if level <= np.log(STANDING_OUT):
                found.append((level, grown))
    for _, grown in sorted(found, key=lambda one: one[0]):
        yield grown


def _together(selection: Selection, known: Selection) -> float:
    """Return ln of the level of all that one selection has more than another, counted over their families."""
    before, after = selection.given(), known.given()
    gain, q = before.squares - after.squares, int(before.dof - after.dof)
    if q < 1:
        return 0.0
    new = known.chosen[len(selection.chosen) :]
    tries = sum(float(np.log(selection.field.tests[one.family])) for one in new)
    return float(log_tail(np.array(gain / max(before.squares, 1e-300)), q, max(after.dof, 1.0))) + tries


def carried_by_few(field: Field, given: Given, family: int, number: int) -> float:
    """Return ln of the level of smooth terms without the few readings that speak for them most.

    A polynomial of many terms follows two or three wrong readings; structure is what stays without them.
    """
    columns = field.families[family].columns[:, number]
    left = columns - given.basis @ (given.basis.T @ columns)
    size = np.maximum(np.linalg.norm(left, axis=0), 1e-300)
    fitted = (left / size) @ np.linalg.lstsq(left / size, given.residual, rcond=1e-6)[0]
    speaks = np.where(field.places >= 0, (fitted * given.residual)[field.places], 0.0).sum(axis=1)
    few = np.argsort(-speaks)[:_FEW]
    beside = given.with_columns(np.concatenate([field.of_reading(int(reading)) for reading in few], axis=1))
    score = field.score(family, beside, [number])
    return field.overall(field.level(family, float(score.log_p[0])))


def _with_outliers(selection: Selection, wrong: Score, given: Given) -> Selection:
    """Return the selection with the worst reading, and others as bad that do not share its error."""
    field = selection.field
    there = {one.number for one in selection.outliers}
    batch: list[int] = []
    for reading in np.argsort(wrong.log_p, kind="stable").tolist():
        level = field.overall(field.level(-1, wrong.log_p[reading]))
        if level > np.log(WRONG_READING) or wrong.gain[reading] < wrong.gain[wrong.best] / 2:
            break
        if reading not in there and all(_alike(field, reading, other) < _ALIKE for other in batch):
            batch.append(reading)
    for reading in batch:
        selection = selection.with_one(Chosen(-1, reading, field.of_reading(reading)))
    return selection


def _alike(field: Field, reading: int, other: int) -> float:
    """Return the largest correlation of the tests of two readings."""
    basis = field.system.basis
    rows, others = field.places[reading], field.places[other]
    product = basis[rows[rows >= 0]] @ basis[others[others >= 0]].T
    sizes = np.sqrt(np.outer(_diagonal(field, reading), _diagonal(field, other)))
    return float(np.abs(product / np.maximum(sizes, 1e-12)).max())


def _diagonal(field: Field, reading: int) -> Array:
    kept = field.places[reading] >= 0
    return np.asarray(np.diag(field.blocks[reading])[kept])
