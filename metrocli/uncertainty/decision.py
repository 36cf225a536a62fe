"""Decisions: capability U/T (Berndt), zones of ISO 14253-1, specific and global risks and guard bands (JCGM 106)."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from metrocli.adjust.probabilities import student_tail
from metrocli.arrays import Array
from metrocli.frozen import dataclass

GOLDEN = 0.2
"""Largest ratio of expanded uncertainty to tolerance (Berndt)"""
FACTOR_2017 = 1.65
"""Guard band of ISO 14253-1:2017 in standard uncertainties: 95 % on one side"""
_REACH = 9.0
"""Number of standard deviations beyond which a normal probability (1e-19) is neglected"""


@dataclass(frozen=True)
class Interval:
    """Lower and upper limit; a missing limit is infinite."""

    low: float = -math.inf
    high: float = math.inf

    @property
    def width(self) -> float:
        """Width of the interval, the tolerance T."""
        return self.high - self.low

    def inside(self, guard: float) -> Interval:
        """Return the interval reduced by a guard band at each limit; a negative guard band widens it."""
        return Interval(self.low + guard, self.high - guard)


def capable(expanded: float, tolerance: float) -> bool:
    """Return whether U is at most a fifth of the full tolerance T (Berndt), with an allowance for rounding."""
    return expanded <= GOLDEN * tolerance * (1 + 1e-9)


def zone(value: float, limits: Interval, guard: float) -> str:
    """Return the zone of a value (ISO 14253-1): conforming, non-conforming, or undecided within `guard` of a limit."""
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
    if not math.isfinite(z):
        return float(z > 0)
    return student_tail(dof, -z) if math.isfinite(dof) else math.erfc(-z / math.sqrt(2)) / 2


@dataclass(frozen=True)
class Items:
    """Prior distribution of the items, a normal distribution."""

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
    """Return the risks if items `Y ~ N(mean, s)` are measured with u and accepted within an interval.

    Each risk is the integral over Y of the density times the probability of the decision. It uses Gauss-Legendre panels
    near the limits, where the integrand is not negligible, and is accurate to 1e-10.
    """

    def acceptance(y: Array) -> Array:
        from scipy.special import ndtr

        chance: Array = ndtr((accepted.high - y) / std) - ndtr((accepted.low - y) / std)
        return chance

    def rejection(y: Array) -> Array:
        from scipy.special import ndtr

        chance: Array = ndtr((y - accepted.high) / std) + ndtr((accepted.low - y) / std)
        return chance

    # the integrand varies over the narrower of both widths: 16 nodes on half of it are exact to rounding
    step = min(std, items.std) / 2
    wrong = sum(_integral(items, acceptance, part, step) for part in _outside(limits, accepted, std))
    lost = sum(_integral(items, rejection, part, step) for part in _at_edges(limits, accepted, std))
    spread = math.hypot(items.std, std)
    taken = conformance(items.mean, spread, accepted)
    return Risks(wrong, wrong / taken if taken > 0 else math.nan, lost)


def _outside(limits: Interval, accepted: Interval, std: float) -> list[Interval]:
    """Return the parts beyond the limits from which an item can still be accepted."""
    reach = _REACH * std
    # a missing limit is infinite; its part then has no width, and its integral is 0
    return [Interval(accepted.low - reach, limits.low), Interval(limits.high, accepted.high + reach)]


def _at_edges(limits: Interval, accepted: Interval, std: float) -> list[Interval]:
    """Return the parts within the limits in which a conforming item can be rejected."""
    reach = _REACH * std
    low = Interval(limits.low, min(accepted.low + reach, limits.high))
    high = Interval(max(accepted.high - reach, limits.low), limits.high)
    # one part where both edges overlap, so that nothing is counted twice
    return [Interval(low.low, high.high)] if low.high >= high.low else [low, high]


def _integral(items: Items, chance: Callable[[Array], Array], part: Interval, step: float) -> float:
    """Return the integral of density times chance over the part where the density is not negligible."""
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
    """Return the guard band for which a value on the acceptance limit has this risk of non-conformity.

    Return NaN if the risk is larger even in the middle of the tolerance.
    """
    from scipy.special import ndtri, stdtrit

    factor = float(stdtrit(dof, 1 - risk)) if math.isfinite(dof) else float(ndtri(1 - risk))
    if not math.isfinite(limits.width):
        return factor * std

    def failing(guard: float) -> float:
        return 1 - conformance(limits.low + guard, std, limits, dof)

    # the other limit adds to the risk, so the band is at least that of a single limit
    low, high = factor * std, limits.width / 2
    return math.nan if failing(high) > risk else _root(failing, low, high, risk)


def _root(falling: Callable[[float], float], low: float, high: float, wanted: float) -> float:
    """Return where a falling function reaches a value, by bisection, rounded to the side where it is below."""
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if falling(middle) > wanted else (low, middle)
    return high


def guard_for_global(items: Items, std: float, limits: Interval, risk: float) -> float:
    """Return the guard band for which the global consumer's risk is `risk`; it can be negative.

    Return NaN if no band between -6 u and half of the tolerance (10 u for a single limit) gives this risk.
    """

    def consumer(guard: float) -> float:
        return global_risk(items, std, limits, limits.inside(guard)).consumer

    low, high = -6 * std, min(limits.width / 2, 10 * std)
    return _root(consumer, low, high, risk) if consumer(high) <= risk <= consumer(low) else math.nan
