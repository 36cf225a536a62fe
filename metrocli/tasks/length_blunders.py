"""Gross errors among the lengths of a network, found point by point before the adjustment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from metrocli.adjust.blocks import Array, Block
from metrocli.instruments import tracer as t
from metrocli.tasks.length_network import Network

CHECKED = 4
"""Lengths that a point needs so that a wrong one shows"""
_GROSS = 8.0
"""Misfit beyond all chance, in standard deviations"""
_MAD = 1.4826
"""Standard deviation of a normal sample over its median absolute deviation"""
_MOST = 3
"""Wrong lengths of one point that are looked for"""


@dataclass(frozen=True)
class Rejected:
    """A length that was left out."""

    row: int
    test: float
    """|w|, nan where it was left out before there was one"""
    reason: str


def far_off(network: Network, state: Mapping[str, Block]) -> dict[int, Rejected]:
    """Return lengths that are off beyond all chance, by row, with the tracers where `state` has them.

    Of each point whose lengths do not meet in one place the fewest are taken without which the rest do; all of them
    where several choices would serve.
    """
    observations = network.lengths.observations
    point = observations.index[t.POINT]
    miss = network.lengths.residuals(state)[0] / observations.sigma[0]
    bound = (_GROSS * max(1.0, _MAD * float(np.median(np.abs(miss))))) ** 2
    suspicious = np.flatnonzero((np.bincount(point, miss**2, len(network.nominal)) > bound) & network.unknown)
    towards = _towards(network, state)
    out: dict[int, Rejected] = {}
    for i in suspicious:
        rows = np.flatnonzero(point == i)
        wrong = _wrong(towards[rows], miss[rows], bound)
        reason = "gross" if len(wrong) < len(rows) else "alike"
        out |= {int(row): Rejected(int(row), float("nan"), reason) for row in rows[wrong]}
    return out


def _towards(network: Network, state: Mapping[str, Block]) -> Array:
    """Return the derivatives of the lengths by their points in standard deviations, (n, 3)."""
    observations = network.lengths.observations
    tracer = state[t.TRACER].values[observations.index[t.TRACER]]
    away = state[t.POINT].values[observations.index[t.POINT]] - tracer[:, :3]
    size = tracer[:, 4] / (np.linalg.norm(away, axis=1) * observations.sigma[0])
    return np.asarray(away * size[:, None])


def _wrong(towards: Array, miss: Array, bound: float) -> list[int]:
    """Return the lengths of a point (m,) without which the rest meet within the bound; all if that cannot be told.

    With R the projector onto the residuals, v = R miss, leaving out the set S lowers the sum of squares by
    `v_S' R_SS^-1 v_S`.
    """
    m = len(miss)
    basis, _ = np.linalg.qr(towards)
    projector = np.eye(m) - basis @ basis.T
    v = projector @ miss
    total = float(v @ v)
    if total <= bound:
        return []
    for size in range(1, min(_MOST, m - CHECKED) + 1):
        serving = [
            list(chosen)
            for chosen in combinations(range(m), size)
            if total - _lowered(projector, v, list(chosen)) <= bound
        ]
        if serving:
            return serving[0] if len(serving) == 1 else list(range(m))
    return list(range(m))


def _lowered(projector: Array, v: Array, chosen: list[int]) -> float:
    part, inner = v[chosen], projector[np.ix_(chosen, chosen)]
    return float(part @ np.linalg.lstsq(inner, part, rcond=None)[0])
