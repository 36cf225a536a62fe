"""Gross errors: a start that they do not spoil, and the readings that the tests reject."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from metrocli.adjust.adjustment import Control, adjust
from metrocli.adjust.blocks import Array, Block
from metrocli.adjust.datum import Datum
from metrocli.adjust.groups import Group
from metrocli.adjust.observations import Index, Mask
from metrocli.adjust.solution import Residuals

_MAD = 1.4826
"""Standard deviation of a normal sample over its median absolute deviation."""
_GROSS = 8.0
"""Residuals beyond this many robust standard deviations call for a robust start."""
_TUKEY = 4.685
"""Tuning constant of the biweight: 95 % efficiency for normal errors."""
_ROUNDS = 12


def robust_start(
    blocks: Iterable[Block], groups: Sequence[Group], name: str, datum: Datum | None = None
) -> dict[str, Block]:
    """Return blocks near the solution, with gross errors among the readings of group `name` held off.

    A few steps of least squares, then, where residuals beyond 8 robust standard deviations are left, rounds of
    reweighting: first 1/|v| (least absolute deviations), then Tukey's biweight, each with the scale of the median.
    """
    state = adjust(blocks, groups, datum, Control(limit=15, covariance=False)).blocks
    group = next(group for group in groups if group.name == name)
    distance = _distances(group, state)
    if distance.max(initial=0.0) <= _GROSS * _scale(distance):
        return dict(state)
    for turn in range(_ROUNDS):
        distance = _distances(group, state)
        share = distance / max(_scale(distance), 1e-12)
        weights = 1 / np.maximum(share, 1.0) if turn < _ROUNDS // 2 else np.maximum(1 - (share / _TUKEY) ** 2, 0.0) ** 2
        weighted = [replace(g, weights=np.maximum(weights, 1e-12)) if g.name == name else g for g in groups]
        state = adjust(state.values(), weighted, datum, Control(limit=8, covariance=False)).blocks
    return dict(state)


def gross(group: Group, blocks: Mapping[str, Block]) -> Mask:
    """Return (n,) True for readings beyond 8 robust standard deviations."""
    distance = _distances(group, blocks)
    return distance > _GROSS * _scale(distance)


def _distances(group: Group, blocks: Mapping[str, Block]) -> Array:
    residual = group.observations.whitened(group.residuals(blocks))
    distances: Array = np.nan_to_num(np.sqrt((residual**2).sum(axis=0)), nan=1e12, posinf=1e12)
    return distances


def _scale(distance: Array) -> float:
    """Return a robust standard deviation of the lengths of residuals."""
    return float(_MAD * np.median(distance)) if distance.size else 0.0


def critical_value(tests: int, level: float = 0.05) -> float:
    """Return the bound that the largest of `tests` normal |w| exceeds with probability `level` (Bonferroni)."""
    from scipy.special import ndtri

    return float(-ndtri(level / (2 * max(tests, 1))))


@dataclass(frozen=True)
class Suspects:
    """Readings of a group whose residuals are too large for chance."""

    rows: Index
    """Indices (k,) into the group"""
    tests: Array
    """Baarda's w of each, the larger of its components, in units of the noise found (k,)"""
    critical: float


def suspects(found: Residuals, unit: float = 1.0) -> Suspects:
    """Return the readings whose largest |w| exceeds the critical value for their number, at 5 % in all.

    `unit` divides w: the standard deviation of unit weight that is taken for right.
    """
    w = np.abs(found.normalised).max(axis=0) / unit
    bound = critical_value(found.values.size)
    rows = np.flatnonzero(w > bound)
    return Suspects(rows, w[rows], bound)
