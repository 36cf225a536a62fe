"""The task calibrate-camera: run, diagnose, simulate and compare."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from metrocli.adjust.clusters.robust import FROM_RESIDUALS, STRUCTURED, must_suffice
from metrocli.adjust.outcome import Outcome
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.corrections import Mistake
from metrocli.diagnosis.trials import FAILURES
from metrocli.errors import InputError, UndeterminedError, UsageError
from metrocli.imageset import ImageSet
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.calibrate_camera import other_lenses
from metrocli.tasks.calibrate_camera.advice import explained, ran_out
from metrocli.tasks.calibrate_camera.build import build, robustly_started
from metrocli.tasks.calibrate_camera.compare import compare_models
from metrocli.tasks.calibrate_camera.diagnosis import adjusted_job, all_covariates
from metrocli.tasks.calibrate_camera.effects import EFFECTS, PLACES
from metrocli.tasks.calibrate_camera.multi_camera import task as multi_camera
from metrocli.tasks.calibrate_camera.multi_camera.paired import as_several
from metrocli.tasks.calibrate_camera.other_lenses import fisheye_instead, other_models
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.calibrate_camera.readings import sighted_in
from metrocli.tasks.calibrate_camera.report import report
from metrocli.tasks.calibrate_camera.settings import CameraSettings, Files, Settings
from metrocli.tasks.calibrate_camera.shape.effect import beside_base
from metrocli.tasks.calibrate_camera.shape.spline import with_shape
from metrocli.tasks.calibrate_camera.simulation import simulate
from metrocli.tasks.calibrate_camera.starts import about_the_middle
from metrocli.tasks.calibrate_camera.wrong_images import turned
from metrocli.tasks.calibrate_camera.wrong_images.strange import not_found, strange_images
from metrocli.tasks.job import Job, Task
from metrocli.tasks.shared.images.adjustment import (
    AdjustedImages,
    Options,
    adjust_images,
    must_converge,
)
from metrocli.tasks.shared.images.camera_parameters import delivered
from metrocli.tasks.shared.images.covariates import with_all_readings
from metrocli.tasks.shared.images.lost import apart_from_others
from metrocli.tasks.shared.images.places import not_sought
from metrocli.tasks.shared.images.settings import SPLINE
from metrocli.tasks.shared.images.tables import root_mean_square
from metrocli.tasks.shared.images.wrong_names import wrong_names
from metrocli.words import listed

_Other = tuple[Mistake, Job[Settings, Files]]
"""What may be wrong, and the job that is right then"""


def run(job: Job[Settings, Files]) -> Result:
    """Calibrate the camera of a job.

    Raises InputError if the files do not fit together, UndeterminedError if the readings do not determine the
    parameters, and NotConvergedError if the adjustment does not converge.
    """
    return with_adjustment(job)[0]


def with_adjustment(job: Job[Settings, Files]) -> tuple[Result, Callable[[], AdjustedJob] | None]:
    """Return the result, and where images show the board from behind what adjusts the job for a comparison."""
    if job.settings.cameras is not None:
        return multi_camera.run(job, job.settings.cameras), None
    settings, problem = prepared(job)
    adjusted = solved(settings, problem)
    if settings.noise == STRUCTURED:
        adjusted = adjusted.with_structure(delivered(problem.rig, problem.effects))
    result = report(problem, settings, adjusted, job.files.test_lengths)
    return result, partial(diagnosed, job) if turned.behind(problem) else None


def diagnosed(job: Job[Settings, Files]) -> AdjustedJob:
    """Return the adjusted job for `diagnose`, with all its readings, outliers included; raises as `run` does."""
    if job.settings.cameras is not None:
        return multi_camera.diagnosed(job, job.settings.cameras)
    settings, problem = prepared(job)
    adjusted = with_all_readings(settings.outliers, lambda how: solved(replace(settings, outliers=how), problem))
    whole = adjusted_job(problem, adjusted)
    lost = not_found(problem, adjusted.group, adjusted.group.residuals(adjusted.solution.blocks))
    noticed = (*turned.seen_from_behind(problem), *lost)
    return replace(whole, not_sought=not_sought(settings.shutter, whole.model), noticed=noticed)


def other_settings(job: Job[Settings, Files], fits: bool) -> Iterator[_Other]:
    """Yield cameras in place of one whose images pair, mirrored images, wrong names, a fisheye for a pinhole.

    The model is compared with the readings where no declared noise fits.
    """
    settings = job.settings
    each: list[CameraSettings] = [settings.camera] if settings.cameras is None else [*settings.cameras.values()]
    known = fits and isinstance(settings.noise, float)
    if settings.cameras is None:
        yield from as_several(job)
    elif known:
        return
    try:
        problems = {"": prepared(job)[1]} if settings.cameras is None else multi_camera.alone(job, settings.cameras)
    except FAILURES:
        # what fails before an adjustment is not in the settings: corrections of its files are tried
        return
    if settings.cameras is None:
        yield from turned.other_settings(job, problems[""])
    if (table := job.files.observations) is not None:
        for mistake, right in wrong_names([(alone.images, alone.blocks) for alone in problems.values()], table):
            yield mistake, job.with_files(observations=right)
    if known or not any(camera.convention == "forward" and camera.model != SPLINE for camera in each):
        return
    if settings.cameras is None:
        yield from other_lenses.other_settings(job, problems[""])
    else:
        pinholes = {name: problem for name, problem in problems.items() if settings.cameras[name].model != SPLINE}
        yield from other_lenses.other_settings_of_several(job, pinholes)


def compare(job: Job[Settings, Files]) -> Table:
    """Return a row for each lens model, from pinhole to rational with thin prism, and for fisheyes."""
    plain = replace(job.settings, camera=replace(job.settings.camera, model=job.settings.camera.formula, base="opencv"))
    settings, problem = prepared(replace(job, settings=plain, effects=()))
    return compare_models([problem, *other_models(problem, settings.camera)])


def prepared(job: Job[Settings, Files]) -> tuple[Settings, CameraProblem]:
    """Return the settings completed by the size of the images, and the adjustment with starting values and effects."""
    settings, files = job.settings, job.files
    if settings.cameras is not None:
        names = " and ".join(settings.cameras)
        raise UsageError(f"this is for a single camera: give a job of its own to each of {names}, with `camera:`")
    images = files.images
    if images is not None:
        _must_have_size(images, settings)
        settings = replace(settings, camera=replace(settings.camera, image_size=images.size))
    problem = build(settings.rig, settings.camera, sighted_in(settings, files), files.scale_bars)
    if settings.camera.model == SPLINE:
        problem = with_shape(problem, settings.noise not in FROM_RESIDUALS)
    return settings, about_the_middle(problem.with_effects(beside_base(problem, job.effects)))


def _must_have_size(images: ImageSet, settings: Settings) -> None:
    declared, size = settings.camera.image_size or images.size, images.size
    if tuple(declared) != tuple(size):
        raise InputError(
            f"the images are {size[0]} x {size[1]} px, but camera: image_size is {declared[0]} x {declared[1]} px"
        )


def check(job: Job[Settings, Files]) -> None:
    """Raise InputError for what shows without a look into the images, and without images for all that shows."""
    if job.files.images is None and job.settings.cameras is not None:
        multi_camera.prepared(job, job.settings.cameras)
    elif job.files.images is None:
        prepared(job)
    elif job.settings.cameras is not None:
        multi_camera.sized(job.settings.cameras, job.files.images)
    else:
        _must_have_size(job.files.images, job.settings)


def solved(settings: Settings, problem: CameraProblem) -> AdjustedImages:
    """Adjust a problem; raises UndeterminedError or NotConvergedError if it has no good solution."""
    if settings.noise == STRUCTURED:
        must_suffice(len(problem.sighted.images), "images")
    remove, estimate_noise = settings.outliers == "remove", settings.noise in FROM_RESIDUALS
    options = Options(remove, estimate_noise, problem.image_size, robustly_started(problem, settings.camera))

    def strange() -> list[str]:
        return strange_images(problem, problem.images) or _strange_beside_others(problem, options)

    try:
        adjusted = adjust_images(problem.blocks, problem.images, problem.others, problem.datum, options)
    except InputError as error:
        if images := strange_images(problem, problem.images):
            raise InputError(f"the readings fit no pose: {'; '.join(images)}") from error
        raise
    solution = adjusted.solution
    if solution.undetermined or solution.outcome is Outcome.TOO_FEW or ran_out(problem, solution):
        raise UndeterminedError(explained(problem, solution, adjusted.rejected, strange()), solution.misfit)
    if not solution.outcome.good:
        off = root_mean_square(problem.images.residuals({**problem.blocks, **solution.blocks}))
        other = fisheye_instead(problem, settings.camera, off)
        must_converge(solution, (*other, *strange()))
    return adjusted


def _strange_beside_others(problem: CameraProblem, options: Options) -> list[str]:
    """Return which images most points have to be left out of, so that the others fit, or else which points."""
    if options.remove_outliers:
        return []
    try:
        rest = adjust_images(
            problem.blocks, problem.images, problem.others, problem.datum, replace(options, remove_outliers=True)
        )
    except InputError:
        return []
    if not rest.solution.outcome.good or not len(rest.rejected):
        return []
    images = apart_from_others(problem.images, rest.group, rest.rejected)
    worst = np.argsort(-np.nan_to_num(rest.rejected.numbers("w")), kind="stable")
    where = (rest.rejected.texts(key) for key in ("image", "target"))
    names = images or np.array(list(map("/".join, zip(*where, strict=True))))[worst].tolist()
    points = f"the points of {listed(names)} do" if images else f"the points {listed(names)} do"
    return [f"{points} not fit those of the other images, which fit each other; check the names of their targets"]


TASK = Task(
    Files,
    run,
    check,
    simulate=simulate,
    diagnosed=diagnosed,
    effects=EFFECTS,
    places=PLACES,
    covariates=all_covariates,
    answers={"compare": compare},
    other_settings=other_settings,
    with_adjustment=with_adjustment,
    unplaced=("targets",),
)
