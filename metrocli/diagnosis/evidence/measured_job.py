"""From an adjusted job to its measurement: the linearised system, its candidates, and what else can enter.

Among the candidates are causes that are not known: waves of a covariate, and a motion in proportion to one. They are
structure that no effect and no correlated error has: images in turn left and right, a unit that creeps.
Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.evidence.functions import process_bases
from metrocli.diagnosis.evidence.measurement import Measurement
from metrocli.diagnosis.evidence.prices import counted
from metrocli.diagnosis.linear.candidates import Candidate, CandidateGroup
from metrocli.diagnosis.linear.columns import CandidateColumns
from metrocli.diagnosis.linear.families import families_of, families_throughout
from metrocli.diagnosis.linear.linearised import linearised
from metrocli.diagnosis.linear.projection import Linearised
from metrocli.diagnosis.noise import variance_groups
from metrocli.effects.covariates import Covariate
from metrocli.effects.effect import Effect, Parameter

_PLACES = 6
"""Fewest places of an effect that acts at all of them at once"""
_MOST = 2e10
"""Largest product of rows and squared columns for that"""
_REDUNDANT = 1e-3
"""Smallest redundancy of a reading whose error shows"""
_SEED = 20
_STEPS = 6
"""Fewest different values of a covariate whose waves are tried"""
_MOST_WAVES = 40
"""Largest number of frequencies, half a period over the range apart"""
_EFFECT = Effect("", "a cause that is not known", (Parameter("size"),))


def measurement_of(
    job: AdjustedJob, weights: Mapping[str, Array] | None = None, like: Measurement | None = None, quick: bool = False
) -> Measurement:
    """Return a job linearised about its solution; one `like` it, of the same candidates, gives the numbers of tests.

    A quick one has no correlated errors and no smooth effects, whose many columns take the most time.
    """
    system = _with_standing(job, linearised(job.model, weights or {}))
    families, not_tested = families_of(job, system)
    every = [*families, *families_throughout(job, system)]
    families += unknown_families(job, system)
    places = _places(system, job)
    readings = int((1 - system.basis.squares(places[:, 0]) > _REDUNDANT).sum())
    scatters = tuple(_scatters(job, system, every, smooth=not quick))
    same = like is not None and [family.form for family in like.families] == [family.form for family in families]
    rng = np.random.default_rng(_SEED)
    prices = like.prices if same and like else counted(system, families, readings, rng, len(scatters))
    return Measurement(
        job,
        system,
        tuple(families),
        not_tested,
        scatters,
        () if quick else tuple(process_bases(job, system)),
        places,
        tuple(variance_groups(job, system)),
        prices,
    )


def _places(system: Linearised, job: AdjustedJob) -> Index:
    """Return the rows of each reading that may be wrong; of single components, those of each by itself."""
    groups = [group for group in system.model.readings if group.name not in job.certified]
    most = max(len(group.observations.readings) for group in groups)
    parts = []
    for group in groups:
        d, n = group.observations.readings.shape
        rows = system.first[group.name] + d * np.arange(n)[:, None] + np.arange(d)
        # padded with -1, so that readings of one and of three components stand in one table
        parts.append(np.pad(rows, ((0, 0), (0, most - d)), constant_values=-1))
    places = np.concatenate(parts)
    return places[places >= 0][:, None] if job.single_components else places


def _scatters(
    job: AdjustedJob, system: Linearised, families: Sequence[CandidateGroup], smooth: bool
) -> list[tuple[CandidateGroup, ...]]:
    """Return the families of each effect that usually acts at all its places, if it has enough of them.

    Smooth ones are left out if they are not asked for.
    """
    from metrocli.effects.extension import can_act_everywhere

    by_name: dict[str, list[CandidateGroup]] = {}
    for family in families:
        effect = family.effect if family.alternatives else None
        if effect is None or not effect.of_all or (effect.is_smooth and not smooth):
            continue
        if can_act_everywhere(system.model, effect):
            by_name.setdefault(family.name, []).append(family)
    scatters = []
    for own in by_name.values():
        columns = sum(int(family.shown.sum()) for family in own)
        # coefficients of a smooth effect are its freedoms, where another effect has one place for each alternative
        places = columns if own[0].effect.is_smooth else sum(family.columns.count for family in own)
        if min(places, columns) >= _PLACES and system.rows * columns**2 <= _MOST:
            scatters.append(tuple(own))
    return scatters


def _with_standing(job: AdjustedJob, system: Linearised) -> Linearised:
    """Return a system with the residuals that it would have without the effects at fixed sizes in its model.

    Their contribution is linear about their sizes theta: `r + G theta`.
    """
    residual = system.residual
    for fixed in job.standing:
        residual = residual + Candidate(fixed.effect, fixed.instance).signature(system) @ np.array(fixed.sizes)
    # projected again: the unknowns absorb a part of what these effects give
    return replace(system, residual=system.seen(residual)) if job.standing else system


def unknown_families(job: AdjustedJob, system: Linearised) -> Iterator[CandidateGroup]:
    """Yield the waves of each periodic covariate, and the motion in proportion to each that is one."""
    for covariate in job.covariates:
        columns = []
        if covariate.together:
            columns = [_motion(job, system, covariate)]
        elif covariate.periodic:
            columns = list(_waves(job, system, covariate))
        if columns:
            yield _family(system, covariate.name, columns)


def _family(system: Linearised, name: str, columns: Sequence[Array]) -> CandidateGroup:
    whole = CandidateColumns.of(np.stack(columns, axis=1))
    # by covariate and number: one wave over a covariate is not that of another
    alternatives = tuple(Candidate(_EFFECT, (name, str(number))) for number in range(len(columns)))
    return CandidateGroup(f"varies with {name}", alternatives, whole, whole.norms(), whole.grams(system.basis), name)


def _motion(job: AdjustedJob, system: Linearised, covariate: Covariate) -> Array:
    """Return the coordinates of a covariate, which are changes of the readings themselves, whitened."""
    changes = np.zeros((system.rows, len(next(iter(covariate.values.values())))))
    for group in job.model.readings:
        changes += system.spread(group, covariate.values[group.name].T)
    return np.asarray(changes / system.scale[:, None])


def _waves(job: AdjustedJob, system: Linearised, covariate: Covariate) -> Iterator[Array]:
    """Yield cosine and sine of each component, from one period over the range up to one in two steps (Nyquist)."""
    values = {name: coordinate for name, coordinate in covariate.values.items() if np.ndim(coordinate) == 1}
    every = np.concatenate([*values.values(), np.zeros(0)])
    steps = np.unique(every)
    if len(steps) < _STEPS:
        return
    low, span = float(steps[0]), float(np.ptp(steps))
    # half periods: a wave between two whole ones has a cosine of 0.6 with either, and would be missed
    turns = np.arange(1.0, (len(steps) - 1) / 2 + 0.1, 0.5)
    for turn in turns[:_MOST_WAVES]:
        parts = []
        for group in job.model.readings:
            if group.name in values:
                d, whole = len(group.observations.readings), system.stretch(group)
                phase = 2 * np.pi * turn * (values[group.name] - low) / span
                # in declared standard deviations, so that one size serves all groups
                factor = system.weights_of(group).reshape(-1, d)
                own = np.zeros((system.rows, 2 * d))
                for component in range(d):
                    rows = slice(whole.start + component, whole.stop, d)
                    own[rows, 2 * component] = np.cos(phase) * factor[:, component]
                    own[rows, 2 * component + 1] = np.sin(phase) * factor[:, component]
                parts.append(own)
        yield np.concatenate(parts, axis=1)
