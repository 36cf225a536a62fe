"""What a campaign prints: shares and numbers, each with its bar; fields are two spaces apart."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf


def _row(what: str, of: str, value: str, bar: str, verdict: str) -> str:
    return f"{what:58}  {of:>9}  {value:24}  {bar:15}  {verdict}".rstrip()


@dataclass(frozen=True)
class Rate:
    """How often something happened, with the bounds that so many cases leave (Clopper and Pearson, 95 %)."""

    what: str
    hits: int
    of: int
    least: float = 0.0
    most: float = 1.0

    @property
    def bounds(self) -> tuple[float, float]:
        """The 95 % interval of the share (Clopper and Pearson)."""
        from scipy.special import betaincinv

        k, n = self.hits, self.of
        low = 0.0 if k == 0 else float(betaincinv(k, n - k + 1, 0.025))
        high = 1.0 if k == n else float(betaincinv(k + 1, n - k, 0.975))
        return low, high

    @property
    def share(self) -> float:
        """The share."""
        return self.hits / self.of

    @property
    def met(self) -> bool:
        """Whether the share is where it should be; of a band, whether the interval of the share reaches it."""
        if self.least > 0 and self.most < 1:
            low, high = self.bounds
            return low <= self.most and high >= self.least
        return self.least <= self.share <= self.most

    @property
    def verdict(self) -> str:
        """In words: a share beyond its bar is `too few` where its interval reaches the bar."""
        low, high = self.bounds
        if self.met:
            return "met"
        return "too few" if low <= self.most and high >= self.least else "NOT MET"

    def __str__(self) -> str:
        low, high = self.bounds
        bar = f">= {self.least:.0%}" if self.least else ""
        bar += (" and " if bar and self.most < 1 else "") + (f"<= {self.most:.0%}" if self.most < 1 else "")
        value = f"{self.share:.1%} [{low:.1%}, {high:.1%}]"
        return _row(self.what, f"{self.hits}/{self.of}", value, bar, "" if not bar else self.verdict)


@dataclass(frozen=True)
class Number:
    """A number with the band that it has to be in: of how many cases, and in which unit."""

    what: str
    of: str
    value: float
    least: float = -inf
    most: float = inf
    unit: str = ""

    @property
    def met(self) -> bool:
        """Whether the number is in its band."""
        return self.least <= self.value <= self.most

    def __str__(self) -> str:
        ends = [f"{sign} {end:g}" for sign, end in ((">=", self.least), ("<=", self.most)) if abs(end) < inf]
        verdict = "" if not ends else "met" if self.met else "NOT MET"
        return _row(self.what, self.of, f"{self.value:.3g} {self.unit}".rstrip(), " and ".join(ends), verdict)
