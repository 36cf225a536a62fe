"""Corners of a chessboard from grey values: a model of two crossing blurred edges is fitted to the pixels.

Method: docs/algorithms/target-detection.md.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from metrocli.arrays import Array, Picture

WINDOW = 0.45
"""Half-width of the window of pixels, as a share of the distance to the neighbouring corners."""
WIDEST, NARROWEST = 12.0, 2.5
"""Limits of the half-width in pixels: farther out the lens bends the edges, closer in there is only blur."""
BLUR = 0.9
"""Starting value of the edges' blur, in pixels."""
STEPS = 20
"""Limit of the Gauss-Newton steps."""
STILL = 0.001
"""A step shorter than this, in pixels, is the last one."""
LOST = 0.6
"""A corner that moves from its start by more than this share of the half-width is rejected."""


def fit(picture: Picture, start: Array, across: Array, bend: Array, window: float = WINDOW) -> tuple[Array, float]:
    """Fit a corner near `start` (2,); return it and its standard deviation per axis in pixels, NaN without a corner.

    The columns of `across` (2, 2) are the steps to the next corners, along the two edges. `bend` (2,) is the curvature
    of the edges in 1/px, positive if they turn from u towards v.
    """
    at, grey, weight = _pixels(picture, start, across, window)
    if len(grey) < 20:
        return np.full(2, np.nan), np.nan
    state = _start(start, across, bend, at, grey)
    for _ in range(STEPS):
        value, jacobian = _linearised(state, bend, at)
        residual = grey - value
        step = _solved(jacobian, residual, weight)
        if step is None:
            break
        state = _moved(state, step)
        if np.abs(step[:2]).max() < STILL:
            return _judged(state, start, across, residual - jacobian @ step, jacobian, weight)
    return np.full(2, np.nan), np.nan


def _pixels(picture: Picture, start: Array, across: Array, window: float) -> tuple[Array, Array, Array]:
    """Return the pixels (m, 2) of the window, their grey values, and weights that decrease towards its rim."""
    sides = np.linalg.norm(across, axis=0)
    half = np.clip(window * sides, NARROWEST, WIDEST)
    reach = np.abs(across / sides) @ half
    height, width = picture.shape
    u0, u1 = max(int(np.ceil(start[0] - reach[0])), 0), min(int(start[0] + reach[0]) + 1, width)
    v0, v1 = max(int(np.ceil(start[1] - reach[1])), 0), min(int(start[1] + reach[1]) + 1, height)
    if u0 >= u1 or v0 >= v1:
        return np.empty((0, 2)), np.empty(0), np.empty(0)
    v, u = (part.ravel() for part in np.mgrid[v0:v1, u0:u1])
    at = np.stack([u, v], axis=1).astype(float)
    inside = (at - start) @ np.linalg.inv(across / sides * half).T
    rim = np.abs(inside).max(1)
    taken = rim <= 1
    weight = np.minimum(1.0, 2 * (1 - rim[taken]) + 0.1)
    return at[taken], picture[v, u][taken].astype(float), weight


def _start(start: Array, across: Array, bend: Array, at: Array, grey: Array) -> Array:
    """Return the starting state: corner (2), directions of the edges (2), blur, mean, contrast, slope of light (2)."""
    angles = np.arctan2(across[1], across[0])
    state = np.array([*start, *angles, BLUR, grey.mean(), 0.0, 0.0, 0.0])
    # grey values are linear in the contrast: it follows from one projection, with its sign
    state[6] = 1.0
    shape = _linearised(state, bend, at)[0] - state[5]
    state[6] = (shape @ (grey - grey.mean())) / max(float(shape @ shape), 1e-12)
    return state


def _linearised(state: Array, bend: Array, at: Array) -> tuple[Array, Array]:
    """Return grey values (m,) and derivatives (m, 9) of `mean + contrast * e1 * e2 + slope . offset`.

    e1 and e2 run from -1 to +1 across an edge, as `2 Phi(distance / blur) - 1` with the normal distribution Phi.
    """
    du, dv = at[:, 0] - state[0], at[:, 1] - state[1]
    blur, contrast = state[4], state[6]
    sides, slopes, along, away = [], [], [], []
    for angle, curvature in zip(state[2:4], bend, strict=True):
        cos, sin = np.cos(angle), np.sin(angle)
        ahead = cos * du + sin * dv
        distance = (cos * dv - sin * du - 0.5 * curvature * ahead * ahead) / blur
        away.append(distance)
        sides.append(2 * ndtr(distance) - 1)
        slopes.append(np.sqrt(2 / np.pi) * np.exp(-0.5 * distance * distance) / blur)
        along.append(ahead)
    first, second = contrast * slopes[0] * sides[1], contrast * slopes[1] * sides[0]
    jacobian = np.empty((9, len(at)))
    jacobian[0] = first * np.sin(state[2]) + second * np.sin(state[3]) - state[7]
    jacobian[1] = -first * np.cos(state[2]) - second * np.cos(state[3]) - state[8]
    jacobian[2] = -first * along[0]
    jacobian[3] = -second * along[1]
    jacobian[4] = -first * away[0] - second * away[1]
    jacobian[5] = 1.0
    jacobian[6] = sides[0] * sides[1]
    jacobian[7], jacobian[8] = du, dv
    return state[5] + contrast * jacobian[6] + state[7] * du + state[8] * dv, jacobian.T


def _solved(jacobian: Array, residual: Array, weight: Array) -> Array | None:
    scale = np.sqrt(weight @ jacobian**2)
    if not (np.isfinite(scale).all() and scale.all()):
        return None
    scaled = jacobian / scale
    normal = scaled.T @ (weight[:, None] * scaled) + 1e-9 * np.eye(len(scale))
    step = np.linalg.solve(normal, scaled.T @ (weight * residual)) / scale
    return step if np.isfinite(step).all() else None


def _moved(state: Array, step: Array) -> Array:
    bound = np.array([1.0, 1.0, 0.2, 0.2, 0.3, np.inf, np.inf, np.inf, np.inf])
    after = state + np.clip(step, -bound, bound)
    after[4] = np.clip(after[4], 0.3, 4.0)
    return np.asarray(after)


def _judged(
    state: Array, start: Array, across: Array, residual: Array, jacobian: Array, weight: Array
) -> tuple[Array, float]:
    sides = np.linalg.norm(across, axis=0)
    if np.linalg.norm(state[:2] - start) > LOST * max(WINDOW * float(sides.min()), NARROWEST):
        return np.full(2, np.nan), np.nan
    scale = np.sqrt(weight @ jacobian**2)
    scaled = jacobian / scale
    inverse = np.linalg.inv(scaled.T @ (weight[:, None] * scaled) + 1e-12 * np.eye(len(scale)))
    lever = (inverse @ (scaled * weight[:, None]).T)[:2] / scale[:2, None]
    freedom = len(residual) / max(len(residual) - len(state), 1)
    return state[:2], float(np.sqrt((lever**2 @ residual**2).mean() * freedom))


def fit_grid(picture: Picture, corners: Array, window: float = WINDOW) -> tuple[Array, Array]:
    """Fit the corners (rows, columns, 2) of a board; return corners of the same shape and sigma (rows, columns) [px].

    A lens bends straight edges. A straight model over a window of half-width w shifts each corner by bend * w^2 / 6,
    a systematic error. So the fit is repeated with the bend computed from the corners of the first fit.
    """
    first, _ = _fit_all(picture, corners, np.zeros_like(corners), window)
    complete = np.where(np.isfinite(first), first, corners)
    return _fit_all(picture, complete, bends(complete), window)


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


def _fit_all(picture: Picture, corners: Array, curvature: Array, window: float) -> tuple[Array, Array]:
    down, right = np.gradient(corners, axis=(0, 1))
    across = np.stack([right, down], axis=-1)
    centres, sigma = np.empty_like(corners), np.empty(corners.shape[:2])
    for place in np.ndindex(*sigma.shape):
        centres[place], sigma[place] = fit(picture, corners[place], across[place], curvature[place], window)
    return centres, sigma
