"""Uncertainty at the points of a working volume: each contribution along each axis, and the extremes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from metrocli.arrays import Array
from metrocli.expressions.derivatives import Jets
from metrocli.expressions.expression import Expression
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.geometry.rotations import cross_matrix

AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Contribution:
    """Standard uncertainties of one contributor along the axes at each point, (n, 3), or (1, 3) if all are equal."""

    name: str
    std: Array
    uniform: bool = False
    dof: float = math.inf
    source: str = ""
    """Contributions of one source are fully correlated"""


def grid(low: Sequence[float], high: Sequence[float], counts: Sequence[int]) -> Array:
    """Return the points of a volume, ends included, z fastest, (n, 3)."""
    axes = [np.linspace(*ends) for ends in zip(low, high, counts, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def of_pose(euler: Array, covariance: Array, points: Array) -> Array:
    """Return the standard uncertainty of `X' = R X + d` from that of (x, y, z, alpha, beta, gamma), (n, 3).

    For a change dd of the shift and a small rotation w from the left, `dX' = dd + w x (R X)`.
    """
    pose = poses.pose_from_euler(euler[:3], euler[3:])
    by_step = np.linalg.inv(poses.euler_form_by_step(pose))
    step = by_step @ covariance @ by_step.T
    turned = -cross_matrix(points @ poses.rotation_of(pose).T)
    variance = np.diag(step)[:3] + 2 * np.einsum("nak,ak->na", turned, step[:3, 3:])
    variance += np.einsum("nak,nak->na", turned @ step[3:, 3:], turned)
    std: Array = np.sqrt(np.maximum(variance, 0.0))
    return std


def of_models(models: Sequence[Expression], values: dict[str, Any], covariance: Array, names: Sequence[str]) -> Array:
    """Return the standard uncertainty of expressions in uncertain values and coordinates of points, (n, 3).

    `values` holds estimates as numbers and coordinates as arrays; `covariance` is that of `names`.
    """
    columns = []
    for model in models:
        slope = model.carried_out(Jets(model, names, values, order=1)).gradient
        slope = slope if np.ndim(slope) else np.zeros((len(names), 1))
        spread = np.einsum("i...,ij,j...->...", slope, covariance, slope)
        columns.append(np.sqrt(np.maximum(np.atleast_1d(spread), 0.0)))
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


@dataclass(frozen=True)
class Extremes:
    """The largest uncertainty in the volume along each axis."""

    largest: Array
    """(contributors, 3): the largest value of each contributor in the volume"""
    by_contributor: Array
    """(3,): root of the sum of squares of these maxima"""
    pointwise: Array
    """(3,): the largest combined uncertainty of all points; never above `by_contributor`"""
    places: Array
    """(3, 3): for each axis the point where it is largest"""
    each: Array
    """(n, 3): combined uncertainty at every point"""


def extremes(contributions: Sequence[Contribution], points: Array) -> Extremes:
    """Return the combined uncertainty: contributions of one source add linearly, different sources in quadrature."""
    variance = np.zeros((len(points), 3))
    maxima = np.zeros(3)
    for group in by_source(contributions):
        together = sum((part.std for part in group[1:]), group[0].std)
        variance += together**2
        maxima += sum((part.std.max(axis=0) for part in group[1:]), group[0].std.max(axis=0)) ** 2
    each = np.sqrt(variance)
    worst = each.argmax(axis=0)
    largest = np.array([part.std.max(axis=0) for part in contributions])
    return Extremes(largest, np.sqrt(maxima), each[worst, range(3)], points[worst], each)


def by_source(contributions: Sequence[Contribution]) -> list[list[Contribution]]:
    """Return the contributions in groups that are fully correlated."""
    groups: dict[str, list[Contribution]] = {}
    for n, part in enumerate(contributions):
        groups.setdefault(part.source or f"\0{n}", []).append(part)
    return list(groups.values())
