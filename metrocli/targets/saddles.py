"""Corners of a chessboard from grey values: a model of two crossing blurred edges is fitted to the pixels.

Method: docs/algorithms/target-detection.md.
"""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array, Index, Mask, Picture
from metrocli.frozen import dataclass

WINDOW = 0.45
"""Half-width of the window of pixels, as a share of the distance to the neighbouring corners."""
WIDEST, NARROWEST = 12.0, 2.5
"""Limits of the half-width in pixels: farther out the lens bends the edges, closer in there is only blur."""
BLUR = 0.9
"""Starting value of the edges' blur, in pixels."""
STEPS = 20
"""Limit of the Gauss-Newton steps."""
STILL, STARTED = 0.001, 0.02
"""A step shorter than this, in pixels, is the last one: of a fit, and of the fit that only gives it starts and bends"""
LOST = 0.6
"""A corner that moves from its start by more than this share of the half-width is rejected."""
_FEWEST, _AT_ONCE = 20, 32
"""Fewest pixels of a window, and the number of corners that are fitted at once"""
_BOUND = np.array([1.0, 1.0, 0.2, 0.2, 0.3, np.inf, np.inf, np.inf, np.inf])
"""Largest step of each entry of a state"""


@dataclass(frozen=True)
class _Windows:
    """The pixels about some corners, as many of each; those outside its window have no weight."""

    start: Array
    """Where the corners are sought, (n, 2)"""
    across: Array
    """Steps to the next corners along the two edges, in columns, (n, 2, 2)"""
    bend: Array
    """Curvature of the edges in 1/px, positive if they turn from u towards v, (n, 2)"""
    u: Array
    """(n, m)"""
    v: Array
    grey: Array
    weight: Array
    """Decreases towards the rim of the window"""

    @classmethod
    def of(cls, picture: Picture, start: Array, across: Array, bend: Array, window: float) -> _Windows:
        """Return the windows of corners (n, 2)."""
        sides = np.linalg.norm(across, axis=1)
        half = np.clip(window * sides, NARROWEST, WIDEST)
        # half of the box about the window, whose sides are along the edges
        reach = np.einsum("nij,nj->ni", np.abs(across / sides[:, None]), half)
        first, last = np.ceil(start - reach).astype(int), np.floor(start + reach).astype(int)
        wide, high = np.maximum((last - first).max(axis=0, initial=0) + 1, 1)
        v, u = (part.ravel() for part in np.mgrid[:high, :wide])
        u, v = first[:, :1] + u, first[:, 1:] + v
        to_window = np.linalg.inv(across / sides[:, None] * half[:, None])
        inside = to_window @ np.stack([u - start[:, :1], v - start[:, 1:]], axis=1)
        rim = np.abs(inside).max(axis=1)
        height, width = picture.shape
        there = (rim <= 1) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
        # the pixels of a window before the others, of which most are dropped
        kept = np.argsort(~there, axis=1, kind="stable")[:, : max(int(there.sum(axis=1).max(initial=0)), 1)]
        u, v, rim, there = (np.take_along_axis(array, kept, 1) for array in (u, v, rim, there))
        grey = picture[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)].astype(float)
        weight = np.where(there, np.minimum(1.0, 2 * (1 - rim) + 0.1), 0.0)
        return cls(start, across, bend, u.astype(float), v.astype(float), grey, weight)

    def some(self, rows: Index | Mask) -> _Windows:
        """Return the windows of some corners."""
        parts = (self.start, self.across, self.bend, self.u, self.v, self.grey, self.weight)
        return _Windows(*(array[rows] for array in parts))

    @property
    def count(self) -> Array:
        """Number of pixels of each window."""
        return np.asarray((self.weight > 0).sum(axis=1))

    def first(self) -> Array:
        """Return states: corner (2), directions of the edges (2), blur, mean, contrast, slope of light (2), (n, 9)."""
        there = self.weight > 0
        state = np.zeros((len(self.start), 9))
        state[:, :2], state[:, 4], state[:, 6] = self.start, BLUR, 1.0
        state[:, 2:4] = np.arctan2(self.across[:, 1], self.across[:, 0])
        mean = np.where(there, self.grey, 0.0).sum(axis=1) / np.maximum(self.count, 1)
        # the mean difference of the two pairs of opposite quadrants, with its sign
        du, dv = self.u - self.start[:, :1], self.v - self.start[:, 1:]
        first, second = (self.across[:, :1, edge] * dv - self.across[:, 1:, edge] * du for edge in (0, 1))
        quadrant = np.where(there, np.sign(first * second), 0.0)
        state[:, 5] = mean
        state[:, 6] = (quadrant * (self.grey - mean[:, None])).sum(axis=1) / np.maximum(np.abs(quadrant).sum(axis=1), 1)
        return state

    def linearised(self, state: Array) -> tuple[Array, Array]:
        """Return grey values (n, m) and derivatives (n, 9, m) of `mean + contrast * e1 * e2 + slope . offset`.

        e1 and e2 run from -1 to +1 across an edge, as `2 Phi(distance / blur) - 1` with the normal distribution Phi.
        """
        corner_u, corner_v, *angles, blur, mean, contrast, slope_u, slope_v = state.T[:, :, None]
        du, dv = self.u - corner_u, self.v - corner_v
        sides, slopes, along, away = [], [], [], []
        for angle, curvature in zip(angles, self.bend.T[:, :, None], strict=True):
            cos, sin = np.cos(angle), np.sin(angle)
            ahead = cos * du + sin * dv
            distance = (cos * dv - sin * du - 0.5 * curvature * ahead * ahead) / blur
            side, bell = _edge(distance)
            away.append(distance)
            sides.append(side)
            slopes.append(contrast * np.sqrt(2 / np.pi) / blur * bell)
            along.append(ahead)
        first, second = slopes[0] * sides[1], slopes[1] * sides[0]
        jacobian = np.empty((len(state), 9, du.shape[1]))
        jacobian[:, 0] = first * np.sin(angles[0]) + second * np.sin(angles[1]) - slope_u
        jacobian[:, 1] = -first * np.cos(angles[0]) - second * np.cos(angles[1]) - slope_v
        np.multiply(first, along[0], out=jacobian[:, 2])
        np.multiply(second, along[1], out=jacobian[:, 3])
        jacobian[:, 4] = first * away[0] + second * away[1]
        np.negative(jacobian[:, 2:5], out=jacobian[:, 2:5])
        jacobian[:, 5] = 1.0
        np.multiply(sides[0], sides[1], out=jacobian[:, 6])
        jacobian[:, 7], jacobian[:, 8] = du, dv
        return mean + contrast * jacobian[:, 6] + slope_u * du + slope_v * dv, jacobian

    def normal(self, jacobian: Array, more: float) -> tuple[Array, Array, Array]:
        """Return normal matrices (n, 9, 9) of unit diagonal, weighted derivatives (n, 9, m), and the scales (n, 9)."""
        weighted = jacobian * self.weight[:, None]
        normal = weighted @ np.swapaxes(jacobian, 1, 2)
        scale = np.sqrt(np.einsum("nkk->nk", normal))
        return normal / scale[:, :, None] / scale[:, None] + more * np.eye(9), weighted, scale


def _edge(distance: Array) -> tuple[Array, Array]:
    """Return `2 Phi(distance) - 1`, to 1.5e-7, and `exp(-distance^2 / 2)`.

    Abramowitz and Stegun, 7.1.26: far below a grey value, in a third of the time of an exact erf.
    """
    bell = np.exp(-0.5 * distance * distance)
    t = 1 / (1 + 0.3275911 / np.sqrt(2) * np.abs(distance))
    series = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    return np.copysign(1 - series * bell, distance), bell


def _fitted(windows: _Windows, start: Array, still: float) -> tuple[Array, Array]:
    """Fit corners from states (n, 9), NaN where none is known, until steps are shorter than `still`.

    Returns states (n, 9) and standard deviations of corners per axis in pixels (n,), NaN without a corner.
    """
    states, sigma = np.full(start.shape, np.nan), np.full(len(start), np.nan)
    rows = np.flatnonzero(windows.count >= _FEWEST)
    windows, state = windows.some(rows), start[rows]
    unknown = np.flatnonzero(np.isnan(state).any(axis=1))
    if len(unknown):
        state[unknown] = windows.some(unknown).first()
    for _ in range(STEPS):
        if not len(rows):
            break
        value, jacobian = windows.linearised(state)
        residual = windows.grey - value
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            normal, weighted, scale = windows.normal(jacobian, 1e-9)
            right = (weighted @ residual[:, :, None])[:, :, 0] / scale
        sound = np.asarray(np.isfinite(normal).all(axis=(1, 2)) & np.isfinite(right).all(axis=1))
        if not sound.all():
            rows, windows, state = rows[sound], windows.some(sound), state[sound]
            jacobian, residual, normal, scale, right = (
                array[sound] for array in (jacobian, residual, normal, scale, right)
            )
        step = np.linalg.solve(normal, right[:, :, None])[:, :, 0] / scale
        state = _moved(state, step)
        done = np.abs(step[:, :2]).max(axis=1, initial=0.0) < still
        if done.any():
            left = residual[done] - np.einsum("nkm,nk->nm", jacobian[done], step[done])
            states[rows[done]], sigma[rows[done]] = _judged(windows.some(done), state[done], left, jacobian[done])
            rows, windows, state = rows[~done], windows.some(~done), state[~done]
    return states, sigma


def _moved(state: Array, step: Array) -> Array:
    after = state + np.clip(step, -_BOUND, _BOUND)
    after[:, 4] = np.clip(after[:, 4], 0.3, 4.0)
    return np.asarray(after)


def _judged(windows: _Windows, state: Array, residual: Array, jacobian: Array) -> tuple[Array, Array]:
    """Return states and standard deviations, NaN where the corner is far from where it was sought."""
    sides = np.linalg.norm(windows.across, axis=1).min(axis=1)
    # by the usual window, also where a marker nearby makes the used one smaller
    lost = np.linalg.norm(state[:, :2] - windows.start, axis=1) > LOST * np.maximum(WINDOW * sides, NARROWEST)
    normal, weighted, scale = windows.normal(jacobian, 1e-12)
    lever = np.linalg.inv(normal)[:, :2] / scale[:, :2, None] / scale[:, None] @ weighted
    freedom = windows.count / np.maximum(windows.count - state.shape[1], 1)
    variance = np.einsum("nkm,nm->nk", lever**2, residual**2).mean(axis=1) * freedom
    return np.where(lost[:, None], np.nan, state), np.where(lost, np.nan, np.sqrt(variance))


def fit_grid(picture: Picture, corners: Array, window: float = WINDOW) -> tuple[Array, Array]:
    """Fit the corners (rows, columns, 2) of a board; return corners of the same shape and sigma (rows, columns) [px].

    A lens bends straight edges. A straight model over a window of half-width w shifts each corner by bend * w^2 / 6,
    a systematic error. So the fit is repeated with the bend computed from the corners of the first fit.
    """
    unknown = np.full((*corners.shape[:2], 9), np.nan)
    first, _ = _fit_all(picture, corners, np.zeros_like(corners), window, unknown, STARTED)
    complete = np.where(np.isfinite(first[..., :2]), first[..., :2], corners)
    states, sigma = _fit_all(picture, complete, bends(complete), window, first, STILL)
    return states[..., :2], sigma


def bends(corners: Array) -> Array:
    """Return the curvature in 1/px of the two edges through each corner (rows, columns, 2), from its neighbours."""
    curvature = np.zeros_like(corners)
    for edge, axis in ((0, 1), (1, 0)):
        if corners.shape[axis] < 3:
            continue
        line = np.moveaxis(corners, axis, 0)
        chord, sag = (line[2:] - line[:-2]) / 2, line[2:] - 2 * line[1:-1] + line[:-2]
        length = np.linalg.norm(chord, axis=-1)
        inner = (chord[..., 0] * sag[..., 1] - chord[..., 1] * sag[..., 0]) / length**3
        # corners at the rim have no neighbour on one side: they get the bend of the next one
        curvature[..., edge] = np.moveaxis(np.concatenate([inner[:1], inner, inner[-1:]]), 0, axis)
    return curvature


def _fit_all(
    picture: Picture, corners: Array, curvature: Array, window: float, states: Array, still: float
) -> tuple[Array, Array]:
    down, right = np.gradient(corners, axis=(0, 1))
    start, across = corners.reshape(-1, 2), np.stack([right, down], axis=-1).reshape(-1, 2, 2)
    bend, states, sigma = curvature.reshape(-1, 2), states.reshape(len(start), -1), np.empty(len(start))
    fitted = np.empty_like(states)
    for first in range(0, len(start), _AT_ONCE):
        own = slice(first, first + _AT_ONCE)
        windows = _Windows.of(picture, start[own], across[own], bend[own], window)
        fitted[own], sigma[own] = _fitted(windows, states[own], still)
    return fitted.reshape(*corners.shape[:2], -1), sigma.reshape(corners.shape[:2])
