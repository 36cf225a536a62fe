"""Reliability of lengths: the least error of each that a test finds, and how far one that small moves its point."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.groups import Group
from metrocli.adjust.solution import Residuals, Solution
from metrocli.instruments import tracer as t

UNITS = {"detectable": "mm", "moves_point": "mm"}
_DELTA0 = 4.13
"""Non-centrality of a w-test at 0.1 % with 80 % power (Baarda 1968): the least detectable bias is 4.13 s / sqrt(r)"""
_SINGULAR = 1e-6
"""Redundancy below which a length is not controlled at all"""


def reliability(solution: Solution, group: Group, found: Residuals) -> dict[str, Array]:
    """Return redundancy, least detectable error and the shift of the point by it, of each length (n,).

    Internal and external reliability after Baarda 1968; a length that nothing controls has an infinite error.
    """
    redundancy = found.redundancy[0]
    controlled = redundancy > _SINGULAR
    least = _DELTA0 * found.sigma[0] / np.sqrt(np.where(controlled, redundancy, 1.0))
    shift = _point_shift(solution, group)
    return {
        "redundancy": redundancy,
        "detectable": np.where(controlled, least, np.inf),
        "moves_point": np.where(controlled | (shift == 0), shift * least, np.inf),
    }


def _point_shift(solution: Solution, group: Group) -> Array:
    """Return how far a point moves for a unit error of one of its lengths, |Q_x. J' / sigma^2|, (n,)."""
    covariance = solution.covariance
    if covariance is None:
        raise RuntimeError(solution.outcome.value)
    index = group.observations.index[t.POINT]
    shift = np.zeros((3, len(index)))
    if not solution.blocks[t.POINT].free.any():
        return np.zeros(len(index))
    touches = group.linear(solution.blocks, covariance.layout.wanted).touches
    for touch in touches:
        pair = covariance.pairs(t.POINT, index, touch.block, touch.index)
        shift += np.einsum("abn,bn->an", pair, touch.jacobian[0])
    return np.asarray(np.linalg.norm(shift / group.observations.sigma[0], axis=0))
