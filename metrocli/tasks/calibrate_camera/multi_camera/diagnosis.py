"""What `diagnose` needs of several cameras: the effects on the board, which all cameras see alike."""

from __future__ import annotations

import numpy as np

from metrocli.diagnosis.adjusted_job import AdjustedJob, Delivered
from metrocli.instruments import camera
from metrocli.tasks.calibrate_camera import KIND
from metrocli.tasks.calibrate_camera.effects import EFFECTS
from metrocli.tasks.calibrate_camera.multi_camera.system import CameraSystem
from metrocli.tasks.shared.images.adjustment import AdjustedImages
from metrocli.tasks.shared.images.covariates import at_solution, covariate, folds, named, place_of_target, refit

_OF_TARGETS = ("stretched-targets", "target-plane-bend", "moved-target", "scale-of-targets")
_OF_ONE = "it is sought in the images of one camera: diagnose a job of that camera alone"


def adjusted_job(system: CameraSystem, adjusted: AdjustedImages) -> AdjustedJob:
    """Return adjusted cameras as input of `diagnose`; cross-validation holds out whole exposures."""
    model = at_solution(system.model, adjusted)
    index = model.readings[0].observations.index
    order = covariate("order of the images", index["view"].astype(float), 5)
    return AdjustedJob(
        KIND.name,
        model,
        EFFECTS,
        named([order, place_of_target(model, 3)]),
        ("image",),
        folds(index["view"]),
        Delivered("places of the cameras", camera.MOUNT, (0, 1, 2), "um", "length"),
        refit(system.datum),
        fewest=2,
        single_components=True,
        sharing=len(np.unique(index["view"])),
        made_together=("image",),
        not_sought={effect.name: _OF_ONE for effect in EFFECTS if effect.name not in _OF_TARGETS},
    )
