"""What `diagnose` needs of an alignment, and the errors that no residual of it can show."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli import units
from metrocli.adjust.model.quantities import Quantity
from metrocli.diagnosis.adjusted_job import AdjustedJob, Delivered
from metrocli.effects.covariates import Covariate
from metrocli.effects.model import Model
from metrocli.geometry import poses
from metrocli.instruments import spindle_camera as spindle
from metrocli.instruments.camera import LENS
from metrocli.table import Table
from metrocli.tasks.align_part import KIND
from metrocli.tasks.align_part.effects import EFFECTS
from metrocli.tasks.align_part.problem import AlignmentProblem
from metrocli.tasks.align_part.settings import Files
from metrocli.tasks.shared.images.adjustment import AdjustedImages
from metrocli.tasks.shared.images.covariates import (
    at_solution,
    covariate,
    covariates,
    folds,
    named,
    place_of_target,
    refit,
)
from metrocli.tasks.shared.images.eccentricity import diameters
from metrocli.tasks.shared.uncontrolled import SCALE, SCALE_WORDS, Hidden, table_of

_OF_ONE_CAMERA = ("focal-change", "principal-point-shift", "radial-distortion", "rolling-shutter")
_OF_OTHERS = "it is sought in the images of one camera: leave out those of the others"


def adjusted_job(problem: AlignmentProblem, adjusted: AdjustedImages) -> AdjustedJob:
    """Return an adjusted alignment as input of `diagnose`; cross-validation holds out whole images."""
    model = at_solution(problem.model, adjusted)
    index = model.readings[0].observations.index
    return AdjustedJob(
        KIND.name,
        model,
        EFFECTS,
        named(all_covariates(model)),
        ("image", "target"),
        folds(index["view"]),
        Delivered("place of the part", spindle.PART, (0, 1, 2), "um", "length"),
        refit(problem.datum),
        noisier=tuple(kind for kind in ("camera",) if kind in model.places),
        left_out=len(adjusted.rejected),
        fewest=2,
        single_components=True,
        sharing=len(np.unique(index["view"])),
        made_together=("image",),
        not_sought=dict.fromkeys(_OF_ONE_CAMERA, _OF_OTHERS) if len(np.unique(index.get(LENS, 0))) > 1 else {},
    )


def all_covariates(model: Model) -> list[Covariate]:
    """Return the covariates of the image points of an alignment."""
    index = model.readings[0].observations.index
    spindle_poses = model.blocks[spindle.SPINDLE].values
    rotations = poses.rotation_of(spindle_poses)[index["view"]]
    # the spindle turns about its own axis, z
    angle = np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0])
    return [
        *covariates(model),
        place_of_target(model),
        covariate("place of the spindle", spindle_poses[index["view"], :3].T),
        # as cosine and sine, which do not jump after a whole turn
        covariate("turn of the spindle", np.stack([np.cos(angle), np.sin(angle)])),
    ]


_SEAT, _SEAT_WORDS = units.parse_quantity("5 um", "length"), "5 um"
"""How far the camera may sit along the spindle from where it was calibrated, assumed"""
_LIST_ERROR, _LIST_ERROR_WORDS = units.parse_quantity("1 mm", "length"), "1 mm"
"""Error of a listed place, assumed"""


def uncontrolled(problem: AlignmentProblem, adjusted: AdjustedImages, files: Files) -> Table:
    """Return what the pose of the part absorbs or no reading uses, and the error from a plausible size of each."""
    return table_of((*_absorbed(problem, adjusted), *_of_lists(adjusted, files)))


def _of_lists(adjusted: AdjustedImages, files: Files) -> Iterator[Hidden]:
    """Yield lists that only the predictions of a result use."""
    if files.supports is not None:
        upright = poses.rotation_of(adjusted.solution.blocks[spindle.PART].values[0])[2, 2]
        yield Hidden(
            "listed places of the supports, such as exchanged columns (how far to raise each)",
            _LIST_ERROR_WORDS,
            _LIST_ERROR * float(np.sqrt(max(1 - upright**2, 0.0))),
            "the part measured again after the supports are raised",
        )
    if files.points is not None:
        yield Hidden(
            "listed places of `points`, such as exchanged columns (where they are predicted)",
            _LIST_ERROR_WORDS,
            _LIST_ERROR,
            "`metrocli verify` with these points as the machine's probe measures them",
        )


def _absorbed(problem: AlignmentProblem, adjusted: AdjustedImages) -> Iterator[Hidden]:
    """Yield what the pose of the part absorbs."""
    blocks, group = adjusted.solution.blocks, adjusted.group
    spindle_places = blocks[spindle.SPINDLE].values[np.unique(group.observations.index[spindle.SPINDLE]), :3]
    extent = float(np.linalg.norm(np.ptp(spindle_places, axis=0)))
    yield Hidden(
        "common scale of the machine and of the target list (places of points)",
        SCALE_WORDS,
        SCALE * extent,
        "temperature of machine and part; calibrated lengths on both",
    )
    yield Hidden(
        "seat of the camera along the spindle (the part along the view)",
        _SEAT_WORDS,
        _SEAT,
        "a target of known place in the machine",
    )
    if not blocks[LENS].free.any():
        lens = blocks[LENS].named(blocks[LENS].members[0])
        depth = group.chain.until(Quantity.POINT_IN_CAMERA).predict(blocks, group.observations)[2]
        yield Hidden(
            "cx and cy of the camera file, taken as exact, or its image_size (the part across the view)",
            "1 px",
            # a lens of square pixels has f, others have fx and fy
            float(np.median(depth)) / lens.get("f", lens.get("fx", np.inf)),
            "a calibration result as camera, with its covariance; the spindle turned between images",
        )
    if problem.sighted.eccentric:
        yield from diameters(group, blocks, problem.sighted.targets.radius)
