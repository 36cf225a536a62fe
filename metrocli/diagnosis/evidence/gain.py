"""The gain of an explanation: how much better held-out readings are predicted with it.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.frozen import dataclass

PREDICTED = 100.0
"""Largest variance of a prediction, relative to that of the noise

A reading beyond it, which the others hardly determine, shows no gain and is left out of the errors.
"""
LEAST_CHANGE = 0.005
"""Least share of the held-out errors that is shown as a change"""


@dataclass(frozen=True)
class Gain:
    """Gain of an explanation: how much better held-out readings are predicted with it."""

    before: float
    """Root mean square error of prediction without the explanation, in the internal unit of the report"""
    after: float
    """The same with the explanation"""
    median_before: float
    """Median of the absolute errors of prediction without the explanation"""
    median_after: float
    ratio: float
    """`after / before`; if the units of readings differ, of errors in standard deviations"""
    log_score: float
    """Sum over the folds of `ln p(held-out | others)` with the explanation less that without it"""
    log_score_std: float
    """Standard error of that sum, by the scatter of the folds; inf of a single fold"""
    folds: tuple[float, ...] = ()
    """The term of each fold in the log score"""

    @property
    def shown(self) -> bool:
        """Whether the gain exceeds twice its standard error."""
        return self.log_score > 2 * self.log_score_std

    @property
    def explains(self) -> bool:
        """Whether the density of held-out readings gains, and their errors do not grow."""
        return self.log_score > 0 and self.reduction >= -LEAST_CHANGE

    @property
    def reduction(self) -> float:
        """Fraction by which the root mean square error decreases, readings of different units together."""
        return 1 - self.ratio

    @property
    def explained(self) -> float:
        """Fraction by which the sum of squares of the errors decreases."""
        return 1 - self.ratio**2


@dataclass(frozen=True)
class FoldPrediction:
    """Prediction of one fold, each reading in its standard deviation."""

    score: float
    """`ln p(held-out | others)`"""
    errors: Array
    """Reading less prediction, (n,)"""
    scale: Array
    """Standard deviation of each reading in the unit of the report, nan for readings of other units, (n,)"""
    shares: Array
    """Number of independent errors that each amounts to: 1 less what unknowns that only its fold shows absorb, (n,)"""
    variances: Array
    """Variance of each error, with that of the reading, (n,)"""

    def mixed(self, other: FoldPrediction, weight: float) -> FoldPrediction:
        """Return the mixture of two predictions of a fold, the other with the probability w = `weight`.

        Density `(1 - w) p + w p'`, its mean, and its variance `(1 - w) v + w v' + w (1 - w) (e' - e)^2` (Bayesian model
        averaging: Hoeting et al. 1999).
        """
        if weight >= 1:
            return other
        own = 1 - weight
        score = float(np.logaddexp(np.log(own) + self.score, np.log(weight) + other.score)) if weight else self.score
        errors = own * self.errors + weight * other.errors
        between = own * weight * (other.errors - self.errors) ** 2
        variances = own * self.variances + weight * other.variances + between
        return FoldPrediction(score, errors, self.scale, self.shares, variances)


def gain_of(pairs: Sequence[tuple[FoldPrediction, FoldPrediction]]) -> Gain:
    """Return the gain from the predictions of each fold, without and with what is judged.

    The log score is the sum of the differences d of the G folds, its standard error `sqrt(G) std(d)`.
    """
    differences = np.array([after.score - before.score for before, after in pairs])
    # a single fold shows no scatter: its gain is never called certain
    spread = float(differences.std(ddof=1)) if len(differences) > 1 else float("inf")
    # by both sides, so that the two errors are those of the same readings
    kept = [np.maximum(before.variances, after.variances) <= PREDICTED for before, after in pairs]
    statistics = []
    for side in zip(*pairs, strict=True):
        errors, scale, shares = (
            np.concatenate([getattr(fold, name)[own] for fold, own in zip(side, kept, strict=True)])
            for name in ("errors", "scale", "shares")
        )
        in_unit = np.isfinite(scale)
        reported = (errors * scale)[in_unit]
        # divided by independent errors and not by rows: what local unknowns take of a held-out image shows no error
        rms = float(np.sqrt((reported**2).sum() / max(float(shares[in_unit].sum()), 1e-9)))
        median = float(np.median(np.abs(reported))) if reported.size else 0.0
        # errors of different units are compared in their standard deviations; their number is that of both sides
        statistics.append((rms, median, rms if in_unit.all() else float(np.sqrt((errors**2).sum()))))
    (rms, median, size), (rms_after, median_after, size_after) = statistics
    ratio = size_after / size if size > 0 else 1.0
    # the standard deviation of a sum of independent terms, each with that of a fold
    std = spread * float(np.sqrt(len(differences)))
    score = float(differences.sum())
    return Gain(rms, rms_after, median, median_after, ratio, score, std, tuple(differences.tolist()))
