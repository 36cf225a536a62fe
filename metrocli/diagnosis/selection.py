"""Selection: effects, unknown smooth terms and outliers race; what wins goes into the model, and must stay worth it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from metrocli.adjust.blocks import Array
from metrocli.diagnosis.distributions import log_tail
from metrocli.diagnosis.given import Fit, Given
from metrocli.diagnosis.race import Field, Score

FIRST, LATER, UNKNOWN, WRONG_READING = 0.03, 0.01, 0.005, 0.01
"""Levels, counted over all that is tried: of the first name, of further names, of smooth terms and of outliers

Beside outliers the first name has the level of further ones: where readings are wrong, more are than are found.
"""
_STEPS = 40
_SHARE = 0.1
"""Readings that may be called outliers at most"""
_AS_MUCH = 0.9
"""Share of what a smooth function explains from which effects that explain it are named first"""
_DOMINANT, _MANY = 20.0, 50
"""By how much effects lower the mean square, and degrees of freedom left, for all else to wait for their adjustment"""
_TOGETHER = 4
"""Effects at most that may stand for one smooth term"""
_ALIKE = 0.3
"""Correlation of two outliers above which they are not taken in one step"""
_FEW = 3
_CLEARLY = 1.0
"""By how much the evidence (ln) of another name must be larger to take the place of one that is in the model"""


@dataclass(frozen=True)
class Chosen:
    """What is in the model: an alternative of a family, or an outlier (family -1, a reading)."""

    family: int
    number: int
    columns: Array

    @property
    def outlier(self) -> bool:
        """Whether it is a wrong reading."""
        return self.family < 0


@dataclass(frozen=True)
class Selection:
    """What the readings ask for beside the model of the job."""

    field: Field
    fit: Fit
    chosen: tuple[Chosen, ...] = ()
    """What the parts of the fit are, one by one"""

    @property
    def named(self) -> tuple[Chosen, ...]:
        """The effects, without smooth terms and outliers."""
        return tuple(one for one in self.chosen if not one.outlier and not self.field.families[one.family].unknown)

    @property
    def unknown(self) -> tuple[Chosen, ...]:
        """The smooth terms."""
        return tuple(one for one in self.chosen if not one.outlier and self.field.families[one.family].unknown)

    @property
    def outliers(self) -> tuple[Chosen, ...]:
        """The wrong readings."""
        return tuple(one for one in self.chosen if one.outlier)

    @property
    def members(self) -> frozenset[tuple[int, int]]:
        """Family and number of all that was chosen."""
        return frozenset((one.family, one.number) for one in self.chosen)

    def given(self, without: Sequence[Chosen] = ()) -> Given:
        """Return the model with what was chosen, but for some."""
        gone = [number for number, one in enumerate(self.chosen) if any(one is other for other in without)]
        return self.fit.without(gone) if gone else self.fit.given

    def with_one(self, one: Chosen, instead: Chosen | None = None) -> Selection:
        """Return the selection with one more, or with it in the place of another."""
        kept = self if instead is None else self.without(instead)
        return replace(kept, fit=kept.fit.with_part(one.columns), chosen=(*kept.chosen, one))

    def without(self, gone: Chosen) -> Selection:
        """Return the selection without one."""
        kept = [number for number, one in enumerate(self.chosen) if one is not gone]
        return replace(self, fit=self.fit.only(kept), chosen=tuple(self.chosen[number] for number in kept))

    def levels(self) -> list[float]:
        """Return ln of the level of each that was chosen, given the others, counted over all that was tried."""
        return levels_of(self)


def select(field: Field, start: Given) -> Selection:
    """Return what wins the race, step by step, until nothing more is beyond chance."""
    selection, passed = Selection(field, Fit(start)), []
    for _ in range(_STEPS):
        step = _step(selection)
        if step is not None and _dominated(step):
            return step
        settled = selection if step is None else _settled(step)
        if settled.members == selection.members or settled.members in passed:
            break
        selection = settled
        passed.append(selection.members)
    return _settled(selection)


def _dominated(selection: Selection) -> bool:
    """Whether effects make up nearly all of the residuals: what else there is shows when they have been adjusted.

    Their signatures are linear about a model without them; what that leaves of a large effect is structure of its own.
    """
    given = selection.given()
    large = selection.fit.start.squares / selection.fit.start.dof > _DOMINANT * given.squares / max(given.dof, 1.0)
    return bool(selection.named) and not selection.unknown and large and given.dof > _MANY


def _settled(selection: Selection) -> Selection:
    """Return the selection after swaps, and without what is not worth it beside the others."""
    if len(selection.chosen) > 1:
        selection = _swapped(selection)
    return _dropped(selection)


def _step(selection: Selection) -> Selection | None:
    """Return the selection with the winner of the race, None where nothing is beyond chance."""
    field, given = selection.field, selection.given()
    if given.dof < 3:
        return None
    scores = field.scores(given)
    found = [(field.level(i, score.log_p[score.best]), i) for i, score in enumerate(scores) if len(score.gain)]
    wrong = field.outliers(given)
    if len(selection.outliers) < _SHARE * len(wrong.gain):
        found.append((field.level(-1, wrong.log_p[wrong.best]), -1))
    for level, family in sorted(found):
        if field.overall(level) > np.log(_allowed(selection, family)):
            continue
        if family < 0:
            return _with_outliers(selection, wrong, given)
        score = scores[family]
        if field.families[family].unknown:
            if carried_by_few(field, given, family, score.best) > np.log(UNKNOWN):
                continue
            known = _with_effects(selection)
            best = field.score(family, known.given())
            left = field.overall(field.level(family, best.log_p[best.best]))
            if left > np.log(UNKNOWN) and _together(selection, known) <= level:
                return known
            if given.squares - known.given().squares > _AS_MUCH * score.gain[score.best]:
                return known
        return _with_best(selection, family, score)
    return None


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
        level, family, score = min(found, key=lambda one: one[0])
        if given.dof < 3 or field.overall(level) > np.log(_allowed(selection, family)) or _dominated(selection):
            break
        selection = _with_best(selection, family, score)
    return selection


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


def _allowed(selection: Selection, family: int) -> float:
    if family < 0:
        return WRONG_READING
    if selection.field.families[family].unknown:
        return UNKNOWN
    return LATER if selection.chosen else FIRST


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


def levels_of(selection: Selection) -> list[float]:
    """Return ln of the level of each chosen one given the others."""
    field, full = selection.field, selection.given()
    gains = {id(one): selection.given(without=[one]) for one in selection.chosen if not one.outlier}
    found = _outlier_gains(selection)
    levels = []
    for one in selection.chosen:
        if one.outlier:
            gain, q = found[id(one)]
        else:
            without = gains[id(one)]
            gain, q = without.squares - full.squares, int(without.dof - full.dof)
        share = np.array(gain / max(full.squares + gain, 1e-300))
        log_p = float(log_tail(share, q, max(full.dof, 1))) if q else 0.0
        levels.append(field.overall(field.level(one.family, log_p)))
    return levels


def _outlier_gains(selection: Selection) -> dict[int, tuple[float, int]]:
    """Return by how much each outlier lowers the sum of squares beside all else, and its rank, from one solution."""
    outliers = selection.outliers
    if not outliers:
        return {}
    base = selection.given(without=outliers)
    x = np.concatenate([one.columns for one in outliers], axis=1)
    x = x - base.basis @ (base.basis.T @ x)
    size = np.maximum(np.linalg.norm(x, axis=0), 1e-300)
    inverse = np.linalg.pinv((x / size).T @ (x / size), rcond=1e-11, hermitian=True)
    beta = inverse @ ((x / size).T @ base.residual)
    found, place = {}, 0
    for one in outliers:
        own = slice(place, place + one.columns.shape[1])
        place = own.stop
        values, vectors = np.linalg.eigh(inverse[own, own])
        good = values > 1e-9 * max(float(values[-1]), 1e-300)
        gain = float((((vectors.T @ beta[own]) ** 2)[good] / values[good]).sum())
        found[id(one)] = gain, int(good.sum())
    return found


def _dropped(selection: Selection) -> Selection:
    """Return the selection without those that are not beyond chance given the others, the least worth first."""
    while selection.chosen:
        levels = selection.levels()
        over = [level - np.log(_bound(selection, one)) for level, one in zip(levels, selection.chosen, strict=True)]
        worst = int(np.argmax(over))
        if over[worst] <= 0:
            break
        selection = selection.without(selection.chosen[worst])
    return selection


def _bound(selection: Selection, one: Chosen) -> float:
    if one.outlier:
        return WRONG_READING
    return FIRST if len(selection.chosen) == 1 else 2 * LATER


def evidence(field: Field, given: Given, family: int, score: Score) -> Array:
    """Return ln of the evidence for each alternative, `-(nu ln RSS + q ln nu)/2 - ln m` (Schwarz 1978)."""
    left = np.maximum(given.squares - score.gain, 1e-300)
    terms = given.dof * np.log(left) + score.rank * np.log(max(given.dof, 2.0))
    value = -terms / 2 - np.log(field.tests[family])
    return np.asarray(np.where(score.rank > 0, value, -np.inf))


def _swapped(selection: Selection) -> Selection:
    """Return the selection with each name replaced by one that the others leave more evidence for, if there is one."""
    field = selection.field
    for _ in range(5):
        for one in (*selection.named, *selection.unknown):
            given = selection.given(without=[one])
            scores = field.scores(given)
            best = [evidence(field, given, i, score) for i, score in enumerate(scores)]
            own = best[one.family][one.number]
            family = int(np.argmax([values.max(initial=-np.inf) for values in best]))
            number = int(np.argmax(best[family]))
            differs, old = family != one.family, scores[one.family].log_p[one.number]
            worse = (
                field.level(family, scores[family].log_p[number]) > field.level(one.family, old) if differs else False
            )
            if best[family][number] > own + (_CLEARLY if differs else 1e-6) and not worse:
                new = Chosen(family, number, field.families[family].columns[:, number])
                selection = selection.with_one(new, instead=one)
                break
        else:
            break
    return selection
