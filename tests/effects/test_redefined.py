"""Effects of the catalogue re-defined by `define:` give what the built-in ones give."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from effects.redefined import REDEFINED, Redefined
from laws.effects_of_kinds import MEASURED, instance_of, size
from simulated import lengths as simulated_lengths

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array
from metrocli.diagnosis.diagnose import diagnose
from metrocli.effects.effect import Effect
from metrocli.effects.extension import with_effect
from metrocli.effects.model import Model
from metrocli.effects.own.define import read
from metrocli.errors import Fault
from metrocli.project import yaml_text
from metrocli.tasks import KINDS

NAMES = [f"{one.kind}: {one.name}" for one in REDEFINED]
AGREE = 1e-9


def built_of(one: Redefined) -> Effect:
    table = KINDS[one.kind].task().effects
    return next(effect for effect in table if effect.name == one.name and effect.by == one.by)


def own_of(one: Redefined) -> Effect:
    task = KINDS[one.kind].task()
    faults: list[Fault] = []
    nodes = yaml_text.parse(one.text, "lab.yaml", Path()).at("define").items
    found = read(nodes, task.places, {effect.name for effect in task.effects}, faults)
    assert not faults, str(faults[0])
    return found[0]


def extended(one: Redefined, model: Model, effect: Effect, place: tuple[str, ...], known: dict[str, float]) -> Model:
    scanned = {p.name: MEASURED[one.kind].scanned[p.name] for p in effect.scanned}
    return with_effect(model, effect, [place], {**scanned, **known})


def noisy(model: Model) -> Model:
    """The model with the readings that it predicts, and noise."""
    rng = np.random.default_rng(11)
    for group in model.readings:
        exact = group.chain.predict(model.blocks, group.observations)
        drawn = rng.normal(size=exact.shape) * group.observations.deviations
        model = model.with_group(group.with_observations(group.observations.with_readings(exact + drawn)))
    return model


def solved(model: Model, data: Model) -> Solution:
    groups = []
    for group in model.groups:
        read = {one.name: one for one in data.groups}[group.name]
        groups.append(replace(group, observations=group.observations.with_readings(read.observations.readings)))
    return adjust(model.blocks.values(), groups, model.datum)


@pytest.mark.alike
@pytest.mark.parametrize("one", REDEFINED, ids=NAMES)
def test_estimates_and_covariances_are_those_of_the_built_in_effect(one: Redefined) -> None:
    built, own = built_of(one), own_of(one)
    model = MEASURED[one.kind].model(built)
    place = instance_of(model, built) if one.built == ("second",) else one.built
    at = place if one.at == ("second",) else one.at
    known = size(built)
    if built.space.name == "WAVE":
        known = {"amplitude": 0.005, "phase": 0.7}
    data = noisy(extended(one, model, built, place, known))
    found = solved(extended(one, model, built, place, {}), data)
    again = solved(extended(one, model, own, at, {}), data)
    theirs = extended(one, model, built, place, {}).added[-1].block
    ours = extended(one, model, own, at, {}).added[-1].block
    assert found.outcome.good and again.outcome.good
    for name, block in again.blocks.items():
        other = theirs if name == ours else name
        std = found.std(other)
        difference = np.abs(block.values - found.blocks[other].values)
        free = found.blocks[other].free
        assert np.all(difference[free] <= AGREE * (std[free] + np.abs(block.values[free]))), name
        near(again.covariance_or_raise().of(name), found.covariance_or_raise().of(other))
    assert abs(again.sigma0 - found.sigma0) <= AGREE * found.sigma0


def near(covariance: Array, expected: Array) -> None:
    assert np.abs(covariance - expected).max(initial=0.0) <= AGREE * np.abs(expected).max(initial=0.0)


@pytest.mark.slow
def test_the_verdict_is_that_of_the_built_in_effect() -> None:
    """The diagnosis of a drift, once with the built-in effect in the table and once with the own one in its place."""
    one = next(one for one in REDEFINED if one.name == "dead-path-drift")
    task = KINDS[one.kind].task()
    own = own_of(one)
    rng = np.random.default_rng(6)
    net = simulated_lengths.network(30, 5).read(rng)
    table = net.lengths()
    t = rng.uniform(0.0, 3600.0, len(table))
    drift = 8e-7 * t * (np.asarray(table.columns["tracer"]) == "T1")
    columns = {**table.columns, "t": t, "length": table.numbers("length") + drift}
    files = {"lengths": replace(table, columns=columns), "points": net.point_table(), "tracers": net.tracer_table()}
    assert task.diagnosed is not None
    adjusted = task.diagnosed(task.job(simulated_lengths.settings(), **files))
    built = diagnose(adjusted)
    table_with_own = tuple(own if effect.name == one.name else effect for effect in adjusted.effects)
    again = diagnose(replace(adjusted, effects=table_with_own))
    assert again.verdict is built.verdict
    assert [str(f.effect.alternative) for f in built.findings] == [f"{one.name} T1"]
    assert [str(f.effect.alternative) for f in again.findings] == [f"{own.name} T1"]
    (ours,), (theirs,) = again.findings, built.findings
    pairs = [(a.value, b.value) for a, b in zip(ours.sizes, theirs.sizes, strict=True)]
    pairs += [(a.std, b.std) for a, b in zip(ours.sizes, theirs.sizes, strict=True)]
    pairs += [(ours.effect.log_level, theirs.effect.log_level), (ours.gain.log_score, theirs.gain.log_score)]
    pairs += [(ours.shift, theirs.shift), (ours.gain.after, theirs.gain.after)]
    found = {c.name.replace(own.name, one.name): c for c in again.design.candidates}
    pairs += [(found[c.name].detectable, c.detectable) for c in built.design.candidates]
    assert all(a == pytest.approx(b, rel=AGREE) for a, b in pairs if b is not None)
