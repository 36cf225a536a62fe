"""What `diagnose` needs of a camera calibration: model, covariates, held-out parts and the result that matters."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.adjusted_job import AdjustedJob, Delivered
from metrocli.effects.effect import Effect
from metrocli.effects.model import Model
from metrocli.geometry import poses
from metrocli.instruments import camera
from metrocli.tasks.calibrate_camera import KIND
from metrocli.tasks.calibrate_camera.effects import EFFECTS
from metrocli.tasks.calibrate_camera.problem import Problem
from metrocli.tasks.shared.images.adjustment import Adjusted
from metrocli.tasks.shared.images.covariates import at_solution, covariate, covariates, folds, named, refit


def adjusted_job(problem: Problem, adjusted: Adjusted) -> AdjustedJob:
    """Return an adjusted calibration as input of `diagnose`.

    Cross-validation holds out whole images; with rig cmm, where one pose serves all images, it holds out targets.
    """
    model = at_solution(problem.model, adjusted)
    index = model.readings[0].observations.index
    points = model.blocks[camera.TARGET].values[index[camera.TARGET]]
    found = [*covariates(model, _in_camera(problem.rig, model, points)), covariate("place of the target", points.T, 3)]
    cmm = problem.rig == "cmm"
    return AdjustedJob(
        KIND.name,
        model,
        EFFECTS,
        named(found),
        () if cmm else ("image",),
        folds(index[camera.TARGET if cmm else "view"]),
        _delivered(problem.rig, model),
        refit(problem.datum),
        ("px", "pixel"),
        fewest=2,
        single_components=True,
        sharing=len(np.unique(index["view"])),
        made_together=("image",),
    )


def _in_camera(rig: str, model: Model, points: Array) -> Array:
    """Return the coordinates of the target in the camera's frame at each reading, (3, n) mm."""
    views = model.blocks[camera.view_name(rig)].values
    at = views if rig == "cmm" else views[model.readings[0].observations.index["view"]]
    seen: Array = poses.apply(at if rig == "board" else poses.inverse(at), points)
    return np.ascontiguousarray(seen.T)


def _moved(model: Model) -> Callable[[Effect, Mapping[str, str]], Array | None]:
    """Return by how much an effect on the targets moves these themselves: one of them, or all about their middle."""
    block = model.blocks[camera.TARGET]

    def moved(effect: Effect, where: Mapping[str, str]) -> Array | None:
        if effect.name == "scale-of-targets":
            return np.asarray((block.values - block.values.mean(axis=0))[:, :, None])
        if effect.name != "moved-target":
            return None
        found = np.zeros((len(block.members), 3, 3))
        found[block.members.index(where["target"])] = np.eye(3)
        return found

    return moved


def _delivered(rig: str, model: Model) -> Delivered:
    """Return the result for which the calibration is run.

    Rig cmm: the place of the camera in the taper. Rig network: the points. Rig board: focal length and principal point.
    """
    if rig == "cmm":
        return Delivered("place of the camera", camera.TAPER, (0, 1, 2), "um", "length")
    if rig == "network":
        return Delivered("point coordinates", camera.TARGET, (0, 1, 2), "um", "length", moved=_moved(model))
    columns = model.blocks[camera.LENS].columns
    pixels = tuple(columns.index(name) for name in ("f", "fx", "fy", "cx", "cy") if name in columns)
    return Delivered("focal length and principal point", camera.LENS, pixels, "px", "pixel")
