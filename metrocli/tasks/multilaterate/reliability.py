"""Reliability of single lengths, and the distance of two points with its uncertainty."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from metrocli.adjust.model.groups import Group
from metrocli.adjust.robust import minimal_detectable
from metrocli.adjust.solution import Residuals, Solution, place_in_tiles
from metrocli.arrays import Array
from metrocli.errors import InputError, UsageError
from metrocli.instruments import tracer as t
from metrocli.result import Estimate, Result
from metrocli.uncertainty.predicted import COMMON, CORE
from metrocli.words import suggestion


def reliability(
    solution: Solution, group: Group, found: Residuals, critical: float, noise: float = 1.0
) -> dict[str, Array]:
    """Return redundancy, minimal detectable error and the shift of the point by that error, of each length (n,).

    These are internal and external reliability after Baarda 1968, for the test with this critical value of |w| relative
    to `noise`, and 80 % power. The error of an uncontrolled length is infinite.
    """
    least = minimal_detectable(found, critical, noise)[0]
    shift = _point_shift(solution, group)
    moves = shift * np.where(np.isfinite(least), least, 0.0)
    return {
        "redundancy": found.redundancy[0],
        "detectable [mm]": least,
        "moves_point [mm]": np.where(np.isfinite(least) | (shift == 0), moves, np.inf),
    }


def _point_shift(solution: Solution, group: Group) -> Array:
    """Return how far a point moves per unit error of one of its lengths, |Q_x. J' / sigma^2|, (n,)."""
    covariance = solution.covariance
    if covariance is None:
        raise RuntimeError(solution.outcome.value)
    index = group.observations.index[t.POINT]
    if not solution.blocks[t.POINT].free.any():
        return np.zeros(len(index))
    place = place_in_tiles(solution, group)
    if place is not None and covariance.layout.eliminated == t.POINT:
        shape = group.observations.readings.shape
        found = covariance.factor * covariance.eliminated.with_readings(place, shape)[:, 0]
        return np.asarray(np.linalg.norm(found / group.observations.sigma[0], axis=0))
    shift = np.zeros((3, len(index)))
    touches = group.linear(solution.blocks, covariance.layout.wanted).touches
    for touch in touches:
        pair = covariance.pairs(t.POINT, index, touch.block, touch.index)
        shift += np.einsum("abn,bn->an", pair, touch.jacobian[0])
    return np.asarray(np.linalg.norm(shift / group.observations.sigma[0], axis=0))


def distance(result: Result, first: str, second: str) -> Estimate:
    """Return the distance of two points of a result with its standard uncertainty.

    Raises UsageError if the result lacks one of the points, InputError if it lacks the covariance between points.
    """
    if "points" not in result.tables or COMMON not in result.arrays:
        raise InputError("the result does not hold the covariance between points (too many points, or another kind)")
    names = result.tables["points"].texts("point")
    for name in (first, second):
        if name not in names:
            raise UsageError(f"the result has no point '{name}'; {suggestion(name, names)}")
    if first == second:
        raise UsageError(f"a distance is between two points; '{first}' is named twice")
    rows = [names.index(first), names.index(second)]
    places, own = result.tables["points"].stacked("xyz")[rows], result.arrays["points_covariance"][rows]
    length, std = between_two(places, own, {COMMON: result.arrays[COMMON][rows], CORE: result.arrays[CORE]})
    return Estimate(f"{first} - {second}", length, std, "mm")


def between_two(places: Array, own: Array, shared: Mapping[str, Array]) -> tuple[float, float]:
    """Return the distance of two points and its standard uncertainty, from their `factors`.

    `u^2 = e' (Q_aa + Q_bb - Q_ab - Q_ba) e`, e the unit vector between them; places (2, 3), own covariances (2, 3, 3).
    """
    away = places[0] - places[1]
    length = float(np.linalg.norm(away))
    both = shared[COMMON][0] @ shared[CORE] @ shared[COMMON][1].T
    direction = away / length if length else away
    variance = direction @ (own[0] + own[1] - both - both.T) @ direction
    return length, float(np.sqrt(max(variance, 0.0)))
