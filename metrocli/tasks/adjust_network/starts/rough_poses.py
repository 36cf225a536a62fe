"""Poses that bring points of a set-up to their places, undisturbed by gross errors."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array
from metrocli.geometry import poses
from metrocli.geometry.rotations import nearest_rotation

_REWEIGHTED = 8
"""Rounds of a fit that gross errors do not spoil"""


def fitted(local: Array, goal: Array, levelled: bool) -> Array:
    """Return the pose that brings local points to their places; gross errors get low weights."""
    weights = np.ones(len(local))
    pose = np.zeros(6)
    for _ in range(_REWEIGHTED):
        pose = _turned(local, goal, weights) if levelled else _pose(local, goal, weights)
        miss = np.linalg.norm(poses.apply(pose, local) - goal, axis=1)
        scale = max(float(np.median(miss)), 1e-9)
        if miss.max() <= 8 * scale or len(local) < 5:
            break
        weights = 1 / np.maximum(miss / scale, 1.0)
    return pose


def _turned(local: Array, goal: Array, weights: Array) -> Array:
    """Return the pose with a turn about z alone, in least squares."""
    w = weights / weights.sum()
    a, b = local - w @ local, goal - w @ goal
    gamma = np.arctan2(
        (w * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])).sum(), (w * (a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1])).sum()
    )
    turn = np.array([0.0, 0.0, 0.0, 0.0, 0.0, gamma])
    return np.concatenate([w @ goal - poses.apply(turn, w @ local), turn[3:]])


def _pose(local: Array, goal: Array, weights: Array) -> Array:
    w = weights / weights.sum()
    centre, target = w @ local, w @ goal
    rotation = nearest_rotation(((goal - target) * w[:, None]).T @ (local - centre))
    return poses.pose(rotation, target - rotation @ centre)
