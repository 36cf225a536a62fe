"""Centres of bright or dark ellipses from grey values: a model of a blurred ellipse is fitted to the pixels.

Method: docs/algorithms/target-detection.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from metrocli.arrays import Array, Picture
from metrocli.targets.blobs import Ellipse
from metrocli.targets.find import FoundTargets

OUTSIDE = 3.5
"""How far outside the edge pixels are used, in pixels: the blur of the edge does not reach farther."""
INSIDE = 7.0
"""How far inside the edge pixels are used, in pixels: deeper ones carry no information on the centre."""
BLUR = 0.8
"""Starting value of the edge's blur, in pixels: a common lens and the pixel itself."""
FEWEST = 16
"""Fewest pixels of a fit."""
STEPS = 30
"""Limit of the Gauss-Newton steps: noise of a fifth of the contrast takes twenty."""
ROUNDS = 4
"""Limit of the rounds; each chooses the pixels anew, around the ellipse of the round before."""
SAME = 0.4
"""If the outline changes by less than this, in pixels, the pixels are not chosen anew."""
STILL = 0.001
"""A step shorter than this, in pixels, is the last one: the next would be about its square."""
MISFIT = 0.12
"""Largest root mean square residual of an ellipse, in units of its contrast."""
CUT = 0.2
"""Largest part of an ellipse beyond the image, in semi-axes: half of one has ten times the noise of a whole one."""
FLAT = 0.48
"""Smallest |covered - 1/2| of pixels away from the edge."""
EVEN, SLOPING = 8, 10
"""Number of unknowns if the light is even over the target, and if it varies linearly across it."""
SLOPE_TEST = 12.0
"""Chi-square above which a slope of the light is estimated; chance alone exceeds it in one of 400 targets.

An estimated slope increases the scatter of small targets by half, so it is estimated only if it is significant."""


@dataclass(frozen=True)
class FittedEllipse:
    """A fitted ellipse and how well the grey values agree with it."""

    ellipse: Ellipse
    sigma: float
    """Standard deviation of the centre per axis, in pixels."""
    background: float
    contrast: float
    """Grey value of the target minus that of the background."""
    misfit: float
    """Root mean square residual in units of the contrast."""
    noise: float
    """Standard deviation of the residuals away from the edge, in units of the contrast; robust."""
    blur: float
    """Standard deviation of the edge's blur in pixels."""


@dataclass
class _Model:
    """Unknowns of the fit: `grey = (background + contrast * covered) * (1 + slope . offset)`.

    `covered` is the normal distribution function of the distance to the edge, in units of the blur. `slope` is a linear
    variation of the light across the target.
    """

    centre: Array
    shape: Array
    blur: float
    background: float
    contrast: float
    slope: Array

    def linearised(self, at: Array) -> tuple[Array, Array]:
        """Return grey values (m,) at pixels (m, 2) and derivatives (m, 10) by centre, shape, blur, levels and slope.

        The distance to the edge is taken to first order, (rho - 1) / |grad rho|. Its derivatives are those at the edge.
        """
        du, dv = at[:, 0] - self.centre[0], at[:, 1] - self.centre[1]
        (p, _), (q, r) = self.shape
        x, y = p * du, q * du + r * dv
        rho = np.maximum(np.hypot(x, y), 1e-9)
        nu, nv = (p * x + q * y) / rho, r * y / rho
        steep = np.maximum(np.hypot(nu, nv), 1e-9)
        away = (rho - 1) / (steep * self.blur)
        from scipy.special import ndtr

        covered = ndtr(-away)
        light = 1 + self.slope[0] * du + self.slope[1] * dv
        level = self.background + self.contrast * covered
        edge = (-self.contrast / (np.sqrt(2 * np.pi) * self.blur)) * light * np.exp(-0.5 * away * away) / steep
        by_shape = edge / rho
        jacobian = np.empty((10, len(at)))
        jacobian[0] = -nu * edge - level * self.slope[0]
        jacobian[1] = -nv * edge - level * self.slope[1]
        jacobian[2] = by_shape * x * du
        jacobian[3] = by_shape * y * du
        jacobian[4] = by_shape * y * dv
        jacobian[5] = -edge * away * steep
        jacobian[6] = light
        jacobian[7] = covered * light
        jacobian[8] = level * du
        jacobian[9] = level * dv
        return level * light, jacobian.T

    def move(self, step: Array) -> None:
        """Apply a step of the unknowns; its size is bounded so that a poor start does not diverge."""
        (p, _), (q, r) = self.shape.tolist()
        # the mean semi-axis: the determinant of W is 1 over the product of both
        size = 1 / max(abs(p * r), 1e-12) ** 0.5
        bound = 0.3 / size
        du, dv, dp, dq, dr, wider, higher, more = (float(part) for part in step[:8])
        self.centre = self.centre + (_bounded(du, 0.3 * size), _bounded(dv, 0.3 * size))
        self.shape = np.array([[p + _bounded(dp, bound), 0.0], [q + _bounded(dq, bound), r + _bounded(dr, bound)]])
        # beyond the size of the dot, a wider blur and a larger contrast look the same
        self.blur = min(max(self.blur + _bounded(wider, 0.3), 0.3), max(0.8, size))
        self.background += higher
        self.contrast += more
        if len(step) > EVEN:
            self.slope = self.slope + step[EVEN:]


def _bounded(value: float, bound: float) -> float:
    return min(max(value, -bound), bound)


def fit(picture: Picture, start: Ellipse, reach: float = np.inf) -> FittedEllipse | None:
    """Fit a blurred ellipse to the grey values around `start`; None without one, or where the image's border cuts it.

    `reach` limits the pixels used, in semi-axes from the centre. It must be less than the distance to other print.
    """
    for _ in range(ROUNDS):
        at, grey = _pixels(picture, start, reach)
        if len(grey) < FEWEST:
            return None
        fitted = _fit(start, at, grey)
        if fitted is None or _is_near(start, fitted.ellipse):
            return fitted if fitted and fitted.ellipse.lies_in(picture, 1 - CUT) else None
        start = fitted.ellipse
    return None


def _fit(start: Ellipse, at: Array, grey: Array) -> FittedEllipse | None:
    """Fit an evenly lit ellipse to given pixels, then a slope of the light too if the residuals require it."""
    model = _start(start, at, grey)
    if model.contrast == 0:
        return None
    state = _converged(model, at, grey, EVEN)
    if state is not None and _is_sloping(*state):
        state = _converged(model, at, grey, SLOPING)
    return None if state is None else _judged(model, *state)


def _is_near(a: Ellipse, b: Ellipse) -> bool:
    """Return whether two outlines are so close that they select the same pixels."""
    moved = max(abs(a.u - b.u), abs(a.v - b.v))
    return moved < SAME and abs(a.long - b.long) < SAME and abs(a.short - b.short) < SAME


def _leads_to(start: Ellipse, ellipse: Ellipse) -> bool:
    """Return whether a start is another outline of an ellipse that has been found already."""
    near = abs(start.u - ellipse.u) + abs(start.v - ellipse.v) < 0.5 * ellipse.short
    return near and 0.5 < start.short / ellipse.short < 2


def is_good(fitted: FittedEllipse | None) -> bool:
    """Return whether there is a fit, and its misfit is small enough for a blurred ellipse."""
    return fitted is not None and fitted.misfit < MISFIT


def fit_all(picture: Picture, starts: Iterable[Ellipse], reach: float = np.inf) -> list[FittedEllipse]:
    """Return the good fits, each once, even if several starts lead to the same ellipse."""
    fits: list[FittedEllipse] = []
    for start in starts:
        if any(_leads_to(start, other.ellipse) for other in fits):
            continue
        fitted = fit(picture, start, reach)
        if fitted is None or not is_good(fitted):
            continue
        if not any(_is_near(fitted.ellipse, other.ellipse) for other in fits):
            fits.append(fitted)
    return fits


def _pixels(picture: Picture, start: Ellipse, reach: float) -> tuple[Array, Array]:
    """Return the pixels (m, 2) near the edge of the ellipse, inside and outside, and their grey values (m,)."""
    height, width = picture.shape
    wide = min(start.long * reach, start.long + OUTSIDE) + 1
    u0, u1 = max(int(start.u - wide), 0), min(int(start.u + wide) + 2, width)
    v0, v1 = max(int(start.v - wide), 0), min(int(start.v + wide) + 2, height)
    if u0 >= u1 or v0 >= v1:
        return np.empty((0, 2)), np.empty(0)
    (p, _), (q, r) = start.shape
    du, dv = np.arange(u0, u1) - start.u, (np.arange(v0, v1) - start.v)[:, None]
    x, y = p * du + 0 * dv, q * du + r * dv
    rho = np.hypot(x, y)
    away = (rho - 1) * rho / np.maximum(np.hypot(p * x + q * y, r * y), 1e-9)
    v, u = np.nonzero((away < OUTSIDE) & (rho < reach) & (away > -INSIDE))
    return np.stack([u + float(u0), v + float(v0)], axis=1), picture[v + v0, u + u0].astype(float)


def _start(start: Ellipse, at: Array, grey: Array) -> _Model:
    """Return the starting model: the given ellipse, with the mean grey values of its inner and outer pixels."""
    shape = start.shape
    circle = (at - (start.u, start.v)) @ shape.T
    order = np.argsort(circle[:, 0] ** 2 + circle[:, 1] ** 2)
    few = max(3, len(order) // 6)
    inner, outer = float(grey[order[:few]].mean()), float(grey[order[-few:]].mean())
    return _Model(np.array([start.u, start.v]), shape, BLUR, outer, inner - outer, np.zeros(2))


def _converged(model: _Model, at: Array, grey: Array, unknowns: int) -> tuple[Array, Array] | None:
    """Fit the first `unknowns` unknowns in place; return residuals (m,) and derivatives (m, 10).

    None if the fit does not converge.
    """
    for _ in range(STEPS):
        value, jacobian = model.linearised(at)
        residual = grey - value
        step = _solved(jacobian[:, :unknowns], residual)
        if step is None:
            return None
        model.move(step)
        # the centre hardly depends on the blur, which need not stand as still
        if max(abs(step[0]), abs(step[1])) < STILL and abs(step[5]) < 10 * STILL:
            return residual - jacobian[:, :unknowns] @ step, jacobian[:, : max(unknowns, SLOPING)]
    return None


def _solved(jacobian: Array, residual: Array) -> Array | None:
    """Return the slightly damped Gauss-Newton step; None if the normal matrix is singular."""
    normal = jacobian.T @ jacobian
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal / np.outer(scale, scale) + 1e-9 * np.eye(len(scale))
    try:
        step = np.linalg.solve(scaled, jacobian.T @ residual / scale) / scale
    except np.linalg.LinAlgError:
        return None
    return step if np.isfinite(step).all() else None


def _is_sloping(residual: Array, jacobian: Array) -> bool:
    """Return whether a slope of the light is significant (chi-square test with two degrees of freedom)."""
    step = _solved(jacobian, residual)
    if step is None or len(residual) <= SLOPING:
        return False
    after = residual - jacobian @ step
    gain = residual @ residual - after @ after
    return bool(gain > SLOPE_TEST * (after @ after) / (len(residual) - SLOPING))


def _judged(model: _Model, residual: Array, jacobian: Array) -> FittedEllipse | None:
    """Return the fitted ellipse and the standard deviation of its centre; None if it cannot be computed.

    The deviation is from White's covariance: each residual counts with its own leverage, so noise may differ between
    pixels.
    """
    unknowns = SLOPING if model.slope.any() else EVEN
    m = len(residual)
    scale = np.sqrt((jacobian[:, :unknowns] ** 2).sum(0))
    if model.contrast == 0 or m <= unknowns or not scale.all():
        return None
    scaled = jacobian[:, :unknowns] / scale
    try:
        lever = np.linalg.inv(scaled.T @ scaled)[:2] @ scaled.T / scale[:2, None]
    except np.linalg.LinAlgError:
        return None
    # the mean of both axes; residuals are smaller than the noise by the unknowns
    variance = (lever**2 @ residual**2).mean() * m / (m - unknowns)
    semi, turn = _axes_of(model.shape, model.blur)
    ellipse = Ellipse(float(model.centre[0]), float(model.centre[1]), float(semi[0]), float(semi[1]), turn)
    misfit = float(np.sqrt(np.mean(residual**2)) / abs(model.contrast))
    # the derivative by the contrast is the share that is covered, under even light
    even = np.abs(residual[np.abs(jacobian[:, 7] - 0.5) > FLAT])
    noise = float(1.4826 * np.median(even) / abs(model.contrast)) if len(even) >= FEWEST else 0.0
    levels = float(model.background), float(model.contrast)
    return FittedEllipse(ellipse, float(np.sqrt(variance)), *levels, misfit, noise, model.blur)


def _axes_of(shape: Array, blur: float) -> tuple[Array, float]:
    """Return the semi-axes, longer first, and the direction of the longer one [rad].

    Blur moves the half level of a convex edge inwards by blur^2 / (2 radius of curvature). This is added back.
    """
    values, vectors = np.linalg.eigh(shape.T @ shape)
    axes = 1 / np.sqrt(values)
    return axes + 0.5 * blur * blur * axes / axes[::-1] ** 2, float(np.arctan2(vectors[1, 0], vectors[0, 0]) % np.pi)


def of_ellipses(targets: Sequence[str], fits: Sequence[FittedEllipse], reason: str = "") -> FoundTargets:
    """Return sightings of fitted ellipses."""
    rows = [(*fit.ellipse.centre, fit.sigma, fit.ellipse.long, fit.ellipse.short, fit.ellipse.angle) for fit in fits]
    table = np.array(rows, dtype=float).reshape(-1, 6)
    return FoundTargets(tuple(targets), table[:, :2], table[:, 2], table[:, 3:5], table[:, 5], reason)
