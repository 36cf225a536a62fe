"""The extended fit: the job adjusted again with the named effects in its model.

Method: docs/algorithms/evidence.md (dominant effects).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.observations import Mask
from metrocli.diagnosis.adjusted_job import AdjustedJob, Standing
from metrocli.diagnosis.evidence.identified import IdentifiedEffect
from metrocli.diagnosis.evidence.measurement import Measurement
from metrocli.diagnosis.evidence.parts import Fixed
from metrocli.diagnosis.linear.projection import Linearised
from metrocli.effects.effect import Effect, Parameter
from metrocli.effects.extension import with_effect, with_effect_everywhere
from metrocli.effects.model import Added, Model
from metrocli.frozen import dataclass

_MOST_ADJUSTED = 6
"""Largest number of effects without each of which the extended job is adjusted"""


def extended_model(job: AdjustedJob, names: Sequence[IdentifiedEffect]) -> Model:
    """Return the model with the named effects in it, at the sizes that were found."""
    model = job.model
    for name in names:
        alternative = name.alternative
        model = with_effect(model, alternative.effect, [alternative.instance], name.known)
        block, row = _row(model, model.added[-1], name)
        step = np.zeros(block.values.shape)
        for parameter, value in zip(alternative.parameters, name.values, strict=True):
            step[row, block.column(parameter)] = value
        model = model.with_blocks({**model.blocks, block.name: block.moved(step)})
    return model


def _row(model: Model, added: Added, name: IdentifiedEffect) -> tuple[Block, int]:
    """Return the block of an effect that was added, and the row of the member on which it acts."""
    block = model.blocks[added.block]
    place = name.alternative.instance
    # an effect with a link, or without a place, has its member last: that of readings elsewhere comes first
    return block, block.members.index(place[0]) if place and added.effect.link is None else -1


@dataclass(frozen=True)
class EffectSize:
    """The estimate of one parameter of an effect."""

    parameter: Parameter
    value: float
    """Its value; for a column that the model already has, the change relative to the job"""
    std: float | None
    """Standard uncertainty; None if the parameter was scanned or is not determined"""
    seen: bool = True
    """Whether the readings determine it apart from the others; if not, `value` holds with the others taken as 0"""


def sizes(job: AdjustedJob, name: IdentifiedEffect) -> tuple[EffectSize, ...]:
    """Return the estimated parameters of a named effect, with the standard uncertainties of its covariance."""
    alternative = name.alternative
    model = extended_model(job, [name])
    block, row = _row(model, model.added[-1], name)
    before = job.model.blocks.get(block.name)
    by_step = block.space.by_step(block.values)[row]
    std = np.sqrt(np.maximum(np.diag(name.covariance), 0.0))
    known = {p.name: p for p in alternative.effect.all_parameters}
    estimated = []
    for at, key in enumerate(alternative.parameters):
        column = block.column(key)
        # a column that the effect itself adds to a block of the job begins at 0
        was = before.values[row, column] if before is not None and column < before.size else 0.0
        seen = bool(name.apart[at])
        spread = float(std[at] * by_step[column]) if seen else None
        estimated.append(EffectSize(known[key], float(block.values[row, column] - was), spread, seen))
    return (
        *estimated,
        *(EffectSize(known[key], value, None) for key, value in alternative.scanned if not known[key].place),
    )


def extended_fit(job: AdjustedJob, names: Sequence[IdentifiedEffect], kept: Mapping[str, Mask]) -> AdjustedJob | None:
    """Return the job with the named effects in its model, adjusted to the kept readings; None if that fails."""
    return extended_fit_and_cost(job, names, kept)[0]


def extended_fit_and_cost(
    job: AdjustedJob, names: Sequence[IdentifiedEffect], kept: Mapping[str, Mask]
) -> tuple[AdjustedJob | None, float]:
    """Return what `extended_fit` does, and the sum of squares that it leaves, infinite if it fails."""
    return _refitted(job, extended_model(job, names), kept)


def _refitted(job: AdjustedJob, model: Model, kept: Mapping[str, Mask]) -> tuple[AdjustedJob | None, float]:
    solution = job.refit(model, kept)
    if not solution.outcome.good:
        return None, float("inf")
    blocks = {name: block.with_values(solution.blocks[name].values) for name, block in model.blocks.items()}
    return replace(job, model=model.with_blocks(blocks)), solution.cost


def with_random_effect(job: AdjustedJob, effect: Effect, std: float, kept: Mapping[str, Mask]) -> AdjustedJob | None:
    """Return the job with an effect at all its places in its model, adjusted to the kept readings; None if it fails."""
    return _refitted(job, with_effect_everywhere(job.model, effect, std), kept)[0]


def result_change(job: AdjustedJob, other: AdjustedJob) -> float:
    """Return the largest change of a delivered member between two adjustments of a job."""
    columns = list(job.delivered.columns)
    before, after = job.model.blocks, other.model.blocks
    moved = job.delivered.of(lambda name: after[name].values[:, columns] - before[name].values[:, columns])
    return float(np.linalg.norm(moved, axis=1).max(initial=0.0))


def linear_change(job: AdjustedJob, system: Linearised, name: IdentifiedEffect) -> float:
    """Return the largest change of the delivered result by an effect, to first order."""
    change = system.absorbed((name.alternative.signature(system) @ name.values)[:, None])
    shift = job.delivered.of(lambda block: system.shift(change, block, job.delivered.columns))
    return float(np.sqrt((shift**2).sum(axis=(1, 2)).max(initial=0.0)))


def result_changes(
    job: AdjustedJob, names: Sequence[IdentifiedEffect], fit: AdjustedJob | None, kept: Mapping[str, Mask]
) -> list[float | None]:
    """Return the change of the delivered result by each effect: the adjusted extended job with it and without it.

    None where an adjustment fails, or for more effects than are adjusted one by one.
    """
    if fit is None or len(names) > _MOST_ADJUSTED:
        return [None] * len(names)
    changes: list[float | None] = []
    for name in names:
        others = [other for other in names if other is not name]
        # with nothing left to name, the job as it is may do, without an adjustment
        without = extended_fit(job, others, kept) if others else _without_names(job, kept)
        changes.append(None if without is None else result_change(without, fit))
    return changes


def _without_names(job: AdjustedJob, kept: Mapping[str, Mask]) -> AdjustedJob | None:
    """Return the job adjusted to the kept readings: it is, unless it has others too or is a part of a larger one."""
    own = job.part is None and all(mask.all() for mask in kept.values())
    return job if own else _refitted(job, job.model, kept)[0]


def relinearised(job: AdjustedJob, names: Sequence[IdentifiedEffect], adjusted: AdjustedJob) -> AdjustedJob:
    """Return the job with its unknowns at the values of an adjustment with the named effects.

    This undoes what a large effect did to the unknowns. Effects that are columns of the job's own blocks, such as terms
    of a lens, stay in the model at their sizes, and all else is linearised about them. The others are set to 0, as they
    are linear themselves. At their sizes a scale or a rotation of everything, which the job's unknowns absorb, would
    not be absorbed.
    """
    model, added = job.model, adjusted.model.added[len(job.model.added) :]
    moved = {key: _without(block, adjusted.model.blocks[key], added) for key, block in model.blocks.items()}
    model, standing = model.with_blocks(moved), []
    for name, extra in zip(names, added, strict=True):
        if extra.effect.link is not None:
            continue
        block, row = _row(adjusted.model, extra, name)
        before, parameters = job.model.blocks[block.name], name.alternative.parameters
        sizes = {key: float(block.values[row, block.column(key)]) - _value(before, row, key) for key in parameters}
        model = with_effect(model, extra.effect, [name.alternative.instance], sizes)
        standing.append(Standing(extra.effect, name.alternative.instance, tuple(sizes.values())))
    spots = frozenset(name.alternative.spot for name in names)
    return replace(job, model=model, adjusted=spots, standing=tuple(standing))


def _without(block: Block, adjusted: Block, added: Sequence[Added]) -> Block:
    """Return a block at adjusted values, except for columns that were freed in it."""
    # columns that an effect adds come last
    values = adjusted.values[:, : block.size].copy()
    for extra in added:
        if extra.block == block.name:
            freed = [block.column(column) for column in extra.columns if column in block.columns]
            # one that the job estimates itself keeps its adjusted value: only what the effect set free goes back
            values[:, freed] = np.where(block.free[:, freed], values[:, freed], block.values[:, freed])
    return block.with_values(values)


def _value(block: Block, row: int, key: str) -> float:
    return float(block.values[row, block.column(key)]) if key in block.columns else 0.0


def readings_kept(m: Measurement, wrong: Iterable[Fixed]) -> dict[str, Mask]:
    """Return for each group a mask of the readings of which no component is among the wrong ones."""
    kept, out = dict[str, Mask](), np.zeros(m.system.rows, dtype=bool)
    for part in wrong:
        out[m.rows_of(part.number)] = True
    for group in m.job.model.readings:
        by_reading = out[m.system.stretch(group)].reshape(-1, len(group.observations.readings))
        kept[group.name] = np.asarray(~by_reading.any(axis=1))
    return kept


def with_group_noise(job: AdjustedJob, m: Measurement, ratios: Mapping[int, float]) -> AdjustedJob:
    """Return a job in which some variance groups of its measurement have so many times their declared noise."""
    factor = np.ones(m.system.rows)
    for number, ratio in ratios.items():
        factor[m.units[number][2]] *= ratio
    model = job.model
    for group in model.readings if ratios else ():
        by_reading = factor[m.system.stretch(group)].reshape(-1, len(group.observations.readings))
        model = model.with_group(group.with_noise_times(by_reading.T))
    return replace(job, model=model)
