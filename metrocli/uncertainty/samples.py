"""Values of many trials, all kept or counted in bins: quantiles, coverage intervals and probabilities.

Method: docs/algorithms/monte-carlo-chunks.md.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from metrocli.arrays import Array
from metrocli.frozen import dataclass

Counts = npt.NDArray[np.int64]
BINS = 1 << 17
"""Number of bins; their width limits the error of every quantile"""
SOME = 10_000
"""Number of values that show where the ends of an interval are"""


@dataclass(frozen=True)
class Kept:
    """All values, in any order."""

    values: Array
    resolution = 0.0
    """Largest error of an interval end from counting in bins; 0 if all values are kept"""

    def symmetric(self, probability: float) -> tuple[float, float]:
        """Return the probabilistically symmetric coverage interval (JCGM 101, 7.7.2)."""
        first, inside = _ranks(len(self.values), probability)
        lowest, highest = self._ends(max(first, len(self.values) - first - inside + 1))
        return float(lowest[first - 1]), float(highest[first - 1 + inside - len(self.values)])

    def shortest(self, probability: float) -> tuple[float, float]:
        """Return the shortest coverage interval (JCGM 101, 7.7.4)."""
        _, inside = _ranks(len(self.values), probability)
        lowest, highest = self._ends(len(self.values) - inside)
        first = int(np.argmin(highest - lowest))
        return float(lowest[first]), float(highest[first])

    def below(self, limit: float) -> float:
        """Return the share of values at or below a limit."""
        return float(np.count_nonzero(self.values <= limit) / len(self.values))

    def _ends(self, count: int) -> tuple[Array, Array]:
        """Return the `count` smallest and the `count` largest values, each in ascending order."""
        # bounds that some of the values suggest leave few to sort
        some = np.sort(self.values[:: max(len(self.values) // SOME, 1)])
        place = count * len(some) // len(self.values) + SOME // 100
        if 2 * place < len(some):
            lowest, highest = self.values[self.values <= some[place]], self.values[self.values >= some[-1 - place]]
            if min(len(lowest), len(highest)) >= count:
                return np.sort(lowest)[:count], np.sort(highest)[-count:]
        ordered = np.sort(self.values)
        return ordered[:count], ordered[-count:]


@dataclass(frozen=True)
class Edges:
    """Edges of equal bins, with one open bin at each end."""

    low: float
    width: float

    @classmethod
    def around(cls, values: Array) -> Edges:
        """Return bins that extend beyond the values of a pilot run by half of their range at each end."""
        low, high = float(values.min()), float(values.max())
        span = (high - low) or max(abs(low), 1.0) * 1e-9
        return cls(low - span / 2, 2 * span / BINS)

    def places(self, values: Array) -> npt.NDArray[np.int32]:
        """Return the bin of each value, 0 and BINS + 1 beyond the ends."""
        scaled = values - self.low
        scaled /= self.width
        scaled += 1.0
        np.clip(scaled, 0.0, BINS + 1.0, out=scaled)
        return scaled.astype(np.int32)


@dataclass(frozen=True)
class Binned:
    """Number of values in each bin, with the same properties as `Kept`."""

    edges: Edges
    counts: Counts
    """(BINS + 2,)"""

    @property
    def resolution(self) -> float:
        return self.edges.width

    def _at(self, ranks: Array, reached: Counts) -> Array:
        """Return the values of these ranks (1: smallest), interpolated in bins; `reached` is the cumulative count."""
        bins = np.searchsorted(reached, ranks, "left")
        before = reached[bins] - self.counts[bins]
        values: Array = self.edges.low + self.edges.width * (bins - 1 + (ranks - before) / self.counts[bins])
        return values

    def symmetric(self, probability: float) -> tuple[float, float]:
        reached = np.cumsum(self.counts)
        first, inside = _ranks(int(reached[-1]), probability)
        low, high = self._at(np.array([first, first + inside], dtype=float), reached)
        return float(low), float(high)

    def shortest(self, probability: float) -> tuple[float, float]:
        reached = np.cumsum(self.counts)
        _, inside = _ranks(int(reached[-1]), probability)
        # lower ends at edges of bins only: between them the width changes by less than a bin, which `resolution` states
        firsts = np.unique(reached[reached > 0])
        firsts = np.concatenate([[1], firsts[firsts + inside <= reached[-1]]])
        lows, highs = self._at(firsts.astype(float), reached), self._at((firsts + inside).astype(float), reached)
        best = int(np.argmin(highs - lows))
        return float(lows[best]), float(highs[best])

    def below(self, limit: float) -> float:
        reached = np.concatenate([[0], np.cumsum(self.counts)])
        # the open bins at the ends are taken as one width wide
        at = self.edges.low + self.edges.width * np.arange(-1, BINS + 2, dtype=float)
        return float(np.interp(limit, at, reached / reached[-1]))


MeasurandSample = Kept | Binned
"""The values of one measurand"""


def _ranks(count: int, probability: float) -> tuple[int, int]:
    """Return the rank of the lower end of a symmetric interval, and the number of ranks to the upper end."""
    # JCGM 101, 7.7.1: q is pM if that is an integer, else the integer part of pM + 1/2
    inside = min(int(probability * count + 0.5), count - 1)
    return max((count - inside + 1) // 2, 1), inside
