"""Ideal features of least squares of the distances. Method: docs/algorithms/feature-fits.md."""

from __future__ import annotations

import numpy as np

from metrocli.errors import NotConvergedError, UndeterminedError
from metrocli.tasks.multilaterate.features.fit import Criterion, Fit, distances
from metrocli.tasks.multilaterate.features.ideal import STEP, UNKNOWNS, Array, Ideal, Shape
from metrocli.tasks.multilaterate.features.start import starts

_ITERATIONS = 200
_EXACT = 1e-12
"""Step, relative to the size of the feature, at which the iteration ends"""
_DETERMINED = 1e-7
"""Smallest singular value, relative to the largest, of unknowns that the points determine"""


def least_squares(shape: Shape, points: Array) -> Fit:
    """Return the feature with the least sum of squared distances of the points (n, 3).

    Raises UndeterminedError if the points do not determine it, NotConvergedError if the iteration does not end.
    """
    wanted = list(UNKNOWNS[shape])
    if len(points) < fewest(shape):
        raise UndeterminedError(f"a {shape} needs {fewest(shape)} points, and there are {len(points)}")
    found = [one for start in starts(shape, points) if (one := _gauss_newton(start, points, wanted)) is not None]
    if not found:
        raise NotConvergedError(f"the least-squares {shape} was not found in {_ITERATIONS} iterations")
    ideal = min(found, key=lambda one: _sum(one, points)).about(points.mean(axis=0))
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
    sensitivity[wanted] = -np.einsum("ab,bnc->anc", np.linalg.inv(normal), towards)
    return Fit(ideal, Criterion.LEAST_SQUARES, distances(ideal, points), sensitivity)


def fewest(shape: Shape) -> int:
    """Return the least number of points that can determine a shape."""
    return {Shape.LINE: 2, Shape.CIRCLE: 3}.get(shape, len(UNKNOWNS[shape]))


def _gauss_newton(ideal: Ideal, points: Array, wanted: list[int]) -> Ideal | None:
    """Return the feature of least squares near a start, or None without an end of the iteration."""
    damping, goal = 0.0, _sum(ideal, points)
    for _ in range(_ITERATIONS):
        rows = ideal.by_step(points)[:, :, wanted].reshape(-1, len(wanted))
        values = np.real(ideal.deviations(points)).reshape(-1)
        weight = np.sqrt(damping) * np.eye(len(wanted))
        step = np.zeros(STEP)
        stacked = np.vstack([rows / np.sqrt(len(points)), weight])
        step[wanted] = -np.linalg.lstsq(stacked, np.append(values / np.sqrt(len(points)), np.zeros(len(wanted))))[0]
        trial = ideal.moved(step)
        reached = _sum(trial, points)
        if np.abs(step).max() <= _EXACT * ideal.size:
            return trial if reached <= goal else ideal
        if reached <= goal * (1 + _EXACT):
            ideal, goal, damping = trial, reached, damping / 10 if damping > 1e-8 else 0.0
        else:
            damping = max(10 * damping, 1e-6)
            if damping > 1e12:
                return ideal
    return None


def _sum(ideal: Ideal, points: Array) -> float:
    return float((np.real(ideal.deviations(points)) ** 2).sum())
