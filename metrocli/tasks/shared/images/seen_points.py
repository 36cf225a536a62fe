"""The points of a network of images with their covariance, and the rays that see them."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.quantities import Quantity
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array, Index
from metrocli.instruments import camera
from metrocli.table import Table
from metrocli.tasks.shared.joint_covariance import factors
from metrocli.uncertainty.predicted import POINTS_COVARIANCE


def with_places(targets: Table, solution: Solution) -> Table:
    """Return the table of targets with their coordinates, as listed or as adjusted."""
    block = solution.blocks[camera.TARGET]
    row = {name: number for number, name in enumerate(block.members)}
    return targets.joined({"x y z [mm]": block.values[[row[name] for name in targets.texts("target")]]})


def depths(group: Group, solution: Solution) -> Array:
    """Return how far before its camera each target is, along the optical axis, for each reading (n,) [mm]."""
    to_camera = group.chain.until(Quantity.POINT_IN_CAMERA)
    return np.asarray(to_camera.predict({**solution.blocks}, group.observations)[2])


def points_of(solution: Solution, target: Index, origins: Array) -> tuple[Table, dict[str, Array]]:
    """Return the coordinates of the targets that are seen, with their rays, and the arrays of their covariance.

    `target` (readings,) and `origins` (readings, 3) are the target of each reading and the place that sees it.
    """
    block, covariance = solution.blocks[camera.TARGET], solution.covariance_or_raise()
    each = covariance.members(camera.TARGET)
    std = np.sqrt(np.einsum("mii->mi", each))
    rays = np.bincount(target, minlength=len(block.members))
    known = rays > 0
    table = Table.of(
        {
            "point": np.array(block.members)[known],
            "x y z [mm]": block.values[known],
            "sx sy sz [mm]": std[known],
            "rays": rays[known],
            "ray_angle [rad]": _ray_angles(block.values, target, origins)[known],
        }
    )
    return table, {POINTS_COVARIANCE: each[known], **factors(covariance, camera.TARGET, known)}


def _ray_angles(points: Array, target: Index, origins: Array) -> Array:
    """Return the largest angle [rad] between two rays of each target, 0 for a single ray."""
    angles = np.zeros(len(points))
    for i in np.unique(target):
        rays = origins[target == i] - points[i]
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        angles[i] = np.arccos(np.clip((rays @ rays.T).min(), -1.0, 1.0))
    return angles
