"""Decisions: capability U/T (Berndt), zones of ISO 14253-1, specific and global risks and guard bands (JCGM 106)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
GOLDEN = 0.2
"""Largest share of the tolerance that the expanded uncertainty may take (Berndt)."""
FACTOR_2017 = 1.65
"""Guard band of ISO 14253-1:2017 in standard uncertainties: 95 % on one side"""
_REACH = 9.0
"""Standard deviations beyond which a normal density counts as nothing (1e-19)"""


@dataclass(frozen=True)
class Interval:
    """Lower and upper limit, infinite where there is none."""

    low: float = -math.inf
    high: float = math.inf

    @property
    def width(self) -> float:
        """The tolerance T."""
        return self.high - self.low

    def inside(self, guard: float) -> Interval:
        """Return what is left when a guard band is taken off each limit; a negative one widens it."""
        return Interval(self.low + guard, self.high - guard)


def capable(expanded: float, tolerance: float) -> bool:
    """Tell whether U takes at most a fifth of the tolerance T, its full width (Berndt); rounding does not decide."""
    return expanded <= GOLDEN * tolerance * (1 + 1e-9)


def zone(value: float, limits: Interval, guard: float) -> str:
    """Return where a value lies (ISO 14253-1): conforming, non-conforming, or undecided within U of a limit."""
    kept, beyond = limits.inside(guard), limits.inside(-guard)
    if kept.low <= value <= kept.high:
        return "conforming"
    return "non-conforming" if value < beyond.low or value > beyond.high else "undecided"


def conformance(value: float, std: float, limits: Interval, dof: float = math.inf) -> float:
    """Return the probability that the measurand conforms, given its measured value (JCGM 106, 7.2 to 7.4).

    Normal, or a scaled t where the degrees of freedom are finite.
    """
    if std == 0:
        return float(limits.low <= value <= limits.high)
    return _cumulative((limits.high - value) / std, dof) - _cumulative((limits.low - value) / std, dof)


def _cumulative(z: float, dof: float) -> float:
    from scipy.special import ndtr, stdtr

    if not math.isfinite(z):
        return float(z > 0)
    return float(stdtr(dof, z)) if math.isfinite(dof) else float(ndtr(z))


@dataclass(frozen=True)
class Items:
    """What is known of the items before they are measured: normal."""

    mean: float
    std: float


@dataclass(frozen=True)
class Risks:
    """Global risks of a measuring process (JCGM 106, 9.5)."""

    consumer: float
    """Probability that an item is accepted and does not conform"""
    consumer_of_accepted: float
    """Probability that an accepted item does not conform"""
    producer: float
    """Probability that an item is rejected and conforms"""


def global_risk(items: Items, std: float, limits: Interval, accepted: Interval) -> Risks:
    """Return the risks when items `Y ~ N(mean, s)` are measured with u and accepted within an interval.

    Integrals over Y of the density times the probability of the decision, by Gauss-Legendre panels near the limits,
    where alone both are more than nothing; to 1e-10.
    """

    def acceptance(y: Array) -> Array:
        from scipy.special import ndtr

        chance: Array = ndtr((accepted.high - y) / std) - ndtr((accepted.low - y) / std)
        return chance

    def rejection(y: Array) -> Array:
        from scipy.special import ndtr

        chance: Array = ndtr((y - accepted.high) / std) + ndtr((accepted.low - y) / std)
        return chance

    step = min(std, items.std) / 2
    wrong = sum(_integral(items, acceptance, part, step) for part in _outside(limits, accepted, std))
    lost = sum(_integral(items, rejection, part, step) for part in _at_edges(limits, accepted, std))
    spread = math.hypot(items.std, std)
    taken = conformance(items.mean, spread, accepted)
    return Risks(wrong, wrong / taken if taken > 0 else math.nan, lost)


def _outside(limits: Interval, accepted: Interval, std: float) -> list[Interval]:
    """Return the parts beyond the limits from which an item can still be accepted."""
    reach = _REACH * std
    return [Interval(accepted.low - reach, limits.low), Interval(limits.high, accepted.high + reach)]


def _at_edges(limits: Interval, accepted: Interval, std: float) -> list[Interval]:
    """Return the parts within the limits in which a conforming item can be rejected."""
    reach = _REACH * std
    low = Interval(limits.low, min(accepted.low + reach, limits.high))
    high = Interval(max(accepted.high - reach, limits.low), limits.high)
    return [Interval(low.low, high.high)] if low.high >= high.low else [low, high]


def _integral(items: Items, chance: Callable[[Array], Array], part: Interval, step: float) -> float:
    """Integrate density times chance over a part, cut to where the density is more than nothing."""
    low = max(part.low, items.mean - _REACH * items.std)
    high = min(part.high, items.mean + _REACH * items.std)
    if not high > low:
        return 0.0
    panels = max(math.ceil((high - low) / step), 1)
    edges = np.linspace(low, high, panels + 1)
    nodes, weights = np.polynomial.legendre.leggauss(16)
    half = np.diff(edges) / 2
    y = edges[:-1, None] + half[:, None] * (nodes + 1)
    density = np.exp(-0.5 * ((y - items.mean) / items.std) ** 2) / (items.std * math.sqrt(2 * math.pi))
    return float((density * chance(y) * weights * half[:, None]).sum())


def guard_for_specific(std: float, risk: float, limits: Interval, dof: float = math.inf) -> float:
    """Return the guard band at which a value on the acceptance limit has this risk of not conforming.

    NaN where even the middle of the tolerance has a larger one.
    """
    from scipy.special import ndtri, stdtrit

    factor = float(stdtrit(dof, 1 - risk)) if math.isfinite(dof) else float(ndtri(1 - risk))
    if not math.isfinite(limits.width):
        return factor * std

    def failing(guard: float) -> float:
        return 1 - conformance(limits.low + guard, std, limits, dof)

    # The other limit takes its part: the band is at least that of one limit.
    low, high = factor * std, limits.width / 2
    return math.nan if failing(high) > risk else _root(failing, low, high, risk)


def _root(falling: Callable[[float], float], low: float, high: float, wanted: float) -> float:
    """Return where a falling function comes down to a value, by bisection; on its safe side."""
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if falling(middle) > wanted else (low, middle)
    return high


def guard_for_global(items: Items, std: float, limits: Interval, risk: float) -> float:
    """Return the guard band at which the consumer's global risk is `risk`; negative where none is needed.

    NaN where no band between -6 u and half of the tolerance (10 u for one limit) gives it.
    """

    def consumer(guard: float) -> float:
        return global_risk(items, std, limits, limits.inside(guard)).consumer

    low, high = -6 * std, min(limits.width / 2, 10 * std)
    return _root(consumer, low, high, risk) if consumer(high) <= risk <= consumer(low) else math.nan
