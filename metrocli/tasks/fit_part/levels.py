"""Chips, flash and mistakes: points that do not lie at the level of the overstock of their surface.

Each surface of a raw part has its own overstock, and its points scatter about it. A robust even fit gives the pose,
then a robust step gives the level of each surface. The scatter is the median absolute deviation, which less than half
of the points cannot change much.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from metrocli.adjust.medians import medians_of
from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass
from metrocli.tasks.fit_part.stock import Nominal, Stock

SAMPLE = 3000
"""Points with which the fit of more than twice as many begins: their pose is near that of all"""
OUTLIER_LIMIT = 6.0
"""Distance from the level, in standard deviations of the scatter, beyond which a point is left out

Of many good points some are beyond 3, and hardly one beyond 6, even where the scatter of a few is estimated too small.
"""
_ROUNDS = 15
"""Most rounds of assigned surfaces and a robust step"""
_SMALLEST_STEP = 1e-3
"""Step [mm] at which the robust fit ends"""
_REWEIGHTINGS = 12
"""Solutions with new weights in a robust step"""
_SIGMA_PER_MAD = 1.4826
"""Standard deviation over median absolute deviation of normal scatter"""
_LEAST_POINTS = 8
"""Points that a surface needs for a scatter of its own: the median of fewer may be that of the chips"""


class NominalWithSurfaces(Nominal, Protocol):
    """An ideal geometry that finds the surface of points."""

    def nearest(self, points: Array, levels: Array | float = 0.0) -> Index:
        """Return the surface of each point (n, 3), near the level (S,) of its overstock."""


@dataclass(frozen=True)
class Levels:
    """Robust levels of the overstock, and which points lie off them."""

    to_part: Array
    """Pose into the part frame (6,)"""
    stock: Stock
    """With the surface of each point"""
    level: Array
    """Overstock of each surface (S,), nan without points"""
    deviation: Array
    """Distance of each point from the level of its surface (n,) [mm]"""
    scatter: Array
    """Standard deviation with which the deviation of each point is compared (n,) [mm]"""

    @property
    def outlying(self) -> Mask:
        """Which points are left out (n,)."""
        return np.asarray(np.abs(self.deviation) > OUTLIER_LIMIT * self.scatter)


def robust_levels(
    nominal: NominalWithSurfaces, measured: Array, surface: Index | None, to_part: Array, sigma: Array
) -> Levels:
    """Return robust levels from a rough pose; without `surface` each point is assigned to the nearest one.

    sigma (n,) [mm] is the standard deviation of the measurement, the least scatter of a point.
    """
    count = len(nominal.names)
    if len(measured) > 2 * SAMPLE:
        rows = np.random.default_rng(1).choice(len(measured), SAMPLE, replace=False)
        sample = robust_levels(
            nominal, measured[rows], None if surface is None else surface[rows], to_part, sigma[rows]
        )
        # the pose of a sample needs one round with all points
        to_part, level, rounds = sample.to_part, sample.level, 1
    else:
        level, rounds = np.zeros(count), _ROUNDS
    stock = Stock(nominal, measured, np.zeros(len(measured), dtype=np.intp) if surface is None else surface)
    for _ in range(rounds):
        if surface is None:
            stock = Stock(nominal, measured, nominal.nearest(stock.at(to_part).points, np.nan_to_num(level)))
        local = stock.at(to_part)
        level = medians_of(local.overstock, stock.surface, count)
        # one level for all surfaces makes them even; levels of their own leave shifts between opposite surfaces open
        step, _ = robust_step(local.rows, local.overstock, np.zeros_like(stock.surface), 1)
        if np.abs(step).max() < _SMALLEST_STEP:
            break
        to_part = local.moved(to_part, step)
    # without chips and flash the surfaces need not be even: here each has its own level
    _, deviation = robust_step(local.rows, local.overstock, stock.surface, count)
    scatter = scatter_of(deviation, stock.surface, count, sigma)
    return Levels(to_part, stock, level, deviation, scatter)


def robust_step(rows: Array, overstock: Array, surface: Index, count: int) -> tuple[Array, Array]:
    """Return the step that makes each surface's overstock even, and the residuals about the levels (n,).

    Weights of Geman and McClure, 1/(1 + (r/3s)^2)^2. The levels are eliminated; of steps that change nothing but the
    levels, the shortest is taken.
    """
    weights = np.ones(len(rows))
    step, residuals = np.zeros(6), overstock
    for _ in range(_REWEIGHTINGS):
        total = np.maximum(np.bincount(surface, weights, count), 1e-300)
        # without the weighted mean of each surface: this eliminates the levels
        *columns, goal = (
            values - (np.bincount(surface, weights * values, count) / total)[surface] for values in (*rows.T, overstock)
        )
        design = np.stack(columns, axis=1)
        normals = (design * weights[:, None]).T @ design
        step = -np.linalg.pinv(normals, rcond=1e-10, hermitian=True) @ ((design * weights[:, None]).T @ goal)
        residuals = goal + design @ step
        # points that lie exactly on a plane have a scale of 0, and weights of 0 / 0
        scale = max(_SIGMA_PER_MAD * float(np.median(np.abs(residuals))), 1e-9)
        # the influence of a residual is largest at 1.7 s and falls beyond: chips pull the pose no further
        weights = 1 / (1 + (residuals / (3 * scale)) ** 2) ** 2
    return step, residuals


def scatter_of(deviation: Array, surface: Index, count: int, sigma: Array) -> Array:
    """Return the scatter of each point: of its surface or of all points, whichever is larger, or of the measurement."""
    size = np.abs(deviation)
    of_all = _SIGMA_PER_MAD * float(np.median(size))
    of_surface = np.where(
        np.bincount(surface, minlength=count) >= _LEAST_POINTS, _SIGMA_PER_MAD * medians_of(size, surface, count), 0.0
    )
    # a nanometre: rounding of exact points is not an outlier
    least = np.maximum(sigma, 1e-6)
    return np.asarray(np.maximum(np.maximum(np.nan_to_num(of_surface)[surface], of_all), least))
