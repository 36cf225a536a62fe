"""Where the ideal part lies before the fit: many rotations are refined at once, and the one that fits best is taken.

With the surfaces of the points named, the rotations cover all of space. Otherwise they cover 10 degrees about the
start, and each point belongs to the surface that is nearest to it at the time.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.geometry import poses
from metrocli.geometry.rotations import rotation_from_vector

_ANYWHERE = 200
"""Random rotations tried if surfaces are named; neighbours are about 30 degrees apart"""
_NEAR = np.radians(8.0)
"""Spacing of the rotations about a given start"""
_USED = 150
"""Points used to refine the rotations, at most"""
_FIRST, _ITERATIONS = 10, 30
"""Iterations of all rotations, and of those that fit best by then"""
_KEPT = 3
"""One rotation of so many is iterated to the end"""
_TURN = 0.3
"""Largest turn of one iteration [rad]"""
_DAMPING = 1e-3
"""Damping of a step relative to its normal equations: points that leave a motion open do not run along it"""
_ALIKE = 2.0
"""Ratio of the typical distances up to which two solutions fit alike"""


class Sought(Protocol):
    """The ideal geometry, as the search needs it."""

    @property
    def middle(self) -> Array:
        """Middle of the part (3,)."""

    def quick(self, points: Array, surface: Index | None) -> tuple[Array, Array]:
        """Return distances and normals at points (B, n, 3), each on its surface (n,), or on the nearest if None."""

    def off_centre(self, points: Array, surface: Index | None) -> float:
        """Return how far the points of each surface are from the point that the nominal gives of it [mm]."""


def searched_pose(
    nominal: Sought, measured: Array, surface: Index | None, start: Array, seed: int = 1, rotations: Array | None = None
) -> Array:
    """Return the pose (6,) that brings measured points (n, 3) roughly onto their surfaces.

    `start` (6,) is the pose into the part frame that the job gives, or that of equal frames. `rotations` (k, 3, 3) are
    tried instead of those that cover space.
    """
    rng = np.random.default_rng(seed)
    rows = _spread(len(measured), surface, rng)
    points, labels = measured[rows], None if surface is None else surface[rows]
    if rotations is None:
        rotations = _around(poses.rotation_of(start), named=surface is not None, rng=rng)
    rotations, shifts = _candidates(nominal, points, start, rotations)
    rotations, shifts = _refined(nominal, points, labels, rotations, shifts)
    placed = _placed(points, rotations, shifts)
    distance, _ = nominal.quick(placed, labels)
    typical = _typical(distance, labels)
    alike = np.flatnonzero(typical <= _ALIKE * typical.min())
    off = np.array([nominal.off_centre(placed[number], labels) for number in alike])
    # of those next to the best off-centre distance, the one that fits best
    near = alike[off <= 1.5 * off.min() + typical.min()]
    best = near[np.argmin(typical[near])]
    return poses.pose(rotations[best], shifts[best])


def _spread(n: int, surface: Index | None, rng: np.random.Generator) -> Index:
    """Return the rows of some points, of every surface alike."""
    order = rng.permutation(n)
    if surface is None or n <= _USED:
        return order[:_USED]
    each = max(_USED // len(np.unique(surface)), 6)
    return np.concatenate([order[surface[order] == number][:each] for number in np.unique(surface)])


def _around(given: Array, named: bool, rng: np.random.Generator) -> Array:
    """Return rotations (k, 3, 3): all of space if the surfaces are named, otherwise those near the given one (3, 3)."""
    if named:
        # four normal numbers have no direction before others: these are evenly spread rotations
        quaternions = rng.normal(size=(_ANYWHERE, 4))
        return np.concatenate([given[None], _rotations(quaternions)])
    grid = np.stack(np.meshgrid(*[[-_NEAR, 0.0, _NEAR]] * 3), axis=-1).reshape(-1, 3)
    return np.asarray(rotation_from_vector(grid) @ given)


def _candidates(nominal: Sought, points: Array, start: Array, rotations: Array) -> tuple[Array, Array]:
    """Return rotations (B, 3, 3) and shifts (B, 3) to try: the middles of points and part on each other."""
    shifts = _middle_on_middle(nominal, points, rotations)
    # points on one side of the part have another middle than it has: the given shift is tried as well
    beside = np.broadcast_to(start[:3], shifts.shape)
    return np.concatenate([rotations, rotations]), np.concatenate([shifts, beside])


def unturned(nominal: Sought, measured: Array, start: Array) -> Array:
    """Return `start`, or the pose with its rotation and the middles of points and part on each other (6,).

    The one that leaves the points nearer to the part: the middle of points on one side is not that of the part.
    """
    given = poses.rotation_of(start)
    tried = [start, poses.pose(given, _middle_on_middle(nominal, measured, given[None])[0])]
    rows = _spread(len(measured), None, np.random.default_rng(1))
    distance, _ = nominal.quick(np.stack([poses.apply(pose, measured[rows]) for pose in tried]), None)
    return tried[int(np.median(np.abs(distance), axis=1).argmin())]


def _middle_on_middle(nominal: Sought, points: Array, rotations: Array) -> Array:
    turned = points[None] @ np.swapaxes(rotations, 1, 2)
    return np.asarray(nominal.middle - (turned.max(axis=1) + turned.min(axis=1)) / 2)


def _rotations(quaternions: Array) -> Array:
    w, x, y, z = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    half = np.arctan2(np.sqrt(x**2 + y**2 + z**2), w)
    axis = np.stack([x, y, z], axis=1) / np.sin(half)[:, None]
    return rotation_from_vector(2 * half[:, None] * axis)


def _placed(points: Array, rotations: Array, shifts: Array) -> Array:
    return points[None] @ np.swapaxes(rotations, 1, 2) + shifts[:, None, :]


def _typical(distance: Array, labels: Index | None) -> Array:
    """Return the typical distance of each pose (B,): the median, of named surfaces the geometric mean of their medians.

    A median of all points would take a part that is laid on the wrong side of one surface, if the others fit exactly;
    a plain mean one that lies between all surfaces, if the names of two are exchanged.
    """
    size = np.abs(distance)
    if labels is None:
        return np.asarray(np.median(size, axis=1))
    medians = [np.median(size[:, labels == number], axis=1) for number in np.unique(labels)]
    return np.asarray(np.exp(np.mean(np.log(np.maximum(medians, 1e-9)), axis=0)))


def _refined(
    nominal: Sought, points: Array, labels: Index | None, rotations: Array, shifts: Array
) -> tuple[Array, Array]:
    """Return the rotations and shifts after damped Gauss-Newton steps; distant points count less and less."""
    damping = np.eye(6) * _DAMPING
    for iteration in range(_ITERATIONS):
        placed = _placed(points, rotations, shifts)
        distance, normal = nominal.quick(placed, labels)
        if iteration == _FIRST:
            best = np.argsort(_typical(distance, labels))[: max(len(rotations) // _KEPT, 1)]
            rotations, shifts, placed = rotations[best], shifts[best], placed[best]
            distance, normal = distance[best], normal[best]
        centre = placed.mean(axis=1, keepdims=True)
        arms = placed - centre
        lever = np.sqrt((arms**2).sum(axis=2).mean(axis=1))[:, None, None] + 1e-9  # points may be all the same
        rows = np.concatenate([normal, np.cross(arms, normal) / lever], axis=2)
        scale = 3 * np.median(np.abs(distance), axis=1, keepdims=True) + 1e-9
        weighted = rows * (1 / (1 + (distance / scale) ** 2))[:, :, None]
        normals = np.swapaxes(weighted, 1, 2) @ rows
        size = np.trace(normals, axis1=1, axis2=2)[:, None, None]
        right = -(np.swapaxes(weighted, 1, 2) @ distance[:, :, None])
        step = np.linalg.solve(normals + damping * size, right)[:, :, 0]
        turn = step[:, 3:] / lever[:, :, 0]
        angle = np.linalg.norm(turn, axis=1, keepdims=True)
        # normals are those of the surface that is near now, and a longer turn leads to others
        turn = turn * np.minimum(1.0, _TURN / np.maximum(angle, 1e-12))
        by = rotation_from_vector(turn)
        middle = centre[:, 0]
        shifts = (by @ (shifts - middle)[:, :, None])[:, :, 0] + middle + step[:, :3]
        rotations = by @ rotations
    return rotations, shifts
