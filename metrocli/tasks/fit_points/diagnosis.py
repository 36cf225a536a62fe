"""A best fit in the form that diagnosis needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.solution import Solution
from metrocli.arrays import Mask
from metrocli.diagnosis.adjusted_job import AdjustedJob, Delivered
from metrocli.effects.covariates import Covariate
from metrocli.effects.extension import with_conditions
from metrocli.effects.model import Model
from metrocli.tasks.fit_points import KIND
from metrocli.tasks.fit_points.effects import EFFECTS, EXPANSION, SCALE
from metrocli.tasks.fit_points.problem import POINT, POSE
from metrocli.tasks.shared.diagnosed import FOLDS


def adjusted_job(model: Model) -> AdjustedJob:
    """Return a best fit at its solution in the form that diagnosis needs; points are held out whole."""
    ready = with_conditions(model)
    return AdjustedJob(
        KIND.name,
        ready,
        EFFECTS,
        covariates(ready),
        (),
        {group.name: group.observations.index[POINT] % FOLDS for group in ready.readings},
        Delivered("shift of the transformation", POSE, (0, 1, 2), "um", "length"),
        refitted,
        not_sought={EXPANSION: "`scale: true` estimates it"} if model.blocks[SCALE].free.any() else {},
    )


def covariates(model: Model) -> tuple[Covariate, ...]:
    """Return the place in the measured list, with which an unknown effect could vary."""
    at = model.blocks[POINT].values
    places = {group.name: np.ascontiguousarray(at[group.observations.index[POINT]].T) for group in model.readings}
    return (Covariate("place of the point", places),)


def refitted(model: Model, keep: Mapping[str, Mask]) -> Solution:
    """Return the adjustment of a model to some of the readings of each group; points that no group reads stay fixed."""
    groups = model.kept(keep).groups
    return adjust([_read(block, groups) for block in model.blocks.values()], groups, model.datum)


def _read(block: Block, groups: Sequence[Group]) -> Block:
    """Return the block of points without freedom of those that no reading needs; any other block as it is."""
    if block.name != POINT:
        return block
    index = [group.observations.index for group in groups]
    used = np.concatenate([np.ravel(each[POINT]) for each in index if POINT in each])
    return replace(block, free=block.free & np.isin(np.arange(len(block.members)), used)[:, None])
