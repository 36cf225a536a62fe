"""Distributions of input quantities as JCGM 101, clause 6.4, assigns them: standard deviation, random draws, quantiles.

Each describes the deviation from the best estimate, so that draws do not lose digits of a large value.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.uncertainty.distributions.ziggurat import student_t

Random = np.random.Generator
_SINE = (
    1.5707963267948966, -0.6459640975062462, 0.07969262624616564, -0.0046817541353042553, 0.00016044118471309159,
    -3.5988430204672575e-6, 5.6921364280986252e-8, -6.6844168318560843e-10, 5.8729757447999501e-12,
)  # fmt: skip
"""Coefficients c of `sin(pi/2 v) = v (c0 + c1 v^2 + ...)` within |v| <= 1, to 4e-19: faster than numpy's sine"""


class Distribution(Protocol):
    """The deviation of a quantity from its best estimate."""

    @property
    def std(self) -> float:
        """Standard uncertainty according to the GUM."""

    @property
    def words(self) -> str:
        """Name of the distribution, for reports."""

    def draw(self, rng: Random, count: int) -> Array:
        """Return random deviations."""

    def quantile(self, p: Array) -> Array:
        """Return the deviation that is not exceeded with probability p."""


@dataclass(frozen=True)
class Normal:
    """Normal (JCGM 101, 6.4.7)."""

    std: float
    words = "normal"

    def draw(self, rng: Random, count: int) -> Array:
        values = rng.standard_normal(count)
        values *= self.std
        return values

    def quantile(self, p: Array) -> Array:
        from scipy.special import ndtri

        values: Array = self.std * ndtri(p)
        return values


@dataclass(frozen=True)
class StudentT:
    """Scaled and shifted t (JCGM 101, 6.4.9): the standard uncertainty of the GUM is its scale."""

    std: float
    dof: float

    @property
    def words(self) -> str:
        return f"t, {self.dof:g} degrees of freedom"

    def draw(self, rng: Random, count: int) -> Array:
        values = student_t(self.dof, rng, count)
        values *= self.std
        return values

    def quantile(self, p: Array) -> Array:
        from scipy.special import stdtrit

        values: Array = self.std * stdtrit(self.dof, p)
        return values


@dataclass(frozen=True)
class Uniform:
    """Rectangular within +-half_width (6.4.2)."""

    half_width: float
    words = "uniform"

    @property
    def std(self) -> float:
        return self.half_width / math.sqrt(3)

    def draw(self, rng: Random, count: int) -> Array:
        values = rng.random(count)
        values *= 2 * self.half_width
        values -= self.half_width
        return values

    def quantile(self, p: Array) -> Array:
        return self.half_width * (2 * p - 1)


@dataclass(frozen=True)
class Trapezoidal:
    """Symmetric trapezoid (6.4.4) whose top is `beta` of its base; beta 0 is the triangle (6.4.5), 1 the rectangle."""

    half_width: float
    beta: float = 0.0

    @property
    def words(self) -> str:
        return f"trapezoidal, beta {self.beta:g}" if self.beta else "triangular"

    @property
    def std(self) -> float:
        return self.half_width * math.sqrt((1 + self.beta**2) / 6)

    def draw(self, rng: Random, count: int) -> Array:
        wide, narrow = self.half_width * (1 + self.beta), self.half_width * (1 - self.beta)
        # the sum of two uniform numbers of different widths is a trapezoid
        values = rng.random(count)
        values *= wide
        values += narrow * rng.random(count)
        values -= self.half_width
        return values

    def quantile(self, p: Array) -> Array:
        # symmetric: the lower half is calculated, and the upper one is its mirror
        low = np.minimum(p, 1 - p)
        side = np.sqrt(2 * low * (1 - self.beta**2)) - 1
        middle = (2 * low - 1) * (1 + self.beta) / 2
        below = np.where(low <= (1 - self.beta) / (1 + self.beta) / 2, side, middle)
        values: Array = self.half_width * np.where(p < 0.5, below, -below)
        return values


@dataclass(frozen=True)
class CurvilinearTrapezoid:
    """Uniform whose half-width is itself uniform within +-inexactness (6.4.3)."""

    half_width: float
    inexactness: float

    @property
    def words(self) -> str:
        return f"curvilinear trapezoid, inexactness {self.inexactness / self.half_width:.2g} of the half-width"

    @property
    def std(self) -> float:
        return math.sqrt(self.half_width**2 / 3 + self.inexactness**2 / 9)

    def draw(self, rng: Random, count: int) -> Array:
        width = rng.random(count)
        width *= 2 * self.inexactness
        width += self.half_width - self.inexactness
        values = rng.random(count)
        values *= 2
        values -= 1
        values *= width
        return values

    def quantile(self, p: Array) -> Array:
        # the cumulative distribution has no inverse in closed form
        grid = np.linspace(-1, 1, 20_001) * (self.half_width + self.inexactness)
        values: Array = np.interp(p, self._cumulative(grid), grid)
        return values

    def _cumulative(self, x: Array) -> Array:
        """Return P(X <= x): the mean over half-widths w of the uniform's, `1/2 + x/(2w)` where |x| < w."""
        low, high = self.half_width - self.inexactness, self.half_width + self.inexactness
        inside = np.clip(np.abs(x), low, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            log_part = np.where(inside > 0, np.abs(x) * (np.log(high) - np.log(inside)), 0.0)
        tail = (inside - low + log_part) / (2 * (high - low)) if high > low else np.abs(x) / (2 * high)
        cumulative: Array = 0.5 + np.sign(x) * tail
        return cumulative


@dataclass(frozen=True)
class Arcsine:
    """U-shaped, of a sinusoid of unknown phase (6.4.6)."""

    half_width: float
    words = "arcsine"

    @property
    def std(self) -> float:
        return self.half_width / math.sqrt(2)

    def draw(self, rng: Random, count: int) -> Array:
        # sin(pi/2 V), of V uniform within +-1
        values = rng.random(count)
        values *= 2
        values -= 1
        square = np.square(values)
        total = np.full(count, _SINE[-1])
        for coefficient in _SINE[-2::-1]:
            total *= square
            total += coefficient
        values *= total
        np.clip(values, -1, 1, out=values)
        values *= self.half_width
        return values

    def quantile(self, p: Array) -> Array:
        values: Array = -self.half_width * np.cos(math.pi * p)
        return values


@dataclass(frozen=True)
class Exponential:
    """Exponential: a quantity that is not negative, of which only the best estimate is known (6.4.10)."""

    mean: float
    words = "exponential"

    @property
    def std(self) -> float:
        return self.mean

    def draw(self, rng: Random, count: int) -> Array:
        values = rng.standard_exponential(count)
        values -= 1
        values *= self.mean
        return values

    def quantile(self, p: Array) -> Array:
        values: Array = self.mean * (-np.log1p(-p) - 1)
        return values


@dataclass(frozen=True)
class Counts:
    """Mean number of events of which `count` were observed: gamma(count + 1), mean and variance count + 1 (6.4.11)."""

    count: int
    words = "counts"

    @property
    def std(self) -> float:
        return math.sqrt(self.count + 1)

    def draw(self, rng: Random, count: int) -> Array:
        values = rng.standard_gamma(self.count + 1, count)
        values -= self.count + 1
        return values

    def quantile(self, p: Array) -> Array:
        from scipy.special import gammaincinv

        values: Array = gammaincinv(self.count + 1, p) - (self.count + 1)
        return values


@dataclass(frozen=True)
class Sampled:
    """Values of an earlier evaluation, each with the same probability."""

    deviations: tuple[float, ...]
    """Deviations from the mean, in the order of the evaluation"""
    file: str = ""
    """File of the values: quantities of the same file are drawn together, row by row"""

    @property
    def words(self) -> str:
        return f"sampled, {len(self.deviations)} values"

    @property
    def std(self) -> float:
        return float(np.std(self.deviations))

    def draw(self, rng: Random, count: int) -> Array:
        return np.asarray(self.deviations)[rng.integers(len(self.deviations), size=count)]

    def quantile(self, p: Array) -> Array:
        places = np.minimum((p * len(self.deviations)).astype(np.intp), len(self.deviations) - 1)
        return np.sort(self.deviations)[places]


def in_trials(distribution: Distribution, dof: float) -> Distribution:
    """Return the Monte Carlo distribution of a quantity whose standard uncertainty has finite degrees of freedom.

    A normal distribution becomes a scaled t (JCGM 101, 6.4.9). The half-width of a uniform distribution gets the
    relative inexactness `1/sqrt(2 dof)` (GUM G.4.2, JCGM 101, 9.5.2). Other distributions stay as they are; their
    degrees of freedom enter the Welch-Satterthwaite formula only.
    """
    if not math.isfinite(dof):
        return distribution
    if isinstance(distribution, Normal):
        return StudentT(distribution.std, dof)
    if isinstance(distribution, Uniform):
        # at most the half-width itself: below 1/2 degree of freedom it would become negative
        return CurvilinearTrapezoid(distribution.half_width, distribution.half_width * min(1 / math.sqrt(2 * dof), 1))
    return distribution
