"""The pose of each image of several cameras: that of the exposure and that of the camera together."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.solution import Solution
from metrocli.arrays import Array
from metrocli.geometry import poses
from metrocli.geometry.rotations import cross_matrix
from metrocli.instruments import camera
from metrocli.tasks.calibrate_camera.multi_camera.system import CameraSystem


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
