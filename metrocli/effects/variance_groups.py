"""Variance groups that a job states: `variance_groups: [{by: image, only: left03, ratio: 3.2}]`.

The standard deviations of these readings are the declared ones times the ratio. `diagnose` finds such groups, and the
extended job has them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from metrocli.effects.effect import Effect
from metrocli.effects.model import Model
from metrocli.effects.requested import RequestedEffect
from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.settings import Number, Text, setting
from metrocli.words import in_a_row, suggestion

_KEY = "variance_groups"
_NOISIER = Effect("variance-group", "readings of one place that are noisier, or less noisy, than declared", ())


@dataclass(frozen=True)
class StatedVariance:
    """An entry of `variance_groups:`: readings of one place with a noise of their own."""

    by: str = setting(Text(), "kind of place, such as tracer or image")
    only: str = setting(Text(), "the place of that kind whose readings they are")
    ratio: float = setting(Number(above=0, maximum=1000), "their standard deviations, as multiples of the declared")


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
            place = model.places[by]
            index = observations.index.get(place.index)
            if index is not None:
                # a length has two ends
                ratios[(np.atleast_2d(index) == place.names.index(only)).any(axis=0)] *= request.variance_ratio
        model = model.with_group(replace(group, observations=replace(observations, ratios=ratios)))
    return model


def _misplaced(model: Model, stated: Sequence[tuple[RequestedEffect, str, str]], number: int) -> list[Fault]:
    """Return a fault where an entry has no readings of its own, or stands twice."""
    request, by, only = stated[number]
    kinds = [key for key, place in model.places.items() if place.index]
    if by not in kinds:
        at = request.node.get("by") or request.node
        return [at.fault(f"{_KEY}: the readings have no '{by}' of their own", f"one of: {in_a_row(kinds)}")]
    if only not in model.places[by].names:
        at, names = request.node.get("only") or request.node, model.places[by].names
        return [at.fault(f"{_KEY}: there is no {by} '{only}'", suggestion(only, names))]
    if any((by, only) == (other, name) for _, other, name in stated[:number]):
        return [request.node.fault(f"{_KEY}: {by} {only} is listed twice", "leave one of them out")]
    return []
