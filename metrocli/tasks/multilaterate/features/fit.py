"""An ideal feature laid through points: deviations, form, and how it follows the points."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
import numpy.typing as npt

from metrocli.frozen import dataclass
from metrocli.tasks.multilaterate.features.ideal import Array, Ideal, Shape

Index = npt.NDArray[np.intp]


class Criterion(StrEnum):
    """How an ideal feature is laid through points (ISO 5459: association)."""

    LEAST_SQUARES = "least-squares"
    MINIMUM_ZONE = "minimum-zone"


@dataclass(frozen=True)
class Contact:
    """The points that hold a minimum zone: no change of the feature makes all their deviations smaller."""

    rows: Index
    sides: Array
    """+1 at the outer limit, -1 at the inner one"""
    weights: Array
    """Positive, of sum 1: the derivatives of the deviations, weighted by them, add up to zero"""
    optimality: float
    """Length of that sum, for derivatives of length about 1; it is rounding where the zone is the least one"""


@dataclass(frozen=True)
class Fit:
    """An ideal feature laid through points."""

    ideal: Ideal
    criterion: Criterion
    deviations: Array
    """Signed distance of each point; without a sign from a line (n,) [mm]"""
    sensitivity: Array
    """Derivative of the step of the feature by each point (7, n, 3)"""
    contact: Contact | None = None

    @property
    def form(self) -> float:
        """Width of the zone of the feature that holds all points; the diameter of the cylinder about a line [mm]."""
        if self.ideal.shape is Shape.LINE:
            return float(2 * self.deviations.max())
        return float(np.ptp(self.deviations))

    def by_points(self, points: Array) -> Array:
        """Return the derivative of the numbers of the feature, and of its form, by the points (9, n, 3)."""
        centre = points.mean(axis=0)
        by_step, by_centre = self.ideal.numbers_by(centre)
        numbers = np.einsum("qs,snc->qnc", by_step, self.sensitivity) + by_centre[:, None, :] / len(points)
        return np.concatenate([numbers, self._form_by_points(points)[None]])

    def _form_by_points(self, points: Array) -> Array:
        ends = [(int(np.argmax(self.deviations)), 2.0)]
        if self.ideal.shape is not Shape.LINE:
            ends = [(int(np.argmax(self.deviations)), 1.0), (int(np.argmin(self.deviations)), -1.0)]
        rows = np.array([row for row, _ in ends])
        factors = np.array([factor for _, factor in ends])
        step, point = gradients(self.ideal, points[rows])
        total = np.einsum("r,rs,snc->nc", factors, step, self.sensitivity)
        np.add.at(total, rows, factors[:, None] * point)
        return np.asarray(total)


def distances(ideal: Ideal, points: Array) -> Array:
    """Return the deviation that makes the zone: of a circle in its plane, of a line the distance (n,)."""
    values = np.real(ideal.deviations(points))
    return np.linalg.norm(values, axis=1) if ideal.shape is Shape.LINE else values[:, 0]


def gradients(ideal: Ideal, points: Array, step: Array | None = None) -> tuple[Array, Array]:
    """Return the derivatives of `distances` by the step (n, 7), at a step, and by the point (n, 3)."""
    by_step, by_point = ideal.by_step(points, step), ideal.by_point(points)
    if ideal.shape is not Shape.LINE:
        return by_step[:, 0], by_point[:, 0]
    values = np.real(ideal.deviations(points, step))
    away = values / np.maximum(np.linalg.norm(values, axis=1), 1e-300)[:, None]
    return np.einsum("nk,nks->ns", away, by_step), np.einsum("nk,nkc->nc", away, by_point)
