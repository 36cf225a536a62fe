"""The task align-part: run, diagnose and simulate."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from metrocli.adjust.clusters.robust import FROM_RESIDUALS, STRUCTURED, must_suffice
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.outcome import Outcome
from metrocli.adjust.robust import robust_start, typical
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.corrections import Mistake
from metrocli.diagnosis.trials import FAILURES
from metrocli.errors import InputError, NotConvergedError, UndeterminedError, all_faults
from metrocli.geometry.poses import EULER, pose_from_euler
from metrocli.instruments.spindle_camera import SPINDLE, part_in_camera
from metrocli.result import Result
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.tasks.align_part.camera import CameraModel, camera_of
from metrocli.tasks.align_part.diagnosis import adjusted_job, all_covariates
from metrocli.tasks.align_part.effects import EFFECTS, EXPANSION, PLACES
from metrocli.tasks.align_part.fitted_targets import target_list
from metrocli.tasks.align_part.fixturing import must_level
from metrocli.tasks.align_part.problem import AlignmentProblem, AlignmentTruth, build, mirrored_pose, true_model
from metrocli.tasks.align_part.report import delivered, explained, predicted, report
from metrocli.tasks.align_part.settings import Files, Settings
from metrocli.tasks.align_part.spindle_poses import SpindlePoses
from metrocli.tasks.job import Job, Task
from metrocli.tasks.shared.images.adjustment import (
    AdjustedImages,
    Options,
    adjust_images,
    is_lost,
    must_converge,
    must_fit,
)
from metrocli.tasks.shared.images.covariates import with_all_readings
from metrocli.tasks.shared.images.lost import apart_from_others
from metrocli.tasks.shared.images.places import not_sought
from metrocli.tasks.shared.images.settings import ESTIMATE
from metrocli.tasks.shared.images.sightings import Needs, sightings
from metrocli.tasks.shared.images.simulation import (
    SimulatedCamera,
    pictures,
    planted,
    sightings_table,
    sights,
)
from metrocli.tasks.shared.images.target_list import known_targets
from metrocli.tasks.shared.images.wrong_names import wrong_names
from metrocli.words import listed


def run(job: Job[Settings, Files]) -> Result:
    """Locate the part of a job.

    Raises InputError if the files do not fit all_faults, UndeterminedError if the readings do not determine the
    unknowns, and NotConvergedError if the adjustment does not converge.
    """
    problem = prepared(job)
    prediction = predicted(problem)
    adjusted = solved(job.settings, problem)
    if job.settings.noise == STRUCTURED:
        adjusted = adjusted.with_structure(delivered(problem.effects))
    return report(problem, adjusted, prediction, job.files)


def diagnosed(job: Job[Settings, Files]) -> AdjustedJob:
    """Return the adjusted job for `diagnose`, with all its readings, outliers included; raises as `run` does."""
    problem, settings = prepared(job), job.settings
    adjusted = with_all_readings(settings.outliers, lambda how: solved(replace(settings, outliers=how), problem))
    whole = adjusted_job(problem, adjusted)
    return replace(whole, not_sought={**not_sought(settings.shutter, whole.model), **whole.not_sought})


def prepared(job: Job[Settings, Files]) -> AlignmentProblem:
    """Return the adjustment with its starting values and the effects of the job."""
    settings, files = job.settings, job.files
    if files.supports is not None:
        must_level(files.supports)
    model = _camera(job)
    if files.images is not None:
        model.must_fit(files.images)
    listed = target_list(files.targets, settings.part)
    sigma = float("nan") if settings.targets == ESTIMATE else 0.0
    sighted = sightings(settings, files.observations, listed.table, files.images, Needs(1, sigma, sigma))
    commanded = SpindlePoses(files.poses, files.machine)
    problem = build(model, sighted, commanded, "clamping-angle" in settings.estimate, listed)
    problem = problem if settings.part is None else problem.with_part(settings.part)
    return problem.with_effects(job.effects)


def _camera(job: Job[Settings, Files]) -> CameraModel:
    return camera_of(job.files.camera, job.settings.camera).with_images(job.settings.cameras)


def check(job: Job[Settings, Files]) -> None:
    """Raise InputError for what shows without a look into the images, and without images for all that shows."""
    files, images = job.files, job.files.images
    if images is None:
        prepared(job)
        return
    with all_faults() as each:
        with each():
            if files.supports is not None:
                must_level(files.supports)
        with each():
            model = _camera(job)
            model.must_fit(images)
        with each():
            target_list(files.targets, job.settings.part)
        with each():
            commanded = SpindlePoses(files.poses, files.machine)
            taken = _camera(job).exposed(images.names).names
            rows = [row for name, row in commanded.rows(_camera(job).images).items() if name in taken]
            commanded.must_be_known(np.array(rows, dtype=np.intp))


def solved(settings: Settings, problem: AlignmentProblem) -> AdjustedImages:
    """Adjust a problem; raises UndeterminedError or NotConvergedError if it has no good solution."""
    if settings.noise == STRUCTURED:
        must_suffice(len(problem.blocks[SPINDLE].members), "images")
    largest = max((camera.size for camera in problem.camera.cameras), key=max)
    options = Options(settings.outliers == "remove", settings.noise in FROM_RESIDUALS, largest, started=True)
    near = _near(problem)
    try:
        adjusted = _adjusted(problem, near, options)
    except (InputError, NotConvergedError) as error:
        # where more than half of the readings are far off, no few images spoil the fit of the others
        lost = is_lost(typical(problem.images, near), largest)
        raise error if lost else _with_images_left_out(problem, near, options, error) from None
    solution = adjusted.solution
    if solution.undetermined or solution.outcome is Outcome.TOO_FEW:
        raise UndeterminedError(explained(problem, solution), solution.misfit)
    other = mirrored_pose(problem, adjusted)
    return adjusted if other is None else solved(settings, other)


def _near(problem: AlignmentProblem) -> dict[str, Block]:
    """Return values near the solution that wrong readings do not spoil."""
    images = problem.images
    return robust_start(problem.blocks.values(), [images, *problem.others], (images.name,), problem.datum, "view")


def other_settings(job: Job[Settings, Files], fits: bool) -> Iterator[tuple[Mistake, Job[Settings, Files]]]:
    """Yield the job with names of targets that may be wrong in an image corrected."""
    table = job.files.observations
    if table is None:
        return
    try:
        problem = prepared(job)
    except FAILURES:
        return
    for mistake, right in wrong_names([(problem.images, _near(problem))], table):
        yield mistake, job.with_files(observations=right)


def _adjusted(problem: AlignmentProblem, near: Mapping[str, Block], options: Options) -> AdjustedImages:
    adjusted = adjust_images(near, problem.images, problem.others, problem.datum, options)
    if adjusted.solution.outcome is Outcome.ITERATION_LIMIT:
        must_fit(typical(adjusted.group, adjusted.solution.blocks), options.image_size)
    if adjusted.solution.outcome is not Outcome.TOO_FEW:  # that is explained with what is not determined
        must_converge(adjusted.solution)
    return adjusted


def _with_images_left_out(
    problem: AlignmentProblem, near: Mapping[str, Block], options: Options, error: InputError | NotConvergedError
) -> InputError | NotConvergedError:
    """Return the error, or one that names the images without which the others fit: their poses or names are wrong."""
    if options.remove_outliers:
        return error
    try:
        rest = _adjusted(problem, near, replace(options, remove_outliers=True))
    except (InputError, NotConvergedError):
        return error
    images = apart_from_others(problem.images, rest.group, rest.rejected)
    if not images:
        return error
    return InputError(
        f"the image points of {listed(images)} do not fit those of the other images, which fit each other\n"
        "check the rows of these images in the file of poses, and their names; `outliers: remove` leaves them out"
    )


def simulate(job: Job[Settings, Files], options: SimulationOptions) -> Simulation:
    """Return the image points that the camera would measure from each pose, with noise and effects.

    The part stands as `simulation:` gives it. Pictures are added if the options ask for them. Raises InputError if the
    truth is missing.
    """
    settings, files, effects = job.settings, job.files, job.effects
    truth, poses = settings.simulation, files.poses
    if truth is None:
        raise InputError("simulate needs the truth: give `simulation: {part: {x: 10 mm, ...}, clamping_angle: 1 mm/m}`")
    model = _camera(job)
    rng = np.random.default_rng(options.seed)
    listed = target_list(files.targets, settings.part)
    known = listed.drawn(known_targets(settings.pattern, listed.table, 0.0), rng)
    growth = 0.0 if settings.part is None else settings.part.growth + settings.part.std * float(rng.normal())
    known = replace(known, points=known.points * (1 + growth))
    at = np.array([getattr(truth.part, name) for name in EULER])
    commanded = SpindlePoses(poses, files.machine)
    exposures = commanded.rows(model.images)
    rows = np.array(list(exposures.values()), dtype=np.intp)
    spindle_poses = commanded.moved(rows, commanded.motion(rows).drawn(rng))
    part = pose_from_euler(at[:3], at[3:])
    times = {name: values[rows] for name, values in poses.conditions("t", "temp").items()}
    shown = [
        SimulatedCamera(
            camera.lens,
            camera.size,
            tuple(camera.images.replace("*", exposure) for exposure in exposures),
            part_in_camera(part, spindle_poses, truth.clamping_angle, in_taper),
            known,
            camera.convention,
            times,
            camera.name,
            camera.shape,
        )
        for camera, in_taper in zip(model.cameras, model.in_taper, strict=True)
        if camera.images
    ]
    seen = sights(shown)
    seen, values = planted(
        true_model(
            model,
            shown,
            seen,
            AlignmentTruth(part, dict(zip(exposures, spindle_poses, strict=True)), truth.clamping_angle),
        ),
        seen,
        effects,
    )
    table = sightings_table([replace(camera, conditions={}) for camera in shown], seen, settings.noise, rng)
    drawn = pictures(shown, settings.pattern if options.images else None, rng, effects=effects)
    true = dict(zip(EULER, at.tolist(), strict=True)) | {"gamma_s": truth.clamping_angle}
    true |= {} if settings.part is None else {f"{EXPANSION}.scale": growth}
    return Simulation({"observations.csv": table}, true | values, drawn)


TASK = Task(
    Files,
    run,
    check,
    simulate=simulate,
    diagnosed=diagnosed,
    effects=EFFECTS,
    places=PLACES,
    covariates=all_covariates,
    other_settings=other_settings,
)
