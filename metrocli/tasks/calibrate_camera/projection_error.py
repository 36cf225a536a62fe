"""How well a camera model projects where no reading is: the standard uncertainty of a corner of the image."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.solution import Solution
from metrocli.arrays import Array, Index
from metrocli.effects.links.lens_shape import LensShape
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments import camera
from metrocli.instruments.camera_start import plane_frame
from metrocli.instruments.lenses.lens import equidistant, focal, ideal_point, image_point, unit_vector
from metrocli.table import Table
from metrocli.tasks.calibrate_camera.lens_conventions import coverage
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.calibrate_camera.shape.found import by_shape
from metrocli.tasks.shared.statistics import Statistics
from metrocli.units.people import two_digits

_STEP = 1e-6
"""Relative step of central differences: near the cube root of the rounding of a double, where their error is least"""
_ONE_ANGLE = np.radians(10.0)
"""Boards whose normals are all nearer to the mean normal than this are shown at one angle"""
_VAGUE_FOCAL_LENGTH = 1e-3
"""Relative uncertainty of a focal length from which one angle of all boards is a warning"""
_VAGUE_CORNER = 0.01
"""Uncertainty of a corner, as a share of the width of the image, from which it is a warning"""
_GRID = (17, 13)
"""Columns and rows of places over the image"""
_SAMPLE = 400
"""Most readings that determine which movement of the camera a change of the lens imitates: it has six numbers"""
_MULTIPLES = np.linspace(0.01, 4.0, 400)
"""Directions that are tried for an image point, as multiples of its direction without distortion"""


@dataclass(frozen=True)
class SolvedCamera:
    """A camera of a solution, or one of several, with its readings."""

    name: str
    """Empty for a single one"""
    number: int
    """Number of its member of the block of lenses"""
    convention: str
    size: tuple[int, int]
    shape: LensShape | None
    readings: Array
    """Image points (2, n) [px]"""


def coverage_statistics(solution: Solution, solved: SolvedCamera) -> Statistics:
    """Return the statistics of how much of the image the readings cover, and how well it is known beyond.

    `corner_std` [px] is the largest standard uncertainty of the image of a fixed direction in a corner of the image.
    """
    projection, size = _projection(solution, solved), solved.size
    lens = projection.lens.named(projection.lens.values)
    corners = np.array([[x, y] for x in (0, size[0] - 1) for y in (0, size[1] - 1)], dtype=float).T
    return {
        **coverage(projection.readings, size, (lens["cx"], lens["cy"])),
        "corner_std": float(projection.std(corners).max()),
        "image_width": size[0],
        "image_height": size[1],
    }


def projection_table(solution: Solution, solved: SolvedCamera, depth: float) -> Table:
    """Return u, v and the standard uncertainty [px] of the images of fixed points at a distance, over the image."""
    axes = [np.linspace(0, extent - 1, n) for extent, n in zip(solved.size, _GRID, strict=True)]
    uv = np.stack([grid.ravel() for grid in np.meshgrid(*axes)])
    name = {"camera [text]": [solved.name] * uv.shape[1]} if solved.name else {}
    return Table.of({**name, "u v [px]": uv.T, "std [px]": _projection(solution, solved).std(uv, depth)})


def _projection(solution: Solution, solved: SolvedCamera) -> _Projection:
    """Return the projection by a camera, with the shape of its lens."""
    lens, covariance = solution.blocks[camera.LENS], solution.covariance_or_raise()
    free = np.flatnonzero(lens.free[solved.number])
    joint = np.asarray(covariance.members(camera.LENS)[solved.number][np.ix_(free, free)])
    if solved.shape is not None:
        cross = covariance.between(camera.LENS, solved.shape.block)[solved.number * len(lens.columns) + free]
        joint = np.block([[joint, cross], [cross.T, covariance.of(solved.shape.block)]])
    derivatives = _LensDerivatives(solved.convention, lens.columns, lens.values[solved.number])
    return _Projection(derivatives, free, joint, solved.readings, solved.shape)


@dataclass(frozen=True)
class _Projection:
    """A lens with the covariance of its free parameters, and of its shape, and the readings (2, n) that gave it."""

    lens: _LensDerivatives
    free: Index
    covariance: Array
    readings: Array
    shape: LensShape | None = None

    def std(self, at: Array, depth: float = np.inf) -> Array:
        """Return the standard uncertainty (n,) [px] of the images of fixed points at image points (2, n).

        J is the derivative of image points by the lens parameters p, at these points c and at readings r, and T that
        by a movement of the camera. The uncertainty is that of `(J_c - T_c T_r^+ J_r) dp`. A movement of the camera
        changes no measurement, and a shift of the principal point is nearly one (mrcal, projection uncertainty).
        Points are at a `depth` along the axis; at an infinite one the camera is turned only.
        """
        if not len(self.free):
            return np.zeros(at.shape[1])
        count = self.readings.shape[1]
        # by their places: by their rows in the file the sample, and so the result, would depend on the order of these
        placed = self.readings[:, np.lexsort(self.readings)]
        sample = placed[:, np.linspace(0, count - 1, min(count, _SAMPLE)).astype(int)]
        seen, directions = self.lens.directions(sample), self.lens.directions(at)
        movement = np.linalg.lstsq(self.lens.by_movement(seen, depth), self._by_lens(sample, seen), rcond=None)[0]
        change = self._by_lens(at, directions) - self.lens.by_movement(directions, depth) @ movement
        variance = np.einsum("ia,ab,ib->i", change, self.covariance, change)
        return np.asarray(np.sqrt(np.maximum(variance.reshape(2, -1).sum(axis=0), 0.0)))

    def _by_lens(self, uv: Array, directions: Array) -> Array:
        of_lens = self.lens.by_lens(uv, directions, self.free)
        return of_lens if self.shape is None else np.concatenate([of_lens, by_shape(self.shape, uv)], axis=1)


@dataclass(frozen=True)
class _LensDerivatives:
    """Derivatives of image points of fixed directions, u of all before v of all."""

    convention: str
    columns: tuple[str, ...]
    values: Array

    def named(self, values: Array) -> dict[str, float]:
        """Return values of the parameters by their names."""
        return dict(zip(self.columns, values.tolist(), strict=True))

    def directions(self, uv: Array) -> Array:
        """Return the directions of image points, (2, n), the nearest to the optical axis that the lens maps there.

        A polynomial may have further ones beyond its fold; where it folds before the image point, that of the fold.
        """
        lens = self.named(self.values)
        if self.convention == "backward":
            return np.array(ideal_point(lens, uv[0], uv[1], self.convention))
        fx, fy = focal(lens)
        centre = np.array([[lens["cx"]], [lens["cy"]]])
        undistorted = (uv - centre) / [[fx], [fy]]
        tried = undistorted[:, :, None] * _MULTIPLES
        images = np.array(image_point(lens, tried[0], tried[1], self.convention == "fisheye")) - centre[:, :, None]
        radii, radius = np.hypot(*images), np.hypot(*(uv - centre))
        # 1 up to the fold: beyond it the radius shrinks, and further directions have the same image
        before_fold = np.cumprod(np.diff(radii, axis=1, prepend=0.0) > 0, axis=1)
        last = np.maximum((before_fold * (radii < radius[:, None])).sum(axis=1), 1) - 1
        rows, after = np.arange(len(last)), np.minimum(last + 1, len(_MULTIPLES) - 1)
        # linear between two that were tried; where the radius does not grow any more, the last one before the fold
        step = radii[rows, after] - radii[rows, last]
        share = np.where(step > 0, (radius - radii[rows, last]) / np.where(step > 0, step, 1.0), 0.0)
        return np.asarray(undistorted * (_MULTIPLES[last] + np.clip(share, -1, 1) * (_MULTIPLES[1] - _MULTIPLES[0])))

    def image(self, values: Array, uv: Array, directions: Array) -> Array:
        """Return the images (2 n,) of directions (2, n) by a lens of these values; `uv` are those by its own."""
        lens = self.named(values)
        if self.convention != "backward":
            return np.concatenate(image_point(lens, directions[0], directions[1], self.convention == "fisheye"))
        # this lens corrects measured points: the change of the direction of a fixed pixel, in pixels
        fx, fy = focal(lens)
        x, y = ideal_point(lens, uv[0], uv[1], self.convention)
        return np.concatenate([fx * x, fy * y])

    def by_lens(self, uv: Array, directions: Array, free: Index) -> Array:
        """Return the derivatives by the lens parameters, (2 n, k)."""
        columns = []
        for k in free.tolist():
            step = np.zeros(len(self.values))
            step[k] = _STEP * max(abs(self.values[k]), 1.0)
            ahead, behind = (self.image(self.values + sign * step, uv, directions) for sign in (1, -1))
            columns.append((ahead - behind) / (2 * step[k]))
        return np.stack(columns, axis=1)

    def by_movement(self, directions: Array, depth: float) -> Array:
        """Return the derivatives by a rotation of the camera about x, y and z, and by a shift, by differences.

        For directions (2, n) they are (2 n, 6), the shift in units of the depth [mm]; (2 n, 3) at an infinite depth.
        Points of a fisheye are at one distance: those of a wide angle have no depth along the axis.
        """
        axes = np.eye(3) * _STEP
        fisheye = self.convention == "fisheye"
        points = unit_vector(directions) if fisheye else np.stack([*directions, np.ones(len(directions[0]))])
        moves = [np.cross(axis, points, axisb=0, axisc=0) for axis in axes]
        if np.isfinite(depth):
            moves += [np.broadcast_to(axis[:, None], points.shape) for axis in axes]
        columns = []
        for moved in moves:
            ahead, behind = (self._image_of_points(points + sign * moved) for sign in (1, -1))
            columns.append((ahead - behind) / (2 * _STEP))
        return np.stack(columns, axis=1)

    def _image_of_points(self, points: Array) -> Array:
        """Return the image points (2 n,) of points (3, n); of a backward lens without distortion, as in `image`."""
        lens, fisheye = self.named(self.values), self.convention == "fisheye"
        ideal = equidistant(points) if fisheye else None
        x, y = (ideal.x, ideal.y) if ideal is not None else points[:2] / points[2]
        if self.convention == "backward":
            fx, fy = focal(lens)
            return np.concatenate([fx * x, fy * y])
        return np.concatenate(image_point(lens, x, y, fisheye))


def coverage_note(statistics: Statistics) -> str:
    """Return how much of the image the readings cover, and how well the model projects in its worst corner."""
    hull, radius, corner = (float(statistics[name]) for name in ("coverage_hull", "coverage_radius", "corner_std"))  # type: ignore[arg-type]
    return (
        f"coverage: readings span {100 * hull:.0f} % of the image, up to {100 * radius:.0f} % of its radius; "
        f"projection into its worst corner: standard uncertainty {two_digits(corner)} px"
    )


def corner_warnings(statistics: Statistics) -> list[str]:
    """Return a warning if the lens is known badly in a corner; `metrocli.doubt` has the bound of a doubt."""
    corner, width = (float(statistics[name]) for name in ("corner_std", "image_width"))  # type: ignore[arg-type]
    if corner <= _VAGUE_CORNER * width:
        return []
    return [
        f"the readings do not reach the corners of the image, where the lens is uncertain by {two_digits(corner)} px "
        "(standard uncertainty): show the target there, or estimate fewer lens parameters"
    ]


def angle_warnings(problem: CameraProblem, std: Array) -> list[str]:
    """Return a warning if all images show a flat board at one angle and the focal length is known badly.

    Boards of one angle exchange focal length and distance. The problem has lens and views of the solution; `std` are
    the standard uncertainties of the lens.
    """
    lens = problem.blocks[camera.LENS]
    free = [i for i, name in enumerate(lens.columns) if name in ("f", "fx", "fy") and lens.free[0, i]]
    frame, planar = plane_frame(problem.sighted.targets.points[np.unique(problem.sighted.target)])
    if problem.rig != "board" or not free or not planar:
        return []
    normals = poses.rotation_of(problem.blocks[camera.VIEW].values) @ poses.rotation_of(frame)[2]
    # a normal and its opposite are one plane
    normals = normals * np.sign(normals @ normals[0])[:, None]
    mean = normals.mean(axis=0) / np.linalg.norm(normals.mean(axis=0))
    angle = float(np.arccos(np.clip(normals @ mean, -1, 1)).max())
    relative_std = std[free] / lens.values[0, free]
    if angle > _ONE_ANGLE or (relative_std < _VAGUE_FOCAL_LENGTH).all():
        return []
    return [
        f"all images show the board at one angle, within {two_digits(float(np.degrees(angle)))} degrees, and the focal "
        f"length is known to {two_digits(100 * float(relative_std.max()))} % only: tilt the board by 20 to 45 degrees "
        "about both axes of the image"
    ]
