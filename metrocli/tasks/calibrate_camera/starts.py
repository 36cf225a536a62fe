"""Starts of calibrations: unknown targets by poses and poses by targets, and the two poses of a flat board far away.

Method: docs/algorithms/robust-start.md (unknown targets).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from metrocli.adjust.adjustment import StoppingRule, adjust
from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.robust import gross, robust_start
from metrocli.arrays import Array, Mask
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments import camera
from metrocli.instruments.camera import VIEW
from metrocli.instruments.lenses.distortion import PRISM, TILT
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.shared.images.adjustment import IMAGES
from metrocli.tasks.shared.images.middle import POINT, held_in_the_middle

_AGAIN = 3
"""Most starts from poses found anew, if targets or images strayed"""
_STEPS = 15
"""Most steps in which targets follow poses"""
_FOCAL = ("f", "fx", "fy")


Resection = Callable[[CameraProblem, Array], CameraProblem]
"""Takes a calibration and places of its targets (n, 3), and returns it with poses found anew by these targets"""


def robustly(problem: CameraProblem) -> CameraProblem:
    """Adjust with weights that gross errors do not spoil.

    The unknown targets of a network follow poses that the listed ones gave. While lens and poses are far off, a target
    that is free as well can move so far that all its readings are given up.
    """
    if problem.rig == "network" and _has_unknown(problem):
        problem = _by_turns(problem)
    return problem.with_blocks({**problem.blocks, **_robust(problem, problem.blocks, problem.datum)})


def about_the_middle(problem: CameraProblem) -> CameraProblem:
    """Return the better of two robust adjustments where a term of the lens shifts images as the principal point does.

    The second starts from a principal point in the middle of the image.
    """
    lens = problem.blocks[camera.LENS]
    free = {name for name, is_free in zip(lens.columns, lens.free[0], strict=True) if is_free}
    if not free & {*PRISM, *TILT} or not free & {*POINT}:
        return problem
    held = held_in_the_middle(
        problem.blocks, problem.image_size, lambda blocks: _robust(problem, blocks, problem.datum)
    )
    both = robustly(problem), robustly(problem.with_blocks(held))
    distances = [np.abs(solution.images.residuals(solution.blocks)) for solution in both]
    # beyond three robust standard deviations of the better one all errors count alike
    most = 3 * 1.4826 * min(float(np.median(distance)) for distance in distances)
    return both[int(np.argmin([float((np.minimum(distance, most) ** 2).sum()) for distance in distances]))]


def without_strays(listed: Array, best: CameraProblem, resected: Resection) -> CameraProblem:
    """Return the best of several starts: `best`, and while targets or images stray, one from poses found anew.

    The poses are those by its targets; targets that stray are back at their listed places (n, 3).
    """
    for _ in range(_AGAIN if _has_unknown(best) else 0):
        targets, count = _strayed(best, camera.TARGET), _strays(best)
        if not count:
            break
        places = np.where(targets[:, None], listed, best.blocks[camera.TARGET].values)
        again = robustly(resected(best, places))
        if _strays(again) >= count:
            break
        best = again
    return best


def _has_unknown(problem: CameraProblem) -> bool:
    return bool(problem.blocks[camera.TARGET].free.any())


def _by_turns(problem: CameraProblem) -> CameraProblem:
    """Return a calibration with poses and the focal length for its targets as they are, then targets for these."""
    lens = problem.blocks[camera.LENS]
    focal = replace(lens, free=lens.free & np.isin(lens.columns, _FOCAL))
    held = {camera.LENS: focal, camera.TARGET: problem.blocks[camera.TARGET].fixed()}
    problem = _valued(problem, _robust(problem, {**problem.blocks, **held}))
    held = {name: block.fixed() for name, block in problem.blocks.items() if name != camera.TARGET}
    blocks = {**problem.blocks, **held}
    # a target has its own readings only: one that wrong readings spoil spoils no other
    solution = adjust(
        blocks.values(), [problem.images, *problem.others], None, StoppingRule(limit=_STEPS, covariance=False)
    )
    placed = _valued(problem, solution.blocks)
    astray = _strayed(placed, camera.TARGET)
    if not astray.any():
        return placed
    # one wrong reading pulls a target away from all of its right ones, which meet at another place
    robust = _valued(problem, _robust(problem, blocks))
    meet = (astray & ~_strayed(robust, camera.TARGET))[:, None]
    places = np.where(meet, *(each.blocks[camera.TARGET].values for each in (robust, placed)))
    return placed.with_blocks({**placed.blocks, camera.TARGET: placed.blocks[camera.TARGET].with_values(places)})


def _robust(problem: CameraProblem, blocks: Mapping[str, Block], datum: Datum | None = None) -> Mapping[str, Block]:
    return robust_start(blocks.values(), [problem.images, *problem.others], (IMAGES,), datum, camera.VIEW)


def _valued(problem: CameraProblem, blocks: Mapping[str, Block]) -> CameraProblem:
    """Return a calibration with the values that were found, and with its own unknowns."""
    return problem.with_blocks({name: block.with_values(blocks[name].values) for name, block in problem.blocks.items()})


def _strays(problem: CameraProblem) -> int:
    """Return the number of unknown targets and of images that most of their readings contradict."""
    return int(_strayed(problem, camera.TARGET).sum() + _strayed(problem, camera.VIEW).sum())


def _strayed(problem: CameraProblem, name: str) -> Mask:
    """Return the members of a block with unknowns (n,) that most of their readings contradict."""
    block, index = problem.blocks.get(name), problem.images.observations.index.get(name)
    if block is None or index is None:
        return np.zeros(0, dtype=bool)
    far = np.bincount(index, gross(problem.images, problem.blocks) > 0, minlength=len(block.members))
    return np.asarray(block.free.any(axis=1) & (2 * far > np.bincount(index, minlength=len(block.members))))


_FAR = 0.2
"""Boards smaller than this share of their distance are checked; on nearer ones perspective decides."""
ALIKE = 4.0
"""A smaller difference of the sums of squares, in units of the declared variance, does not decide between the poses."""


@dataclass(frozen=True)
class ChosenViews:
    """Views with the better of their two poses."""

    views: Block
    undecided: tuple[str, ...]
    """Images whose two poses differ but fit about equally well"""


def better_poses(blocks: dict[str, Block], images: Group, board: Array, normal: Array) -> ChosenViews:
    """Return the views, each with its pose or with the mirrored one, whichever fits better with the lens held fixed.

    The mirror image of the board's normal n about the line of sight s is `2 (s n) s - n` (Schweighofer and Pinz 2006).
    `board` are the targets (m, 3) and `normal` is the normal of their plane, both in the frame of the board.
    """
    views = blocks[VIEW]
    extent = float(np.linalg.norm(np.ptp(board, axis=0)))
    middle = poses.apply(views.values, board.mean(axis=0))
    far = extent < _FAR * np.linalg.norm(middle, axis=1)
    if not far.any():
        return ChosenViews(views, ())
    turned = replaced(views, poses.mirrored_about(views.values, middle, board.mean(axis=0), normal), far)
    held = [*(block.fixed() for name, block in blocks.items() if name != VIEW), turned]
    other = adjust(held, [images], None, StoppingRule(limit=30, covariance=False)).blocks[VIEW]
    here, there = (_costs({**blocks, VIEW: views_}, images) for views_ in (views, other))
    better = far & (there < here)
    apart = np.linalg.norm(poses.difference(views.values, other.values)[:, 3:], axis=1) > 0.1
    seen = np.isfinite(here) & np.isfinite(there)
    undecided = far & apart & (np.abs(np.where(seen, there, np.inf) - np.where(seen, here, 0.0)) < ALIKE)
    return ChosenViews(replaced(views, other.values, better), tuple(np.array(views.members)[undecided].tolist()))


def replaced(views: Block, values: Array, chosen: Mask) -> Block:
    """Return the block with other values for the chosen members."""
    return views.with_values(np.where(chosen[:, None], values, views.values))


def _costs(blocks: dict[str, Block], images: Group) -> Array:
    """Return the whitened sum of squares of each view; infinite if a point is behind the camera."""
    residual = images.observations.whitened(images.residuals(blocks))
    square = np.nan_to_num((residual**2).sum(axis=0), nan=np.inf)
    costs = np.bincount(images.observations.index[VIEW], square, len(blocks[VIEW].members))
    return np.asarray(costs, dtype=float)
