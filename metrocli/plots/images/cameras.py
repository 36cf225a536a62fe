"""Cameras of a result in space as pyramids with names, the board that they see as a grid, and beams between them."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.geometry import poses
from metrocli.plots.plotted_points import PlottedPoints
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.shared.images.calibrated import StatedCamera, stated_cameras
from metrocli.tasks.shared.images.exposures import exposures

_DEPTH = 0.07
"""Height of a pyramid, as a share of the extent of all cameras and targets"""
_ROOMY = 40
"""Images from which on pyramids become smaller with the distance of the images"""
_MOST = 300
"""Images beyond which cameras are points only"""
_NAMED = 3
"""Cameras up to which each has a colour and its name"""
_LABELLED = 48
"""Images up to which each has its name; of more, the worst, the first and the last of each camera"""
_BEAMS = 1000
"""Most beams; of more, each image has the same number, at equal steps of its targets"""
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
        of = exposures({camera.name: camera.images for camera in cameras}, images).camera
    size *= min(1.0, (_ROOMY / len(images)) ** (1 / 3))
    lines = _pyramids(placed, np.stack([_corners(camera) for camera in cameras])[of] * size)
    each = [(camera.name, of == k) for k, camera in enumerate(cameras)] if 1 < len(cameras) <= _NAMED else []
    worst = np.zeros(len(images)) if rig == "cmm" else _rms(result, images)
    few = len(images) <= _LABELLED
    drawn = [
        PlottedPoints(
            name, tuple(np.array(images)[own]), placed[own, :3], lines=lines[own],
            named=_named(of[own], worst[own], few),
        )
        for name, own in each or [("cameras", of >= 0)]
    ]  # fmt: skip
    beams = _beams(result, images, placed[:, :3], cameras if rig == "cmm" else ())
    return [*board, *drawn, *beams]


def _rms(result: Result, images: list[str]) -> Array:
    """Return the root mean square of the residuals of each image, 0 where it is not known."""
    views = result.tables["views"]
    known = dict(zip(views.texts("image"), views.numbers("rms").tolist(), strict=True)) if "rms" in views else {}
    return np.asarray(np.nan_to_num([known.get(image, 0.0) for image in images]))


def _named(of: Index, worst: Array, few: bool) -> tuple[int, ...]:
    """Return the rows with names: of each camera the worst image, the first and the last; then all, if they are few."""
    each = [np.flatnonzero(of == k) for k in np.unique(of)]
    rows = [int(row) for own in each for row in (own[np.argmax(worst[own])], own[0], own[-1])]
    return tuple(dict.fromkeys([*rows, *(range(len(of)) if few else ())]))


def _beams(result: Result, images: list[str], eyes: Array, standing: Sequence[StatedCamera]) -> list[PlottedPoints]:
    """Return lines from each image to the targets that it shows; `standing` are the cameras that have many images."""
    targets, residuals = result.tables.get("targets"), result.tables.get("residuals", Table({}))
    if targets is None or not set("xyz") <= set(targets) or not {"image", "target"} <= set(residuals):
        return []
    at, row_of = targets.stacked("xyz"), {name: row for row, name in enumerate(targets.texts("target"))}
    pairs = list(dict.fromkeys(zip(residuals.texts("image"), residuals.texts("target"), strict=True)))
    eye_of = {image: k for k, image in enumerate(images)}
    if standing:
        names = list(dict.fromkeys(image for image, _ in pairs))
        of = exposures({camera.name: camera.images for camera in standing}, names).camera.tolist()
        eye_of = dict(zip(names, of, strict=True))
    known = [(eye_of[image], row_of[target]) for image, target in pairs if image in eye_of and target in row_of]
    if not known:
        return []
    rows = np.array(known)
    seen = [rows[rows[:, 0] == k, 1] for k in range(len(images))]
    most = min(max(map(len, seen)), max(1, _BEAMS // len(images)))
    start = np.repeat(eyes[:, None], most, axis=1)
    # an image of fewer targets has beams that end where they begin
    ends = start.copy()
    for k, own in enumerate(seen):
        chosen = np.unique(np.linspace(0, len(own) - 1, min(most, len(own))).astype(np.intp))
        ends[k, : len(chosen)] = at[own[chosen]]
    return [PlottedPoints("beams", tuple(images), eyes, lines=np.stack([start, ends], axis=2), faint=True)]


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
    placed = [taper if camera.pose is None else poses.compose(taper, camera.pose) for camera in cameras]
    return [camera.name or "camera" for camera in cameras], np.stack(placed)


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
