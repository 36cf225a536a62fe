"""What `diagnose` needs of an alignment: model, covariates, held-out images and the result that matters."""

from __future__ import annotations

import numpy as np

from metrocli.diagnosis.adjusted_job import AdjustedJob, Delivered
from metrocli.geometry import poses
from metrocli.instruments import spindle_camera as spindle
from metrocli.instruments.camera import TAPER, TARGET
from metrocli.tasks.align_part import KIND
from metrocli.tasks.align_part.effects import EFFECTS
from metrocli.tasks.align_part.problem import Problem
from metrocli.tasks.shared.images.adjustment import Adjusted
from metrocli.tasks.shared.images.covariates import at_solution, covariate, covariates, folds, named, refit


def adjusted_job(problem: Problem, adjusted: Adjusted) -> AdjustedJob:
    """Return an adjusted alignment as input of `diagnose`; cross-validation holds out whole images."""
    model = at_solution(problem.model, adjusted)
    index, blocks = model.readings[0].observations.index, model.blocks
    points = blocks[TARGET].values[index[TARGET]]
    held = blocks[spindle.SPINDLE].values
    angle = float(blocks[spindle.COUPLING].values[0, 0])
    into = spindle.part_in_camera(blocks[spindle.PART].values[0], held, angle, blocks[TAPER].values[0])
    in_camera = poses.apply(into[index["view"]], points).T
    turn = poses.rotation_of(held)[index["view"]]
    about = np.arctan2(turn[:, 1, 0], turn[:, 0, 0])
    found = [
        *covariates(model, in_camera),
        covariate("place of the target", points.T, 2),
        covariate("place of the spindle", held[index["view"], :3].T, 2),
        covariate("turn of the spindle", np.stack([np.cos(about), np.sin(about)]), 2),
    ]
    return AdjustedJob(
        KIND.name,
        model,
        EFFECTS,
        named(found),
        ("image", "target"),
        folds(index["view"]),
        Delivered("place of the part", spindle.PART, (0, 1, 2), "um", "length"),
        refit(problem.datum),
        ("px", "pixel"),
        fewest=2,
        single_components=True,
        sharing=len(np.unique(index["view"])),
        made_together=("image",),
    )
