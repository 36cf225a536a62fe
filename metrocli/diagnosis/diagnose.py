"""The whole diagnosis of one adjusted job, from its linearised system to the verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.cross_validation import Gain, gains
from metrocli.diagnosis.detectability import Design, design, separations
from metrocli.diagnosis.extended_fit import Size, about, field_of_job, kept, mended, recentred, sizes, weights_of
from metrocli.diagnosis.linear.candidates import NotTested
from metrocli.diagnosis.linear.fitted_columns import nothing
from metrocli.diagnosis.linear.projection import System
from metrocli.diagnosis.linear.score_tests import Field
from metrocli.diagnosis.linear.signatures import signature
from metrocli.diagnosis.mistakes import Mistaken
from metrocli.diagnosis.noise import GIVEN, Noise, Unit, apart, noise_of, weighted
from metrocli.diagnosis.residual_structure import (
    REPEATS,
    Left,
    PureError,
    left_over,
    log_strongest,
    other_shape_from,
    pure_error,
)
from metrocli.diagnosis.selection.confidence_set import Named, named
from metrocli.diagnosis.selection.refined_scan import polished
from metrocli.diagnosis.selection.search import carried_on, carried_over, select
from metrocli.diagnosis.selection.selection_state import Selection
from metrocli.diagnosis.selection.thresholds import dominated
from metrocli.errors import UndeterminedError

Say = Callable[[str], None]
_LACK_OF_FIT = 0.005
_ROUNDS = 3
_RACES = 5
"""How often the race is held at most"""
_SEED = 20


@dataclass(frozen=True)
class Outlier:
    """A reading that is wrong."""

    keys: Mapping[str, str]
    test: float
    """By how many standard deviations it is off, given all else that was found"""


@dataclass(frozen=True)
class Finding:
    """One effect that was named."""

    named: Named
    sizes: tuple[Size, ...]
    gain: Gain
    shift: float
    """By how much what is delivered changes with it, at most"""
    other_shape_from: float
    """Share of its size from which on a cause of another shape would have shown beside it (80 % power)"""


@dataclass(frozen=True)
class Diagnosis:
    """What the model of a job gets wrong."""

    subject: AdjustedJob
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
    adjusts: bool = True
    """Whether the job can be adjusted with what was named"""
    together: Gain | None = None
    """What all that was named gains, where it is more than one"""
    repeats: PureError | None = None
    """What repeated readings say of the noise, where there are any"""
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


def diagnose(subject: AdjustedJob, say: Say = lambda line: None) -> Diagnosis:
    """Return what the readings of an adjusted job say of its model.

    Raises UndeterminedError where no reading is to spare.
    """
    say("looking for structure")
    point, (field, not_tested, units, selection) = _raced(subject, say)
    names = named(selection)
    say("holding parts of the readings out")
    gained = gains(point, selection, names) if names else []
    changed = mended(subject, names, kept(selection)) if names else None
    field_after, given = recentred(changed, selection, units, np.random.default_rng(_SEED))
    left, after = left_over(selection, names, field_after, given)
    repeats = pure_error(subject, field_after.system, given)
    if left is None and repeats is not None and repeats.lack_of_fit < _LACK_OF_FIT:
        left = Left(repeats.lack_of_fit, (REPEATS,))
    found = noise_of(given)
    say("finding what the measurement could not see")
    findings = tuple(
        Finding(
            name,
            sizes(subject, name),
            gain,
            _shift(point, field.system, name),
            other_shape_from(name, field_after, found.ratio),
        )
        for name, gain in zip(names, gained, strict=False)
    )
    return Diagnosis(
        subject,
        found,
        units,
        _outliers(subject, selection),
        findings,
        left,
        float(np.exp(log_strongest(field, nothing(field.system)))),
        after,
        design(point, field, not_tested, found.ratio),
        _separate(subject, names),
        changed is not None or not names,
        gained[-1] if len(names) > 1 else None,
        repeats,
    )


Race = tuple[Field, list[NotTested], tuple[Unit, ...], Selection]


def _raced(subject: AdjustedJob, say: Say) -> tuple[AdjustedJob, Race]:
    """Return the race, and the subject with its unknowns where the named effects do not bend them.

    Where effects stop it, it is held again about the job adjusted with them, with these among all others; in the end it
    is carried on about the job adjusted with all that was named.
    """
    point = subject
    for left in reversed(range(_RACES)):
        point = point if left else replace(point, patient=True)
        field, not_tested, units, selection = _selected(point, np.random.default_rng(_SEED))
        selection = polished(point, selection)
        if not dominated(selection):
            break
        say("adjusting with what was found")
        names = named(selection)
        changed = mended(subject, names, kept(selection))
        point = replace(point, patient=True) if changed is None else about(subject, names, changed)
    names = named(selection)
    changed = mended(subject, names, kept(selection)) if names else None
    if changed is not None:
        point = replace(about(subject, names, changed), patient=True)
        field, not_tested = field_of_job(point, weights_of(subject, units), np.random.default_rng(_SEED))
        selection = polished(point, carried_on(carried_over(selection, field)))
    return point, (field, not_tested, units, selection)


def planned(subject: AdjustedJob) -> Design:
    """Return what a measurement can see, before or without looking at its residuals."""
    field, not_tested = field_of_job(subject, {}, np.random.default_rng(_SEED))
    return design(subject, field, not_tested)


def _selected(subject: AdjustedJob, rng: np.random.Generator) -> Race:
    """Return the selection with the readings of each unit weighted by the noise that was found in it."""
    weights: Mapping[str, Array] = {}
    units: tuple[Unit, ...] = ()
    for _ in range(_ROUNDS + 1):
        field, not_tested = field_of_job(subject, weights, rng)
        if field.system.dof < 1:
            raise UndeterminedError(
                "no reading is to spare: the unknowns take them all up, whatever is wrong\n"
                "measure more; `metrocli diagnose --design` says what a measurement shows"
            )
        last = len(units) == _ROUNDS
        unit = None if last else _sigma_first(subject, field)
        if unit is None:
            selection = select(field, nothing(field.system))
            # beside a large effect other structure is not searched for yet, and would count as noise
            unit = None if last or dominated(selection) else apart(subject, field.system, selection.given(), rng)
        if unit is None:
            break
        weights, units = weighted(subject, weights, unit), (*units, unit)
    return field, not_tested, _joined(units), selection


def _sigma_first(subject: AdjustedJob, field: Field) -> Unit | None:
    """Return what the job gives with a wrong sigma, where that says more of the residuals than any cause.

    With draws of its own: the levels of a job that gives nothing are those without this test.
    """
    given = nothing(field.system)
    unit = apart(subject, field.system, given, np.random.default_rng(_SEED))
    if unit is None or unit.key != GIVEN or unit.ratio < 1:
        return None
    return unit if unit.log_level < log_strongest(field, given) else None


def _joined(units: Sequence[Unit]) -> tuple[Unit, ...]:
    """Return units with one ratio each, the product of those that were found one after the other."""
    found: dict[tuple[str, str], Unit] = {}
    for unit in units:
        before = found.get((unit.key, unit.name))
        found[unit.key, unit.name] = unit if before is None else replace(unit, ratio=unit.ratio * before.ratio)
    return tuple(found.values())


def _outliers(subject: AdjustedJob, selection: Selection) -> tuple[Outlier, ...]:
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


def _shift(subject: AdjustedJob, system: System, name: Named) -> float:
    """Return by how much what is delivered changes at most when an effect is taken into the model."""
    alternative = name.alternative
    full = signature(subject.model, system, alternative.effect, alternative.instance, dict(alternative.scanned))
    shift = system.shifts((full @ name.values)[:, None], subject.delivered.blocks, subject.delivered.columns)
    return float(np.sqrt((shift**2).sum(axis=(1, 2)).max(initial=0.0)))


def _separate(subject: AdjustedJob, names: Sequence[Named]) -> tuple[str, ...]:
    found: dict[str, None] = {}
    for name in names:
        for rival in name.rivals[:2]:
            for words in separations(subject, name.alternative, rival.alternative):
                found[words] = None
    return tuple(found)
