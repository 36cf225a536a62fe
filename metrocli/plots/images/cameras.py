"""Cameras of a result in space, drawn as pyramids towards the image, and the board that they see, as a grid."""

from __future__ import annotations

import re

import numpy as np

from metrocli.arrays import Array
from metrocli.geometry import poses
from metrocli.plots.plotted_points import PlottedPoints
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.shared.images.calibrated import StatedCamera, stated_cameras
from metrocli.tasks.shared.images.exposures import exposures

_DEPTH = 0.07
"""Height of a pyramid, as a share of the extent of all cameras and targets"""
_MOST = 300
"""Images beyond which cameras are points only"""
_NAMED = 3
"""Cameras up to which each has a colour and its name"""
_ON_GRID = re.compile(r"r(\d+)c(\d+)")
"""Name of a target of a board"""


def cameras_of(result: Result) -> list[PlottedPoints]:
    """Return the targets of a board or of a CMM and the camera of each image, in the frame of the targets."""
    rig, cameras = result.statistics.get("rig"), stated_cameras(result) if "camera" in result.tables else []
    images, placed = _standing(result, cameras) if rig == "cmm" else _of_views(result)
    if not images:
        return []
    board = _board(result.tables.get("targets"), "board" if rig == "board" else "targets") if rig != "network" else []
    around = [each.at for each in board] + [placed[:, :3]]
    size = _DEPTH * float(np.linalg.norm(np.ptp(np.concatenate(around), axis=0)))
    if not cameras or len(images) > _MOST:
        return [*board, PlottedPoints("cameras", tuple(images), placed[:, :3])]
    of = np.arange(len(images)) if rig == "cmm" else np.zeros(len(images), dtype=np.intp)
    if len(cameras) > 1 and rig != "cmm":
        of = exposures({one.name: one.images for one in cameras}, images).camera
    lines = _pyramids(placed, np.stack([_corners(one) for one in cameras])[of] * size)
    each = [(one.name, of == k) for k, one in enumerate(cameras)] if 1 < len(cameras) <= _NAMED else []
    return [
        *board,
        *(
            PlottedPoints(name, tuple(np.array(images)[own]), placed[own, :3], lines=lines[own])
            for name, own in each or [("cameras", of >= 0)]
        ),
    ]


def _of_views(result: Result) -> tuple[list[str], Array]:
    """Return the images whose pose is known, with the pose of their camera (n, 6) in the frame of the targets."""
    views, rig = result.tables.get("views"), result.statistics.get("rig")
    if rig not in ("board", "network") or views is None or "alpha" not in views:
        return [], np.zeros((0, 6))
    listed = views.stacked(poses.EULER)
    held = poses.pose_from_euler(listed[:, :3], listed[:, 3:])
    placed = poses.inverse(held) if rig == "board" else held
    known = np.asarray(np.isfinite(placed).all(axis=1))
    return [name for name, is_known in zip(views.texts("image"), known, strict=True) if is_known], placed[known]


def _standing(result: Result, cameras: list[StatedCamera]) -> tuple[list[str], Array]:
    """Return the cameras that stand in the frame of the targets, with their poses (n, 6)."""
    known, first = {estimate.name: estimate.value for estimate in result.estimates}, cameras[0].name
    keys = [f"{first}.{key}" if first else key for key in poses.EULER]
    if not set(keys) <= set(known):
        return [], np.zeros((0, 6))
    listed = np.array([known[key] for key in keys])
    taper = poses.pose_from_euler(listed[:3], listed[3:])
    placed = [taper if one.pose is None else poses.compose(taper, one.pose) for one in cameras]
    return [one.name or "camera" for one in cameras], np.stack(placed)


def _board(targets: Table | None, kind: str) -> list[PlottedPoints]:
    """Return the targets, with lines along rows and columns where their names have these."""
    if targets is None or not set("xyz") <= set(targets):
        return [PlottedPoints(kind, ("origin",), np.zeros((1, 3)))]
    at, names = targets.stacked("xyz"), targets.texts("target")
    places = [_ON_GRID.fullmatch(name) for name in names]
    row_of = {(int(place[1]), int(place[2])): row for row, place in enumerate(places) if place}
    # each target has a line to the next one of its row and of its column; at the rim these end where they begin
    ends = np.tile(np.arange(len(at))[:, None], (1, 2))
    for (row, column), k in row_of.items():
        ends[k] = row_of.get((row, column + 1), k), row_of.get((row + 1, column), k)
    lines = np.stack([np.broadcast_to(at[:, None], (len(at), 2, 3)), at[ends]], axis=2)
    return [PlottedPoints(kind, tuple(names), at, lines=lines if row_of else None)]


def _pyramids(placed: Array, corners: Array) -> Array:
    """Return the edges of the pyramid of each image (n, 8, 2, 3): from the camera to the corners, and about them."""
    at = poses.apply(placed[:, None], corners)
    start = np.broadcast_to(placed[:, None, :3], at.shape)
    return np.concatenate([np.stack([start, at], axis=2), np.stack([at, np.roll(at, -1, axis=1)], axis=2)], axis=1)


def _corners(camera: StatedCamera) -> Array:
    """Return the directions (4, 3) to the corners of the image, without distortion, along the optical axis of length 1.

    Those of a wide angle end at 60 degrees: a pyramid has no wider opening.
    """
    wide, high = camera.size
    lens = camera.lens
    fx, fy = (lens["fx"], lens["fy"]) if "fx" in lens else (lens["f"] * (1 + lens.get("aspect", 0.0)), lens["f"])
    x, y = (min(extent / focal / 2, _WIDEST) for extent, focal in ((wide, fx), (high, fy)))
    return np.array([[-x, -y, 1.0], [x, -y, 1.0], [x, y, 1.0], [-x, y, 1.0]])


_WIDEST = float(np.tan(np.radians(60.0)))
