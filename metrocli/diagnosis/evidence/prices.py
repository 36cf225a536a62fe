"""The prices of explanations: what an explanation must gain in evidence, by the number of tests of its kind.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Mask
from metrocli.diagnosis.linear.candidates import CandidateGroup
from metrocli.diagnosis.linear.counting import effective_number_of_tests, of_some_members, smallest_of_family
from metrocli.diagnosis.linear.distributions import critical, log_family, single_level
from metrocli.diagnosis.linear.projection import Linearised
from metrocli.frozen import dataclass

LEVEL = 0.03
"""Share of measurements of white noise in which an effect is named, or keeps a size that others can stand for"""
ALIKE = float(np.log(20.0))
"""Difference of evidence up to which two explanations explain the readings alike"""
LITTLE = 0.05
"""Share up to which what is left of a misfit leaves it explained, and that of a signature is too little to see it"""
FURTHER = float(np.log(3.0))
"""What a further effect pays beyond the first: a third of the level"""
_LOG_ODDS = 2.0
"""ln of the prior odds for errors that are usual, and against causes that nobody knows"""
OF_UNITS = -_LOG_ODDS
"""What errors of each unit pay beyond their tests: real readings nearly always have them, prior odds of e^2"""
OF_ALL = _LOG_ODDS
"""What errors of unknown cause that all readings share pay beyond their tests: that is what effects are"""
PRIOR = 2.0
"""The declared noise in degrees of freedom"""
DRAWS = 300
"""Draws of white noise by which dependent tests are counted"""


def gain_of_columns(explained: Array, rank: Array, squares: float | Array, dof: float | Array) -> Array:
    """Return ln of the evidence of columns at their likeliest size, beside a fit with some squares and freedoms.

    The size has a g-prior. With `f = (T/q)/((S - T)/(nu - q))`, T the squares explained and q the rank, it is
    `(nu ln(S (nu - q)/((S - T) nu)) - q ln f)/2` for f > 1, else 0.
    """
    # not the whole: where everything is explained f is infinite, and so would be the evidence
    t, q = np.minimum(explained, squares * (1 - 1e-12)), np.asarray(rank, dtype=float)
    with np.errstate(all="ignore"):
        f = (t / q) / ((squares - t) / (dof - q))
        gain = (dof * np.log(squares * (dof - q) / ((squares - t) * dof)) - q * np.log(f)) / 2
    return np.where((q > 0) & (dof > q) & (f > 1), gain, 0.0)


@dataclass(frozen=True)
class Prices:
    """What each kind of explanation pays in ln of the evidence."""

    tests: tuple[float, ...]
    """Effective number of tests of each family, counted over all causes; then that of single readings"""
    causes: float
    """Effective number of causes: each has an equal share of the level"""
    dof: float
    cache: dict[tuple[int, int], float] = field(default_factory=dict, compare=False, repr=False)
    refuted: Mapping[int, Mask] = field(default_factory=dict)
    """Of some families, the alternatives that held-out readings speak against: no evidence pays for them"""

    def of_columns(self, family: int, rank: int) -> float:
        """Return the gain at which the F test of a family has the level of all: about ln(tests) + 0.5, at any rank."""
        key = family, rank
        if key not in self.cache:
            q, rest = float(rank), max(self.dof - rank, 1.0)
            f = critical(single_level(LEVEL, self.tests[family]), rank, rest)
            share = q * f / (rest + q * f)
            self.cache[key] = float(gain_of_columns(np.array(share), np.array(q), 1.0, self.dof))
        return self.cache[key]

    def of_ranks(self, family: int, ranks: Array) -> Array:
        """Return the prices of the alternatives of a family by their ranks; 0 for rank 0."""
        prices = np.zeros(len(ranks))
        for rank in np.unique(ranks[ranks > 0]).tolist():
            prices[ranks == rank] = self.of_columns(family, int(rank))
        return np.where(self.refuted[family], np.inf, prices) if family in self.refuted else prices


def price_of_variance(tests: float) -> float:
    """Return the gain of the likelihood at which one variance, of so many tested, has the level: half a chi-squared."""
    from scipy.special import ndtri

    # one-sided: a variance can only be larger than 0
    return float(ndtri(LEVEL / max(tests, 1.0)) ** 2 / 2)


def counted(
    system: Linearised,
    families: Sequence[CandidateGroup],
    readings: int,
    rng: np.random.Generator,
    everywhere: int = 0,
) -> Prices:
    """Return the prices, with the effective numbers of tests from simulated white noise.

    Errors of single readings are nearly independent tests, so their number is that of the readings. Each effect that
    may act `everywhere`, at all its places at once, is one test.
    """
    every = system.dof + PRIOR
    system, families = of_some_members(system, families, rng)
    noise = system.seen(rng.normal(size=(system.rows, DRAWS)))
    # chi-square with as many degrees of freedom as the declared noise counts for, so that the draws have its part too
    squares, dof = (noise**2).sum(axis=0) + rng.chisquare(PRIOR, DRAWS), system.dof + PRIOR
    least = [smallest_of_family(family, noise, squares, dof) for family in families]
    counts = [effective_number_of_tests(levels_) for levels_ in least]
    levels = [log_family(levels_, count) for levels_, count in zip(least, counts, strict=True)]
    # one more for wrong readings, which are a family of their own, and one for each effect at all its places
    # (docs/decisions/266-all-names-share-one-level.md)
    causes = (effective_number_of_tests(np.min(levels, axis=0)) if levels else 0.0) + 1.0 + everywhere
    return Prices((*(causes * count for count in counts), causes * max(readings, 1)), causes, every)
