"""Distance of two points of a result with its uncertainty, from the covariance of the pair.

A result holds the covariance of each point, and factors of the covariance between any two: `Q_ab = C_a K C_b'`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Mask
from metrocli.adjust.schur.covariance import Covariance
from metrocli.errors import InputError, UsageError
from metrocli.instruments import tracer as t
from metrocli.result import Estimate, Result
from metrocli.uncertainty.predicted import COMMON, CORE
from metrocli.words import suggestion

_LARGEST = 4_000_000
"""Largest size of the factors, in numbers; results of larger networks do not hold them"""


def factors(covariance: Covariance, chosen: Mask) -> dict[str, Array]:
    """Return the factors C (points, 3, k) and K (k, k) of the chosen points; an empty mapping if they are too large.

    If the points are eliminated, their shared covariance is `W Q_r W'`; a datum on the points adds `-E S' - S E'`.
    """
    if covariance.layout.eliminated == t.POINT:
        points = covariance.eliminated
        core, gauge = covariance.reduced, points.gauge
        if gauge is not None:
            k = gauge.reduced.shape[1]
            exchange = -np.kron([[0.0, 1.0], [1.0, 0.0]], np.eye(k))
            core = np.block([[core, np.zeros((len(core), 2 * k))], [np.zeros((2 * k, len(core))), exchange]])
        if 3 * int(chosen.sum()) * len(core) > _LARGEST:
            return {}
        parts = [points.weights] + ([] if gauge is None else [gauge.moves, points.share])
        common: Array | None = np.concatenate([part[chosen] for part in parts], axis=2)
    else:
        size = 3 * int(chosen.sum())
        core = covariance.of(t.POINT)[np.ix_(*[np.repeat(chosen, 3)] * 2)] if size**2 <= _LARGEST else np.zeros((0, 0))
        common = np.eye(size).reshape(-1, 3, size) if size**2 <= _LARGEST else None
    return {} if common is None else {COMMON: common, CORE: covariance.factor * core}


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
