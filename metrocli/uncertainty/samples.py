"""Values of many trials: their quantiles, coverage intervals and probabilities, kept whole or as counts in bins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]
BINS = 1 << 17
"""Bins of the counts; their width bounds the error of every quantile."""


class Sample(Protocol):
    """The values of one measurand."""

    @property
    def resolution(self) -> float:
        """How far an end of an interval can be off because values were counted in bins; 0 where all are kept."""

    def symmetric(self, probability: float) -> tuple[float, float]:
        """Return the probabilistically symmetric coverage interval (JCGM 101, 7.7.2)."""

    def shortest(self, probability: float) -> tuple[float, float]:
        """Return the shortest coverage interval (JCGM 101, 7.7.4)."""

    def below(self, limit: float) -> float:
        """Return the share of values at or below a limit."""


@dataclass(frozen=True)
class Sorted:
    """All values, in ascending order."""

    values: Array
    resolution = 0.0

    def symmetric(self, probability: float) -> tuple[float, float]:
        count = len(self.values)
        inside = min(int(probability * count + 0.5), count - 1)
        first = max((count - inside + 1) // 2 - 1, 0)
        return float(self.values[first]), float(self.values[first + inside])

    def shortest(self, probability: float) -> tuple[float, float]:
        count = len(self.values)
        inside = min(int(probability * count + 0.5), count - 1)
        first = int(np.argmin(self.values[inside:] - self.values[: count - inside]))
        return float(self.values[first]), float(self.values[first + inside])

    def below(self, limit: float) -> float:
        return float(np.searchsorted(self.values, limit, "right") / len(self.values))


@dataclass(frozen=True)
class Edges:
    """Equal bins, two open ones at the ends included."""

    low: float
    width: float

    @classmethod
    def around(cls, values: Array) -> Edges:
        """Return bins that reach as far beyond the values of a pilot run as these are wide."""
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
    """How many values fell into each bin."""

    edges: Edges
    counts: Counts
    """(BINS + 2,)"""

    @property
    def resolution(self) -> float:
        return self.edges.width

    def _cumulative(self) -> tuple[Array, Array]:
        """Return the inner edges of the bins and the share of values below each."""
        share: Array = np.cumsum(self.counts)[:-1] / float(self.counts.sum())
        at: Array = self.edges.low + self.edges.width * np.arange(BINS + 1, dtype=float)
        return at, share

    def symmetric(self, probability: float) -> tuple[float, float]:
        at, share = self._cumulative()
        low, high = np.interp([(1 - probability) / 2, (1 + probability) / 2], share, at)
        return float(low), float(high)

    def shortest(self, probability: float) -> tuple[float, float]:
        at, share = self._cumulative()
        starts = np.flatnonzero(share <= 1 - probability)
        ends = np.interp(share[starts] + probability, share, at)
        first = int(np.argmin(ends - at[starts]))
        return float(at[starts[first]]), float(ends[first])

    def below(self, limit: float) -> float:
        at, share = self._cumulative()
        return float(np.interp(limit, at, share))
