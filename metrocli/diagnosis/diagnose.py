"""The whole diagnosis of one adjusted job, from its linearised system to the verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from metrocli.adjust.blocks import Array
from metrocli.adjust.observations import Mask
from metrocli.diagnosis.candidates import NotTested, families_of
from metrocli.diagnosis.design import Design, design, separations
from metrocli.diagnosis.gain import Gain, gains
from metrocli.diagnosis.naming import Named, named
from metrocli.diagnosis.noise import Noise, Unit, apart, noise_of, weighted
from metrocli.diagnosis.projection import System, linearised, signature
from metrocli.diagnosis.race import Field, Given, field_of, nothing
from metrocli.diagnosis.selection import Selection, select
from metrocli.diagnosis.smooth import smooth_families
from metrocli.diagnosis.subject import Subject
from metrocli.effects.model import Model, with_effect

Say = Callable[[str], None]
_AFTER = 0.02
"""Level, counted over all smooth functions, of structure that is left when everything has been named"""
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

    @property
    def verdict(self) -> str:
        """clean, explained, indistinct or unexplained."""
        if self.left is not None:
            return "unexplained"
        if not self.findings:
            return "clean"
        return "indistinct" if any(finding.named.rivals for finding in self.findings) else "explained"


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
    field, not_tested = _field(subject, {}, np.random.default_rng(_SEED))
    return design(subject, field, not_tested)


def _field(subject: Subject, weights: Mapping[str, Array], rng: np.random.Generator) -> tuple[Field, list[NotTested]]:
    system = linearised(subject.model, weights)
    families, not_tested = families_of(subject, system)
    families = [*families, *smooth_families(subject, system)]
    return field_of(system, families, rng, subject.components_apart), not_tested


def _selected(subject: Subject, rng: np.random.Generator) -> tuple[Field, list[NotTested], tuple[Unit, ...], Selection]:
    """Return the selection with the readings of each unit weighted by the noise that was found in it."""
    weights: Mapping[str, Array] = {}
    units: tuple[Unit, ...] = ()
    for _ in range(_ROUNDS + 1):
        field, not_tested = _field(subject, weights, rng)
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
    field = field_of(system, smooth_families(changed, system), rng, subject.components_apart)
    wrong = [field.of_reading(one.number) for one in selection.outliers]
    given = nothing(system)
    return field, given.with_columns(np.concatenate(wrong, axis=1)) if wrong else given


def _kept(selection: Selection) -> dict[str, Mask]:
    """Return for each group the readings that are not outliers."""
    kept, first = {}, 0
    wrong = {int(selection.field.reading[one.number]) for one in selection.outliers}
    for group in selection.field.system.model.readings:
        count = group.observations.count
        kept[group.name] = np.array([first + i not in wrong for i in range(count)])
        first += count
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
        found.append((field.level(number, score.log_p[score.best]), family.unknown))
        own = [i for i, a in enumerate(family.alternatives) if not a.instance or a.instance[0] in units]
        if units and own:
            found.append((float(np.minimum(score.log_p[own].min() + np.log(len(own)), 0.0)), family.unknown))
    if not found:
        return (Left(0.0, tuple(unknown)) if unknown else None), 1.0
    level = float(-np.expm1(field.unknowns * np.log1p(-min(np.exp(min(found)[0]), 1 - 1e-16))))
    if unknown:
        levels = dict(zip(map(id, selection.chosen), selection.levels(), strict=True))
        p = float(np.exp(min(levels[id(one)] for one in selection.unknown)))
        return Left(p, tuple(dict.fromkeys([*unknown, *([min(found)[1]] if level < _AFTER else [])]))), level
    return (Left(level, (min(found)[1],)) if level < _AFTER else None), level


def _outliers(subject: Subject, selection: Selection) -> tuple[Outlier, ...]:
    if not selection.outliers:
        return ()
    given = selection.given()
    sigma = np.sqrt(given.squares / max(given.dof, 1))
    keys = [
        {key: values[i] for key, values in group.observations.keys.items()}
        for group in subject.model.readings
        for i in range(group.observations.count)
    ]
    tests: dict[int, float] = {}
    for one in selection.outliers:
        without = selection.given(without=[one])
        reading = int(selection.field.reading[one.number])
        test = float(np.sqrt(max(without.squares - given.squares, 0.0)) / sigma)
        tests[reading] = max(tests.get(reading, 0.0), test)
    found = [Outlier(keys[reading], test) for reading, test in tests.items()]
    return tuple(sorted(found, key=lambda one: -one.test))


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
