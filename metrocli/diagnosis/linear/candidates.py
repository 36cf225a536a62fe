"""Candidates: the forms and places of each cause, with the columns that each would add to the model.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, product

import numpy as np

from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.observations import Index, Mask
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.linear.columns import Columns, gathered, joined
from metrocli.diagnosis.linear.projection import VISIBLE, System
from metrocli.diagnosis.linear.signatures import scan
from metrocli.effects.effect import Effect
from metrocli.effects.extension import can_act, lacking, names_for, places_of
from metrocli.effects.model import Model

_MOST_PLACES = 3000
_SMALL = 1e-6
"""Visible share of the squares of a signature below which its visible part is computed, not a difference"""
_MOST_SCANNED, _FEWEST_SCANNED = 20_000_000, 8
"""Largest number of elements of a scan's columns, and the number of values that are tried in any case

The best value is refined between its neighbours, so a coarse scan finds the same value.
"""
_AT_ONCE = 64
"""Columns that are projected at once"""


@dataclass(frozen=True)
class Alternative:
    """One form of a cause at one place."""

    effect: Effect
    instance: tuple[str, ...]
    scanned: tuple[tuple[str, float], ...] = ()
    parameters: tuple[str, ...] = ()
    """Parameters, one for each of its columns, in order"""
    named: tuple[tuple[str, str], ...] = ()
    """Scanned parameters that are places: parameter and name of the place"""

    @property
    def where(self) -> dict[str, str]:
        """The place as a job names it, without scanned parameters."""
        named = dict(zip(self.effect.keys, self.instance, strict=True))
        return named | ({"by": self.effect.by} if "by" in self.effect.where else {})

    @property
    def spot(self) -> tuple[str, tuple[str, ...]]:
        """Cause and place, without the form and the values of scanned parameters."""
        return self.effect.name, self.instance

    def like(self, other: Alternative) -> bool:
        """Return whether it differs from another alternative in the values of scanned parameters at most."""
        return (self.effect.name, self.effect.by, self.instance, self.parameters, self.named) == (
            other.effect.name,
            other.effect.by,
            other.instance,
            other.parameters,
            other.named,
        )

    def far_from(self, other: Alternative) -> float:
        """Return the distance of its scanned parameters from those of another alternative."""
        own = dict(self.scanned)
        return sum(abs(own[key] - value) for key, value in other.scanned)

    def __str__(self) -> str:
        return " ".join([self.effect.name, *self.instance, *(f"{key} {name}" for key, name in self.named)])


@dataclass(frozen=True)
class Family:
    """A cause with all its alternatives that have the same number of columns."""

    name: str
    alternatives: tuple[Alternative, ...]
    columns: Columns
    """The whitened signatures"""
    raw: Array
    """Norm of each whole whitened signature, (alternatives, parameters)"""
    absorbed: Array
    """Coordinates of the rest of the signatures in the basis of the unknowns, (unknowns, alternatives, parameters)"""
    unknown: str = ""
    """Covariate of a family of smooth functions, whose cause is not known; "" for effects"""


@dataclass(frozen=True)
class NotTested:
    """An effect that cannot be tested, with the reason; with a place if it can be tested at other places."""

    effect: Effect
    reason: str
    where: Mapping[str, str] = field(default_factory=dict)


def families_of(job: AdjustedJob, system: System) -> tuple[list[Family], list[NotTested]]:
    """Return the candidates of all effects that the data can test, and the effects that they cannot test."""
    families: dict[tuple[str, int], list[Family]] = {}
    missing: list[NotTested] = []
    for effect in job.effects:
        if effect.of_one_reading:
            continue
        if effect.name in job.not_sought:
            missing.append(NotTested(effect, job.not_sought[effect.name]))
            continue
        missing += _untestable(job.model, effect)
        for family in _of_effect(job, system, effect):
            families.setdefault((family.name, family.columns.parameters), []).append(family)
    tested = {name for name, _ in families}
    seen = [one for one in missing if one.where or one.effect.name not in tested]
    return [_joined(parts) for parts in families.values()], seen


def _joined(parts: Sequence[Family]) -> Family:
    if len(parts) == 1:
        return parts[0]
    return Family(
        parts[0].name,
        tuple(one for part in parts for one in part.alternatives),
        joined([part.columns for part in parts]),
        np.concatenate([part.raw for part in parts], axis=0),
        np.concatenate([part.absorbed for part in parts], axis=1),
    )


def _untestable(model: Model, effect: Effect) -> list[NotTested]:
    """Return the reasons why an effect cannot be modelled: one if it is the same everywhere, else place by place."""
    places = [dict(zip(effect.keys, place, strict=True)) for place in _places(model, effect)]
    found = [NotTested(effect, lacking(model, effect, at), at) for at in places if not can_act(model, effect, at)]
    if len(found) == len(places) and len({one.reason for one in found}) == 1:
        return [NotTested(effect, found[0].reason)]
    return found


def instances(model: Model, effect: Effect) -> list[tuple[str, ...]]:
    """Return all places where an effect could act."""
    return places_of(model, effect)[:_MOST_PLACES]


def _places(model: Model, effect: Effect) -> list[tuple[str, ...]]:
    return list(product(*(names_for(model, effect, key) for key in effect.keys)))[:_MOST_PLACES]


def _of_effect(job: AdjustedJob, system: System, effect: Effect) -> Iterator[Family]:
    places = _absent(job.model, effect)
    together = bool(effect.keys) and all(job.model.places[key].index for key in effect.keys)
    for chosen in [places] if together else [[place] for place in places]:
        if not chosen:
            continue
        kept = _informative(list(_columns(job, system, effect, chosen)))
        by_size: dict[int, list[_Columns]] = {}
        for item in kept:
            by_size.setdefault(item.raw.shape[0], []).append(item)
        for items in by_size.values():
            columns = gathered((item.alternative.instance, item.rows, item.values) for item in items)
            absorbed = np.stack([item.absorbed for item in items], axis=1)
            raw = np.stack([item.raw for item in items])
            yield Family(effect.name, tuple(item.alternative for item in items), columns, raw, absorbed)


@dataclass(frozen=True)
class _Columns:
    """One alternative: its columns at the rows that they change, their norms, and coordinates of what is absorbed."""

    alternative: Alternative
    rows: Index
    values: Array
    raw: Array
    absorbed: Array
    visible: bool


def _informative(items: Sequence[_Columns]) -> list[_Columns]:
    """Return the items without scan values whose signature the unknowns absorb, if other values are visible.

    Such a value is the time of a step that lies before all affected readings.
    """
    seen = [item.visible for item in items]
    somewhere = {item.alternative.instance for item, visible in zip(items, seen, strict=True) if visible}
    return [
        item for item, visible in zip(items, seen, strict=True) if visible or item.alternative.instance not in somewhere
    ]


def _absent(model: Model, effect: Effect) -> list[tuple[str, ...]]:
    """Return the places where the model does not estimate the effect yet; a known value of it can be wrong.

    Effects with scanned parameters can act at a place more than once.
    """
    same = [one for one in model.added if (one.effect.name, one.effect.by) == (effect.name, effect.by)]
    added = [one for one in same if one.columns and not one.std]
    there = {place for one in added for place in one.instances}
    places = instances(model, effect)
    return places if effect.scanned else [place for place in places if place not in there]


def _scans(model: Model, effect: Effect, rows: int) -> list[tuple[tuple[str, float], ...]]:
    """Return all combinations of scanned values to try; one empty combination without scanned parameters."""
    grids: list[list[tuple[str, float]]] = []
    for parameter in effect.scanned:
        values: Array = np.zeros(0)
        if parameter.place:
            values = np.arange(1.0, len(model.places[parameter.place].names))
        elif parameter.grid is not None:
            most = int(np.clip(_MOST_SCANNED / (rows * len(effect.parameters)), _FEWEST_SCANNED, parameter.tried))
            values = thinned(parameter.grid(model.readings[0].observations.conditions), most)
        grids.append([(parameter.name, float(value)) for value in values])
    return list(product(*grids))


def thinned(values: Array, most: int) -> Array:
    """Return at most `most` of the values, evenly spaced in their order."""
    if len(values) <= most:
        return values
    return np.asarray(values[np.linspace(0, len(values) - 1, most).astype(int)])


def _columns(job: AdjustedJob, system: System, effect: Effect, places: Sequence[tuple[str, ...]]) -> Iterator[_Columns]:
    """Yield for each place and scan the columns of its parameters."""
    scans = [dict(one) for one in _scans(job.model, effect, system.rows)]
    found = zip(scans, scan(job.model, system, effect, places, scans) if scans else (), strict=True)
    for scanned, full, block, chosen, inside in _split(system, found):
        member, column = np.nonzero(chosen)
        before = job.model.blocks.get(block.name)
        for number, place in enumerate(places):
            own = member == (number + 1 if len(block.members) > 1 and before is None else _row(block.members, place))
            if not own.any():
                own = np.ones(len(member), dtype=bool) if len(places) == 1 else own
            touched = np.flatnonzero(full[:, own].any(axis=1)) if own.any() else np.zeros(0, dtype=np.intp)
            if len(touched) >= job.fewest:
                names = tuple(block.columns[i] for i in column[own])
                named = _scanned_places(job.model, effect, scanned)
                alternative = Alternative(effect, place, tuple(scanned.items()), names, named)
                yield _visible(system, alternative, touched, full[:, own], inside[:, own])


def _visible(system: System, alternative: Alternative, touched: Index, full: Array, inside: Array) -> _Columns:
    """Return an alternative with its whole columns, or with their visible parts where these are small.

    `|g|^2 - |b'g|^2` keeps few digits of a small difference, so such a part is projected. Columns that are not visible
    are left out.
    """
    raw = np.linalg.norm(full[touched], axis=0)
    shown = raw**2 - (inside**2).sum(axis=0)
    if (shown < VISIBLE**2 * raw**2).all():
        touched = touched[:0]
    elif (shown < _SMALL * raw**2).any():
        full = system.seen(full)
        touched = np.flatnonzero(full.any(axis=1))
    return _Columns(alternative, touched, full[touched], raw, inside, bool(len(touched)))


def _split(
    system: System, found: Iterable[tuple[dict[str, float], tuple[Array, Block, Mask]]]
) -> Iterator[tuple[dict[str, float], Array, Block, Mask, Array]]:
    """Yield columns with the coordinates of what the unknowns absorb of them, computed many at a time."""
    held: list[tuple[dict[str, float], tuple[Array, Block, Mask]]] = []
    for one in chain(found, [None]):
        if one is not None and one[1][2].any():
            held.append(one)
        if held and (one is None or sum(full.shape[1] for _, (full, _, _) in held) >= _AT_ONCE):
            inside = system.basis.coordinates(np.concatenate([full for _, (full, _, _) in held], axis=1))
            place = 0
            for scanned, (full, block, chosen) in held:
                own = slice(place, place + full.shape[1])
                place = own.stop
                yield scanned, full, block, chosen, inside[:, own]
            held = []


def _scanned_places(model: Model, effect: Effect, scanned: Mapping[str, float]) -> tuple[tuple[str, str], ...]:
    places = {parameter.name: parameter.place for parameter in effect.scanned if parameter.place}
    return tuple((key, model.places[place].names[int(scanned[key])]) for key, place in places.items())


def _row(members: Sequence[str], place: tuple[str, ...]) -> int:
    return members.index(place[0]) if place and place[0] in members else 0
