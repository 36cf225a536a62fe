"""Covariates of image points for `diagnose`, and how image points are held out and refitted.

A covariate is a quantity with which an unknown effect could vary: time, place in the image, distance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.adjustment import StoppingRule, adjust
from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.quantities import Quantity
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array, Index, Mask
from metrocli.effects.covariates import Covariate
from metrocli.effects.effect import ELAPSED, WARMING
from metrocli.effects.extension import with_conditions
from metrocli.effects.model import Model
from metrocli.errors import NoSolutionError
from metrocli.instruments.camera import LENS, TARGET
from metrocli.tasks.shared.diagnosed import FOLDS
from metrocli.tasks.shared.images.adjustment import IMAGES, AdjustedImages
from metrocli.tasks.shared.images.middle import held_in_the_middle

_OF_TRIALS = StoppingRule(limit=200)
"""An adjustment with terms that the readings show takes less than 100 steps; others may wander through thousands"""
PLACE = "place in the image"


def with_all_readings(outliers: str, solve: Callable[[str], AdjustedImages]) -> AdjustedImages:
    """Return the adjustment of all readings, `solve("report")`, of a job that reports or removes outliers.

    An estimated noise is that of the readings which the job does not leave out, as the job states it.
    """
    every = solve("report")
    if outliers == "report" or every.noise is None:
        return every
    try:
        noise = solve(outliers).noise
    except NoSolutionError:
        return every
    observations = every.group.observations
    known = replace(observations, sigma=observations.sigma * ((noise or every.noise) / every.noise))
    return replace(every, group=every.group.with_observations(known), noise=noise)


def at_solution(model: Model, adjusted: AdjustedImages) -> Model:
    """Return the model at the solution of its adjustment, with the readings that were used and their conditions."""
    groups = tuple(adjusted.group if group.name == IMAGES else group for group in model.groups)
    return with_conditions(replace(model, blocks=adjusted.solution.blocks, groups=groups))


def covariates(model: Model) -> list[Covariate]:
    """Return the covariates of all image jobs."""
    group = model.readings[0]
    observations = group.observations
    in_camera = group.chain.until(Quantity.POINT_IN_CAMERA).predict(model.blocks, observations)
    lens, of = model.blocks[LENS], observations.index.get(LENS, np.zeros(1, dtype=np.intp))
    conditions, view = observations.conditions, observations.index["view"].astype(float)
    # Predicted image points: the readings would put their own noise into the covariates.
    off = group.chain.predict(model.blocks, observations) - lens.values[:, lens.mask(("cx", "cy"))][of].T
    order = covariate("order of the images", view)
    if ELAPSED in conditions:
        order = covariate("t_s", conditions[ELAPSED])
    orders = [replace(order, periodic=True)]
    if WARMING in conditions:
        orders.append(covariate("temp_degC", conditions[WARMING]))
    orders.append(covariate(PLACE, off))
    orders.append(covariate("image radius", np.hypot(*off)))
    orders.append(replace(covariate("image azimuth", np.arctan2(off[1], off[0])), angle=True))
    orders.append(covariate("distance from the camera", in_camera[2]))
    return orders


def place_of_target(model: Model) -> Covariate:
    """Return the place of the target of each reading in the target list."""
    places = model.blocks[TARGET].values[model.readings[0].observations.index[TARGET]]
    return covariate("place of the target", places.T)


def covariate(name: str, values: Array) -> Covariate:
    """Return a covariate of the image points."""
    return Covariate(name, {IMAGES: np.ascontiguousarray(values)})


def folds(unit: Index) -> Mapping[str, Index]:
    """Return the held-out part to which each reading belongs.

    `unit` is the image or the target of each reading. Units stay whole; parts are runs of about equally many units.
    """
    units, rank = np.unique(unit, return_inverse=True)
    # runs, not every tenth one: images in a row resemble each other, and would predict each other too well
    return {IMAGES: np.asarray(rank * min(FOLDS, len(units)) // len(units))}


def refit(datum: Datum | None, size: tuple[int, int] | None = None) -> Callable[[Model, Mapping[str, Mask]], Solution]:
    """Return a function that adjusts a model to the readings kept.

    Poses of images without a reading or a prior are held fixed. A model with more terms of the lens of images of a
    `size` is adjusted from a principal point in their middle, too: the better solution counts.
    """

    def adjusted(model: Model, keep: Mapping[str, Mask]) -> Solution:
        groups = model.kept(keep).groups
        indices = [group.observations.index for group in groups]
        blocks = {name: _without_the_unread(block, indices) for name, block in model.blocks.items()}

        def from_blocks(start: Mapping[str, Block]) -> Solution:
            return adjust(start.values(), groups, datum, _OF_TRIALS)

        near = from_blocks(blocks)
        if size is None or not any(extra.effect.link is None for extra in model.added):
            return near
        far = from_blocks(held_in_the_middle(blocks, size, lambda held: from_blocks(held).blocks))
        return min((near, far), key=lambda solution: (not solution.outcome.good, solution.cost))

    return adjusted


def _without_the_unread(block: Block, indices: Sequence[Mapping[str, Index]]) -> Block:
    """Return the block with members that neither images (first of the indices) nor priors read held fixed.

    Targets stay free, whatever reads them.
    """
    if block.name not in indices[0] or block.name == TARGET:
        return block
    read = np.concatenate([np.ravel(index[block.name]) for index in indices if block.name in index])
    return replace(block, free=block.free & np.isin(np.arange(len(block.members)), read)[:, None])


def named(covariates: Iterable[Covariate]) -> tuple[Covariate, ...]:
    """Return the covariates that are not constant over the readings."""
    return tuple(known for known in covariates if np.ptp(np.atleast_2d(known.values[IMAGES]), axis=1).max() > 0)
