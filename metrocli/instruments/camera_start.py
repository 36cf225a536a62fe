"""Starting values of cameras from target coordinates and image points alone."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from metrocli.adjust.allowance import take
from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.geometry.rotations import nearest_rotation
from metrocli.instruments.linear_maps import linear_maps

_FLAT = 1e-3
"""Targets whose thickness is below this share of their extent are treated as coplanar."""

_AS_LONG = 5
"""Steps of an adjustment that take as long as one start"""


@dataclass(frozen=True)
class TargetImages:
    """Image points, each with its target and its view."""

    points: Array
    """Coordinates of the targets, (m, 3) mm"""
    uv: Array
    """Image points, (2, n) px"""
    target: Index
    view: Index
    views: int

    def selected(self, keep: Mask) -> TargetImages:
        """Return the scene with only the image points where `keep` is true."""
        return TargetImages(self.points, self.uv[:, keep], self.target[keep], self.view[keep], self.views)


def plane_frame(points: Array) -> tuple[Array, bool]:
    """Return the pose that transforms the targets' best-fit plane to z = 0, and whether they are coplanar."""
    centre = points.mean(axis=0)
    # three rows of zeros: with one or two points the decomposition has three axes all the same
    spread, axes = np.linalg.svd(np.concatenate([points - centre, np.zeros((3, 3))]), full_matrices=False)[1:]
    # a reflection would mirror the board: the normal takes the other sign
    rotation = nearest_rotation(axes if np.linalg.det(axes) > 0 else np.diag([1.0, 1.0, -1.0]) @ axes)
    return poses.pose(rotation, -rotation @ centre), bool(spread[2] <= _FLAT * spread[1] or len(points) < 4)


def start(
    scene: TargetImages, centre: Array, focal: float | None, guess: float, again: bool = True
) -> tuple[float, Array]:
    """Return the focal length [px] and the poses (views, 6) that transform targets into the frame of each camera.

    Coplanar targets: homographies and the closed form of Zhang (2000), with the principal point at `centre`. Other
    targets: direct linear transformation. `guess` is the focal length used if the views do not determine it. `again` is
    whether views that are astray are tried again, from the 24 rotations of a cube.
    """
    take(_AS_LONG)
    to_plane, planar = plane_frame(scene.points[np.unique(scene.target)])
    local = poses.apply(to_plane, scene.points)
    scale = float(np.abs(local).max()) or 1.0
    local = local / scale
    rays = (scene.uv - centre[:, None]) / guess
    seen = local[scene.target, :2] if planar else local[scene.target]
    maps, keep = linear_maps(np.column_stack([seen, np.ones(len(seen))]), rays, scene.view, scene.views)
    # views with at least as many equations as unknowns: of fewer the map is one of many
    telling = maps[2 * np.bincount(scene.view[keep], minlength=scene.views) >= maps[0].size - 1]
    ratio = focal / guess if focal else (_focal_of_homographies(telling) if planar else _focal_of_projections(telling))
    maps[:, :2] /= ratio
    started = _poses_of_homographies(maps) if planar else _poses_of_projections(maps)
    # wrong readings can turn the map of a board so that its points are behind the camera
    if not planar or not np.isfinite(_misfit(scene.selected(keep), local, rays[:, keep] / ratio, started)).all():
        started = _resected(scene.selected(keep), local, rays[:, keep] / ratio, started, again)
    started[:, :3] *= scale
    return ratio * guess, poses.compose(started, np.broadcast_to(to_plane, started.shape))


def _focal_of_homographies(maps: Array) -> float:
    """Return the focal length, in units of the guess, that fits all homographies best.

    `h1' w h2 = 0` and `h1' w h1 = h2' w h2`, with `w = diag(1/f2, 1/f2, 1)` and f2 = f^2, are linear in 1/f2 (Zhang
    2000).
    """
    h1, h2 = maps[:, :, 0], maps[:, :, 1]
    a = np.concatenate([h1[:, 0] * h2[:, 0] + h1[:, 1] * h2[:, 1], (h1[:, :2] ** 2).sum(1) - (h2[:, :2] ** 2).sum(1)])
    b = np.concatenate([h1[:, 2] * h2[:, 2], h1[:, 2] ** 2 - h2[:, 2] ** 2])
    # each homography has a scale of its own, which must not weight it
    weight = np.tile(1 / np.maximum((h1**2).sum(1) + (h2**2).sum(1), 1e-300), 2)
    a, b = a * weight, b * weight
    inverse_square = -(a @ b) / max(a @ a, 1e-300)
    return _plausible(1 / np.sqrt(inverse_square)) if inverse_square > 0 else 1.0


def _focal_of_projections(maps: Array) -> float:
    """Return the median focal length of the left 3 x 3 parts K R, K = diag(f, f, 1) up to scale."""
    rows = maps[:, :, :3]
    third = (rows[:, 2] ** 2).sum(1)
    along = np.einsum("vab,vb->va", rows[:, :2], rows[:, 2]) / third[:, None]
    square = (rows[:, :2] ** 2).sum(2) / third[:, None] - along**2
    good = square[square > 0]
    return _plausible(float(np.sqrt(np.median(good)))) if good.size else 1.0


def _plausible(ratio: float) -> float:
    """Return the ratio of focal length and guess; 1 if it is implausible, the adjustment then starts at the guess."""
    return ratio if 0.05 < ratio < 50 else 1.0


def _poses_of_homographies(maps: Array) -> Array:
    lengths = np.linalg.norm(maps[:, :, 0], axis=1) + np.linalg.norm(maps[:, :, 1], axis=1)
    # the centre of the board is in front of the camera
    sign = np.where(maps[:, 2, 2] < 0, -1.0, 1.0)
    scaled = maps * (2 * sign / lengths)[:, None, None]
    normal = np.cross(scaled[:, :, 0], scaled[:, :, 1])
    rotation = nearest_rotation(np.stack([scaled[:, :, 0], scaled[:, :, 1], normal], axis=2))
    return poses.pose(rotation, scaled[:, :, 2])


def _poses_of_projections(maps: Array) -> Array:
    determinant = np.linalg.det(maps[:, :, :3])
    # divided by the cube root of the determinant, with its sign: R has determinant 1, and -R would be a reflection
    scaled = maps / (np.cbrt(np.abs(determinant)) * np.where(determinant < 0, -1.0, 1.0))[:, None, None]
    return poses.pose(nearest_rotation(scaled[:, :, :3]), scaled[:, :, 3])


_ITERATIONS = 60
_ASTRAY = 3.0
"""A view is tried again from other rotations if its misfit exceeds this multiple of the median"""
_PROJECTION = 6
"""... or if it has fewer readings than this, too few to start from a projection"""


def _resected(scene: TargetImages, local: Array, rays: Array, start_poses: Array, again: bool) -> Array:
    """Return poses refined in object space.

    A view that ends behind the camera or with a large misfit is tried `again` from the 24 rotations of a cube.
    """
    best = _orthogonal_iteration(scene, local, rays, start_poses)
    misfit = _misfit(scene, local, rays, best)
    few = np.bincount(scene.view, minlength=scene.views) < _PROJECTION
    astray = np.flatnonzero(few | ~np.isfinite(misfit) | (misfit > _ASTRAY * np.median(misfit)))
    if not (again and astray.size):
        return best
    chosen = np.isin(scene.view, astray)
    part = TargetImages(
        scene.points,
        scene.uv[:, chosen],
        scene.target[chosen],
        np.searchsorted(astray, scene.view[chosen]),
        len(astray),
    )
    for rotation in cube_rotations():
        first = poses.pose(np.broadcast_to(rotation, (len(astray), 3, 3)), np.zeros(3))
        attempt = _orthogonal_iteration(part, local, rays[:, chosen], first)
        value = _misfit(part, local, rays[:, chosen], attempt)
        better = value < misfit[astray]
        best[astray[better]], misfit[astray[better]] = attempt[better], value[better]
    return best


def cube_rotations() -> Array:
    """Return the 24 rotations that map a cube onto itself."""
    signed = np.array(
        [np.diag(signs)[list(order)] for signs in product((1.0, -1.0), repeat=3) for order in permutations(range(3))]
    )
    turns: Array = signed[np.linalg.det(signed) > 0]
    return turns


def _misfit(scene: TargetImages, local: Array, rays: Array, pose: Array) -> Array:
    """Return the RMS misfit of each view in the plane Z = 1; infinite if a point is behind the camera."""
    points = poses.apply(pose[scene.view], local[scene.target])
    front = points[:, 2] > 0
    gap = points[:, :2] / np.where(front, points[:, 2], 1.0)[:, None] - rays.T
    square = np.where(front, (gap**2).sum(axis=1), np.inf)
    misfit: Array = np.sqrt(
        np.bincount(scene.view, square, scene.views) / np.maximum(np.bincount(scene.view, minlength=scene.views), 1)
    )
    return misfit


def _orthogonal_iteration(scene: TargetImages, local: Array, rays: Array, start_poses: Array) -> Array:
    """Return poses that bring points onto their rays in object space (Lu, Hager and Mjolsness 2000).

    V is the projection onto a ray. The best shift for a given R is `t = (I - mean V)^-1 mean((V - I) R p)`; the best R
    rotates the points onto `V (R p + t)`. Alternating both converges from almost any start.
    """
    direction = np.stack([*rays, np.ones(rays.shape[1])])
    direction = direction / np.linalg.norm(direction, axis=0)
    project = direction[:, None] * direction[None]
    points = local[scene.target].T
    counts = np.maximum(np.bincount(scene.view, minlength=scene.views), 1)
    # of each view once: it depends on the rays alone
    gain = np.linalg.inv(np.eye(3) - _sums(project.reshape(9, -1), scene).reshape(-1, 3, 3) / counts[:, None, None])
    centre = _sums(points, scene) / counts[:, None]
    rotation = poses.rotation_of(start_poses)
    shift = start_poses[:, :3]
    for _ in range(_ITERATIONS):
        turned = np.einsum("nab,bn->an", rotation[scene.view], points)
        missing = np.einsum("abn,bn->an", project, turned) - turned
        shift = (gain @ (_sums(missing, scene) / counts[:, None])[:, :, None])[:, :, 0]
        goal = np.einsum("abn,bn->an", project, turned + shift[scene.view].T)
        moment = _sums((goal[:, None] * points[None]).reshape(9, -1), scene).reshape(-1, 3, 3)
        moment -= _sums(goal, scene)[:, :, None] * centre[:, None, :]
        rotation = nearest_rotation(moment)
    return poses.pose(rotation, shift)


def _sums(values: Array, scene: TargetImages) -> Array:
    """Return the sums of values (c, n) over the readings of each view, (views, c)."""
    return np.stack([np.bincount(scene.view, row, scene.views) for row in values], axis=1)
