"""Validation of the law of propagation: its interval against that of Monte Carlo (JCGM 101, clause 8)."""

from __future__ import annotations

import math
from collections.abc import Sequence

from metrocli.frozen import dataclass
from metrocli.uncertainty.monte_carlo import tolerance_of

_NOTABLE = 0.05
"""Smallest share of a variance or of a width that is reported"""


@dataclass(frozen=True)
class Judged:
    """The results of both methods for one measurand."""

    value: float
    std: float
    U: float
    nonlinear: float
    """Share of the second order in the variance"""
    second_std: float
    """Second-order standard uncertainty; NaN if its variance is negative"""
    mean: float
    mc_std: float
    interval: tuple[float, float]
    """Symmetric coverage interval of Monte Carlo"""
    normal_factor: float
    """Coverage factor of the probability for a normal distribution"""
    dof: float
    """Effective degrees of freedom"""


@dataclass(frozen=True)
class Verdict:
    """Whether Monte Carlo validates GUM, and the reasons if not."""

    valid: bool
    reasons: tuple[str, ...]


def judge(found: Judged, digits: int) -> Verdict:
    """Return the verdict: valid if the interval ends differ by at most half of the last digit of u (JCGM 101, 8.1).

    Otherwise the verdict lists reasons: a non-linear model (share of the second order, shift of the mean), a
    distribution that is not normal (k by Monte Carlo), or quantities with few degrees of freedom.
    """
    if found.std == found.mc_std == 0:
        return Verdict(True, ())
    allowed = tolerance_of(found.std or found.mc_std, digits)
    low = abs(found.value - found.U - found.interval[0])
    high = abs(found.value + found.U - found.interval[1])
    valid = low <= allowed and high <= allowed
    return Verdict(valid, () if valid else tuple(_reasons(found)))


def _reasons(found: Judged) -> Sequence[str]:
    lines = []
    if found.std == 0:
        return ["the model has no first-order sensitivity at the best estimates; only its higher orders act"]
    if found.nonlinear > _NOTABLE:
        lines.append(f"the model is not linear: the second order makes {100 * found.nonlinear:.0f} % of the variance")
    shift = found.mean - found.value
    if abs(shift) > 2 * _NOTABLE * found.std:
        lines.append(f"the mean is shifted by {shift / found.std:+.2f} u against the value at the best estimates")
    if found.mc_std > found.second_std * (1 + _NOTABLE):
        more = found.mc_std / found.second_std
        few = "few degrees of freedom" if math.isfinite(found.dof) else "higher orders act, as of a pole near the value"
        lines.append(f"the std of the trials is {more:.2f} times the second-order u: {few}")
    if found.mc_std > 0:
        half = (found.interval[1] - found.interval[0]) / 2
        factor = half / found.mc_std
        if abs(factor / found.normal_factor - 1) > _NOTABLE / 2:
            normal = f"a normal one needs {found.normal_factor:.2f}"
            lines.append(f"the distribution is not normal: it needs k = {factor:.2f}, {normal}")
        skew = (found.interval[1] + found.interval[0]) / 2 - found.mean
        if abs(skew) > 2 * _NOTABLE * half:
            lines.append(
                f"the distribution is skew: the middle of its interval lies {skew / found.mc_std:+.2f} u from its mean"
            )
        if not lines and not math.isclose(found.U, half, rel_tol=_NOTABLE / 2):
            lines.append(f"U is {found.U / half:.3f} times the half-width of the coverage interval")
    return lines or ["the intervals differ by slightly more than the significant digits allow"]
