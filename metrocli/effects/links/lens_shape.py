"""The shape of a lens that no polynomial has: a smooth shift of image points over the image, on knots.

Uniform cubic B-splines (de Boor, A Practical Guide to Splines). Beyond the image the shift is that at its border.
"""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.chain import LinkContext, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.instruments.camera import LENS

SHAPE = "lens-shape"
"""Block of the shape of a lens"""
_REACH = 4
"""Knots on which a cubic spline depends at one place"""
_ROUNDS = 40
"""Each reduces the error of an unshifted point to the slope of the shift, far below 0.5"""


@dataclass(frozen=True)
class Knots:
    """Coefficients of a spline over the image, of shift u and then of shift v, each row by row."""

    image_size: tuple[int, int]
    counts: tuple[int, int]
    """Columns and rows, at least four of each"""

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return 2 * self.counts[0] * self.counts[1]

    def places(self) -> Array:
        """Return the image points (counts, 2) [px] of the coefficients of one shift."""
        # the first spline has its top one space before the border: four reach into each space
        u, v = (
            (np.arange(n) - 1) * (extent - 1) / (n - _REACH + 1)
            for extent, n in zip(self.image_size, self.counts, strict=True)
        )
        return np.stack([np.tile(u, len(v)), np.repeat(v, len(u))], axis=1)

    def basis(self, uv: Array, slope: int | None = None) -> Array:
        """Return the splines (n, counts) at image points (2, n), or their derivatives by u (slope 0) or v (slope 1)."""
        parts = [_along(self.image_size[a], self.counts[a], uv[a], a == slope) for a in (0, 1)]
        (column, across), (row, down) = parts
        place = (row[:, :, None] * self.counts[0] + column[:, None, :]).reshape(uv.shape[1], -1)
        weight = (down[:, :, None] * across[:, None, :]).reshape(uv.shape[1], -1)
        splines = np.zeros((uv.shape[1], self.counts[0] * self.counts[1]))
        np.put_along_axis(splines, place, weight, axis=1)
        return splines


@dataclass(frozen=True)
class KnownShape:
    """A shift of image points with known coefficients."""

    knots: Knots
    coefficients: Array
    """Of u and of v, (2, counts) px"""

    def at(self, uv: Array) -> Array:
        """Return the shift (2, n) px of image points (2, n) of the base lens."""
        moved: Array = self.coefficients @ self.knots.basis(uv).T
        return moved


def shifted(uv: Array, shape: KnownShape | None) -> Array:
    """Return where image points (2, n) of the base lens are; None: there is no shift."""
    return uv if shape is None else uv + shape.at(uv)


def unshifted(uv: Array, shape: KnownShape | None) -> Array:
    """Return the image points (2, n) of the base lens that are shifted to (2, n); None: there is no shift."""
    points = uv
    for _ in range(0 if shape is None else _ROUNDS):
        points = uv + points - shifted(points, shape)
    return points


def _along(extent: int, count: int, x: Array, slope: bool) -> tuple[Index, Array]:
    """Return knots (n, 4) and weights (n, 4) of the splines along one axis."""
    spaces = count - _REACH + 1
    t = np.nan_to_num(x.clip(0, extent - 1)) * (spaces / (extent - 1))
    first = np.minimum(t.astype(np.intp), spaces - 1)
    f = t - first
    if slope:
        # beyond the border the shift is that at the border
        inside = np.where((x > 0) & (x < extent - 1), spaces / (extent - 1) / 2, 0.0)
        weights = [-((1 - f) ** 2), 3 * f * f - 4 * f, -3 * f * f + 2 * f + 1, f * f]
        return first[:, None] + np.arange(_REACH), np.stack(weights, axis=1) * inside[:, None]
    weights = [(1 - f) ** 3, 3 * f**3 - 6 * f * f + 4, -3 * f**3 + 3 * f * f + 3 * f + 1, f**3]
    return first[:, None] + np.arange(_REACH), np.stack(weights, axis=1) / 6


@dataclass(frozen=True)
class LensShape:
    """Link that shifts image points: `(u, v) += sum_k B_k(u, v) (N w)_k`, w its own block.

    N takes the unknowns to coefficients, so that they change neither the base lens nor the pose of the camera. Of
    several cameras, it shifts the image points of one `member` of the block of lenses.
    """

    knots: Knots
    to_coefficients: Array
    """N (coefficients, size)"""
    block: str = SHAPE
    member: int | None = None
    takes = gives = Quantity.IMAGE_POINT

    @property
    def blocks(self) -> tuple[str, ...]:
        """Its own block."""
        return (self.block,)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the shifted image point (2, n) [px], with derivatives by the image point and the unknowns."""
        both = self.to_coefficients.reshape(2, -1, self.to_coefficients.shape[1])
        coefficients = both @ local.rows(self.block)[:, 0]
        at = self._basis(value, local)
        moved = value + coefficients @ at.T
        if not local.wanted:
            return Step(moved)
        by_point = np.stack([coefficients @ self._basis(value, local, slope).T for slope in (0, 1)], axis=1)
        by_point = by_point + np.eye(2)[:, :, None]
        # readings first in memory: the normal equations take them in that order
        by_shape = np.empty((value.shape[1], *both.shape[::2]))
        for axis, basis in enumerate(both):
            np.matmul(at, basis, out=by_shape[:, axis])
        by_shape = np.moveaxis(by_shape, 0, 2)
        return Step(moved, by_point, {self.block: by_shape} if self.block in local.wanted else {})

    def _basis(self, value: Array, local: LinkContext, slope: int | None = None) -> Array:
        basis = self.knots.basis(value, slope)
        return basis if self.member is None else basis * (local.observations.index[LENS] == self.member)[:, None]
