"""Reliability of single readings of a network (Baarda 1968): the error that is found, and how far it moves a point."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.groups import Group
from metrocli.adjust.robust import minimal_detectable
from metrocli.adjust.solution import Residuals, Solution, place_in_tiles
from metrocli.arrays import Array
from metrocli.instruments import tracer as t


def reliability(
    solution: Solution, group: Group, residuals: Residuals, critical: float, noise: float = 1.0
) -> dict[str, Array]:
    """Return redundancy, minimal detectable error and the shift of the point by that error, of each reading (n,).

    These are internal and external reliability after Baarda 1968, for the test with this critical value of |w| relative
    to `noise`, and 80 % power. The error of an uncontrolled reading is infinite.
    """
    least = minimal_detectable(residuals, critical, noise)[0]
    shift = point_shift(solution, group)
    moves = shift * np.where(np.isfinite(least), least, 0.0)
    return {
        "redundancy": residuals.redundancy[0],
        f"detectable [{group.observations.unit}]": least,
        "moves_point [mm]": np.where(np.isfinite(least) | (shift == 0), moves, np.inf),
    }


def point_shift(solution: Solution, group: Group) -> Array:
    """Return how far a point moves per unit error of one of its readings, |Q_x. J' / sigma^2|, (n,).

    A reading that uses two points is one of the first.
    """
    covariance = solution.covariance
    if covariance is None:
        raise RuntimeError(solution.outcome.value)
    index = np.atleast_2d(group.observations.index[t.POINT])[0]
    if not solution.blocks[t.POINT].free.any():
        return np.zeros(len(index))
    place = place_in_tiles(solution, group)
    if place is not None and covariance.layout.eliminated == t.POINT:
        shape = group.observations.readings.shape
        moved = covariance.factor * covariance.eliminated.with_readings(place, shape)[:, 0]
        return np.asarray(np.linalg.norm(moved / group.observations.sigma[0], axis=0))
    shift = np.zeros((3, len(index)))
    touches = group.linear(solution.blocks, covariance.layout.wanted).touches
    for touch in touches:
        pair = covariance.pairs(t.POINT, index, touch.block, touch.index)
        shift += np.einsum("abn,bn->an", pair, touch.jacobian[0])
    return np.asarray(np.linalg.norm(shift / group.observations.sigma[0], axis=0))
