"""Variance groups that a job states: `variance_groups: [{by: image, only: left03, ratio: 3.2}]`.

The standard deviations of these readings are the declared ones times the ratio. `diagnose` finds such groups, and the
extended job has them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.groups import Group
from metrocli.arrays import Mask
from metrocli.effects.effect import Effect
from metrocli.effects.model import Model
from metrocli.effects.requested import PlaceName, RequestedEffect
from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.settings import Number, Text, setting
from metrocli.words import suggestion

READING = "reading"
"""Kind of place whose names are the groups of readings, each with a declared noise of its own"""
MOST = 1e6
"""Largest ratio; the smallest is its reciprocal"""
_KEY = "variance_groups"
_NOISIER = Effect("variance-group", "readings of one place that are noisier, or less noisy, than declared", ())


@dataclass(frozen=True)
class StatedVariance:
    """An entry of `variance_groups:`: readings of one place with a noise of their own."""

    by: str = setting(Text(), "kind of place, such as tracer or image")
    only: str = setting(PlaceName(), "the place of that kind whose readings they are")
    ratio: float = setting(
        Number(minimum=1 / MOST, maximum=MOST), "their standard deviations, as multiples of the declared"
    )


def requests_of(stated: Sequence[StatedVariance], nodes: Sequence[Node]) -> tuple[RequestedEffect, ...]:
    """Return the entries of `variance_groups:` among the effects that a job requests."""
    return tuple(
        RequestedEffect((_NOISIER,), {group.by: group.only}, {}, node, variance_ratio=group.ratio)
        for group, node in zip(stated, nodes, strict=True)
    )


def with_variance_groups(model: Model, requests: Iterable[RequestedEffect]) -> Model:
    """Return the model whose readings have the noise of the variance groups that a job states.

    Raises InputError that lists every one that the readings cannot have, with the reason.
    """
    stated = [(request, *next(iter(request.where.items()))) for request in requests if request.variance_ratio]
    faults = [fault for number in range(len(stated)) for fault in _misplaced(model, stated, number)]
    if faults:
        raise InputError(faults)
    for group in model.readings if stated else ():
        # not those that it has: a model may be extended anew about another solution
        ratios, observations = np.ones(group.observations.count), group.observations
        for request, by, only in stated:
            ratios[readings_at(model, group, by, only)] *= request.variance_ratio
        model = model.with_group(replace(group, observations=replace(observations, ratios=ratios)))
    return model


def still_read(model: Model, requests: Iterable[RequestedEffect]) -> tuple[RequestedEffect, ...]:
    """Return the requests without the variance groups of which a model has no readings: all were left out as wrong."""
    return tuple(
        request
        for request in requests
        if not request.variance_ratio or not _misplaced(model, [(request, *next(iter(request.where.items())))], 0)
    )


def readings_at(model: Model, group: Group, by: str, only: str) -> Mask:
    """Return which readings of a group are those of a place, (n,)."""
    if by == READING:
        return np.full(group.observations.count, group.name == only)
    place = model.places[by]
    index = group.observations.index.get(place.index)
    if index is None:
        return np.zeros(group.observations.count, dtype=bool)
    # a length has two ends
    return np.asarray((np.atleast_2d(index) == place.names.index(only)).any(axis=0))


def _names(model: Model) -> Mapping[str, Sequence[str]]:
    """Return the names of the places of readings, by their kind; a single group of readings is not a place."""
    names = {key: place.names for key, place in model.places.items() if place.index and any(place.names)}
    return names | ({READING: [group.name for group in model.readings]} if model.readings[1:] else {})


def _misplaced(model: Model, stated: Sequence[tuple[RequestedEffect, str, str]], number: int) -> list[Fault]:
    """Return a fault where an entry has no readings of its own, or stands twice."""
    request, by, only = stated[number]
    names = _names(model)
    if by not in names:
        at = request.node.get("by") or request.node
        return [no_places(model, _KEY, by, [*names], at)]
    at = request.node.get("only") or request.node
    if only not in names[by]:
        return [at.fault(f"{_KEY}: there is no {by} '{only}'", suggestion(only, names[by]))]
    if not any(readings_at(model, group, by, only).any() for group in model.readings):
        return [at.fault(f"{_KEY}: {by} '{only}' has no readings", "leave it out")]
    if any((by, only) == (other, name) for _, other, name in stated[:number]):
        return [request.node.fault(f"{_KEY}: {by} {only} is listed twice", "leave one of them out")]
    return []


def no_places(model: Model, key: str, by: str, kinds: Sequence[str], at: Node) -> Fault:
    """Return the fault of an entry `by` places that the readings have not, with the kind that may be meant.

    Files call places otherwise: the names in the column `station` are those of tracers.
    """
    names = {name for group in model.readings for name in group.observations.keys.get(by, ())}
    same = [kind for kind in kinds if kind in model.places and names and names <= {*model.places[kind].names}]
    hint = suggestion(by, kinds) if kinds else "they are of one kind and have no places: leave it out"
    if same:
        hint = f"write by: {same[0]}, which has the names in the column '{by}'"
    return at.fault(f"{key}: the readings have no '{by}' of their own", hint)
