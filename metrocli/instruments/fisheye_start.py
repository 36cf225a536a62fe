"""Starting values of a fisheye: the focal length by trial, poses as of a camera turned to the middle of a view."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from metrocli.arrays import Array
from metrocli.geometry import poses
from metrocli.geometry.rotations import rotation_from_vector
from metrocli.instruments.camera_start import TargetImages, start
from metrocli.instruments.lenses.lens import direction, equidistant, image_point

_TRIED = np.geomspace(0.12, 1.6, 12)
"""Focal lengths to try, in units of the longer side of the image: it then spans from 480 down to 36 degrees"""
_SOME = 16
"""Views with which focal lengths are tried"""
_WIDEST = np.cos(np.radians(80))
"""Cosine of the angle from the middle of a view beyond which points do not enter its start"""


def start_of_fisheye(
    scene: TargetImages, lens: Mapping[str, float], focal: float | None, side: float
) -> tuple[float, Array]:
    """Return the focal length [px] and the poses (views, 6) that transform targets into the frame of each camera.

    `lens` has what is known of the lens, `side` is the longer side of the image [px]. The focal length with which the
    median image point is nearest is taken.
    """
    if not focal:
        some = _of_some_views(scene)
        # the median needs at most half of the views at their places
        focal = min((_TRIED * side).tolist(), key=lambda trial: _posed(some, {**lens, "f": trial}, again=False)[1])
    return focal, _posed(scene, {**lens, "f": focal})[0]


def _of_some_views(scene: TargetImages) -> TargetImages:
    """Return the readings of views that are spread over all: they determine the focal length well enough."""
    present = np.unique(scene.view)
    chosen = present[np.unique(np.linspace(0, len(present) - 1, _SOME).astype(int))]
    number = np.full(scene.views, -1)
    number[chosen] = np.arange(len(chosen))
    part = scene.selected(number[scene.view] >= 0)
    return TargetImages(part.points, part.uv, part.target, number[part.view], len(chosen))


def _posed(scene: TargetImages, lens: Mapping[str, float], again: bool = True) -> tuple[Array, float]:
    """Return the poses for a lens, and the median distance [px] of image points from their prediction.

    `again` is whether views that are astray are tried again.
    """
    seen = direction(lens, scene.uv[0], scene.uv[1], "fisheye")
    known = np.isfinite(seen[0])
    sums = [np.bincount(scene.view[known], row[known], scene.views) for row in seen]
    turn = _to_axis(np.stack(sums, axis=1).astype(float))
    ahead = np.einsum("nab,bn->an", turn[scene.view], np.where(known, seen, 0.0))
    near = ahead[2] > _WIDEST
    flat = ahead[:2] / np.where(near, ahead[2], 1.0)
    # turned to the middle of its points a fisheye is a pinhole near the axis,
    # so that the start of cameras serves it too
    part = TargetImages(scene.points, flat, scene.target, scene.view, scene.views).selected(near)
    _, pose = start(part, np.zeros(2), 1.0, 1.0, again)
    pose = poses.compose(poses.pose(np.swapaxes(turn, 1, 2), np.zeros(3)), pose)
    at = equidistant(poses.apply(pose[scene.view], scene.points[scene.target]).T)
    u, v = image_point(lens, at.x, at.y, fisheye=True)
    off = np.hypot(u - scene.uv[0], v - scene.uv[1])
    return pose, float(np.median(np.nan_to_num(off, nan=np.inf)))


def _to_axis(middle: Array) -> Array:
    """Return the rotations (views, 3, 3) that turn directions (views, 3) onto the axis z, by the shortest way."""
    unit = middle / np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-300)
    across = np.stack([unit[:, 1], -unit[:, 0], np.zeros(len(unit))], axis=1)
    size = np.linalg.norm(across, axis=1, keepdims=True)
    # atan2 has no singularity at a right angle, and of a direction on the axis it is 0
    angle = np.arctan2(size, unit[:, 2:])
    return rotation_from_vector(across / np.maximum(size, 1e-300) * angle)
