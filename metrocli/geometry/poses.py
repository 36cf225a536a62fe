"""Poses: a rotation and a shift from one frame into another, `X' = R X + d`, kept as (x, y, z, rx, ry, rz).

x, y, z is d; rx, ry, rz is the rotation vector of R. A step of a pose adds to d and turns R from the left.
"""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array
from metrocli.geometry.rotations import (
    euler_by_vector,
    euler_from_rotation,
    nearest_rotation,
    rotation_from_euler,
    rotation_from_vector,
    vector_by_left_turn,
    vector_from_rotation,
)

COLUMNS = ("x", "y", "z", "rx", "ry", "rz")
EULER = ("x", "y", "z", "alpha", "beta", "gamma")


def pose(rotation: Array, shift: Array) -> Array:
    """Return poses (..., 6) from rotations (..., 3, 3) and shifts (..., 3)."""
    return np.concatenate([np.broadcast_to(shift, (*rotation.shape[:-2], 3)), vector_from_rotation(rotation)], axis=-1)


def rotation_of(poses: Array) -> Array:
    """Return R of poses, (..., 6) -> (..., 3, 3)."""
    return rotation_from_vector(poses[..., 3:])


def pose_from_euler(shift: Array, angles: Array) -> Array:
    """Return poses (..., 6) from shifts (..., 3) and angles alpha, beta, gamma [rad] (..., 3)."""
    return pose(rotation_from_euler(angles[..., 0], angles[..., 1], angles[..., 2]), shift)


def euler_form(poses: Array) -> Array:
    """Return (x, y, z, alpha, beta, gamma) of poses, (..., 6) -> (..., 6)."""
    return np.concatenate([poses[..., :3], euler_from_rotation(rotation_of(poses))], axis=-1)


def euler_form_by_step(poses: Array) -> Array:
    """Return the derivative of `euler_form` by a step of the pose, (..., 6) -> (..., 6, 6)."""
    derivative = np.zeros((*poses.shape, 6))
    derivative[..., :3, :3] = np.eye(3)
    derivative[..., 3:, 3:] = euler_by_vector(rotation_of(poses))
    return derivative


def moved(poses: Array, step: Array) -> Array:
    """Return poses after a step (shift added, turned from the left), (..., 6), (..., 6) -> (..., 6)."""
    rotation = rotation_from_vector(step[..., 3:]) @ rotation_of(poses)
    return pose(rotation, poses[..., :3] + step[..., :3])


def difference(poses: Array, reference: Array) -> Array:
    """Return the step that leads from `reference` to `poses`, (..., 6)."""
    # `R R_ref'`, since steps turn from the left
    turn = rotation_of(poses) @ np.swapaxes(rotation_of(reference), -1, -2)
    return pose(turn, poses[..., :3] - reference[..., :3])


def difference_by_step(poses: Array, reference: Array) -> Array:
    """Return the derivative of `difference` by a step of `poses`, (..., 6) -> (..., 6, 6)."""
    derivative = np.zeros((*poses.shape, 6))
    derivative[..., :3, :3] = np.eye(3)
    derivative[..., 3:, 3:] = vector_by_left_turn(difference(poses, reference)[..., 3:])
    return derivative


def inverse(poses: Array) -> Array:
    """Return the pose of the opposite direction: `X = R^T (X' - d)`, (..., 6)."""
    turned = np.swapaxes(rotation_of(poses), -1, -2)
    return pose(turned, -(turned @ poses[..., :3, None])[..., 0])


def compose(outer: Array, inner: Array) -> Array:
    """Return the pose that applies `inner` first, then `outer`, (..., 6)."""
    rotation = rotation_of(outer)
    return pose(rotation @ rotation_of(inner), (rotation @ inner[..., :3, None])[..., 0] + outer[..., :3])


def apply(poses: Array, points: Array) -> Array:
    """Return `R X + d`, poses (..., 6) and points (..., 3) -> (..., 3)."""
    return (rotation_of(poses) @ points[..., None])[..., 0] + poses[..., :3]


def fit_pose(points: Array, goals: Array) -> Array:
    """Return the pose that brings points (n, 3) nearest to goals (n, 3) in least squares (Kabsch)."""
    centre, goal = points.mean(axis=0), goals.mean(axis=0)
    rotation = nearest_rotation((goals - goal).T @ (points - centre))
    return pose(rotation, goal - rotation @ centre)


def fit_similarity(points: Array, goals: Array) -> tuple[Array, float]:
    """Return pose (6,) and scale that lay points (n, 3) nearest to goals (n, 3), unweighted (Umeyama 1991)."""
    # the rotation of the best fit does not depend on the scale
    rotation = rotation_of(fit_pose(points, goals))
    centred, centred_goals = points - points.mean(axis=0), goals - goals.mean(axis=0)
    scale = float((centred_goals * (centred @ rotation.T)).sum() / max((centred**2).sum(), 1e-300))
    return fit_pose(scale * points, goals), scale


def mirrored_about(poses: Array, sight: Array, centre: Array, normal: Array) -> Array:
    """Return poses (n, 6) whose plane has its normal mirrored about a line of sight, and whose centre stays.

    The mirror image of the normal n about the unit vector s is `2 (s n) s - n` (Schweighofer and Pinz 2006). `sight` is
    the vector to the centre (n, 3); `centre` and `normal` (3,) are in the frame of the plane.
    """
    rotation, kept = rotation_of(poses), apply(poses, centre)
    along = sight / np.linalg.norm(sight, axis=1, keepdims=True)
    turned = rotation @ normal
    mirrored = 2 * (along * turned).sum(axis=1, keepdims=True) * along - turned
    axis = np.cross(turned, mirrored)
    sine, cosine = np.linalg.norm(axis, axis=1), (turned * mirrored).sum(axis=1)
    # atan2 of both: the arc cosine loses half of the digits where the turn is small
    turn = axis / np.maximum(sine, 1e-12)[:, None] * np.arctan2(sine, cosine)[:, None]
    rotation = rotation_from_vector(turn) @ rotation
    return pose(rotation, kept - rotation @ centre)
