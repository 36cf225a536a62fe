"""What `diagnose` needs of a camera calibration, and the errors that no residual of it can show."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from metrocli import units
from metrocli.arrays import Array
from metrocli.diagnosis.adjusted_job import AdjustedJob, Delivered
from metrocli.effects.covariates import Covariate
from metrocli.effects.effect import Effect
from metrocli.effects.model import Model
from metrocli.instruments import camera
from metrocli.instruments.camera import TARGET
from metrocli.table import Table
from metrocli.tasks.calibrate_camera import KIND
from metrocli.tasks.calibrate_camera.doubts import PrincipalPoint
from metrocli.tasks.calibrate_camera.effects import EFFECTS
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.calibrate_camera.settings import CameraSettings
from metrocli.tasks.calibrate_camera.shape.effect import LENS_SHAPE, lens_shape
from metrocli.tasks.shared.images.adjustment import AdjustedImages
from metrocli.tasks.shared.images.covariates import PLACE, at_solution, covariates, folds, named, place_of_target, refit
from metrocli.tasks.shared.images.eccentricity import diameters
from metrocli.tasks.shared.uncontrolled import SCALE, SCALE_WORDS, Hidden, table_of


def adjusted_job(problem: CameraProblem, adjusted: AdjustedImages) -> AdjustedJob:
    """Return an adjusted calibration as input of `diagnose`.

    Cross-validation holds out whole images; with rig cmm, where one pose serves all images, it holds out targets.
    """
    model = at_solution(problem.model, adjusted)
    index = model.readings[0].observations.index
    cmm = problem.rig == "cmm"
    return AdjustedJob(
        KIND.name,
        model,
        tuple(lens_shape(problem.with_model(model)) if effect is LENS_SHAPE else effect for effect in EFFECTS),
        named(all_covariates(model)),
        () if cmm else ("image",),
        folds(index[camera.TARGET if cmm else "view"]),
        _delivered(problem.rig, model),
        refit(problem.datum, problem.image_size),
        left_out=len(adjusted.rejected),
        fewest=3,
        single_components=True,
        sharing=len(np.unique(index["view"])),
        made_together=("image",),
    )


def all_covariates(model: Model) -> list[Covariate]:
    """Return the covariates of the image points of a calibration."""
    # what all images share over the image is the shape of the lens
    known = (replace(covariate, of_units=covariate.name == PLACE) for covariate in covariates(model))
    return [*known, place_of_target(model)]


def _moved(model: Model) -> Callable[[Effect, Mapping[str, str]], Array | None]:
    """Return by how much an effect on the targets moves these themselves: one of them, or all about their middle."""
    block = model.blocks[camera.TARGET]

    def moved(effect: Effect, where: Mapping[str, str]) -> Array | None:
        if effect.name == "scale-of-targets":
            return np.asarray((block.values - block.values.mean(axis=0))[:, :, None])
        if effect.name != "moved-target":
            return None
        changes = np.zeros((len(block.members), 3, 3))
        changes[block.members.index(where["target"])] = np.eye(3)
        return changes

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


PITCH = units.parse_quantity("0.1 percent", "ratio")
_CENTRE = units.parse_quantity("10 percent", "ratio")
_PIXEL = units.parse_quantity("0.1 percent", "ratio")


def uncontrolled(
    problem: CameraProblem, settings: CameraSettings, adjusted: AdjustedImages, centre: PrincipalPoint | None
) -> Table:
    """Return the settings that enter the result without a residual, and the error from a plausible mistake in each."""
    return table_of(_rows(problem, settings, adjusted, centre))


def _rows(
    problem: CameraProblem, settings: CameraSettings, adjusted: AdjustedImages, centre: PrincipalPoint | None
) -> Iterator[Hidden]:
    blocks = adjusted.solution.blocks
    lens = blocks[camera.LENS].named()
    seen = blocks[TARGET].values[np.unique(adjusted.group.observations.index[TARGET])]
    place = blocks[camera.view_name(problem.rig)].values[:, :3]
    if problem.rig == "board":
        yield Hidden(
            "pitch, or scale of the target list (distances of the board; the lens does not depend on it)",
            "0.1 %",
            PITCH * float(np.median(np.linalg.norm(place, axis=1))),
            "the board measured over its whole length",
        )
    else:
        yield Hidden(
            "common scale of the targets (distance of the camera from them)",
            SCALE_WORDS,
            SCALE * float(np.linalg.norm(place - seen.mean(axis=0), axis=1).max()),
            "temperature and calibration of what placed the targets, or of the scale bars",
        )
    focal = float(lens.get("f", lens.get("fx", 0.0)))
    off = centre.allowed if centre is not None else _CENTRE * np.array(problem.image_size)
    if off.any():
        distance = float(np.median(np.linalg.norm(place - seen.mean(axis=0), axis=1)))
        yield Hidden(
            "image_size, whose middle is the principal point, or held cx and cy (places of the camera across its view)",
            "what the readings do not exclude" if centre is not None else "10 % of the image size",
            float(np.linalg.norm(off)) / focal * distance,
            "cx and cy among `estimate`, with views that are tilted and turned",
        )
    if settings.pixel_size is not None:
        yield Hidden(
            "pixel_size (the lens in mm; in px it does not depend on it)",
            "0.1 %",
            _PIXEL * focal * settings.pixel_size,
            "the data sheet of the sensor",
        )
    if problem.sighted.eccentric:
        yield from diameters(adjusted.group, blocks, problem.sighted.targets.radius)
