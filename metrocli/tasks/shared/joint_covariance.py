"""Factors of the covariance between any two points of a network, `Q_ab = C_a K C_b'`, as results hold them."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Mask
from metrocli.adjust.schur.covariance import Covariance
from metrocli.uncertainty.predicted import COMMON, CORE

_LARGEST = 4_000_000
"""Largest size of the factors, in numbers; results of larger networks do not hold them"""


def factors(covariance: Covariance, block: str, chosen: Mask) -> dict[str, Array]:
    """Return the factors C (points, 3, k) and K (k, k) of the chosen points; an empty mapping if they are too large.

    `block` is the name of the block of points. If the points are eliminated, their shared covariance is `W Q_r W'`; a
    datum on the points adds `-E S' - S E'`.
    """
    if covariance.layout.eliminated == block:
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
        core = covariance.of(block)[np.ix_(*[np.repeat(chosen, 3)] * 2)] if size**2 <= _LARGEST else np.zeros((0, 0))
        common = np.eye(size).reshape(-1, 3, size) if size**2 <= _LARGEST else None
    return {} if common is None else {COMMON: common, CORE: covariance.factor * core}
