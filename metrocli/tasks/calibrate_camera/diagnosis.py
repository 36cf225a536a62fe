"""A calibration as diagnosis sees it."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.adjusted_job import AdjustedJob, Delivered
from metrocli.effects.model import Model
from metrocli.geometry import poses
from metrocli.instruments import camera
from metrocli.tasks.calibrate_camera import KIND
from metrocli.tasks.calibrate_camera.effects import EFFECTS
from metrocli.tasks.calibrate_camera.problem import Problem
from metrocli.tasks.shared.images.adjustment import Adjusted
from metrocli.tasks.shared.images.covariates import at_solution, covariate, covariates, folds, named, refit


def adjusted_job(problem: Problem, adjusted: Adjusted) -> AdjustedJob:
    """Return the job of an adjusted calibration; views are held out, with rig cmm the targets."""
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
    )


def _in_camera(rig: str, model: Model, points: Array) -> Array:
    """Return the targets in the camera at each reading, (3, n)."""
    views = model.blocks[camera.view_name(rig)].values
    at = views if rig == "cmm" else views[model.readings[0].observations.index["view"]]
    seen: Array = poses.apply(at if rig == "board" else poses.inverse(at), points)
    return np.ascontiguousarray(seen.T)


def _delivered(rig: str, model: Model) -> Delivered:
    """Return the place of the camera in the taper for rig cmm, else focal length and principal point."""
    if rig == "cmm":
        return Delivered("place of the camera", camera.TAPER, (0, 1, 2), "um", "length")
    if rig == "network":
        return Delivered("point coordinates", camera.TARGET, (0, 1, 2), "um", "length")
    columns = model.blocks[camera.LENS].columns
    pixels = tuple(columns.index(name) for name in ("f", "fx", "fy", "cx", "cy") if name in columns)
    return Delivered("focal length and principal point", camera.LENS, pixels, "px", "pixel")
