"""What unknown effects on image points could vary with, and how image points are refitted and held out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np

from metrocli.adjust.adjustment import Control, adjust
from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.observations import Index, Mask
from metrocli.adjust.solution import Solution
from metrocli.diagnosis.adjusted_job import Covariate
from metrocli.effects.effect import ELAPSED, WARMING
from metrocli.effects.extension import with_conditions
from metrocli.effects.model import Model
from metrocli.instruments.camera import LENS, TARGET
from metrocli.tasks.shared.images.adjustment import IMAGES, Adjusted

FOLDS = 10


def at_solution(model: Model, adjusted: Adjusted) -> Model:
    """Return a model of image points at its adjustment, with the readings that were used and conditions in them."""
    groups = tuple(adjusted.group if group.name == IMAGES else group for group in model.groups)
    return with_conditions(replace(model, blocks=adjusted.solution.blocks, groups=groups))


def covariates(model: Model, in_camera: Array) -> list[Covariate]:
    """Return what image points could vary with; `in_camera` (3, n) are the targets as the camera has them."""
    group = model.readings[0]
    observations = group.observations
    lens = model.blocks[LENS].named()
    conditions, view = observations.conditions, observations.index["view"].astype(float)
    # where the model puts the points: the readings themselves would bring their noise along
    off = group.chain.predict(model.blocks, observations) - np.array([[lens["cx"]], [lens["cy"]]])
    order = covariate("order of the images", view, 5)
    if ELAPSED in conditions:
        order = covariate("t_s", conditions[ELAPSED], 5)
    found = [replace(order, periodic=True)]
    if WARMING in conditions:
        found.append(covariate("temp_degC", conditions[WARMING], 5))
    found.append(covariate("place in the image", off, 5))
    found.append(covariate("image radius", np.hypot(*off), 5))
    found.append(replace(covariate("image azimuth", np.arctan2(off[1], off[0]), 8), angle=True))
    found.append(covariate("distance from the camera", in_camera[2], 4))
    return found


def covariate(name: str, values: Array, degree: int) -> Covariate:
    """Return a covariate of the image points."""
    return Covariate(name, {IMAGES: np.ascontiguousarray(values)}, degree)


def folds(unit: Index) -> Mapping[str, Index]:
    """Return parts of about equally many units (images, targets), as they come in order."""
    units = np.unique(unit)
    rank = np.zeros(int(unit.max()) + 1, dtype=np.intp)
    rank[units] = np.arange(len(units))
    return {IMAGES: np.asarray(rank[unit] * min(FOLDS, len(units)) // len(units))}


def refit(datum: Datum | None) -> Callable[[Model, Mapping[str, Mask]], Solution]:
    """Return what adjusts a model to some of its readings; what no reading is left of stays where it is."""

    def adjusted(model: Model, keep: Mapping[str, Mask]) -> Solution:
        groups = [group.selected(keep[group.name]) if group.name in keep else group for group in model.groups]
        blocks = [_without_the_unread(block, groups[0].observations.index) for block in model.blocks.values()]
        return adjust(blocks, groups, datum, Control())

    return adjusted


def _without_the_unread(block: Block, index: Mapping[str, Index]) -> Block:
    """Return a block whose members without a reading are not free; targets with a prior need none."""
    if block.name not in index or block.name == TARGET:
        return block
    read = np.bincount(index[block.name], minlength=len(block.members)) > 0
    return replace(block, free=block.free & read[:, None])


def named(covariates: Iterable[Covariate]) -> tuple[Covariate, ...]:
    """Return the covariates that differ between readings."""
    return tuple(one for one in covariates if np.ptp(np.atleast_2d(one.values[IMAGES]), axis=1).max() > 0)
