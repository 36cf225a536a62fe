"""mrcal's splined stereographic model: `q = f (u + du(u)) + c`, u the stereographic image of a direction.

`u = 2 (x, y) / (|p| + z)`. du is a cubic B-spline on Nx by Ny knots about 0, at the same steps of u along x and y.
The inner Nx - 2 span the field of view along x. Beyond them the outermost cubics go on.

Source: mrcal.secretsauce.net/splined-models.html; compared with mrcal 2.2.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass

_NAME = re.compile(r"LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=(\d+)_Ny=(\d+)_fov_x_deg=(\d+)")
_ROUNDS = 40
"""Most steps of the inverse"""
_CLOSE, _SOLVED = 1e-14, 1e-10
"""Gap of the inverse at which it ends, and largest one of a solution, in u"""
_STRAIGHT = 1e-10
"""Weight of the second differences of the knots beside that of the points"""
_LEAST, _MOST = 4, 1000
"""Knots along one axis"""


@dataclass(frozen=True)
class StereographicGrid:
    """The knots of a splined model."""

    columns: int
    rows: int
    field: int
    """Field of view along x [deg]"""

    @classmethod
    def named(cls, name: str) -> StereographicGrid | None:
        """Return the knots that a name of mrcal states; None for any other model, and for impossible counts."""
        match = _NAME.fullmatch(name)
        if match is None:
            return None
        columns, rows, field = map(int, match.groups())
        known = min(columns, rows) >= _LEAST and max(columns, rows) <= _MOST and 0 < field < 360
        return cls(columns, rows, field) if known else None

    @property
    def name(self) -> str:
        """Return the name of the model in mrcal."""
        return f"LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx={self.columns}_Ny={self.rows}_fov_x_deg={self.field}"

    @property
    def size(self) -> int:
        """Return the number of knots."""
        return self.columns * self.rows

    @property
    def step(self) -> float:
        """Return the distance of neighbouring knots in u."""
        # the inner columns - 2 knots have columns - 3 steps between them, over 4 tan(field / 4) in u
        return 4 * float(np.tan(np.radians(self.field) / 4)) / (self.columns - 3)

    def shift(self, u: Array, shifts: Array) -> Array:
        """Return du (2, n) at points (2, n), of shifts (knots, 2)."""
        place, weights = self._splines(u)
        return np.asarray(np.einsum("nk,nka->an", weights, shifts[place]))

    def fitted(self, u: Array, wanted: Array) -> Array:
        """Return shifts (knots, 2) whose du at points (2, n) is nearest to what is wanted (2, n)."""
        from scipy.sparse import csr_array

        place, weights = self._splines(u)
        rows = np.repeat(np.arange(len(place)), place.shape[1])
        at = csr_array((weights.ravel(), (rows, place.ravel())), (len(place), self.size))
        return straightest(at, (self.columns, self.rows), wanted)

    def _splines(self, u: Array, slope: int | None = None) -> tuple[Index, Array]:
        """Return the knots (n, 16) that points (2, n) depend on, with weights or their slopes by u or v."""
        (column, across), (row, down) = (
            self._along(u[axis], count, slope == axis) for axis, count in enumerate((self.columns, self.rows))
        )
        place = (row[:, :, None] * self.columns + column[:, None, :]).reshape(u.shape[1], -1)
        return place, (down[:, :, None] * across[:, None, :]).reshape(u.shape[1], -1)

    def _along(self, u: Array, count: int, slope: bool) -> tuple[Index, Array]:
        """Return knots (n, 4) and weights (n, 4) along one axis."""
        t = u / self.step + (count - 1) / 2
        # clipped: beyond the inner knots the outermost cubic goes on, as in mrcal
        second = np.clip(np.floor(t), 1, count - 3).astype(np.intp)
        f = t - second
        weights = [(1 - f) ** 3, 3 * f**3 - 6 * f * f + 4, -3 * f**3 + 3 * f * f + 3 * f + 1, f**3]
        slopes = [-((1 - f) ** 2), 3 * f * f - 4 * f, -3 * f * f + 2 * f + 1, f * f]
        chosen = np.stack(slopes, axis=1) / 2 / self.step if slope else np.stack(weights, axis=1) / 6
        return second[:, None] - 1 + np.arange(4), chosen

    def unshifted(self, target: Array, shifts: Array) -> Array:
        """Return u (2, n) with `u + du(u) = target` by Newton's method, nan without a solution; shifts (knots, 2)."""
        u = target
        for _ in range(_ROUNDS):
            held = np.nan_to_num(u)
            gap = held + self.shift(held, shifts) - target
            if not (np.abs(gap) > _CLOSE).any():
                break
            (xx, yx), (xy, yy) = (
                np.einsum("nk,nka->an", weights, shifts[place]) + np.eye(2)[:, axis, None]
                for axis in (0, 1)
                for place, weights in (self._splines(held, axis),)
            )
            whole = xx * yy - xy * yx
            # a fold of the map has no inverse; nan takes the point out
            whole = np.where(whole > 0, whole, np.nan)
            u = held - np.stack([yy * gap[0] - xy * gap[1], xx * gap[1] - yx * gap[0]]) / whole
        held = np.nan_to_num(u)
        solved = np.isfinite(u) & (np.abs(held + self.shift(held, shifts) - target) < _SOLVED)
        return np.where(solved.all(axis=0), held, np.nan)


def straightest(basis: Any, counts: tuple[int, int], wanted: Array) -> Array:
    """Return coefficients (knots, k) of splines whose values are nearest to what is wanted (k, n).

    By linear least squares with a sparse basis (n, knots) of columns and rows of knots. Where the points leave knots
    open, the spline is as straight as it can be.
    """
    from scipy.sparse import csr_array, eye_array, kron
    from scipy.sparse.linalg import spsolve

    columns, rows = counts
    bends = [csr_array(np.diff(np.eye(count), 2, axis=0)) for count in counts]
    across, down = kron(eye_array(rows), bends[0]), kron(bends[1], eye_array(columns))
    # per point and per knot, so that the weight does not depend on how many of either there are
    straight = _STRAIGHT * basis.shape[0] / basis.shape[1] * (across.T @ across + down.T @ down)
    return np.asarray(spsolve((basis.T @ basis + straight).tocsc(), basis.T @ wanted.T))


def flattened(direction: Array) -> Array:
    """Return the stereographic image (2, n) of directions (3, n) of any length."""
    x, y, z = direction
    return np.asarray(2 * np.stack([x, y]) / (np.sqrt(x * x + y * y + z * z) + z))


def raised(u: Array) -> Array:
    """Return the directions (3, n) of stereographic points (2, n), the inverse of `flattened`."""
    square = (u * u).sum(axis=0) / 4
    return np.stack([u[0], u[1], 1 - square])
