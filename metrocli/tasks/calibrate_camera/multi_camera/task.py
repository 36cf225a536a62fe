"""calibrate-camera with `cameras:`: run, check and diagnose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from metrocli.adjust.clusters.robust import FROM_RESIDUALS, STRUCTURED, must_suffice
from metrocli.adjust.outcome import Outcome
from metrocli.diagnosis.adjusted_job import AdjustedJob, Delivered
from metrocli.effects.estimates import absorbed_in_words
from metrocli.errors import InputError, UndeterminedError
from metrocli.imageset import ImageSet
from metrocli.instruments import camera
from metrocli.result import Result
from metrocli.tasks.calibrate_camera import KIND
from metrocli.tasks.calibrate_camera.advice import in_words
from metrocli.tasks.calibrate_camera.effects import EFFECTS
from metrocli.tasks.calibrate_camera.multi_camera.alone import fisheyes
from metrocli.tasks.calibrate_camera.multi_camera.report import delivered, report
from metrocli.tasks.calibrate_camera.multi_camera.system import CameraSystem, calibrated_alone, system_of
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.calibrate_camera.readings import sighted_in
from metrocli.tasks.calibrate_camera.settings import Files, OneOfSeveral, Settings
from metrocli.tasks.job import Job
from metrocli.tasks.shared.images.adjustment import AdjustedImages, Options, adjust_images, must_converge
from metrocli.tasks.shared.images.covariates import (
    at_solution,
    covariate,
    folds,
    named,
    place_of_target,
    refit,
    with_all_readings,
)
from metrocli.tasks.shared.images.exposures import exposures


def run(job: Job[Settings, Files], cameras: Mapping[str, OneOfSeveral]) -> Result:
    """Calibrate several cameras together; raises as the calibration of one."""
    system = prepared(job, cameras)
    adjusted = _solved(job.settings, system)
    if job.settings.noise == STRUCTURED:
        adjusted = adjusted.with_structure(delivered(system))
    return report(system, adjusted, job)


def diagnosed(job: Job[Settings, Files], cameras: Mapping[str, OneOfSeveral]) -> AdjustedJob:
    """Return the adjusted cameras for `diagnose`, with all their readings; raises as `run`."""
    system, settings = prepared(job, cameras), job.settings
    adjusted = with_all_readings(settings.outliers, lambda how: _solved(replace(settings, outliers=how), system))
    return adjusted_job(system, adjusted)


def prepared(job: Job[Settings, Files], cameras: Mapping[str, OneOfSeveral]) -> CameraSystem:
    """Return the adjustment of all cameras with starting values and effects."""
    settings, files, cameras = job.settings, job.files, _with_sizes(job, cameras)
    return system_of(settings, cameras, sighted_in(settings, files), files.scale_bars).with_effects(job.effects)


def alone(job: Job[Settings, Files], cameras: Mapping[str, OneOfSeveral]) -> dict[str, CameraProblem]:
    """Return the calibration of each camera by its own readings, which others do not contradict."""
    return calibrated_alone(job.settings, _with_sizes(job, cameras), sighted_in(job.settings, job.files))


def _with_sizes(job: Job[Settings, Files], cameras: Mapping[str, OneOfSeveral]) -> Mapping[str, OneOfSeveral]:
    return cameras if job.files.images is None else sized(cameras, job.files.images)


def sized(cameras: Mapping[str, OneOfSeveral], images: ImageSet) -> dict[str, OneOfSeveral]:
    """Return the cameras with the size of their images.

    Raises InputError for images of one camera with different sizes, or of another size than the job states.
    """
    exposed = exposures({name: several.images for name, several in cameras.items()}, images.names)
    with_size = {}
    for number, (name, several) in enumerate(cameras.items()):
        own = [image for image, camera in zip(images.names, exposed.camera, strict=True) if camera == number]
        size = images.size_of(own) if own else several.image_size
        if size is not None and tuple(several.image_size or size) != tuple(size):
            width, height = several.image_size or size
            raise InputError(
                f"the images are {size[0]} x {size[1]} px, but cameras: {name}: image_size is {width} x {height} px"
            )
        with_size[name] = replace(several, image_size=size)
    return with_size


def _solved(settings: Settings, system: CameraSystem) -> AdjustedImages:
    """Adjust all cameras; raises UndeterminedError or NotConvergedError if there is no good solution."""
    if settings.noise == STRUCTURED:
        must_suffice(len(system.exposed.names), "images")
    remove, estimate_noise = settings.outliers == "remove", settings.noise in FROM_RESIDUALS
    adjusted = adjust_images(
        system.blocks, system.images, system.others, system.datum, Options(remove, estimate_noise, system.largest_size)
    )
    solution = adjusted.solution
    if solution.undetermined or solution.outcome is Outcome.TOO_FEW:
        lines = [f"{solution.outcome.value}: {solution.observations} readings, {solution.unknowns} unknowns"]
        lines += [f"  undetermined: {in_words(str(combination))}" for combination in solution.undetermined[:3]]
        lines += absorbed_in_words(system.effects, solution, system.datum) or [
            "  what would determine it: more exposures of the board by all cameras, tilted by 20 to 45 degrees, near "
            "and far, or fewer parameters in `estimate`"
        ]
        raise UndeterminedError("\n".join(lines), solution.misfit)
    must_converge(solution, () if solution.outcome.good else fisheyes(system, settings, solution))
    return adjusted


_OF_TARGETS = ("stretched-targets", "target-plane-bend", "moved-target", "scale-of-targets")
_OF_ONE = "it is sought in the images of one camera: diagnose a job of that camera alone"


def adjusted_job(system: CameraSystem, adjusted: AdjustedImages) -> AdjustedJob:
    """Return adjusted cameras as input of `diagnose`; cross-validation holds out whole exposures."""
    model = at_solution(system.model, adjusted)
    index = model.readings[0].observations.index
    order = covariate("order of the images", index["view"].astype(float))
    return AdjustedJob(
        KIND.name,
        model,
        EFFECTS,
        named([order, place_of_target(model)]),
        ("image",),
        folds(index["view"]),
        Delivered("places of the cameras", camera.MOUNT, (0, 1, 2), "um", "length"),
        refit(system.datum),
        noisier=("camera",),
        left_out=len(adjusted.rejected),
        fewest=2,
        single_components=True,
        sharing=len(np.unique(index["view"])),
        made_together=("image",),
        not_sought={effect.name: _OF_ONE for effect in EFFECTS if effect.name not in _OF_TARGETS},
    )
