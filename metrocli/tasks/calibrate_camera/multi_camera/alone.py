"""Each of several cameras calibrated alone: why it must not be used.

Poses and a noise that follows the residuals take up what a lens lacks, with several cameras as with one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from metrocli.adjust.clusters.robust import FROM_RESIDUALS
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array
from metrocli.errors import InputError, UndeterminedError
from metrocli.geometry import poses
from metrocli.geometry.rotations import cross_matrix
from metrocli.instruments import camera
from metrocli.tasks.calibrate_camera.advice import turned_too_little
from metrocli.tasks.calibrate_camera.doubts import principal_point, unmodelled, why_not
from metrocli.tasks.calibrate_camera.multi_camera.system import CameraSystem
from metrocli.tasks.calibrate_camera.other_lenses import fisheye_instead
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.calibrate_camera.projection_error import angle_warnings
from metrocli.tasks.calibrate_camera.settings import Settings
from metrocli.tasks.calibrate_camera.shape.spline import with_shape
from metrocli.tasks.calibrate_camera.wrong_images.turned import seen_from_behind
from metrocli.tasks.shared.images.adjustment import AdjustedImages, Options, adjust_images
from metrocli.tasks.shared.images.exposures import IMAGE
from metrocli.tasks.shared.images.settings import SPLINE
from metrocli.tasks.shared.images.tables import root_mean_square


def doubts_and_warnings(
    system: CameraSystem, settings: Settings, adjusted: AdjustedImages, folded: Mapping[str, str]
) -> tuple[list[str], list[str]]:
    """Return why cameras must not be used, and what else their readings contradict.

    `folded` has the cameras whose lens model folds over as all readings have it. Effects of a job are those of all
    cameras: what one of them alone leaves is then no reason against it.
    """
    doubts, warnings = list[str](), list[str]()
    for name, problem in () if system.effects else _problems(system, settings):
        options = Options(settings.outliers == "remove", settings.noise in FROM_RESIDUALS, problem.image_size)
        try:
            alone = adjust_images(problem.blocks, problem.images, problem.others, problem.datum, options)
        except (UndeterminedError, InputError):
            continue  # the readings of all cameras determine it
        if alone.solution.outcome.good:
            folds, centre = [folded[name]] if name in folded else [], principal_point(problem, alone)
            doubts += (f"{name}: {line}" for line in why_not(problem, system.cameras[name], alone, centre, folds))
            warnings += (f"{name}: {line}" for line in (centre.warnings() if centre is not None else []))
    if not doubts:
        doubts += (f"{name}: {line}" for name, line in folded.items())
        doubts += unmodelled(adjusted, adjusted.group.observations.index[IMAGE], system.largest_size)
    return doubts, warnings


def view_warnings(system: CameraSystem, solution: Solution) -> Iterator[str]:
    """Yield what the views of a camera do not show, by the values and uncertainties that all readings give."""
    if system.rig != "board":
        return
    lens, std, views = solution.blocks[camera.LENS], solution.std(camera.LENS), views_of(system, solution)[0]
    unturned = list[str]()
    for number, (name, problem) in enumerate(system.alone.items()):
        own = replace(lens, values=lens.values[[number]], free=lens.free[[number]], members=("",))
        there = problem.blocks[camera.VIEW].with_values(views[system.exposed.camera == number])
        solved = problem.with_blocks({**problem.blocks, camera.LENS: own, camera.VIEW: there})
        lines = angle_warnings(solved, std[number]) + seen_from_behind(solved)
        yield from (f"{name}: {line}" for line in lines)
        unturned += (f"{name}: {line}" for line in turned_too_little(solved))
    # all see one board: a single camera that is turned separates its errors from those of lenses
    if len(unturned) == len(system.cameras):
        yield from unturned


def fisheyes(system: CameraSystem, settings: Settings, solution: Solution) -> list[str]:
    """Return the cameras that the model fisheye fits far better than an adjustment that did not converge."""
    off = root_mean_square(system.images.residuals({**system.blocks, **solution.blocks}))
    each = (
        (name, fisheye_instead(problem, system.cameras[name], off)) for name, problem in _problems(system, settings)
    )
    return [f"{name}: {line}" for name, lines in each for line in lines]


def _problems(system: CameraSystem, settings: Settings) -> Iterator[tuple[str, CameraProblem]]:
    for number, (name, alone) in enumerate(system.alone.items()):
        spline, problem = system.cameras[name].model == SPLINE, _as_noisy(alone, system, number)
        yield name, with_shape(problem, settings.noise not in FROM_RESIDUALS) if spline else problem


def _as_noisy(problem: CameraProblem, system: CameraSystem, number: int) -> CameraProblem:
    """Return the calibration of a camera alone, with the variance groups of its readings."""
    observations = system.images.observations
    if observations.ratios is None:
        return problem
    ratios = observations.ratios[system.exposed.camera[observations.index[IMAGE]] == number]
    images = problem.images.with_observations(replace(problem.images.observations, ratios=ratios))
    return problem.with_model(problem.model.with_group(images))


def views_of(system: CameraSystem, solution: Solution) -> tuple[Array, Array]:
    """Return the pose of each image (images, 6), as one camera has it, and the covariance (images, 6, 6) of its steps.

    V is the pose of the exposure, M that of the camera in the frame of the first. With rig board `P = M^-1 V`
    transforms from the board to the camera; with rig network `P = V M` is the pose of the camera. A step shifts a pose
    and turns it from the left.
    """
    at, of = system.exposed.exposure, system.exposed.camera
    view, mount = solution.blocks[camera.VIEW].values[at], solution.blocks[camera.MOUNT].values[of]
    if system.rig == "board":
        values = poses.compose(poses.inverse(mount), view)
        back = np.swapaxes(poses.rotation_of(mount), 1, 2)
        steps = _blocks(back, None), _blocks(-back, back @ cross_matrix(view[:, :3] - mount[:, :3]))
    else:
        values, turn = poses.compose(view, mount), poses.rotation_of(view)
        lever = -cross_matrix((turn @ mount[:, :3, None])[:, :, 0])
        steps = _blocks(np.broadcast_to(np.eye(3), turn.shape), lever), _blocks(turn, None)
    covariance = solution.covariance_or_raise()
    of_view, of_mount = covariance.members(camera.VIEW)[at], covariance.members(camera.MOUNT)[of]
    between = covariance.between(camera.VIEW, camera.MOUNT).reshape(len(covariance.members(camera.VIEW)), 6, -1, 6)
    cross = steps[0] @ between[at, :, of] @ np.swapaxes(steps[1], 1, 2)
    own = sum(step @ each @ np.swapaxes(step, 1, 2) for step, each in zip(steps, (of_view, of_mount), strict=True))
    return values, own + cross + np.swapaxes(cross, 1, 2)


def _blocks(turn: Array, lever: Array | None) -> Array:
    """Return the derivatives (n, 6, 6) of a step: shift and turn are rotated alike, and a turn shifts by a lever."""
    full = np.zeros((len(turn), 6, 6))
    full[:, :3, :3] = full[:, 3:, 3:] = turn
    if lever is not None:
        full[:, :3, 3:] = lever
    return full
