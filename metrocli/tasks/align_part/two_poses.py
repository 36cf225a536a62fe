"""The two poses of a part whose targets lie in one plane: images from afar fit its tilt and the mirrored tilt alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrocli.adjust.adjustment import StoppingRule, adjust
from metrocli.arrays import Array
from metrocli.errors import UndeterminedError
from metrocli.geometry import poses
from metrocli.instruments import spindle_camera as spindle
from metrocli.instruments.camera import TAPER
from metrocli.tasks.align_part.problem import AlignmentProblem
from metrocli.tasks.shared.images.adjustment import AdjustedImages

_FLAT = 0.1
"""Targets whose thickness is below this share of their extent lie nearly in one plane"""
_ALIKE = 10.83
"""Difference of chi-square up to which both poses fit alike: 0.1 % of chance, one degree of freedom"""
_APART = 6.0
"""Standard uncertainties from which two poses are not the same"""


def mirrored_pose(problem: AlignmentProblem, adjusted: AdjustedImages) -> AlignmentProblem | None:
    """Return the problem at the mirrored pose of the part where that fits better; None where the pose found is right.

    Raises UndeterminedError if both fit alike.
    """
    solution = adjusted.solution
    points = problem.sighted.targets.points[np.unique(problem.sighted.target)]
    _, thick, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    if not solution.outcome.good or thick[2] > _FLAT * thick[1]:
        return None
    part, angle = solution.blocks[spindle.PART], float(solution.blocks[spindle.COUPLING].values[0, 0])
    camera_poses = spindle.camera_in_machine(
        solution.blocks[spindle.SPINDLE].values, angle, solution.blocks[TAPER].values[0]
    )
    centre = points.mean(axis=0)
    sight = (poses.apply(part.values, centre) - camera_poses[:, :3].mean(axis=0)).reshape(1, 3)
    mirrored = part.with_values(poses.mirrored_about(part.values, sight, centre, axes[2]))
    # mirrored about the mean line of sight only a start: the adjustment finds the second minimum, if there is one
    turned = {**solution.blocks, spindle.PART: mirrored}
    other = adjust(turned.values(), solution.groups, problem.datum, StoppingRule(limit=60, covariance=False))
    step = poses.difference(other.blocks[spindle.PART].values, part.values)[0]
    apart = float(np.linalg.norm(step[3:])) > _APART * float(np.linalg.norm(solution.std(spindle.PART)[0, 3:]))
    # in units of the noise that the residuals show, if that is larger: a wrong sigma must not decide between poses
    change = (other.cost - solution.cost) / max(1.0, float(np.nan_to_num(solution.sigma0, nan=1.0))) ** 2
    if not apart or not np.isfinite(other.cost) or change > _ALIKE:
        return None
    if change < -_ALIKE:
        return replace(problem, model=problem.model.with_blocks({**problem.blocks, **other.blocks}))
    raise UndeterminedError(_alike(part.values[0], other.blocks[spindle.PART].values[0]), 0.0)


def _alike(first: Array, other: Array) -> str:
    one, two = (np.degrees(poses.euler_form(pose)[3:]) for pose in (first, other))
    words = (f"alpha {a:.2f}, beta {b:.2f}, gamma {c:.2f} deg" for a, b, c in (one, two))
    return (
        "the images fit two poses of the part alike, since its targets lie nearly in one plane and are small or far "
        "away:\n" + "\n".join(f"  {text}" for text in words) + "\n  what decides: images from positions further apart "
        "or nearer, or a target out of the plane"
    )
