"""Reverse budget: how small the standard uncertainty of one input must be for a wanted expanded uncertainty.

Input i multiplied by s keeps its correlations and degrees of freedom. Then `u^2(s) = a + 2 b s + c s^2` with
`c = g_i^2 V_ii` and `b = g_i sum_(j != i) g_j V_ij`. The factor k follows from the effective degrees of freedom at s.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.uncertainty.inputs import Inputs
from metrocli.uncertainty.propagation import Coverage, LinearPropagation, coverage_factor, whole_dof

_STEPS = 1000
_HALVINGS = 40
_factor = lru_cache(4096)(coverage_factor)


@dataclass(frozen=True)
class _Scaled:
    """U of a measurand as a function of the factor of one input: its group apart from all others."""

    coverage: Coverage
    others: float
    """Variance of the other groups"""
    others_over_dof: float
    """Sum of their squared variances over their degrees of freedom"""
    own: tuple[float, float, float]
    """a, 2b and c of the group of the input"""
    dof: float

    def expanded(self, s: Array) -> Array:
        """Return U at each factor (n,)."""
        a, b, c = self.own
        variance = np.maximum(a + b * s + c * s * s, 0.0)
        total, weighted = self.others + variance, self.others_over_dof + variance**2 / self.dof
        with np.errstate(divide="ignore", invalid="ignore"):
            dof = np.where(weighted > 0, total**2 / weighted, np.inf)
        k = [_factor(self.coverage, whole_dof(each)) for each in dof.tolist()]
        result: Array = np.array(k) * np.sqrt(total)
        return result


def needed_factors(linear: LinearPropagation, inputs: Inputs, coverage: Coverage, wanted: float) -> Array:
    """Return for each input (n,) the largest factor of its standard uncertainty with which U is at most `wanted`.

    It is 1 where U is small enough already, and NaN where no factor of this input alone suffices.
    """
    shares = np.outer(linear.sensitivities, linear.sensitivities) * inputs.covariance
    factors = np.full(len(shares), np.nan)
    groups = [(list(group), _dof(group, inputs, linear)) for group in inputs.groups]
    variances = [float(shares[np.ix_(group, group)].sum()) for group, _ in groups]
    weighted = [variance**2 / dof for variance, (_, dof) in zip(variances, groups, strict=True)]
    for at, (group, dof) in enumerate(groups):
        others = sum(variances) - variances[at], sum(weighted) - weighted[at]
        for i in group:
            c, both = float(shares[i, i]), 2 * float(shares[i, group].sum() - shares[i, i])
            own = (variances[at] - both - c, both, c)
            others = (max(others[0], 0.0), max(others[1], 0.0))
            factors[i] = _largest(_Scaled(coverage, *others, own, dof), wanted) if c > 0 else np.nan
    return factors


def _dof(group: tuple[int, ...], inputs: Inputs, linear: LinearPropagation) -> float:
    """Return the least degrees of freedom of the inputs of a group that act, as the effective ones count them."""
    acting = [i for i in group if linear.sensitivities[i] != 0 and inputs.covariance[i, i] > 0]
    return min((inputs.quantities[i].dof for i in acting), default=np.inf)


def _largest(scaled: _Scaled, wanted: float) -> float:
    """Return the largest factor up to 1 with U at most `wanted`, NaN without one; U can have steps, by k."""
    grid = np.linspace(1.0, 0.0, _STEPS + 1)
    reached = scaled.expanded(grid) <= wanted
    if not reached.any():
        return float("nan")
    first = int(np.argmax(reached))
    low, high = float(grid[first]), float(grid[max(first - 1, 0)])
    for _ in range(_HALVINGS if first else 0):
        middle = (low + high) / 2
        if scaled.expanded(np.array([middle]))[0] <= wanted:
            low = middle
        else:
            high = middle
    return low
