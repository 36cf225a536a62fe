"""The families of all effects: the candidates that the data can test, and what they cannot test.

Method: docs/algorithms/what-can-be-seen.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.linear.basis import rows_with_values
from metrocli.diagnosis.linear.candidates import Candidate, CandidateGroup, NotTested
from metrocli.diagnosis.linear.column_parts import Course, OwnColumns, StepColumns
from metrocli.diagnosis.linear.columns import CandidateColumns, gathered, joined
from metrocli.diagnosis.linear.projection import VISIBLE, Linearised
from metrocli.diagnosis.linear.scans import scanned_columns, scans
from metrocli.diagnosis.linear.signatures import of_places, scan
from metrocli.effects.effect import Effect
from metrocli.effects.extension import REACH, can_act, lacking, names_for, places_of
from metrocli.effects.links.own import NoValueAtReadingError
from metrocli.effects.model import Model

_MOST_PLACES = 3000
_SMALL = 1e-6
"""Visible share of the squares of a signature below which its visible part is computed, not a difference"""
_BEYOND = "the measurement sees only sizes beyond the plausible"


def families_of(job: AdjustedJob, system: Linearised) -> tuple[list[CandidateGroup], list[NotTested]]:
    """Return the candidates of all effects that the data can test, and the effects that they cannot test."""
    families: dict[tuple[str, int], list[CandidateGroup]] = {}
    missing: list[NotTested] = []
    for effect in job.effects:
        if effect.of_one_reading or effect.throughout:
            continue
        if effect.name in job.not_sought:
            missing.append(NotTested(effect, job.not_sought[effect.name]))
            continue
        missing += _untestable(job.model, effect)
        for family in _of_effect(job, system, effect, missing):
            families.setdefault((family.name, family.columns.parameters), []).append(family)
    tested = {candidate.effect.form for parts in families.values() for part in parts for candidate in part.alternatives}
    # without a place the whole cause is meant: another form of it may be tested all the same
    untested = [gap for gap in missing if gap.where or gap.effect.form not in tested]
    return [*map(_joined, families.values())], untested


def families_throughout(job: AdjustedJob, system: Linearised) -> tuple[CandidateGroup, ...]:
    """Return the effects that are sought at all their places at once only, as far as they can act somewhere."""
    wanted = [effect for effect in job.effects if effect.throughout and set(effect.keys) <= set(job.model.places)]
    return tuple(family for effect in wanted for family in _of_effect(job, system, effect, []))


def _joined(parts: Sequence[CandidateGroup]) -> CandidateGroup:
    if len(parts) == 1:
        return parts[0]
    placed = zip(np.cumsum([0, *(part.columns.count for part in parts[:-1])]).tolist(), parts, strict=True)
    return CandidateGroup(
        parts[0].name,
        tuple(candidate for part in parts for candidate in part.alternatives),
        joined([part.columns for part in parts]),
        np.concatenate([part.raw for part in parts]),
        np.concatenate([part.gram for part in parts]),
        whole={at + number: own for at, part in placed for number, own in part.whole.items()},
    )


def _untestable(model: Model, effect: Effect) -> list[NotTested]:
    """Return the reasons why an effect cannot be modelled: one if it is the same everywhere, else place by place."""
    places = [dict(zip(effect.keys, place, strict=True)) for place in _places(model, effect)]
    if not places and (effect.definition or effect.keys[0] in model.places):
        key = effect.keys[0]
        few = "all readings share one" if key in model.places and model.places[key].names else "this measurement has no"
        return [NotTested(effect, f"{few} {key}")]
    gaps = [NotTested(effect, lacking(model, effect, at), at) for at in places if not can_act(model, effect, at)]
    if len(gaps) == len(places) and len({gap.reason for gap in gaps}) == 1:
        return [NotTested(effect, gaps[0].reason)]
    return gaps


def instances(model: Model, effect: Effect) -> list[tuple[str, ...]]:
    """Return all places where an effect could act."""
    return places_of(model, effect)[:_MOST_PLACES]


def _places(model: Model, effect: Effect) -> list[tuple[str, ...]]:
    return list(product(*(names_for(model, effect, key) for key in effect.keys)))[:_MOST_PLACES]


def _of_effect(
    job: AdjustedJob, system: Linearised, effect: Effect, missing: list[NotTested]
) -> Iterator[CandidateGroup]:
    """Yield the families of an effect; add to `missing` where it has no value at a reading."""
    places = _absent(job.model, effect)
    # one linearisation serves all places whose members are rows of the readings' index; others change the chain itself
    together = bool(effect.keys) and not effect.selects and all(job.model.places[key].index for key in effect.keys)
    for chosen in [places] if together else [[place] for place in places]:
        by_size: dict[int, list[_Visible]] = {}
        try:
            for candidate, own in _columns(job, system, effect, chosen) if chosen else ():
                by_size.setdefault(own.values.shape[1], []).append((candidate, own))
        except NoValueAtReadingError as error:
            at = {} if together else dict(zip(effect.keys, chosen[0], strict=True))
            missing.append(NotTested(effect, str(error), at))
        for items in by_size.values():
            yield from _family(system, items, missing)


def _family(system: Linearised, items: Sequence[_Visible], missing: list[NotTested]) -> Iterator[CandidateGroup]:
    """Yield the family of some alternatives: whole columns, or their visible parts where these are small.

    `|g|^2 - |b'g|^2` keeps few digits of a small difference, so such a part is projected. Columns that are not visible
    are left out. So are scan values whose signature the unknowns absorb, if other values are visible at the same place:
    the time of a step that lies before all affected readings is such a value. Places of which only sizes out of reach
    are visible are added to `missing`.
    """
    columns = _gathered(items)
    raw, gram = columns.norms(), columns.grams(system.basis)
    shown = np.einsum("kqq->kq", gram) / np.where(raw > 0, raw, 1.0) ** 2
    visible = ~(shown < VISIBLE**2).all(axis=1)
    weak = visible & (shown < _SMALL).any(axis=1)
    changed, shown_items = ~visible | weak, list(items)
    for number in np.flatnonzero(changed).tolist():
        own = OwnColumns(np.zeros(0, dtype=np.intp), np.zeros((0, raw.shape[1])))
        if weak[number]:
            seen = system.seen(columns.whole([number], system.rows)[:, 0])
            own = OwnColumns(rows := rows_with_values(seen), seen[rows])
        shown_items[number] = (items[number][0], own)
        gram[number] = own.values.T @ own.values
        visible[number] = len(own.rows) > 0
    within = (np.sqrt(np.maximum(np.einsum("kqq->kq", gram), 0.0)) * _reach(items) >= 1).any(axis=1)
    shown_at = {items[number][0].instance for number in np.flatnonzero(visible & within).tolist()}
    beyond = {items[number][0].instance: items[number][0] for number in np.flatnonzero(visible & ~within).tolist()}
    missing += [
        NotTested(candidate.effect, _BEYOND, candidate.where)
        for place, candidate in beyond.items()
        if place not in shown_at
    ]
    somewhere = shown_at | beyond.keys()
    kept = [
        i for i, (candidate, _) in enumerate(items) if (visible[i] and within[i]) or candidate.instance not in somewhere
    ]
    if not kept:
        return
    yield CandidateGroup(
        items[0][0].effect.name,
        tuple(items[number][0] for number in kept),
        _gathered([shown_items[number] for number in kept]) if changed.any() or len(kept) < len(items) else columns,
        raw[kept],
        gram[kept],
        whole={at: items[number][1] for at, number in enumerate(kept) if changed[number]},
    )


def _reach(items: Sequence[_Visible]) -> Array:
    """Return the largest size of each parameter that a cause can have, (alternatives, parameters).

    An adjustment calls a larger one undetermined, so that no job could be extended by it.
    """
    effect = items[0][0].effect
    most = {parameter.name: parameter.plausible * (1.0 if effect.limited else REACH) for parameter in effect.parameters}
    return np.array([[most[name] for name in candidate.parameters] for candidate, _ in items])


_Visible = tuple[Candidate, OwnColumns | StepColumns]
"""A candidate with its columns at the rows that they change"""


def _gathered(items: Sequence[_Visible]) -> CandidateColumns:
    return gathered((candidate.instance, own) for candidate, own in items)


def _absent(model: Model, effect: Effect) -> list[tuple[str, ...]]:
    """Return the places where the model does not estimate the effect yet; a known value of it can be wrong.

    Effects with scanned parameters can act at a place more than once.
    """
    same = [extra for extra in model.added if (extra.effect.name, extra.effect.by) == (effect.name, effect.by)]
    added = [extra for extra in same if extra.columns and not extra.std]
    there = {place for extra in added for place in extra.instances}
    return [place for place in instances(model, effect) if effect.scanned or place not in there]


def _columns(
    job: AdjustedJob, system: Linearised, effect: Effect, places: Sequence[tuple[str, ...]]
) -> Iterator[_Visible]:
    """Yield for each place and scan the columns of its parameters."""
    if effect.is_step:
        yield from _steps(job, system, effect, places)
        return
    for scanned, (full, block, chosen) in scanned_columns(system, effect, places):
        for place, names, own in of_places(job.model, block, chosen, places):
            changed = OwnColumns.of(full, own, system.same_rows)
            if len(changed.rows) >= job.fewest:
                placed = [p for p in effect.scanned if p.place]
                named = tuple((p.name, job.model.places[p.place].names[int(scanned[p.name])]) for p in placed)
                yield Candidate(effect, place, tuple(scanned.items()), names, named), changed


def _steps(
    job: AdjustedJob, system: Linearised, effect: Effect, places: Sequence[tuple[str, ...]]
) -> Iterator[_Visible]:
    """Yield for each place and time the columns of an effect that acts from this time on.

    They are those of the effect that acts from the earliest time on, without the rows before.
    """
    name, times = effect.scanned[0].name, system.times
    tried = scans(job.model, effect, system.rows)
    if not tried:
        return
    # the course of all steps of a place: it acts from the earliest reading on
    full, block, chosen = next(scan(system, effect, places, [{name: float(np.nanmin(times))}]))
    courses = []
    for place, names, own in of_places(job.model, block, chosen, places):
        course = Course.of(OwnColumns.of(full, own), times)
        courses.append((place, names, course, times[course.rows]))
    for scanned in tried:
        for place, names, course, ordered in courses:
            begin = int(np.searchsorted(ordered, scanned[name]))
            # what acts on all readings of a place is no change there: a ball was there from the start
            if begin and len(course.rows) - begin >= job.fewest:
                yield Candidate(effect, place, tuple(scanned.items()), names), StepColumns(course, begin)
