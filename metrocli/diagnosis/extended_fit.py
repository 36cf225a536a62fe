"""The extended fit: the job adjusted again with the named effects in its model.

Method: docs/algorithms/selection-and-levels.md (dominant effects).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.observations import Mask
from metrocli.diagnosis.adjusted_job import AdjustedJob, Standing
from metrocli.diagnosis.linear.candidates import NotTested, families_of, families_throughout
from metrocli.diagnosis.linear.counted_tests import score_tests_of
from metrocli.diagnosis.linear.fitted_columns import FittedColumns, nothing_fitted
from metrocli.diagnosis.linear.linearised import linearised
from metrocli.diagnosis.linear.projection import System, by_rows
from metrocli.diagnosis.linear.score_tests import ScoreTests
from metrocli.diagnosis.linear.signatures import signature
from metrocli.diagnosis.linear.smooth_terms import beside_columns, smooth_families
from metrocli.diagnosis.noise import Unit, reweighted
from metrocli.diagnosis.selection.all_of_a_kind import AllOfAKind
from metrocli.diagnosis.selection.confidence_set import NamedEffect
from metrocli.diagnosis.selection.selection_state import Selection
from metrocli.effects.effect import Parameter
from metrocli.effects.extension import with_effect, with_effect_everywhere
from metrocli.effects.model import Added, Model
from metrocli.frozen import dataclass

_MOST_ADJUSTED = 6
"""Largest number of effects without each of which the extended job is adjusted"""
_LINEAR = 0.01
"""Departure of the adjusted residuals from the linear ones [sigma] below which they are the same for all tests"""


def score_tests_of_job(
    job: AdjustedJob, weights: Mapping[str, Array], rng: np.random.Generator, like: ScoreTests | None = None
) -> tuple[ScoreTests, list[NotTested]]:
    """Return the score tests of all candidates of a job, and the effects that its data do not allow to test.

    `like` are earlier tests of the job, whose effective numbers of tests hold for these as well.
    """
    system = _with_standing(job, linearised(job.model, weights))
    families, not_tested = families_of(job, system)
    everything = [*families, *smooth_families(job, system)]
    test_set = score_tests_of(system, everything, rng, job.single_components, like)
    everywhere = families_throughout(job, system)
    test_set = replace(test_set, adjusted=job.adjusted, budget=job.budget, throughout=everywhere)
    return adjusted_with_all(test_set) if job.patient else test_set, not_tested


def adjusted_with_all(test_set: ScoreTests) -> ScoreTests:
    """Return score tests in which no effect stops the selection."""
    effects = (family for family in test_set.families if not family.unknown)
    spots = {one.spot for family in effects for one in family.alternatives}
    return replace(test_set, adjusted=test_set.adjusted | spots)


def _with_standing(job: AdjustedJob, system: System) -> System:
    """Return a system with the residuals that it would have without the effects at fixed sizes in its model.

    Their contribution is linear about their sizes theta: `r + G theta`.
    """
    residual = system.residual
    for one in job.standing:
        residual = residual + signature(job.model, system, one.effect, one.instance, {}) @ np.array(one.sizes)
    return replace(system, residual=system.seen(residual)) if job.standing else system


def weights_of(job: AdjustedJob, units: Sequence[Unit]) -> Mapping[str, Array]:
    """Return factors on the whitened readings of noisier units that bring their noise to that of the others."""
    weights: Mapping[str, Array] = {}
    for unit in units:
        weights = reweighted(job, weights, unit)
    return weights


def extended_model(job: AdjustedJob, names: Sequence[NamedEffect]) -> Model:
    """Return the model with the named effects in it, at the sizes that were found."""
    model = job.model
    for name in names:
        alternative = name.alternative
        model = with_effect(model, alternative.effect, [alternative.instance], name.known)
        block, row = _own_row(model, name)
        step = np.zeros(block.values.shape)
        for parameter, value in zip(alternative.parameters, name.values, strict=True):
            step[row, block.column(parameter)] = value
        model = model.with_blocks({**model.blocks, block.name: block.moved(step)})
    return model


def _own_row(model: Model, name: NamedEffect) -> tuple[Block, int]:
    """Return the block of the effect that was added last, and the row of the member on which it acts."""
    return _row(model, model.added[-1], name)


def _row(model: Model, added: Added, name: NamedEffect) -> tuple[Block, int]:
    block = model.blocks[added.block]
    place = name.alternative.instance
    return block, block.members.index(place[0]) if place and added.effect.link is None else -1


@dataclass(frozen=True)
class Size:
    """The estimate of one parameter of an effect."""

    parameter: Parameter
    value: float
    """Its value; for a column that the model already has, the change relative to the job"""
    std: float | None
    """Standard uncertainty; None if the parameter was scanned or is not determined"""
    seen: bool = True
    """Whether the readings determine it apart from the others; if not, `value` holds with the others taken as 0"""


def sizes(job: AdjustedJob, name: NamedEffect) -> tuple[Size, ...]:
    """Return the estimated parameters of a named effect, with standard uncertainties for the noise that was found."""
    alternative = name.alternative
    block, row = _own_row(extended_model(job, [name]), name)
    before = job.model.blocks.get(block.name)
    by_step = block.space.by_step(block.values)[row]
    std = np.sqrt(np.maximum(np.diag(name.covariance), 0.0))
    known = {p.name: p for p in alternative.effect.all_parameters}
    found = []
    for at, key in enumerate(alternative.parameters):
        column = block.column(key)
        was = before.values[row, column] if before is not None and column < before.size else 0.0
        seen = bool(name.apart[at])
        spread = float(std[at] * by_step[column]) if seen else None
        found.append(Size(known[key], float(block.values[row, column] - was), spread, seen))
    return (*found, *(Size(known[key], value, None) for key, value in alternative.scanned if not known[key].place))


def extended_fit(job: AdjustedJob, names: Sequence[NamedEffect], kept: Mapping[str, Mask]) -> AdjustedJob | None:
    """Return the job with the named effects in its model, adjusted to the kept readings; None if that fails."""
    return _refitted(job, extended_model(job, names), kept)


def _refitted(job: AdjustedJob, model: Model, kept: Mapping[str, Mask]) -> AdjustedJob | None:
    solution = job.refit(model, kept)
    if not solution.outcome.good:
        return None
    blocks = {name: block.with_values(solution.blocks[name].values) for name, block in model.blocks.items()}
    return replace(job, model=model.with_blocks(blocks))


def with_scatter(job: AdjustedJob, found: AllOfAKind, kept: Mapping[str, Mask]) -> AdjustedJob | None:
    """Return the job with an effect at all its places in its model, adjusted to the kept readings; None if it fails."""
    return _refitted(job, with_effect_everywhere(job.model, found.effect, found.std), kept)


def result_change(job: AdjustedJob, other: AdjustedJob) -> float:
    """Return the largest change of a delivered member between two adjustments of a job."""
    columns = list(job.delivered.columns)
    before, after = job.model.blocks, other.model.blocks
    moved = job.delivered.of(lambda name: after[name].values[:, columns] - before[name].values[:, columns])
    return float(np.linalg.norm(moved, axis=1).max(initial=0.0))


def result_changes(
    job: AdjustedJob, names: Sequence[NamedEffect], fit: AdjustedJob | None, kept: Mapping[str, Mask]
) -> list[float | None]:
    """Return the change of the delivered result by each effect: the adjusted extended job with it and without it.

    None where an adjustment fails, or for more effects than are adjusted one by one.
    """
    if fit is None or len(names) > _MOST_ADJUSTED:
        return [None] * len(names)
    found: list[float | None] = []
    for name in names:
        others = [other for other in names if other is not name]
        without = extended_fit(job, others, kept) if others else _without_names(job, kept)
        found.append(None if without is None else result_change(without, fit))
    return found


def _without_names(job: AdjustedJob, kept: Mapping[str, Mask]) -> AdjustedJob | None:
    """Return the job adjusted to the kept readings: it is, unless it has others too or is a part of a larger one."""
    own = job.part is None and all(mask.all() for mask in kept.values())
    return job if own else _refitted(job, job.model, kept)


def relinearised(job: AdjustedJob, names: Sequence[NamedEffect], adjusted: AdjustedJob) -> AdjustedJob:
    """Return the job with its unknowns at the values of an adjustment with the named effects.

    This undoes what a large effect did to the unknowns. Effects that are columns of the job's own blocks, such as terms
    of a lens, stay in the model at their sizes, and all else is linearised about them. The others are set to 0, as they
    are linear themselves. At their sizes a scale or a rotation of everything, which the job's unknowns absorb, would
    not be absorbed.
    """
    model, added = job.model, adjusted.model.added[len(job.model.added) :]
    moved = {key: _without(block, adjusted.model.blocks[key], added) for key, block in model.blocks.items()}
    model, standing = model.with_blocks(moved), []
    for name, one in zip(names, added, strict=True):
        if one.effect.link is not None:
            continue
        block, row = _row(adjusted.model, one, name)
        before, parameters = job.model.blocks[block.name], name.alternative.parameters
        sizes = {key: float(block.values[row, block.column(key)]) - _value(before, row, key) for key in parameters}
        model = with_effect(model, one.effect, [name.alternative.instance], sizes)
        standing.append(Standing(one.effect, name.alternative.instance, tuple(sizes.values())))
    spots = frozenset(name.alternative.spot for name in names)
    return replace(job, model=model, adjusted=spots, standing=tuple(standing))


def _without(block: Block, adjusted: Block, added: Sequence[Added]) -> Block:
    """Return a block at adjusted values, except for columns that were freed in it."""
    values = adjusted.values[:, : block.size].copy()
    for one in added:
        if one.block == block.name:
            freed = [block.column(column) for column in one.columns if column in block.columns]
            values[:, freed] = np.where(block.free[:, freed], values[:, freed], block.values[:, freed])
    return block.with_values(values)


def _value(block: Block, row: int, key: str) -> float:
    return float(block.values[row, block.column(key)]) if key in block.columns else 0.0


def departure(selection: Selection, fit: AdjustedJob) -> float:
    """Return the norm of what an extended fit leaves of the kept readings beside what the linear fit predicts [sigma].

    It is 0 if the model is linear between the solution of the job and that of the extended fit. It bounds the square
    root of what the difference adds to any test.
    """
    system = selection.test_set.system
    wrong, squares = _wrong(selection), 0.0
    predicted = selection.fitted(without=selection.unknown).residual
    for group in fit.model.groups:
        if group.name in system.first:
            own = slice(system.first[group.name], system.first[group.name] + group.observations.readings.size)
            factor = group.observations.deviations.T.ravel() / system.scale[own]
            left = by_rows(group.linear(fit.model.blocks, frozenset())) * factor - predicted[own]
            squares += float((left[~wrong[own]] ** 2).sum())
    return float(np.sqrt(squares))


def is_linear(selection: Selection, fit: AdjustedJob) -> bool:
    """Return whether the adjusted residuals of an extended fit are those of the linear one for all tests."""
    return departure(selection, fit) < _LINEAR


def score_tests_after(
    changed: AdjustedJob | None,
    selection: Selection,
    names: Sequence[NamedEffect],
    units: Sequence[Unit],
    rng: np.random.Generator,
) -> tuple[ScoreTests, FittedColumns]:
    """Return the score tests of smooth functions about the extended fit, and the fit of the outliers there.

    Without an extended fit the linearised solution is used; so it is, with the columns of the named effects as further
    unknowns, where the model is linear up to the extended fit and all parameters of the effects are estimated.
    """
    if changed is None:
        return selection.test_set, selection.fitted()
    if all(name.seen.all() for name in names) and is_linear(selection, changed):
        named = selection.fitted(without=[*selection.unknown, *selection.outliers]).basis
        system = selection.test_set.system.with_unknowns(named)
        families = [beside_columns(family, named) for family in selection.test_set.families if family.unknown]
    else:
        system = linearised(changed.model, weights_of(changed, units))
        families = smooth_families(changed, system)
    test_set = score_tests_of(system, families, rng, changed.single_components, selection.test_set)
    wrong = [test_set.of_reading(one.number) for one in selection.outliers]
    fitted = nothing_fitted(system)
    return test_set, fitted.with_columns(np.concatenate(wrong, axis=1)) if wrong else fitted


def readings_kept(selection: Selection) -> dict[str, Mask]:
    """Return for each group a mask of the readings that are not outliers in any component."""
    test_set, wrong, found = selection.test_set, _wrong(selection), dict[str, Mask]()
    for group in test_set.system.model.readings:
        d, n = group.observations.readings.shape
        start = test_set.system.first[group.name]
        found[group.name] = np.asarray(~wrong[start : start + n * d].reshape(n, d).any(axis=1))
    return found


def _wrong(selection: Selection) -> Mask:
    """Return which rows are those of outliers, (rows,)."""
    test_set = selection.test_set
    wrong = np.zeros(test_set.system.rows, dtype=bool)
    for one in selection.outliers:
        wrong[test_set.places[one.number][test_set.places[one.number] >= 0]] = True
    return wrong
