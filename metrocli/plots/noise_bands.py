"""What pure noise may do: bounds that normalised residuals w ~ N(0, 1) leave in 5 % of measurements."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass

LEVEL = 0.95
"""Probability that pure noise stays inside an envelope as a whole"""
_BINS, _FEWEST = 20, 5
_DENSE = 2000
"""Ranks of each half at which the bounds are computed; between them they are interpolated"""
_COUNTS = (3, 5, 10, 20, 50, 100, 300, 1000, 3000, 10000, 30000)
_LOCAL = (0.0180, 0.0117, 0.0074, 0.0048, 0.0029, 0.00224, 0.0015, 0.00113, 0.00092, 0.00072, 0.00064)
"""Level of each ordered value by which all n together stay inside with 95 %, from 3,000 to 20,000 simulations each"""


def normal_quantile(probability: Array | float) -> Array:
    """Return the quantile of the standard normal distribution."""
    from scipy.special import ndtri

    return np.asarray(ndtri(probability), dtype=float)


def largest_of(count: int) -> float:
    """Return the bound that the largest of `count` values |w| exceeds in 5 % of measurements: one value in 20."""
    return float(normal_quantile(1 - (1 - LEVEL ** (1 / max(count, 1))) / 2))


@dataclass(frozen=True)
class Trend:
    """Means of w over bins of a covariate, with the envelope of pure noise."""

    middles: Array
    """(m,) mean of the covariate in each bin"""
    means: Array
    """(m,) mean of w"""
    bounds: Array
    """(m,) all m means of pure noise lie within plus and minus these with a probability of 95 %"""

    stds: Array
    """(m,) standard deviation of each mean of pure noise"""

    @property
    def beyond(self) -> Index:
        """The bins whose mean is outside the envelope."""
        return np.flatnonzero(np.abs(self.means) > self.bounds)


def trend(covariate: Array, w: Array) -> Trend:
    """Return the means of w over up to 20 bins of nearly equal counts; readings of one value stay together.

    The mean of n values of pure noise has the standard deviation 1/sqrt(n). The bound is `z / sqrt(n)` with z such that
    all m means are inside with 95 %: `z = Phi^-1(1 - (1 - 0.95^(1/m)) / 2)`. An adjustment makes the means of its
    residuals a little smaller, so the envelope is on the safe side.
    """
    order = np.argsort(covariate, kind="stable")
    bins = max(min(_BINS, len(w) // _FEWEST), 1)
    values = covariate[order]
    wanted = np.arange(1, bins) * len(w) // bins
    # the next place at which the covariate changes, so that equal values are in one bin
    cuts = np.unique(np.searchsorted(values, values[wanted], side="left"))
    cuts = np.append(0, cuts[cuts > 0])
    counts = np.diff(np.append(cuts, len(w)))
    middles = np.add.reduceat(values, cuts) / counts
    means = np.add.reduceat(w[order], cuts) / counts
    stds = 1 / np.sqrt(counts)
    return Trend(middles, means, largest_of(len(counts)) * stds, stds)


@dataclass(frozen=True)
class NormalPlot:
    """Ordered values of w against those that the normal distribution expects, with the envelope of pure noise."""

    rows: Index
    """(n,) row of each ordered value"""
    expected: Array
    ordered: Array
    low: Array
    high: Array

    @property
    def outside(self) -> int:
        """The number of values outside the envelope."""
        return int(((self.ordered < self.low) | (self.ordered > self.high)).sum())


def normal_plot(w: Array) -> NormalPlot:
    """Return the normal plot of w (n,): `Phi^-1((i - 3/8) / (n + 1/4))` and bounds for all n together (95 %).

    w has to be finite. The i-th of n uniform values has a Beta(i, n + 1 - i) distribution, and all have the same level
    `local_level(n)`.
    """
    from scipy.special import betaincinv

    count = len(w)
    rows = np.argsort(w, kind="stable")
    rank = np.arange(1.0, count + 1)
    half = local_level(count) / 2
    # the upper bounds follow from the lower ones by symmetry, without the rounding of probabilities near 1
    expected = normal_quantile((rank - 0.375) / (count + 0.25))
    some = rank if count <= 2 * _DENSE else np.unique(np.geomspace(1, count / 2, _DENSE).round())
    some = np.union1d(some, count + 1 - some)
    some_low = normal_quantile(betaincinv(some, count + 1 - some, half))
    low = np.interp(rank, some, some_low)
    return NormalPlot(rows, expected, w[rows], low, -low[::-1])


def local_level(count: int) -> float:
    """Return the level of each of n ordered values by which all together stay inside with 95 %.

    Simulated for 3 to 30,000 values, interpolated in log n; beyond that the last value.
    """
    return float(np.exp(np.interp(np.log(count), np.log(_COUNTS), np.log(_LOCAL))))
