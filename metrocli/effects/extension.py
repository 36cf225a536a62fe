"""Extension of a model by effects: links are spliced into its chains, or columns of one of its blocks are freed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import chain, count, product

import numpy as np

from metrocli.adjust.datum import turning
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Chain, Link
from metrocli.adjust.model.groups import Group, prior
from metrocli.adjust.rounds import with_aspects
from metrocli.arrays import Array, Index
from metrocli.effects.acting import NOMINAL
from metrocli.effects.effect import ELAPSED, WARMING, Effect, needed_in_words
from metrocli.effects.model import Added, Model
from metrocli.effects.requested import RequestedEffect
from metrocli.errors import Fault, InputError
from metrocli.words import suggestion

ELSEWHERE = "elsewhere"
"""Member of an effect's block for the readings on which the effect does not act; it stays at 0"""
_UNTOUCHED = "has no influence on the readings"
REACH = 1000.0
"""An effect whose uncertainty exceeds its plausible size by this factor is undetermined"""


def extended(model: Model, requests: Iterable[RequestedEffect]) -> Model:
    """Return the model with the effects that a job names.

    Raises InputError that lists every effect that cannot be added, with the reason.
    """
    requests = tuple(request for request in requests if request.is_in_table)
    if not requests:
        return model
    model, faults = with_conditions(model), list[Fault]()
    for request in requests:
        own = _misplaced(model, request)
        effect = None if own else _form(model, request)
        if effect is not None and request.std:
            model = with_effect_everywhere(model, effect, request.std)
        elif effect is not None:
            values = {key: _number(model, effect, key, value) for key, value in request.values.items()}
            model = with_effect(model, effect, [tuple(request.where[key] for key in effect.keys)], values)
        elif not own and request.std and any(not model.places[key].index for key in request.forms[0].keys):
            key = request.forms[0].keys[0]
            hint = f"write one entry for each {key}: {{name: {request.name}, {key}: {model.places[key].names[0]}}}"
            own.append(
                request.node.fault(f"{request.name} takes no `std`: a reading does not concern one {key} alone", hint)
            )
        elif not own:
            reasons = dict.fromkeys(lacking(model, form, request.where) for form in request.forms)
            hint = "" if _UNTOUCHED in reasons else request.forms[0].remedy
            own.append(request.node.fault(f"{request.name} {', or '.join(reasons)}", hint))
        faults.extend(own)
    if faults:
        raise InputError(faults)
    return model


def with_conditions(model: Model) -> Model:
    """Return the model with all conditions that effects vary with: its aspects, `elapsed`, `warming`, X, Y and Z.

    `elapsed` needs the times of the readings, `warming` their temperatures. Both count from the earliest reading of all
    and keep their values if readings are left out later.
    """
    with_time = [group.observations.conditions for group in model.readings if "t" in group.observations.conditions]
    start = min((float(c["t"].min()) for c in with_time if c["t"].size), default=0.0)
    first = next((float(c["temp"][np.argmin(c["t"])]) for c in with_time if "temp" in c and start in c["t"]), None)
    groups = []
    for group in model.groups:
        conditions = dict(group.observations.conditions)
        if group.name in model.measured and "t" in conditions and ELAPSED not in conditions:
            conditions[ELAPSED] = conditions["t"] - start
        if group.name in model.measured and "temp" in conditions and WARMING not in conditions:
            conditions[WARMING] = conditions["temp"] - (conditions["temp"][0] if first is None else first)
        if group.name in model.measured:
            conditions |= _nominal(model, group)
        timed = replace(group, observations=replace(group.observations, conditions=conditions))
        aspects = model.aspects if group.name in model.measured else {}
        groups.append(with_aspects(timed, aspects, model.blocks)[0])
    return replace(model, groups=tuple(groups))


def _nominal(model: Model, group: Group) -> dict[str, Array]:
    """Return the nominal coordinates X, Y, Z of the points of readings that do not have them yet."""
    observations = group.observations
    if NOMINAL[0] in observations.conditions:
        return {}
    known = ((observations.index[name], at) for name, at in model.nominal.items() if name in observations.index)
    # a reading may use a second point, such as that under its station
    coordinates = (at[index if index.ndim == 1 else index[0]] for index, at in known)
    return {axis: values for places in coordinates for axis, values in zip(NOMINAL, places.T, strict=True)}


def can_act(model: Model, effect: Effect, where: Mapping[str, str]) -> bool:
    """Whether some readings have the conditions that an effect needs at a place, and a chain on which it acts."""
    return effect.acts_at(where) and any(_passes(model, group, effect, where) for group in model.readings)


def _has(group: Group, needs: Sequence[str]) -> bool:
    conditions = group.observations.conditions
    return all(name in conditions and np.isfinite(conditions[name]).any() for name in needs)


def lacking(model: Model, effect: Effect, where: Mapping[str, str]) -> str:
    """Return the reason, for messages, why an effect cannot act at a place."""
    both = zip(effect.needs, effect.needed(where), strict=True)
    missing = {form: name for form, name in both if not any(_has(group, [name]) for group in model.readings)}
    return effect.lacks or (f"needs {needed_in_words(missing)}" if missing else _UNTOUCHED)


def _reaches(model: Model, group: Group, effect: Effect, where: Mapping[str, str]) -> bool:
    if effect.link is None:
        return (of := effect.columns_of) in group.chain.blocks and {*effect.beside} <= {*model.blocks[of].columns}
    link = effect.link("", where)
    return group.chain.takes(link) and set(link.blocks) <= {"", *group.chain.blocks}


def with_effect(
    model: Model, effect: Effect, instances: Sequence[tuple[str, ...]], values: Mapping[str, float]
) -> Model:
    """Return the model with an effect at some places.

    Parameters in `values` are fixed there, the others are estimated and start at 0. Several places at once are
    allowed if an index of the readings distinguishes them (`Place.index`).
    """
    columns = tuple(p.name for p in effect.parameters if p.name not in values)
    if effect.link is None:
        return _freed(model, effect, tuple(instances), values)
    name = _unused(" ".join([effect.name, *(instances[0] if len(instances) == 1 else ())]), model.blocks)
    apart = not effect.selects and any(model.places[key].index for key in effect.keys)
    where = dict(zip(effect.keys, instances[0], strict=True))
    link = effect.link(name, where)
    block = _block(effect, name, instances, values, apart)
    groups = tuple(
        _spliced(model, group, effect, instances, link, apart) if _passes(model, group, effect, where) else group
        for group in model.groups
    )
    added = Added(effect, tuple(instances), name, columns)
    datum = turning(model.datum, block) if effect.turns and model.datum else model.datum
    blocks = {**model.blocks, name: block}
    return replace(model, blocks=blocks, groups=groups, datum=datum, added=(*model.added, added))


def with_known_effect(model: Model, effect: Effect, values: Mapping[str, float], std: Mapping[str, float]) -> Model:
    """Return the model with an effect on all readings whose parameters are known with a standard uncertainty.

    They are unknowns that have been observed; one with the uncertainty 0 is fixed.
    """
    model = with_effect(model, effect, [()], {key: value for key, value in values.items() if not std[key]})
    added = model.added[-1]
    block = model.blocks[added.block]
    row = np.array([[values[name] for name in block.columns]])
    block = replace(block, values=row)
    columns = tuple(block.columns.index(name) for name in added.columns)
    sigma = np.array([[std[name] for name in added.columns]])
    known = (prior(block, np.zeros(1, dtype=np.intp), sigma, columns=columns),) if columns else ()
    return replace(model, blocks={**model.blocks, block.name: block}, groups=(*model.groups, *known))


def can_act_everywhere(model: Model, effect: Effect) -> bool:
    """Whether an effect can have sizes of its own at all places of its kind, which readings must distinguish."""
    return bool(effect.common and all(model.places[key].index for key in effect.keys) and places_of(model, effect))


def with_effect_everywhere(
    model: Model, effect: Effect, std: float, places: Sequence[tuple[str, ...]] | None = None
) -> Model:
    """Return the model with an effect at all its places, or at some, each with sizes that scatter about 0 by `std`."""
    places = places_of(model, effect) if places is None else places
    model = with_effect(model, effect, places, {})
    added = replace(model.added[-1], std=std)
    block = model.blocks[added.block]
    members = np.arange(int(not effect.is_smooth), len(block.members))
    scatter = prior(block, members, np.full((len(members), len(effect.parameters)), std))
    return replace(model, groups=(*model.groups, scatter), added=(*model.added[:-1], added))


def places_of(model: Model, effect: Effect) -> list[tuple[str, ...]]:
    """Return all places at which an effect can act."""
    everywhere = product(*(names_for(model, effect, key) for key in effect.keys))
    return [place for place in everywhere if can_act(model, effect, dict(zip(effect.keys, place, strict=True)))]


def _form(model: Model, request: RequestedEffect) -> Effect | None:
    if request.std:
        return next((effect for effect in request.forms if can_act_everywhere(model, effect)), None)
    return next((effect for effect in request.forms if can_act(model, effect, request.where)), None)


def _misplaced(model: Model, request: RequestedEffect) -> list[Fault]:
    """Return a fault for each place that the measurement lacks, or at which the effect cannot act."""
    named = dict(request.where)
    for parameter in request.forms[0].scanned:
        if parameter.place and parameter.name in request.values:
            named[parameter.place] = str(request.values[parameter.name])
    return [
        (request.node.get(key) or request.node).fault(
            f"{request.name}: {_no_place(model, key, name)}", suggestion(name, allowed)
        )
        for key, name in named.items()
        if name not in (allowed := dict.fromkeys(n for form in request.forms for n in names_for(model, form, key)))
    ]


def _no_place(model: Model, key: str, name: str) -> str:
    known = name in model.places[key].names
    return f"{key} '{name}' is the reference for the others" if known else f"there is no {key} '{name}'"


def names_for(model: Model, effect: Effect, key: str) -> tuple[str, ...]:
    """Return the names of one kind of place at which an effect can act."""
    names = tuple(name for name in model.places[key].names if not effect.among or name in effect.among)
    return names[1:] if key in effect.not_first else names


def _number(model: Model, effect: Effect, key: str, value: float | str) -> float:
    parameter = next(parameter for parameter in effect.all_parameters if parameter.name == key)
    return float(model.places[parameter.place].names.index(str(value))) if parameter.place else float(value)


def _unused(name: str, taken: Iterable[str]) -> str:
    names = chain([name], (f"{name} {number}" for number in count(2)))
    return next(candidate for candidate in names if candidate not in taken)


def _block(
    effect: Effect, name: str, instances: Sequence[tuple[str, ...]], values: Mapping[str, float], apart: bool
) -> Block:
    """Return the block of an effect, with one row for each place.

    If an index distinguishes the places (`apart`), a row of zeros comes first for readings elsewhere.
    """
    row = np.array([values.get(p.name, 0.0) for p in effect.all_parameters])
    free = np.array([p.name not in values for p in effect.parameters] + [False] * len(effect.scanned))
    members = (ELSEWHERE, *("/".join(instance) for instance in instances)) if apart else ("",)
    rows, frees = np.tile(row, (len(members), 1)), np.tile(free, (len(members), 1))
    if apart:
        rows[0], frees[0] = 0.0, False
    reach = np.array([REACH * p.plausible for p in effect.all_parameters])
    return Block(
        name, rows, tuple(p.name for p in effect.all_parameters), members, frees, reach=reach, space=effect.space
    )


def _passes(model: Model, group: Group, effect: Effect, where: Mapping[str, str]) -> bool:
    """Return whether readings have what an effect needs, pass through its link, and may concern its places."""
    has = group.name in model.measured and _has(group, effect.needed(where))
    return has and _concerns(model, group, effect) and _reaches(model, group, effect, where)


def _concerns(model: Model, group: Group, effect: Effect) -> bool:
    """Return whether the readings of a group name the places of an effect: those of another instrument do not."""
    indices = [model.places[key].index for key in effect.keys if key in model.places and not effect.selects]
    return all(index in group.observations.index for index in indices if index)


def _spliced(
    model: Model, group: Group, effect: Effect, instances: Sequence[tuple[str, ...]], link: Link, apart: bool
) -> Group:
    observations = group.observations
    chain: Chain = group.chain.spliced([link])
    if apart:
        touched = _touched(model, group, effect, instances)
        observations = observations.with_index({link.blocks[-1]: touched})
    return replace(group, chain=chain, observations=observations)


def _touched(model: Model, group: Group, effect: Effect, instances: Sequence[tuple[str, ...]]) -> Index:
    """Return the number, from 1, of the place that each reading concerns, or 0 for a reading elsewhere, (n,)."""
    touched = np.zeros(group.observations.count, dtype=np.intp)
    for number, instance in enumerate(instances, 1):
        here = np.ones(len(touched), dtype=bool)
        for key, name in zip(effect.keys, instance, strict=True):
            if (place := model.places[key]).index:
                here &= group.observations.index[place.index] == place.names.index(name)
        touched[here] = number
    return touched


def _freed(model: Model, effect: Effect, instances: tuple[tuple[str, ...], ...], values: Mapping[str, float]) -> Model:
    """Return the model with columns of one of its own blocks set free, or moved by the given values."""
    block = model.blocks[effect.columns_of]
    missing = [p for p in effect.parameters if p.name not in block.columns]
    block = block.with_columns(tuple(p.name for p in missing), REACH * np.array([p.plausible for p in missing]))
    rows = [block.members.index(instance[0]) for instance in instances] if effect.keys else slice(None)
    moved, free, columns = block.values.copy(), block.free.copy(), []
    for parameter in effect.parameters:
        column = block.column(parameter.name)
        moved[rows, column] += values.get(parameter.name, 0.0)
        if parameter.name not in values and not free[rows, column].any():
            free[rows, column] = True
            columns.append(parameter.name)
    added = Added(effect, instances, block.name, tuple(columns))
    blocks = {**model.blocks, block.name: replace(block, values=moved, free=free)}
    return replace(model, blocks=blocks, added=(*model.added, added))
