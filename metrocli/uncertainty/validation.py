"""Validation of the law of propagation: its interval against that of Monte Carlo (JCGM 101, clause 8)."""

from __future__ import annotations

import math
from collections.abc import Sequence

from metrocli.frozen import dataclass
from metrocli.uncertainty.monte_carlo import tolerance_of
from metrocli.uncertainty.samples import MeasurandSample

_NOTABLE = 0.05
"""Smallest share of a variance or of a width that is reported"""
_SURE = 3.0
"""Standard errors of an interval end within which the end of all possible trials is taken to lie"""
_FINER = 5.0
"""Share of the tolerance to which trials that decide know the interval ends: a fifth (JCGM 101, 8.2)"""
_MOST_TRIALS = 1e9
"""Largest number of trials of a job"""


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
    known: tuple[tuple[float, float], tuple[float, float]]
    """Where each of its ends lies with any number of trials, by the scatter of these"""
    trials: int
    normal_factor: float
    """Coverage factor of the probability for a normal distribution"""
    t_std: float
    """Standard deviation of the trials if the model is linear: t distributions are wider than u"""


@dataclass(frozen=True)
class Validation:
    """Whether Monte Carlo validates GUM, None where the trials cannot decide it, and the reasons if not."""

    valid: bool | None
    reasons: tuple[str, ...]


def known_ends(
    sample: MeasurandSample, probability: float, trials: int
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return between which values each end of the symmetric interval of a distribution lies, from its trials.

    The share of trials beyond an end is binomial, whatever the distribution.
    """
    beyond = (1 - probability) / 2
    scatter = 2 * _SURE * math.sqrt(beyond * (1 - beyond) / trials)
    outer, inner = (sample.symmetric(min(max(p, 0.0), 1.0)) for p in (probability + scatter, probability - scatter))
    return (outer[0], inner[0]), (inner[1], outer[1])


def judge(judged: Judged, digits: int) -> Validation:
    """Return the verdict: valid if the interval ends differ by at most half of the last digit of u (JCGM 101, 8.1).

    Where the ends may differ by less or by more, as far as the trials know them, the verdict is open. Otherwise it
    lists reasons: a non-linear model (share of the second order, shift of the mean), a distribution that is not normal
    (k by Monte Carlo), or quantities with few degrees of freedom.
    """
    if judged.std == judged.mc_std == 0:
        return Validation(True, ())
    allowed = tolerance_of(judged.std or judged.mc_std, digits)
    ends = judged.value - judged.U, judged.value + judged.U
    apart = [(low - end, end - high) for end, (low, high) in zip(ends, judged.known, strict=True)]
    if max(map(max, apart)) > allowed:
        return Validation(False, tuple(_reasons(judged)))
    if max(-min(pair) for pair in apart) <= allowed:
        return Validation(True, ())
    return Validation(None, (_undecided(judged, allowed),))


def _undecided(judged: Judged, allowed: float) -> str:
    """Return why the trials do not decide, and how many would."""
    error = max(high - low for low, high in judged.known) / (2 * _SURE)
    needed = judged.trials * (2 * error * _FINER / allowed) ** 2
    text = (
        f"{judged.trials} trials know the interval ends to {error:.2g} (standard error), too little for a difference "
        f"of {allowed:.2g}, half of the last digit of u"
    )
    if needed <= judged.trials:
        return f"the interval ends differ by {allowed:.2g}, half of the last digit of u, as nearly as the trials know"
    if needed > _MOST_TRIALS:
        return f"{text}: take fewer `digits`"
    # rounded up to two digits
    step = 10.0 ** (math.floor(math.log10(needed)) - 1)
    return f"{text}: `trials: {math.ceil(needed / step) * step:.0f}` would do"


def _reasons(judged: Judged) -> Sequence[str]:
    lines = []
    if judged.std == 0:
        return ["the model has no first-order sensitivity at the best estimates; only its higher orders act"]
    if judged.nonlinear > _NOTABLE:
        lines.append(f"the model is not linear: the second order makes {100 * judged.nonlinear:.0f} % of the variance")
    shift = judged.mean - judged.value
    if abs(shift) > 2 * _NOTABLE * judged.std:
        lines.append(f"the mean is shifted by {shift / judged.std:+.2f} u against the value at the best estimates")
    if judged.mc_std > judged.second_std * (1 + _NOTABLE):
        more = judged.mc_std / judged.second_std
        lines.append(f"the std of the trials is {more:.2f} times the second-order u: {_wider(judged)}")
    if judged.mc_std > 0:
        half = (judged.interval[1] - judged.interval[0]) / 2
        factor = half / judged.mc_std
        if abs(factor / judged.normal_factor - 1) > _NOTABLE / 2:
            normal = f"a normal one needs {judged.normal_factor:.2f}"
            lines.append(f"the distribution is not normal: it needs k = {factor:.2f}, {normal}")
        skew = (judged.interval[1] + judged.interval[0]) / 2 - judged.mean
        if abs(skew) > 2 * _NOTABLE * half:
            lines.append(
                f"the distribution is skew: the middle of its interval lies {skew / judged.mc_std:+.2f} u from its mean"
            )
        # only where nothing else is named: the other reasons change U as well
        if not lines and not math.isclose(judged.U, half, rel_tol=_NOTABLE / 2):
            lines.append(f"U is {judged.U / half:.3f} times the half-width of the coverage interval")
    return lines or ["the intervals differ by slightly more than the significant digits allow"]


def _wider(judged: Judged) -> str:
    """Return why trials scatter more than the second order: t distributions, what is beyond it, or both."""
    few, poles = "few degrees of freedom", "higher orders act, as of a pole near the value"
    of_t = math.sqrt(judged.second_std**2 + max(judged.t_std**2 - judged.std**2, 0.0))
    if judged.mc_std <= of_t * (1 + _NOTABLE):
        return few
    return f"{few}, and {poles}" if of_t > judged.second_std * (1 + _NOTABLE) else poles
