"""Correlated errors that a job states: `correlated: [{covariate: t_s, by: tracer, length: 0.25, std: 0.8 um}]`.

They are random effects: independent coefficients of smooth functions of a covariate, each with the standard deviation
`std` about 0, in each unit (tracer, image) or common to all readings. The functions are those with which `diagnose`
finds such errors. Method: docs/algorithms/evidence.md (correlated errors).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli import units
from metrocli.adjust.model.chain import LinkContext, Step
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.quantities import AtQuantity
from metrocli.arrays import Array
from metrocli.effects.covariates import (
    STATED_RICH,
    Covariate,
    Covariates,
    StatedCorrelation,
    kernel,
    least_length,
    smooth_functions,
)
from metrocli.effects.effect import Effect, Parameter
from metrocli.effects.extension import extended, with_conditions, with_effect_everywhere
from metrocli.effects.model import Model
from metrocli.effects.requested import RequestedEffect
from metrocli.effects.variance_groups import no_places, with_variance_groups
from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.words import in_a_row, suggestion


@dataclass(frozen=True)
class SmoothError(AtQuantity):
    """Link `y_a += s_a sum_k c_ak B_k`, a the component of a reading; columns c_11, c_12, .. of its block."""

    functions: tuple[str, ...]
    """Conditions B_k"""
    scales: tuple[float, ...]
    """Declared noise s_a of each component, relative to that of the first: displacements and angles differ in unit"""

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the readings (d, n) with the error."""
        basis = np.stack([local.observations.conditions[name] for name in self.functions])
        d, (k, n) = len(value), basis.shape
        of_each = np.array(self.scales)[:, None, None] * basis
        added = (local.rows(self.block).reshape(d, k, -1) * of_each).sum(axis=1)
        by_block = np.zeros((d, d, k, n))
        by_block[np.arange(d), np.arange(d)] = of_each
        return Step(value + added, None, {self.block: by_block.reshape(d, d * k, n)})


NAME = "correlated-error"
_MOST = 1000.0
"""Largest standard deviation, in those of the declared noise: readings with more would not pass for this instrument"""
_ERROR = Effect(NAME, "errors of the readings that vary smoothly with a covariate", (Parameter("c1"),), throughout=True)


def requests_of(
    stated: Sequence[StatedCorrelation], nodes: Sequence[Node], covariates: Covariates
) -> tuple[RequestedEffect, ...]:
    """Return the entries of `correlated:` among the effects that a job requests."""
    return tuple(
        RequestedEffect((_ERROR,), {}, vars(error), node, 1.0, (error, covariates))
        for error, node in zip(stated, nodes, strict=True)
    )


def with_all(model: Model, requests: Iterable[RequestedEffect]) -> Model:
    """Return the model with the effects, variance groups and correlated errors that a job requests.

    Raises InputError that lists every one that the readings cannot have, with the reason.
    """
    requests = tuple(requests)
    model = with_variance_groups(extended(model, requests), requests)
    stated = [(request.node, *request.correlation) for request in requests if request.correlation is not None]
    if not stated:
        return model
    model, faults = with_conditions(model), list[Fault]()
    known = {covariate.name: covariate for covariate in stated[0][2](model) if not covariate.together}
    for number, (node, error, _) in enumerate(stated):
        twice = any(error == other for _, other, _ in stated[:number])
        own = [node.fault("correlated: the same error is listed twice", "leave one of them out")] if twice else []
        own += _misplaced(model, error, known, node)
        if not own:
            model, own = _with_error(model, error, known[error.covariate], node)
        faults.extend(own)
    if faults:
        raise InputError(faults)
    return model


def _misplaced(model: Model, error: StatedCorrelation, known: Mapping[str, Covariate], node: Node) -> list[Fault]:
    """Return a fault where the readings have no such covariate, no such kind of place, or no such place."""
    if error.covariate not in known:
        at = node.get("covariate") or node
        message = f"correlated: the readings have no covariate '{error.covariate}'"
        return [at.fault(message, f"one of: {in_a_row(list(known))}")]
    kinds = [key for key, place in model.places.items() if place.index and place.names]
    if error.by and error.by not in kinds:
        at = node.get("by") or node
        return [no_places(model, "correlated", error.by, kinds, at)]
    if error.only and not error.by:
        return [node.fault("correlated: `only` without `by`", "write by: the kind of that place, such as tracer")]
    if error.only and error.only not in model.places[error.by].names:
        at = node.get("only") or node
        names = model.places[error.by].names
        return [at.fault(f"correlated: there is no {error.by} '{error.only}'", suggestion(error.only, names))]
    return []


def _with_error(model: Model, error: StatedCorrelation, covariate: Covariate, node: Node) -> tuple[Model, list[Fault]]:
    groups = [group for group in model.readings if group.name in covariate.values]
    labels = [model.units_in(group, error.by) for group in groups]
    many = len(model.places[error.by].names) if error.by else 1
    smooth = smooth_functions(covariate, groups, labels, many, error.length)
    if smooth is None:
        words = f"correlated: too few readings{f' of each {error.by}' if error.by else ''} for an error over this"
        return model, [node.fault(words, "leave the entry out, or take readings of more of them together")]
    least = least_length(smooth.distances)
    if error.length < least:
        at = node.get("length") or node
        return model, [at.fault(f"correlated: {covariate.name} resolves no length below {least:.2g}")]
    sizes = stds(error.std, groups)
    if sizes is None:
        at, noise = node.get("std") or node, float(_typical(groups[0])[0])
        hint = f"write a size above zero with its unit, at most {_MOST:g} times the declared noise of {noise:.2g} "
        hint += groups[0].observations.unit_of_each[0]
        return model, [at.fault(f"correlated: std: '{error.std}' is not a size of these readings", hint)]
    turn = kernel(smooth.distances, error.length, STATED_RICH)
    for group, (values, numbers), std in zip(groups, smooth.values, sizes, strict=True):
        basis = np.einsum("nm,nmk->kn", values, turn[numbers])
        model = _with_group(model, group.name, error, basis, std)
    return model, []


def stds(text: str, groups: Sequence[Group]) -> list[float] | None:
    """Return the size in the first component of each group: one for all in units of their noise.

    None if it is in the unit of none of them.
    """
    typical = [float(_typical(group)[0]) for group in groups]
    for name in units.DIMENSIONS:
        of_unit = np.concatenate([group.observations.deviations_in(units.internal_unit(name)) for group in groups])
        if len(of_unit):
            try:
                size = units.parse_quantity(text, name)
            except units.QuantityError:
                continue
            own = float(np.median(of_unit))
            if 0 < size <= _MOST * own:
                return [size / own * each for each in typical]
    return None


def _typical(group: Group) -> Array:
    """Return for each component the median of the declared standard deviations in its unit, (d,)."""
    observations = group.observations
    return np.array([np.median(observations.deviations_in(unit)) for unit in observations.unit_of_each])


def _with_group(model: Model, name: str, error: StatedCorrelation, basis: Array, std: float) -> Model:
    """Return the model with an error of one group, whose smooth functions (k, n) become conditions of its readings."""
    number = sum(added.effect.name == NAME for added in model.added) + 1
    group = model.group(name)
    observations, typical = group.observations, _typical(group)
    # in units of the declared noise, as diagnose has it: noisier readings have more of it
    relative = np.sqrt(((observations.deviations / typical[:, None]) ** 2).mean(axis=0))
    keys = tuple(f"{NAME} {number} {j}" for j in range(len(basis)))
    conditions: Mapping[str, Array] = dict(zip(keys, basis * relative, strict=True))
    group = replace(group, observations=observations.with_conditions(conditions))
    components, first = len(observations.readings), observations.unit_of_each[0]
    dimension = next((quantity for quantity in units.DIMENSIONS if units.internal_unit(quantity) == first), "")
    parameters = tuple(Parameter(f"c{j + 1}", dimension, std) for j in range(components * len(basis)))
    at, scales = group.chain.links[-1].gives, tuple((typical / typical[0]).tolist())
    effect = replace(
        _ERROR,
        parameters=parameters,
        link=lambda block, where: SmoothError(block, at, keys, scales),
        where=(error.by,) if error.by else (),
        needs=keys[:1],
    )
    model = model.with_group(group)
    return with_effect_everywhere(model, effect, std, [(error.only,)] if error.only else None)
