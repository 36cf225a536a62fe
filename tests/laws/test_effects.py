"""Every effect of every table: right derivatives, nothing at 0, found again from data it was planted in, and explained."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from laws.effects_of_kinds import MEASURED, instance_of, size

from metrocli.adjust.adjustment import adjust
from metrocli.arrays import Array
from metrocli.effects.effect import DRIVERS, Effect
from metrocli.effects.extension import with_effect
from metrocli.effects.model import Model
from metrocli.effects.page import page
from metrocli.tasks import KINDS
from metrocli.units import DIMENSIONS

TABLES = {kind.name: effects for kind in KINDS.values() if (effects := kind.task().effects)}
ENTRIES = [(kind, at) for kind, effects in TABLES.items() for at in range(len(effects))]
NAMES = [
    f"{kind}: {TABLES[kind][at].name}{TABLES[kind][at].by and ' by '}{TABLES[kind][at].by}" for kind, at in ENTRIES
]


@cache
def model_of(kind: str, effect: Effect) -> Model:
    return MEASURED[kind].model(effect)


@pytest.fixture(params=ENTRIES, ids=NAMES)
def entry(request: pytest.FixtureRequest) -> tuple[str, Effect]:
    kind, at = request.param
    return kind, TABLES[kind][at]


def with_one(kind: str, effect: Effect, known: dict[str, float]) -> Model:
    model = model_of(kind, effect)
    scanned = {p.name: MEASURED[kind].scanned[p.name] for p in effect.scanned}
    return with_effect(model, effect, [instance_of(model, effect)], {**scanned, **known})


def predicted(model: Model) -> Array:
    return np.concatenate([g.chain.predict(model.blocks, g.observations).ravel() for g in model.readings])


def of_free(model: Model, before: Model) -> Array:
    """Derivatives of all readings by the effect's free parameters, (readings, parameters)."""
    added = model.added[-1]
    block = model.blocks[added.block]
    own = block.free.copy()
    if added.block in before.blocks:
        own[:, : before.blocks[added.block].size] &= ~before.blocks[added.block].free
    columns = [block.column(name) for name in added.columns]
    parts = []
    for group in model.readings:
        total = np.zeros((*group.observations.readings.shape, len(columns)))
        for touch in group.linear(model.blocks, frozenset({added.block})).touches:
            free = own[touch.index][:, columns]
            total += np.moveaxis(touch.jacobian[:, columns], 1, 2) * free[None]
        sigma = group.observations.sigma
        parts.append((total * sigma[:, :, None]).reshape(-1, len(columns)))
    return np.concatenate(parts)


def test_each_kind_with_effects_is_under_the_laws() -> None:
    assert set(TABLES) == set(MEASURED)


EFFECTS = [(kind, effect) for kind, effects in TABLES.items() for effect in effects]


def is_complete(effect: Effect) -> bool:
    return bool(
        effect.cause
        and effect.source
        and effect.reveal
        and effect.parameters
        and (effect.link is None) == bool(effect.columns_of)
        and all(p.dimension in DIMENSIONS or not p.dimension for p in effect.all_parameters)
        and all(p.plausible > 0 for p in effect.parameters)
        and effect.by in ("", *DRIVERS)
    )


def states_usual_sizes(effect: Effect) -> bool:
    least, most = effect.usual_sizes or (0.0, 1.0)
    return 0 <= least < most and bool(effect.usual or effect.of_one_reading)


def names_parameters(effect: Effect) -> bool:
    return all(re.search(rf"\b{p.name}\b", effect.formula) for p in effect.parameters)


def test_each_entry_is_complete() -> None:
    assert not [(kind, effect.name) for kind, effect in EFFECTS if not is_complete(effect)]


def test_effects_that_they_are_confused_with_exist() -> None:
    names = {kind: {effect.name for effect in effects} for kind, effects in TABLES.items()}
    unknown = [
        (kind, effect.name, other)
        for kind, effect in EFFECTS
        for other in set(effect.confused_with) - (names[kind] - {effect.name})
    ]
    assert not unknown


def test_each_formula_names_all_parameters() -> None:
    assert not [(kind, effect.name) for kind, effect in EFFECTS if not names_parameters(effect)]


def test_each_states_usual_sizes() -> None:
    assert not [(kind, effect.name) for kind, effect in EFFECTS if not states_usual_sizes(effect)]


def test_the_page_of_an_effect_has_all_that_its_entries_state() -> None:
    lacking = [
        (effect.name, words)
        for kind, effect in EFFECTS
        for words in (f"For {kind}:", effect.cause[1:], effect.usual, effect.reveal, effect.note, effect.source)
        if words not in page(effect.name, TABLES)
    ]
    assert not lacking


def test_at_zero_it_changes_nothing(entry: tuple[str, Effect]) -> None:
    kind, effect = entry
    zero = with_one(kind, effect, {p.name: 0.0 for p in effect.parameters})
    assert np.allclose(predicted(zero), predicted(model_of(kind, effect)), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    "share", [pytest.param(0.0, id="at 0", marks=pytest.mark.slow), pytest.param(1.0, id="at its size")]
)
def test_derivatives_are_differences(entry: tuple[str, Effect], share: float) -> None:
    kind, effect = entry
    model = with_one(kind, effect, {})
    block = model.blocks[model.added[-1].block]
    values = block.values.copy()
    for p in effect.parameters:
        values[-1, block.column(p.name)] += share * size(effect)[p.name]
    model = model.with_blocks({**model.blocks, block.name: block.with_values(values)})
    found = of_free(model, model_of(kind, effect))
    for at, name in enumerate(model.added[-1].columns):
        parameter = next(p for p in effect.parameters if p.name == name)

        def moved(h: float, name: str = name) -> Array:
            step = np.zeros_like(values)
            step[-1, block.column(name)] = h
            return predicted(model.with_blocks({**model.blocks, block.name: block.with_values(values).moved(step)}))

        h = 0.1 * parameter.plausible
        near, far = moved(h) - moved(-h), moved(2 * h) - moved(-2 * h)
        expected = (8 * near - far) / (12 * h)
        bound = 1e-6 * np.abs(expected).max() + 1e-12 * np.abs(predicted(model)).max() / h
        assert np.abs(found[:, at] - expected).max() <= bound


def test_derivatives_by_the_other_unknowns_are_differences(entry: tuple[str, Effect]) -> None:
    """The link's derivatives by what comes into it, and by the instrument's blocks it uses."""
    kind, effect = entry
    model = with_one(kind, effect, size(effect))
    rng = np.random.default_rng(8)
    for name, block in model.blocks.items():
        if not block.free.any() or name == model.added[-1].block:
            continue
        step = rng.normal(size=block.values.shape) * block.free
        total = np.zeros(0)
        for group in model.readings:
            along = np.zeros(group.observations.readings.shape)
            for touch in group.linear(model.blocks, frozenset({name})).touches:
                along += np.einsum("dsn,ns->dn", touch.jacobian, step[touch.index])
            total = np.concatenate([total, (along * group.observations.sigma).ravel()])
        h = 1e-4 if block.space.name == "POSE" else 1e-3

        def moved(h: float, block=block, name: str = name, step: Array = step) -> Array:  # type: ignore[no-untyped-def]
            return predicted(model.with_blocks({**model.blocks, name: block.moved(h * step)}))

        expected = (8 * (moved(h) - moved(-h)) - (moved(2 * h) - moved(-2 * h))) / (12 * h)
        bound = 1e-6 * np.abs(expected).max() + 1e-11 * np.abs(predicted(model)).max() / h
        assert np.abs(total - expected).max() <= bound, name


@pytest.mark.parametrize("entry", [(kind, one) for kind, all_of in TABLES.items() for one in all_of if one.is_step])
def test_a_step_acts_on_all_later_readings(entry: tuple[str, Effect]) -> None:
    """`diagnose` takes a step at any time from that at the first reading."""
    kind, effect = entry
    before = model_of(kind, effect)
    late, early = (of_free(with_one(kind, effect, known), before) for known in ({}, {effect.scanned[0].name: -1e9}))
    acts = late.any(axis=1)
    assert acts.any() and np.allclose(early[acts], late[acts])


def test_what_is_planted_is_found(entry: tuple[str, Effect]) -> None:
    kind, effect = entry
    truth = with_one(kind, effect, size(effect))
    start = with_one(kind, effect, {})
    groups = tuple(
        replace(
            group,
            observations=group.observations.with_readings(
                truth_group.chain.predict(truth.blocks, truth_group.observations)
            ),
        )
        if group.name in truth.measured
        else group
        for group, truth_group in zip(start.groups, truth.groups, strict=True)
    )
    solution = adjust(start.blocks.values(), groups, start.datum)
    assert solution.outcome.good, solution.undetermined
    added = start.added[-1]
    block = solution.blocks[added.block]
    for name in added.columns:
        value, std = block.values[-1, block.column(name)], solution.std(added.block)[-1, block.column(name)]
        expected = truth.blocks[added.block].values[-1, block.column(name)]
        assert abs(value - expected) <= 1e-3 * std + 1e-6 * abs(expected)
