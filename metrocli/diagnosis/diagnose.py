"""The whole diagnosis of one adjusted job, from its linearised system to the verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from metrocli.adjust.blocks import Array
from metrocli.adjust.observations import Mask
from metrocli.diagnosis.candidates import NotTested, families_of
from metrocli.diagnosis.design import Design, design, separations
from metrocli.diagnosis.distributions import log_family
from metrocli.diagnosis.gain import Gain, gains
from metrocli.diagnosis.mistakes import Mistaken
from metrocli.diagnosis.naming import Named, named
from metrocli.diagnosis.noise import Noise, Unit, apart, noise_of, weighted
from metrocli.diagnosis.projection import System, linearised, signature
from metrocli.diagnosis.race import Field, Given, field_of, nothing
from metrocli.diagnosis.selection import Selection, carried_by_few, select
from metrocli.diagnosis.smooth import smooth_families
from metrocli.diagnosis.subject import Subject
from metrocli.effects.model import Model, with_effect

Say = Callable[[str], None]
_AFTER, _NOTHING_NAMED = 0.03, 0.005
"""Levels, counted over all smooth functions, of structure that is left beside names, and where there is none"""
_CARRIED = 0.2
"""Level that it must keep, counted over all that is tried, without the few readings that speak for it most"""
_ROUNDS = 3
_SEED = 20


@dataclass(frozen=True)
class Outlier:
    """A reading that is wrong."""

    keys: Mapping[str, str]
    test: float
    """By how many standard deviations it is off, given all else that was found"""


@dataclass(frozen=True)
class Left:
    """Structure that no known effect explains."""

    p_value: float
    depends_on: tuple[str, ...]


@dataclass(frozen=True)
class Finding:
    """One effect that was named."""

    named: Named
    gain: Gain
    shift: float
    """By how much what is delivered changes with it, at most"""


@dataclass(frozen=True)
class Diagnosis:
    """What the model of a job gets wrong."""

    subject: Subject
    noise: Noise
    apart: tuple[Unit, ...]
    outliers: tuple[Outlier, ...]
    findings: tuple[Finding, ...]
    left: Left | None
    before: float
    """Level of the strongest structure before anything was named, counted over all that was tried"""
    after: float
    """Level of the strongest smooth structure left"""
    design: Design
    separate_by: tuple[str, ...]
    mistaken: Mistaken | None = None
    """A mistake in the files, without which all else was found"""

    @property
    def verdict(self) -> str:
        """clean, explained, indistinct or unexplained."""
        if self.left is not None:
            return "unexplained"
        sets: list[tuple[object, ...]] = [finding.named.rivals for finding in self.findings]
        if self.mistaken is not None:
            sets.append(self.mistaken.mistakes[1:])
        if not sets:
            return "clean"
        return "indistinct" if any(sets) else "explained"


def diagnose(subject: Subject, say: Say = lambda line: None) -> Diagnosis:
    """Return what the readings of an adjusted job say of its model."""
    rng = np.random.default_rng(_SEED)
    say("looking for structure")
    field, not_tested, units, selection = _selected(subject, rng)
    names = named(selection)
    before = _strongest(field)
    say("holding parts of the readings out")
    gained = gains(subject, selection, names) if names else []
    field_after, given = _recentred(subject, selection, names, units, rng)
    left, after = _left(selection, names, field_after, given)
    found = noise_of(given)
    say("finding what the measurement could not see")
    findings = tuple(
        Finding(name, gain, _shift(subject, field.system, name)) for name, gain in zip(names, gained, strict=True)
    )
    return Diagnosis(
        subject,
        found,
        units,
        _outliers(subject, selection),
        findings,
        left,
        before,
        after,
        design(subject, field, not_tested, found.ratio),
        _separate(subject, names),
    )


def planned(subject: Subject) -> Design:
    """Return what a measurement can see, before or without looking at its residuals."""
    field, not_tested = field_of_job(subject, {}, np.random.default_rng(_SEED))
    return design(subject, field, not_tested)


def field_of_job(
    subject: Subject, weights: Mapping[str, Array], rng: np.random.Generator
) -> tuple[Field, list[NotTested]]:
    """Return the race of everything that could be in a job, and the effects that its data do not allow to test."""
    system = linearised(subject.model, weights)
    families, not_tested = families_of(subject, system)
    everything = [*families, *smooth_families(subject, system)]
    return field_of(system, everything, rng, subject.single_components), not_tested


def _selected(subject: Subject, rng: np.random.Generator) -> tuple[Field, list[NotTested], tuple[Unit, ...], Selection]:
    """Return the selection with the readings of each unit weighted by the noise that was found in it."""
    weights: Mapping[str, Array] = {}
    units: tuple[Unit, ...] = ()
    for _ in range(_ROUNDS + 1):
        field, not_tested = field_of_job(subject, weights, rng)
        selection = select(field, nothing(field.system))
        unit = apart(subject, field.system, selection.given(), rng) if len(units) < _ROUNDS else None
        if unit is None:
            break
        weights, units = weighted(subject, weights, unit), (*units, unit)
    return field, not_tested, units, selection


def _strongest(field: Field) -> float:
    """Return the level of the strongest candidate in the residuals as they are."""
    given = nothing(field.system)
    levels = [field.level(i, score.log_p[score.best]) for i, score in enumerate(field.scores(given)) if len(score.gain)]
    wrong = field.outliers(given)
    return float(np.exp(field.overall(min([*levels, field.level(-1, wrong.log_p[wrong.best])]))))


def _weights(subject: Subject, units: Sequence[Unit]) -> Mapping[str, Array]:
    weights: Mapping[str, Array] = {}
    for unit in units:
        weights = weighted(subject, weights, unit)
    return weights


def extended_model(subject: Subject, names: Sequence[Named], start: bool = True) -> Model:
    """Return the model with the named effects in it, at what was found of them."""
    model = subject.model
    for name in names:
        alternative = name.alternative
        model = with_effect(model, alternative.effect, [alternative.instance], dict(alternative.scanned))
        added = model.added[-1]
        block = model.blocks[added.block]
        values = block.values.copy()
        row = block.members.index(alternative.instance[0]) if alternative.instance and added.effect.link is None else -1
        for parameter, value in zip(alternative.parameters, name.values, strict=True):
            values[row, block.column(parameter)] += value if start else 0.0
        model = model.with_blocks({**model.blocks, block.name: block.with_values(values)})
    return model


def _recentred(
    subject: Subject, selection: Selection, names: Sequence[Named], units: Sequence[Unit], rng: np.random.Generator
) -> tuple[Field, Given]:
    """Return the smooth functions' race about the solution with the named effects adjusted, outliers left out of it.

    Where that adjustment fails the linear solution serves.
    """
    if not names:
        return selection.field, selection.given()
    model = extended_model(subject, names)
    solution = subject.refit(model, _kept(selection))
    if not solution.outcome.good:
        return selection.field, selection.given()
    blocks = {name: block.with_values(solution.blocks[name].values) for name, block in model.blocks.items()}
    changed = replace(subject, model=model.with_blocks(blocks))
    system = linearised(changed.model, _weights(subject, units))
    field = field_of(system, smooth_families(changed, system), rng, subject.single_components)
    wrong = [field.of_reading(one.number) for one in selection.outliers]
    given = nothing(system)
    return field, given.with_columns(np.concatenate(wrong, axis=1)) if wrong else given


def _kept(selection: Selection) -> dict[str, Mask]:
    """Return for each group the readings that are not outliers, in any component."""
    field = selection.field
    wrong = np.zeros(field.system.rows)
    for one in selection.outliers:
        wrong[field.places[one.number][field.places[one.number] >= 0]] = 1.0
    kept = {}
    for group in field.system.model.readings:
        d, n = group.observations.readings.shape
        start = field.system.first[group.name]
        kept[group.name] = wrong[start : start + n * d].reshape(n, d).max(axis=1) == 0
    return kept


def _left(selection: Selection, names: Sequence[Named], field: Field, given: Given) -> tuple[Left | None, float]:
    """Return the structure that no effect explains, and the level of the strongest smooth function left."""
    unknown = [selection.field.families[one.family].unknown for one in selection.unknown]
    units = {place for name in names for place in name.alternative.instance}
    found = []
    for number, family in enumerate(field.families):
        if not family.unknown:
            continue
        score = field.score(number, given)
        found.append((field.level(number, score.log_p[score.best]), number, score.best))
        own = [i for i, a in enumerate(family.alternatives) if not a.instance or a.instance[0] in units]
        if units and own:
            best = own[int(np.argmin(score.log_p[own]))]
            found.append((float(np.minimum(score.log_p[best] + np.log(len(own)), 0.0)), number, best))
    log_level, number, best = min(found, default=(0.0, -1, 0))
    level = float(np.exp(log_family(log_level, field.unknowns)))
    stays = number >= 0 and level < (_AFTER if names else _NOTHING_NAMED)
    stays = stays and carried_by_few(field, given, number, best) < np.log(_CARRIED)
    after = [field.families[number].unknown] if stays else []
    if unknown:
        levels = dict(zip(map(id, selection.chosen), selection.levels(), strict=True))
        p = float(np.exp(min(levels[id(one)] for one in selection.unknown)))
        return Left(p, tuple(dict.fromkeys([*unknown, *after]))), level
    return (Left(level, tuple(after)) if after else None), level


def _outliers(subject: Subject, selection: Selection) -> tuple[Outlier, ...]:
    if not selection.outliers:
        return ()
    given = selection.given()
    sigma = np.sqrt(given.squares / max(given.dof, 1))
    found = []
    for one in selection.outliers:
        without = selection.given(without=[one])
        found.append(
            Outlier(
                _keys(selection.field, one.number), float(np.sqrt(max(without.squares - given.squares, 0.0)) / sigma)
            )
        )
    return tuple(sorted(found, key=lambda one: -one.test))


def _keys(field: Field, number: int) -> dict[str, str]:
    """Return what identifies a reading, with its component where these go wrong one by one."""
    row = int(field.places[number][0])
    groups = field.system.model.readings
    group = next(g for g in groups if 0 <= row - field.system.first[g.name] < g.observations.readings.size)
    observations = group.observations
    reading, component = divmod(row - field.system.first[group.name], len(observations.readings))
    keys = {key: values[reading] for key, values in observations.keys.items()}
    single = len(observations.readings) > 1 and field.places.shape[1] == 1
    return keys | ({"component": observations.components[component]} if single else {})


def _shift(subject: Subject, system: System, name: Named) -> float:
    """Return by how much what is delivered changes at most when an effect is taken into the model."""
    alternative = name.alternative
    full = signature(subject.model, system, alternative.effect, alternative.instance, dict(alternative.scanned))
    shift = system.shift((full @ name.values)[:, None], subject.delivered.block, subject.delivered.columns)
    return float(np.sqrt((shift**2).sum(axis=(1, 2)).max(initial=0.0)))


def _separate(subject: Subject, names: Sequence[Named]) -> tuple[str, ...]:
    found: dict[str, None] = {}
    for name in names:
        for rival in name.rivals[:2]:
            for words in separations(subject, name.alternative, rival.alternative):
                found[words] = None
    return tuple(found)
