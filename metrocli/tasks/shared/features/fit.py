"""Fits of ideal features: starting values, least squares, and the fit that a job asks for."""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.errors import NotConvergedError, UndeterminedError
from metrocli.frozen import dataclass
from metrocli.tasks.shared.features.ideal import STEP, UNKNOWNS, Ideal, IdealFeature, tangents

_DIRECTIONS = 150
"""Directions of an axis, evenly over half the sphere"""
_KEPT = 4
"""Directions from which the fit starts; the best fit counts"""
_SAMPLE = 400
"""Points, at most, that choose the directions"""


def starts(shape: IdealFeature, points: Array) -> Iterator[Ideal]:
    """Yield features near the points (n, 3) from which a fit can start."""
    centre = points.mean(axis=0)
    away = points - centre
    size = float(np.sqrt((away**2).sum(axis=1).mean())) or 1.0
    principal = np.linalg.svd(away, full_matrices=False)[2]
    if shape is IdealFeature.LINE:
        yield Ideal(shape, centre, principal[0], size=size)
    elif shape is IdealFeature.PLANE:
        yield Ideal(shape, centre, principal[2], size=size)
    elif shape is IdealFeature.CIRCLE:
        yield from _round(shape, away / size, centre, size, principal[2:])
    elif shape is IdealFeature.SPHERE:
        scaled = away / size
        # `|p|^2 = 2 c.p + (R^2 - |c|^2)` is linear in the centre c and the last term
        *middle, rest = _solved(np.column_stack([2 * scaled, np.ones(len(points))]), (scaled**2).sum(axis=1))[0]
        radius = np.sqrt(max(rest + float(np.square(middle).sum()), 0.0))
        yield Ideal(shape, centre + size * np.array(middle), np.array([0.0, 0.0, 1.0]), size * radius, size=size)
    else:
        every = np.linspace(0, len(points) - 1, min(len(points), _SAMPLE)).astype(int)
        # the principal axes as well: a long cylinder lies along one, closer than any of the even directions
        yield from _round(shape, away[every] / size, centre, size, np.concatenate([principal, _directions()]))


def _directions() -> Array:
    """Return unit vectors (_DIRECTIONS, 3) on half a sphere, by the golden angle."""
    height = (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS
    turn = np.arange(_DIRECTIONS) * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - height**2)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), height])


def _round(shape: IdealFeature, scaled: Array, centre: Array, size: float, axes: Array) -> Iterator[Ideal]:
    """Yield the features about those axes whose squared radii fit best.

    About an axis `u^2 + v^2 = 2 (a u + b v) + R^2 - a^2 - b^2`, with `2 R k h + k^2 h^2` more for a cone: linear.
    """
    fits = []
    for axis in axes:
        first, second = tangents(axis)
        u, v, h = scaled @ first, scaled @ second, scaled @ axis
        columns = [2 * u, 2 * v, np.ones(len(u))]
        columns += [h, h**2] if shape is IdealFeature.CONE else []
        solved, misfit = _solved(np.column_stack(columns), u**2 + v**2)
        radius = np.sqrt(max(solved[2] + solved[0] ** 2 + solved[1] ** 2, 0.0))
        if radius == 0:
            continue
        slope = solved[3] / (2 * radius) if shape is IdealFeature.CONE else 0.0
        origin = centre + size * (solved[0] * first + solved[1] * second)
        # over the radius: u^2 + v^2 - R^2 is 2 R times the distance from the surface
        fits.append((misfit / radius, Ideal(shape, origin, axis, size * radius, float(np.arctan(slope)), size)))
    fits.sort(key=lambda fitted: fitted[0])
    # several starts: the best direction of a coarse search is not always that of the best fit
    yield from (ideal for _, ideal in fits[:_KEPT])


def _solved(matrix: Array, wanted: Array) -> tuple[Array, float]:
    solution = np.asarray(np.linalg.lstsq(matrix, wanted, rcond=None)[0], dtype=float)
    return solution, float(np.linalg.norm(matrix @ solution - wanted))


_ITERATIONS = 200
_EXACT = 1e-12
"""Step, relative to the size of the feature, at which the iteration ends"""
_DETERMINED = 1e-7
"""Smallest singular value, relative to the largest, of unknowns that the points determine"""


def least_squares(shape: IdealFeature, points: Array) -> FeatureFit:
    """Return the feature with the least sum of squared distances of the points (n, 3).

    Raises UndeterminedError if the points do not determine it, NotConvergedError if the iteration does not end.
    """
    wanted = list(UNKNOWNS[shape])
    if len(points) < fewest(shape):
        raise UndeterminedError(f"a {shape} needs {fewest(shape)} points, and there are {len(points)}")
    fits = [fitted for start in starts(shape, points) if (fitted := _gauss_newton(start, points, wanted)) is not None]
    if not fits:
        raise NotConvergedError(f"the least-squares {shape} was not found in {_ITERATIONS} iterations")
    ideal = min(fits, key=lambda ideal: _sum(ideal, points)).about(points.mean(axis=0))
    rows = ideal.by_step(points)[:, :, wanted]
    values = np.linalg.svd(rows.reshape(-1, len(wanted)), compute_uv=False)
    if values[-1] < _DETERMINED * values[0]:
        raise UndeterminedError(
            f"the {len(points)} points do not determine a {shape}: it can move without leaving them; "
            "points farther apart along and around it would determine it"
        )
    normal = np.einsum("nka,nkb->ab", rows, rows)
    sensitivity = np.zeros((STEP, *points.shape))
    towards = np.einsum("nka,nkc->anc", rows, ideal.by_point(points))
    # the least sum stays least: `J'J ds = -J' (dd/dp) dp`, second derivatives times residuals left out
    sensitivity[wanted] = -np.einsum("ab,bnc->anc", np.linalg.inv(normal), towards)
    return FeatureFit(ideal, Criterion.LEAST_SQUARES, distances(ideal, points), sensitivity)


def fewest(shape: IdealFeature) -> int:
    """Return the least number of points that can determine a shape."""
    return {IdealFeature.LINE: 2, IdealFeature.CIRCLE: 3}.get(shape, len(UNKNOWNS[shape]))


def _gauss_newton(ideal: Ideal, points: Array, wanted: list[int]) -> Ideal | None:
    """Return the feature of least squares near a start, or None without an end of the iteration."""
    damping, goal = 0.0, _sum(ideal, points)
    for _ in range(_ITERATIONS):
        rows = ideal.by_step(points)[:, :, wanted].reshape(-1, len(wanted))
        values = np.real(ideal.deviations(points)).reshape(-1)
        weight = np.sqrt(damping) * np.eye(len(wanted))
        step = np.zeros(STEP)
        # divided by the root of the number, so that the damping means the same for any number of points
        stacked = np.vstack([rows / np.sqrt(len(points)), weight])
        step[wanted] = -np.linalg.lstsq(stacked, np.append(values / np.sqrt(len(points)), np.zeros(len(wanted))))[0]
        trial = ideal.moved(step)
        reached = _sum(trial, points)
        if np.abs(step).max() <= _EXACT * ideal.size:
            return trial if reached <= goal else ideal
        # rounding may raise the sum at its minimum
        if reached <= goal * (1 + _EXACT):
            ideal, goal, damping = trial, reached, damping / 10 if damping > 1e-8 else 0.0
        else:
            damping = max(10 * damping, 1e-6)
            if damping > 1e12:
                return ideal
    return None


def _sum(ideal: Ideal, points: Array) -> float:
    return float((np.real(ideal.deviations(points)) ** 2).sum())


class Criterion(StrEnum):
    """How an ideal feature is laid through points (ISO 5459: association)."""

    LEAST_SQUARES = "least-squares"
    MINIMUM_ZONE = "minimum-zone"


@dataclass(frozen=True)
class ZoneContact:
    """The points that hold a minimum zone: no change of the feature makes all their deviations smaller."""

    rows: Index
    sides: Array
    """+1 at the outer limit, -1 at the inner one"""
    weights: Array
    """Positive, of sum 1: the derivatives of the deviations, weighted by them, add up to zero"""
    optimality: float
    """Length of that sum, for derivatives of length about 1; it is rounding where the zone is the least one"""


@dataclass(frozen=True)
class FeatureFit:
    """An ideal feature laid through points."""

    ideal: Ideal
    criterion: Criterion
    deviations: Array
    """Signed distance of each point; without a sign from a line (n,) [mm]"""
    sensitivity: Array
    """Derivative of the step of the feature by each point (7, n, 3)"""
    contact: ZoneContact | None = None

    @property
    def form(self) -> float:
        """Width of the zone of the feature that holds all points; the diameter of the cylinder about a line [mm]."""
        if self.ideal.shape is IdealFeature.LINE:
            return float(2 * self.deviations.max())
        return float(np.ptp(self.deviations))

    def by_points(self, points: Array) -> Array:
        """Return the derivative of the numbers of the feature, and of its form, by the points (9, n, 3)."""
        centre = points.mean(axis=0)
        by_step, by_centre = self.ideal.numbers_by(centre)
        numbers = np.einsum("qs,snc->qnc", by_step, self.sensitivity) + by_centre[:, None, :] / len(points)
        return np.concatenate([numbers, self._form_by_points(points)[None]])

    def _form_by_points(self, points: Array) -> Array:
        # the width of the zone changes with its two farthest points only; about a line it is twice the largest distance
        ends = [(int(np.argmax(self.deviations)), 2.0)]
        if self.ideal.shape is not IdealFeature.LINE:
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
    return np.linalg.norm(values, axis=1) if ideal.shape is IdealFeature.LINE else values[:, 0]


def gradients(ideal: Ideal, points: Array, step: Array | None = None) -> tuple[Array, Array]:
    """Return the derivatives of `distances` by the step (n, 7), at a step, and by the point (n, 3)."""
    by_step, by_point = ideal.by_step(points, step), ideal.by_point(points)
    if ideal.shape is not IdealFeature.LINE:
        return by_step[:, 0], by_point[:, 0]
    values = np.real(ideal.deviations(points, step))
    away = values / np.maximum(np.linalg.norm(values, axis=1), 1e-300)[:, None]
    return np.einsum("nk,nks->ns", away, by_step), np.einsum("nk,nkc->nc", away, by_point)
