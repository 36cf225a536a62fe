"""The distance of two points of a network with its uncertainty."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import InputError, UsageError
from metrocli.result import Estimate, Result
from metrocli.uncertainty.predicted import COMMON, CORE
from metrocli.words import suggestion


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
