"""Images that a viewer turned or mirrored: each still fits a board.

One that is turned by 180 degrees has (W-1-u, H-1-v) for (u, v), so its principal point is that of the others, reflected
in the middle of the image. Poses take up most of the difference, and the noise the rest. One that is mirrored, or whose
u and v are exchanged, fits the board seen from behind.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from metrocli import units
from metrocli.adjust.adjustment import StoppingRule, adjust
from metrocli.adjust.model.groups import Group
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array, Mask
from metrocli.diagnosis.corrections import Mistake
from metrocli.geometry import poses
from metrocli.instruments import camera
from metrocli.instruments.camera_start import plane_frame
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.calibrate_camera.settings import Files, Settings
from metrocli.tasks.job import Job
from metrocli.tasks.shared.images.adjustment import AdjustedImages
from metrocli.tasks.shared.images.tables import root_mean_square, scatter
from metrocli.words import counted, listed

_FEWEST = 4
"""Fewest images; an image needs more readings: its pose and its principal point take up eight coordinates"""
_CERTAIN = 3.0
"""Standard uncertainties by which the principal point of turned images is on the other side"""
_GAIN = 50.0
"""Decrease of chi-square by turning images back from which they are named, in units of the residuals' variance"""
_FITS = 4.0
"""Variance, in that declared or that of neighbouring points, above which something else is wrong ..."""
_MUCH = 2.0
"""... and how many times smaller turning images back has to make their own squares then"""
_BETWEEN = 3.0
"""Least sum of squares of the two means, for each image, in that of noise"""
_WITHIN = 0.3
"""Largest share of it that may be left about the two means beyond noise"""
_AXES = ("cx", "cy")


def turned_images(problem: CameraProblem, adjusted: AdjustedImages) -> list[str]:
    """Return why a camera must not be used some of whose images fit better turned by 180 degrees."""
    solution = adjusted.solution
    lens = solution.blocks[camera.LENS]
    columns = [lens.columns.index(name) for name in _AXES]
    if problem.rig == "cmm" or len(problem.sighted.images) < _FEWEST or not lens.free[0, columns].all():
        return []
    turned = _on_the_other_side(problem, adjusted, columns)
    if not turned.any():
        return []
    better, group = _with_turned_back(problem, adjusted, turned)
    # measured by the better fit: turned images make the noise of their own fit large
    variance = max(better.cost / max(solution.dof, 1), 1e-12)
    if not np.isfinite(better.cost) or (solution.cost - better.cost) / variance < _GAIN:
        return []
    ratio = _squares(adjusted.group, solution, turned) / _squares(group, better, turned)
    # a camera that still does not fit has another fault, which turning may happen to hide a little of
    if (variance if adjusted.noise is None else _in_scatter(group, better, problem)) > _FITS and ratio < _MUCH:
        return []
    names = [name for name, is_turned in zip(problem.sighted.images, turned, strict=True) if is_turned]
    values = better.blocks[camera.LENS].named()
    f = "f" if "f" in values else "fx"
    rest, times = len(turned) - len(names), units.two_digits(ratio)
    return [
        f"{counted(len(names), 'image', 'are')} turned by 180 degrees, or the {rest} others are: {listed(names)}; "
        f"turned back, their squared residuals are {times} times smaller and {f} = {values[f]:.1f} px; save all "
        "images as the camera wrote them"
    ]


def _squares(group: Group, solution: Solution, images: Mask) -> float:
    """Return the weighted sum of squared residuals of some images."""
    residual = group.linear(solution.blocks, frozenset()).residual
    return max(float((residual[:, images[group.observations.index[camera.VIEW]]] ** 2).sum()), 1e-12)


def _in_scatter(group: Group, solution: Solution, problem: CameraProblem) -> float:
    """Return the variance of residuals in that of neighbouring points, which an estimated noise does not hide."""
    observations, residuals = group.observations, group.residuals(solution.blocks)
    alone = scatter(residuals, observations.readings, observations.index[camera.VIEW], problem.image_size)
    return float((root_mean_square(residuals) / max(alone, 1e-12)) ** 2)


def _with_turned_back(problem: CameraProblem, adjusted: AdjustedImages, turned: Mask) -> tuple[Solution, Group]:
    """Return the solution with the readings of some images turned by 180 degrees, and these readings."""
    group, (w, h) = adjusted.group, problem.image_size
    observations, readings = group.observations, group.observations.readings
    # W - 1 - u: pixel centres are whole numbers, and the first is 0
    flipped = np.array([[w - 1.0], [h - 1.0]]) - readings
    mended = np.where(turned[observations.index[camera.VIEW]], flipped, readings)
    group = group.with_observations(observations.with_readings(mended))
    blocks = dict(adjusted.solution.blocks)
    views = blocks[camera.VIEW]
    poses_of_views = np.where(turned[:, None], _rolled(views.values, problem.rig), views.values)
    blocks[camera.VIEW] = views.with_values(poses_of_views)
    # the lens that both halves share is wrong for each: only poses may move before it is freed
    held = [block.fixed() if name != camera.VIEW else block for name, block in blocks.items()]
    moved = adjust(held, [group], None, StoppingRule(limit=30, covariance=False)).blocks
    freed = [replace(block, free=blocks[name].free) for name, block in moved.items()]
    return adjust(freed, [group, *problem.others], problem.datum, StoppingRule(covariance=False)), group


def seen_from_behind(problem: CameraProblem) -> list[str]:
    """Return which images show a flat board from the other side than most: they may be mirrored."""
    named = behind(problem)
    return [mirrored(named)] if named else []


def mirrored(named: Sequence[str]) -> str:
    """Return that images show a board from behind, in words."""
    noun = "image" if len(named) == 1 else "images"
    return f"{noun} {listed(named)}: the board is seen from the other side than in the others; mirrored?"


def other_settings(job: Job[Settings, Files], problem: CameraProblem) -> Iterator[tuple[Mistake, Job[Settings, Files]]]:
    """Yield the observed points of images that show the board from behind, mirrored back in each way that differs."""
    named, table = behind(problem), job.files.observations
    if not named or table is None:
        return
    there, many = np.isin(table.texts("image"), named), len(named) > 1
    of = f"{'images' if many else 'image'} {listed(named)}"
    u, v = table.numbers("u"), table.numbers("v")
    w, h = problem.image_size
    ways = (
        (f"u and v of {of} are exchanged", f"u as v and v as u of {of}", v, u),
        (f"{of} {'are' if many else 'is'} mirrored from left to right", f"{w - 1} - u for u of {of}", w - 1 - u, v),
        (f"{of} {'are' if many else 'is'} mirrored upside down", f"{h - 1} - v for v of {of}", u, h - 1 - v),
    )
    for words, write, new_u, new_v in ways:
        mirrored = table.changed({"u": np.where(there, new_u, u), "v": np.where(there, new_v, v)})
        mistake = Mistake("observations", words, write, file=table.file, sort="images")
        yield mistake, job.with_files(observations=mirrored)


def behind(problem: CameraProblem) -> list[str]:
    """Return the images that show a flat board, or a flat list of a network, from the other side than most."""
    if problem.rig == "cmm":
        return []
    points = problem.sighted.targets.points[np.unique(problem.sighted.target)]
    views = problem.blocks[camera.VIEW].values
    few = on_the_other_side((poses.inverse(views) if problem.rig == "board" else views)[:, :3], points)
    few &= problem.blocks[camera.VIEW].free.any(axis=1)  # an image that lost all readings has no pose
    return [name for name, there in zip(problem.sighted.images, few, strict=True) if there]


def on_the_other_side(places: Array, points: Array) -> Mask:
    """Return which places of a camera (n, 3) are on the other side of flat targets (m, 3) than most."""
    frame, planar = plane_frame(points)
    there = poses.apply(frame, places)[:, 2] > 0
    return np.asarray((there if 2 * there.sum() <= len(there) else ~there) & planar)


def _rolled(values: Array, rig: str) -> Array:
    """Return poses of views after a turn of the camera by 180 degrees about its viewing axis."""
    half = poses.pose(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    turns = np.broadcast_to(half, values.shape)
    return poses.compose(turns, values) if rig == "board" else poses.compose(values, turns)


def _on_the_other_side(problem: CameraProblem, adjusted: AdjustedImages, columns: list[int]) -> Mask:
    """Return the images whose own principal point is on the other side of the middle than that of most, (images,).

    Each image has its own principal point here, by one linear step with its pose and the rest of the lens held.
    """
    solution, count = adjusted.solution, len(problem.sighted.images)
    linear = adjusted.group.linear(solution.blocks, frozenset((camera.LENS, camera.VIEW)))
    jacobians = {touch.block: touch.jacobian for touch in linear.touches}
    view = adjusted.group.observations.index[camera.VIEW]
    middle = (np.array(problem.image_size) - 1) / 2
    offset, weight = np.zeros((count, 2)), np.zeros((count, 2, 2))
    common = solution.blocks[camera.LENS].values[0, columns] - middle
    for i in np.flatnonzero(np.bincount(view, minlength=count) > _FEWEST).tolist():
        mine = view == i
        by_point = np.moveaxis(jacobians[camera.LENS][:, columns][:, :, mine], 1, 2).reshape(-1, 2)
        by_pose = np.moveaxis(jacobians[camera.VIEW][:, :, mine], 1, 2).reshape(-1, 6)
        both = np.column_stack([by_point, linear.residual[:, mine].ravel()])
        # without what its pose takes up: a shift of the principal point is nearly a turn of the camera
        left = both - by_pose @ np.linalg.lstsq(by_pose, both, rcond=None)[0]
        weight[i] = left[:, :2].T @ left[:, :2]
        offset[i] = common + np.linalg.lstsq(left[:, :2], left[:, 2], rcond=None)[0]
    scale = solution.cost / max(solution.dof, 1)
    # one direction through the middle separates the two halves: the one along which the points lie farthest apart
    along = np.linalg.eigh(_spread(offset, weight))[1][:, -1]
    position, information = offset @ along, np.einsum("a,iab,b->i", along, weight, along) / scale
    side = position > 0
    few = side if 2 * side.sum() <= count else ~side
    total = float(information[few].sum())
    if total <= 0:
        return np.zeros(count, dtype=bool)
    mean = abs(float((information * position)[few].sum() / total))
    apart = mean * np.sqrt(total) > _CERTAIN and _are_two(position, information)
    return few if apart else np.zeros(count, dtype=bool)


def _are_two(position: Array, information: Array) -> bool:
    """Return whether positions stand at two places, as far on one side of 0 as on the other.

    Any that scatter about 0 have a mean on either side: 0.64 of the squares of normal ones are those of the two means.
    A smooth shape of the lens, or a bent board, makes them scatter far beyond their uncertainty.
    """
    seen = information > 0
    count, far = int(seen.sum()), np.abs(position)
    middle = float(information @ far / information.sum())
    between, within = float(information.sum()) * middle**2, float(information @ (far - middle) ** 2)
    return between > _BETWEEN * count and within - count < _WITHIN * between


def _spread(offset: Array, weight: Array) -> Array:
    """Return the weighted sum of squares of offsets (n, 2), (2, 2)."""
    each = np.einsum("iaa->i", weight)
    return np.asarray((offset * each[:, None]).T @ offset)
